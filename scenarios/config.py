"""A scenario: one frozen record that holds everything a run depends on."""

from dataclasses import dataclass, field
from typing import Annotated

from annotated_types import Ge, Gt, Le, MinLen

from plant.config import CellConfig
from qpmpc.config import ControllerConfig, Interval
from scenarios.motion import Axis, MotionConfig

_NOISE_LEVELS = 5.0
"""Standard deviations of the measured force that tell contact from none."""
_HYSTERESIS = 2.0
"""Force at which contact is found, relative to that below which it is lost [-]."""


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
class ApproachConfig:
    """How contact is seen to be lost, and the tool led back; see ``docs/plant.md``.

    Without effect where the contact is bilateral: it cannot be lost.
    """

    enabled: bool = True
    """Whether the tool is led by the approach while it is off the tissue, where z is among
    ``axes``; by the controller if not. Lost contact is reported in either case."""
    threshold: Annotated[float, Gt(0), Le(100)] | None = None
    """Measured pressing force, -z, below which there may be no contact, and twice which finds it
    again [N]; five times ``controller.observer.force_noise`` if not given."""
    lost_after: Annotated[float, Ge(0), Le(1)] = 0.005
    """Time below the threshold after which the contact counts as lost [s]."""
    found_after: Annotated[float, Ge(0), Le(1)] = 0.002
    """Time above twice the threshold after which it counts as found [s]."""
    speed: Annotated[float, Gt(0), Le(0.5)] = 0.05
    """Largest speed at which the tool is led to the tissue [m/s]; less where the bound on its
    velocity is less."""
    acceleration: Annotated[float, Gt(0), Le(100)] = 5.0
    """Largest acceleration with which that speed is taken on [m/s^2]."""


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
    approach: ApproachConfig = field(default_factory=ApproachConfig)
    controller: ControllerConfig = field(default_factory=ControllerConfig)
    cell: CellConfig = field(default_factory=CellConfig)

    @property
    def contact_lost_below(self) -> float:
        """Measured pressing force below which there may be no contact [N]."""
        given = self.approach.threshold
        return _NOISE_LEVELS * self.controller.observer.force_noise if given is None else given

    @property
    def contact_found_above(self) -> float:
        """Measured pressing force above which there is contact again [N]."""
        return _HYSTERESIS * self.contact_lost_below

    @property
    def cycles(self) -> int:
        """Number of control cycles."""
        return max(1, round(self.duration / self.cell.period))
