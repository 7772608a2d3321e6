"""The verbs of the command line, one module a family: arguments as records, and what they do."""
