"""Errors of the robot cell.

The plant and the controller do not know each other, so each has one base class of its own; the
command line catches both.
"""


class PlantError(Exception):
    """Base of all errors raised by ``plant``; its text is one line fit to be shown to a user."""


class ArmError(PlantError):
    """An arm of one's own cannot be used.

    Attributes: ``source``, the file or the key it is about; ``reason``.
    """

    def __init__(self, source: str, reason: str) -> None:
        self.source = source
        self.reason = reason
        super().__init__(f"{source}: {reason}")


class UnstableSimulationError(PlantError):
    """The physics has left what it can compute.

    Attributes: ``time``, when [s].
    """

    def __init__(self, time: float) -> None:
        self.time = time
        super().__init__(
            f"the simulation became unstable at t = {time:.3f} s (a control loop that diverges, or "
            "a physics step too long for the stiffness)"
        )
