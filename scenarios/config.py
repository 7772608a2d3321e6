"""A scenario: one frozen record that holds everything a run depends on."""

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Ge, Gt, Le, MinLen

from plant.config import CellConfig
from qpmpc.config import ControllerConfig, Interval
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
    ramp: Annotated[float, Ge(0), Le(3600)] = 0.0
    """Time over which it moves linearly to the new value [s]; 0: at once."""


@dataclass(frozen=True)
class LiveConfig:
    """A setpoint that another process sends, see ``docs/live-setpoint.md``."""

    port: Annotated[int, Ge(1024), Le(65535)]
    """UDP port on 127.0.0.1 that is opened for it."""
    largest_rate: Annotated[float, Gt(0), Le(1e5)] = 100.0
    """How fast the setpoint follows what is sent [N/s]."""
    stale_after: Annotated[float, Gt(0), Le(60)] = 0.1
    """Silence after which the setpoint stays where it is [s]."""


@dataclass(frozen=True)
class SetpointConfig:
    """The contact force that is wished for: given here, recorded in a file, or sent live."""

    x: float = 1.0
    """Contact force on x at the start [N]."""
    y: float = 2.0
    """Contact force on y at the start [N]."""
    z: float = -10.0
    """Contact force on z at the start [N]; pressing down is negative."""
    steps: tuple[SetpointStep, ...] = ()
    """Changes, in the order of their times."""
    file: str | None = None
    """CSV file of a recorded wish, columns t [s] and those of x, y, z [N] that are controlled; in
    place of x, y, z and steps."""
    live: LiveConfig | None = None
    """What another process sends, from x, y, z on; the run is then paced by the clock."""
    preview: bool = True
    """Whether the controller sees changes coming within its horizon; a surgeon's hand it does
    not."""


@dataclass(frozen=True)
class AxesChange:
    """New intervals for some axes; the others stay as they are."""

    x: Interval | None = None
    y: Interval | None = None
    z: Interval | None = None


@dataclass(frozen=True)
class BoundsStep:
    """A change of bounds, which the controller sees coming within its horizon."""

    time: Annotated[float, Gt(0)]
    """When it begins [s]."""
    ramp: Annotated[float, Ge(0), Le(3600)] = 0.0
    """Time over which finite bounds move to their new values [s]; 0: at once."""
    force: Interval | AxesChange | None = None
    """New bounds on the contact force [N]; as before if not given."""
    velocity: Interval | AxesChange | None = None
    """New bounds on the velocity of the tool [m/s]; as before if not given."""


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
    bounds_steps: tuple[BoundsStep, ...] = ()
    """Changes of ``controller.bounds`` during the run, in the order of their times. A setpoint may
    lie outside them: the bound is then what is held."""
    controller: ControllerConfig = field(default_factory=ControllerConfig)
    cell: CellConfig = field(default_factory=CellConfig)

    @property
    def cycles(self) -> int:
        """Number of control cycles."""
        return max(1, round(self.duration / self.cell.period))
