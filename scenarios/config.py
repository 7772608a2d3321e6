"""A scenario: one frozen record that holds everything a run depends on."""

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Ge, Gt, Le, MinLen

from plant.config import CellConfig
from qpmpc.config import ControllerConfig
from scenarios.motion import Axis, MotionConfig


@dataclass(frozen=True)
class SetpointStep:
    """A change of the setpoint, known ahead to the controller's preview."""

    time: Annotated[float, Gt(0)]
    """When it happens [s]."""
    x: float | None = None
    """New contact force on x [N]; as before if not given."""
    y: float | None = None
    """New contact force on y [N]."""
    z: float | None = None
    """New contact force on z [N]; pressing down is negative."""


@dataclass(frozen=True)
class SetpointConfig:
    """The contact force that is wished for."""

    x: float = 1.0
    """Contact force on x at the start [N]."""
    y: float = 2.0
    """Contact force on y at the start [N]."""
    z: float = -10.0
    """Contact force on z at the start [N]; pressing down is negative."""
    steps: tuple[SetpointStep, ...] = ()
    """Changes, in the order of their times."""


@dataclass(frozen=True)
class Scenario:
    """An experiment on the two-robot cell. Keys of the TOML file are the names of the fields."""

    name: Annotated[str, MinLen(1)]
    """What results are filed under."""
    description: str = ""
    """One line for ``pulsempc scenarios``."""
    duration: Annotated[float, Gt(0), Le(3600)] = 15.0
    """Simulated time [s]."""
    seed: Annotated[int, Ge(0)] = 0
    """Of the motion and of the sensor noise."""
    backend: str = "daqp"
    """Which solver answers the QP."""
    axes: Annotated[tuple[Axis, ...], MinLen(1)] = ("x", "y", "z")
    """Axes under force control; the tool holds its position on the others."""
    setpoint: SetpointConfig = field(default_factory=SetpointConfig)
    motion: MotionConfig = field(default_factory=MotionConfig)
    controller: ControllerConfig = field(default_factory=ControllerConfig)
    cell: CellConfig = field(default_factory=CellConfig)

    @property
    def cycles(self) -> int:
        """Number of control cycles."""
        return max(1, round(self.duration / self.cell.period))
