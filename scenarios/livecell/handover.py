"""From one controller to another without a jump in the command.

The new one first runs beside the old one, unheard: it sees the same measurements and is told which
commands are applied, so that its observer has settled before anything depends on it. Then the
command passes over, as a mean of both that shifts to the new one. Bounds on command and rate are
intervals that both heed, so the mean heeds them too; and no change of the command from cycle to
cycle is larger than the larger of what the two would do, but for what they differ by in the share
of one cycle.
"""

import numpy as np
from numpy.typing import NDArray

from plant.interface import Measurement
from qpmpc.step import Step
from scenarios.approach import ContactState, Recovery
from scenarios.cycle import ControlCycle

Array = NDArray[np.float64]
SETTLING, PASSING = 0.15, 0.1
"""How long the new controller runs unheard, and how long the command then takes to pass [s]."""


class Handover:
    """The controller in force, and the one that comes."""

    def __init__(self, cycle: ControlCycle, period: float) -> None:
        """Begin with one in force.

        Args:
            cycle: the controller with what it is asked about.
            period: of control [s].
        """
        self.cycle = cycle
        """The one in force."""
        self.command = np.zeros(3)
        """What is applied, ``(3,)`` [m/s^2]."""
        self._coming: ControlCycle | None = None
        self._recovery: Recovery | None = None
        self._settling, self._passing = round(SETTLING / period), round(PASSING / period)
        self._age = 0

    @property
    def under_way(self) -> bool:
        """Whether another controller is coming."""
        return self._coming is not None

    @property
    def share(self) -> float:
        """Share of the command that is the coming controller's."""
        if self._coming is None:
            return 0.0
        return min(1.0, max(0.0, (self._age - self._settling) / self._passing))

    def begin(self, coming: ControlCycle, force: Array, recovery: Recovery | None) -> None:
        """Let another controller come.

        Args:
            coming: it, without anything that looks after the contact.
            force: last measured on the controlled axes, ``(n_axes,)`` [N].
            recovery: what is to look after the contact when it is in force.
        """
        coming.controller.reset(force)
        coming.controller.adopt(command=self.cycle.applied)
        coming.command[:] = self.command
        self._coming, self._recovery, self._age = coming, recovery, 0

    def decide(self, k: int, measurement: Measurement, deadline: float | None = None) -> Step:
        """Decide the command of a cycle, which is in `command` then; see `ControlCycle.decide`."""
        cycle, coming = self.cycle, self._coming
        step = cycle.decide(k, measurement, deadline)
        self.command[:] = cycle.command
        if coming is None:
            return step
        coming.decide(k, measurement, deadline)
        looking_after = cycle.recovery
        if looking_after is not None and looking_after.watch.state is not ContactState.PRESSING:
            self._age = 0  # in the air there is nothing to settle on
        share = self.share
        if share:
            self.command += share * (coming.command - cycle.command)
            self._adopt(cycle)
        self._adopt(coming)
        self._age += 1
        return step

    def prepare(self) -> bool:
        """Let both do what needs no measurement; return whether the new one is now in force."""
        coming = self._coming
        over = coming is not None and self.share >= 1.0
        if coming is not None:
            coming.controller.prepare()
        if not over or coming is None:
            self.cycle.controller.prepare()
            return False
        if self.cycle.recovery is not None and self._recovery is not None:
            self._recovery.watch = self.cycle.recovery.watch
        coming.recovery = self._recovery
        self.cycle, self._coming, self._recovery = coming, None, None
        return True

    def _adopt(self, cycle: ControlCycle) -> None:
        cycle.command[:] = self.command
        cycle.controller.adopt(command=cycle.applied)
