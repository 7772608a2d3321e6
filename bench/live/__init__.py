"""The live cell: a process that runs the experiment, and a page that shows it and asks for changes."""
