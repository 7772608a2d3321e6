"""Errors of the experiments: everything a scenario, its motion or its loop can refuse."""


class ScenarioError(Exception):
    """Base of all errors raised by ``scenarios``; its text is one line, fit to be shown."""
