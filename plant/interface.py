"""What passes between a plant and whoever controls it: the whole contract, and nothing else.

Any object with these members can take the place of `plant.cell.Cell` in the loop.
"""

from dataclasses import dataclass
from typing import Protocol

from plant.viper import FloatArray


@dataclass(frozen=True, slots=True)
class Measurement:
    """What a controller may see at a control instant. Arrays are the measurement's own."""

    time: float
    """Since the start of the run [s]."""
    force: FloatArray
    """Contact force that the tool exerts, as the sensor reads it, ``(3,)`` [N]."""
    position: FloatArray
    """Instrument tip from the encoders, ``(3,)`` [m]."""
    velocity: FloatArray
    """Its velocity from the encoders, ``(3,)`` [m/s]."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What only the log may see, at the instant of the last measurement."""

    force: FloatArray
    """Contact force without sensor, ``(3,)`` [N]."""
    tissue: FloatArray
    """Position of the tissue's surface at rest, ``(3,)`` [m]."""
    torque: FloatArray
    """Joint torques that the inner loop last asked for, after saturation, ``(6,)`` [N m]."""
    saturated: bool
    """Whether a torque was cut at its limit."""


class TissueMotion(Protocol):
    """Motion of the tissue from home at the control instants, time-major."""

    @property
    def position(self) -> FloatArray:
        """Displacement, ``(n, 3)`` [m]."""
        ...

    @property
    def velocity(self) -> FloatArray:
        """Its first derivative, ``(n, 3)`` [m/s]."""
        ...

    @property
    def acceleration(self) -> FloatArray:
        """Its second derivative, ``(n, 3)`` [m/s^2]."""
        ...


class Plant(Protocol):
    """A plant under force control: measure, decide, apply, once per period."""

    period: float
    """Control period [s]."""

    def measure(self) -> Measurement:
        """Read the sensors at the present control instant."""
        ...

    def apply(self, command: FloatArray) -> None:
        """Apply an acceleration command ``(3,)`` [m/s^2] and go on by one period."""
        ...

    def truth(self) -> Truth:
        """Return what is really there, for the log."""
        ...
