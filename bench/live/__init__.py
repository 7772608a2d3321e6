"""The live cell: a process that runs the experiment, and a page that shows and changes it."""
