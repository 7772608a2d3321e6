"""Motion that nearly repeats itself: learned beat by beat, and previewed (``docs/rhythm.md``)."""
