"""What is to be small: the force error, and what a controller must not buy it with."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scenarios.log import Log

Array = NDArray[np.float64]

CHATTER = 4.2
"""RMS of the torques' increments that costs nothing [N m]: about what the predictive controller
makes with its shipped values, so that nobody is held to less."""


@dataclass(frozen=True)
class Cost:
    """The parts of the cost of one run."""

    error: float
    """RMS force error as a share of that of a tool held still, over the axes [-]."""
    chatter: float
    """RMS of the increments of the joint torques [N m]."""
    saturated: float
    """Share of the cycles with a torque or a command on its bound [-]."""
    lost: float
    """Share of the run that a trip of the protection took [-]."""

    @property
    def total(self) -> float:
        """The cost: error, chatter beyond what is free, saturation; a trip weighs most."""
        excess = max(0.0, self.chatter / CHATTER - 1.0)
        trip = 1.0 + self.lost if self.lost > 0 else 0.0
        return self.error + excess + self.saturated + trip


WORST = 4.0
"""Cost where there is no run: the controller cannot be made, or what it does is no number."""


def cost(log: Log, held: Array, cycles: int) -> Cost:
    """Return the cost of a run.

    Args:
        log: of the run.
        held: force error of a tool held still, ``(cycles, 3)`` [N].
        cycles: of the whole run.
    """
    end = log.counted
    index = ["xyz".index(axis) for axis in log.axes]
    error = log.force[:end, index] - log.setpoint[:end]
    share = np.sqrt(np.mean(error**2, axis=0) / np.mean(held[:, index] ** 2, axis=0))
    saturated = log.torque_saturated[:end] | log.command_saturated[:end]
    return Cost(
        error=float(min(1.0, np.sqrt(np.mean(share**2)))),
        chatter=float(np.sqrt(np.mean(np.diff(log.torque[:end], axis=0) ** 2))),
        saturated=float(saturated.mean()),
        lost=1.0 - end / cycles,
    )
