"""The command line, tables and pictures."""
