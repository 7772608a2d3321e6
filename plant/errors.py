"""Errors of the robot cell.

The plant and the controller do not know each other, so each has one base class of its own; the
command line catches both.
"""


class PlantError(Exception):
    """Base of all errors raised by ``plant``; its text is one line fit to be shown to a user."""
