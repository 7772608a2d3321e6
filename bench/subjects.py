"""What a timed loop runs: nothing at all, the plant alone, or the whole control cycle."""

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from bench.cycles import NONE, SOURCES, STATUSES
from plant.interface import Measurement, Plant
from scenarios.cycle import ControlCycle

Array = NDArray[np.float64]
Kind = Literal["empty", "plant", "backend"]
_STATUS_CODES = {status: code for code, status in enumerate(STATUSES)}
_SOURCE_CODES = {source: code for code, source in enumerate(SOURCES)}


class Subject(Protocol):
    """One cycle in three parts: answer, get ready, let the world go on."""

    name: str
    kind: Kind
    path: str | None
    """How the controller's step is run; None without one."""
    solve: int
    """What the last cycle's solve took [ns], `NONE` without one."""
    status: int
    """Code of the last cycle's status, `NONE` without a controller."""
    source: int
    """Code of where the last command came from, `NONE` without a controller."""

    def respond(self, left: float) -> None:
        """Do what the deadline is about: from the measurement, which is there, to the command.

        Args:
            left: until the deadline [s], negative if it has passed.
        """
        ...

    def settle(self) -> None:
        """Do what the controller does after the command is out."""
        ...

    def advance(self) -> None:
        """Bring the plant to its next measurement."""
        ...

    def errors(self) -> Array:
        """Return force minus setpoint of the cycles so far, ``(cycles, n_axes)`` [N]."""
        ...


class Empty:
    """Nothing but the pacing: what the machine itself does to a loop."""

    name: str = "empty"
    kind: Kind = "empty"
    path: str | None = None
    solve = status = source = NONE

    def respond(self, left: float) -> None:
        """Do nothing."""

    def settle(self) -> None:
        """Do nothing."""

    def advance(self) -> None:
        """Do nothing."""

    def errors(self) -> Array:
        """Return no errors: there is no force."""
        return np.zeros((0, 0))


class Still(Empty):
    """The plant with its brakes closed and no controller: what simulating it does to a loop."""

    name = "plant"
    kind: Kind = "plant"

    def __init__(self, plant: Plant) -> None:
        """Begin.

        Args:
            plant: held still.
        """
        self._plant, self._command = plant, np.zeros(3)
        plant.measure()

    def advance(self) -> None:
        """Go on by one period."""
        self._plant.apply(self._command)
        self._plant.measure()


class Controlled:
    """The whole cycle: observer, reference, QP, command; then the plant."""

    kind: Kind = "backend"

    def __init__(
        self, name: str, plant: Plant, cycle: ControlCycle, setpoint: Array, cycles: int
    ) -> None:
        """Begin.

        Args:
            name: of the backend.
            plant: at the start of its run.
            cycle: the controller of this plant.
            setpoint: at each cycle, at least ``(cycles, n_axes)`` [N].
            cycles: how many there will be at most.
        """
        self.name = name
        self._plant, self._cycle, self._k = plant, cycle, 0
        self._setpoint = setpoint
        self._force = np.full((cycles, 3), np.nan)
        self._axes = ["xyz".index(axis) for axis in cycle.controller.axes]
        # Where there is a compiled step, it is what runs.
        compiled = cycle.controller.about().compilation.used
        self.path: str | None = "compiled" if compiled else "interpreted"
        self.solve = self.status = self.source = NONE
        self._measurement: Measurement = plant.measure()
        self._force[0] = plant.truth().force

    def respond(self, left: float) -> None:
        """Decide the command of this cycle."""
        step = self._cycle.decide(self._k, self._measurement, left)
        self._step = step

    def settle(self) -> None:
        """Let the observer go on under the command."""
        self._cycle.controller.prepare()

    def advance(self) -> None:
        """Apply the command, go on by one period, and measure."""
        step, times = self._step, self._step.times
        # Without an answer asked for there is no solve: its time is exactly 0.
        self.solve = round((times.build + times.solve) * 1e9) if times.solve > 0 else NONE
        self.status = _STATUS_CODES[step.status]
        self.source = _SOURCE_CODES[step.source]
        plant = self._plant
        plant.apply(self._cycle.command)
        self._measurement = plant.measure()
        self._k += 1
        if self._k < len(self._force):
            self._force[self._k] = plant.truth().force

    def errors(self) -> Array:
        """Return force minus setpoint of the cycles so far, ``(cycles, n_axes)`` [N]."""
        k = self._k
        error: Array = self._force[:k, self._axes] - self._setpoint[:k]
        return error
