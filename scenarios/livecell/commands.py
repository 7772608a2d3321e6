"""What can be asked of a running experiment."""

from dataclasses import dataclass
from enum import StrEnum

from scenarios.motion.config import AXES

SETTABLE = frozenset(
    {
        "backend",
        "controller.kind",
        "controller.force_weight",
        "controller.increment_weight",
        "controller.reference_time",
        "controller.bounds.command",
        "cell.contact.stiffness",
        *(f"controller.bounds.force.{axis}" for axis in AXES),
        *(f"setpoint.{axis}" for axis in AXES),
    }
)
"""Keys of the scenario that may change while it runs."""


@dataclass(frozen=True)
class Set:
    """Give a key of the scenario another value; checked as one of a file is."""

    key: str
    value: float | str | tuple[float, float]


class Act(StrEnum):
    """Let something happen."""

    EARLY_BEAT = "early beat"
    DROPOUT = "sensor dropout"
    SOLVER_FAILURE = "solver failure"
    PAUSE = "pause"
    RESUME = "resume"
    STEP = "step"
    RESET = "reset"
    RECORD = "record"
    KEEP = "keep"
    """End the recording and write it."""


Command = Set | Act


class Kind(StrEnum):
    """What an `Event` is."""

    TOLD = "told"
    REFUSED = "refused"
    FAILED = "failed"
    """It cannot go on without a reset."""


@dataclass(frozen=True)
class Event:
    """What came of a command, or happened by itself."""

    kind: Kind
    text: str
    time: float
    """Of the experiment [s]."""
