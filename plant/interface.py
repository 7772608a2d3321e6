"""What passes between a plant and whoever controls it: the whole contract, and nothing else.

Any object with these members can take the place of `plant.cell.Cell` in the loop.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Protocol, runtime_checkable

import numpy as np

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


class Cause(StrEnum):
    """Which limit of the protection was passed; the keys of ``cell.protection`` have the names."""

    HEARTBEAT = "heartbeat"
    JOINT_RANGE = "joint_range"
    JOINT_SPEED = "joint_speed"
    TIP_SPEED = "tip_speed"
    TRACKING_VELOCITY = "tracking_velocity"
    TRACKING_ORIENTATION = "tracking_orientation"
    TRACKING_HEART = "tracking_heart"
    FORCE = "force"


@dataclass(frozen=True, slots=True)
class Trip:
    """Why and when the protection took the tool away."""

    cause: Cause
    time: float
    """Of the physics step after which the limit was found passed [s]."""
    value: float
    """What was found, in the unit of the limit."""
    limit: float
    """What it was compared with."""
    joint: int | None = None
    """Number of the joint, from 1; None where no joint is concerned."""


@dataclass(frozen=True, slots=True)
class Truth:
    """What only the log may see, at the instant of the last measurement."""

    force: FloatArray
    """Contact force without sensor, ``(3,)`` [N]."""
    tissue: FloatArray
    """Position of the tissue's surface at rest, ``(3,)`` [m]."""
    torque: FloatArray
    """Joint torques that the inner loop last asked for, after saturation; after a trip, those that
    the protection asks for, ``(n,)`` [N m]."""
    saturated: bool
    """Whether a torque was cut at its limit."""
    touching: bool = True
    """Whether tool and tissue touch."""
    joint_velocity: FloatArray = field(default_factory=lambda: np.zeros(6))
    """Speeds of the tool's joints, of the links where these are flexible, ``(n,)`` [rad/s]."""
    joint_angle: FloatArray = field(default_factory=lambda: np.full(1, np.nan))
    """Angles of all joints, Robot_Heart's first, ``(6 + n,)`` [rad]; a single NaN where the plant
    does not tell: such a run cannot be drawn."""
    force_peak: float = 0.0
    """Largest magnitude of the contact force since the measurement before, at any physics step
    [N]."""
    trip: Trip | None = None
    """What the protection has tripped on, the last `apply` included."""


@dataclass(frozen=True, slots=True)
class JointSpace:
    """What tool velocity, contact force and command mean for the tool's joints, for one instant.

        joint speeds   speed_gain v + speed_offset
        joint torques  command_gain u + velocity_gain v + force_gain F + torque_offset

    v [m/s], F [N] and u [m/s^2] have an entry for each force-controlled axis, in the order in which
    the axes were given. The configuration is frozen; what the other axes and the orientation do
    counts with its present value. Both maps are exact for the present v and F and the previous u.
    Arrays are the record's own; those of the limits are read-only.
    """

    speed_gain: FloatArray
    """``(n, n_axes)`` [rad/m]."""
    speed_offset: FloatArray
    """``(n,)`` [rad/s]."""
    command_gain: FloatArray
    """``(n, n_axes)`` [N m s^2/m]."""
    velocity_gain: FloatArray
    """``(n, n_axes)`` [N m s/m]."""
    force_gain: FloatArray
    """``(n, n_axes)`` [m]."""
    torque_offset: FloatArray
    """``(n,)`` [N m]."""
    speed_limit: FloatArray
    """Largest speed of each joint in either direction, ``(n,)`` [rad/s]."""
    torque_limit: FloatArray
    """Torque at which each joint saturates, in either direction, ``(n,)`` [N m]."""


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

    def apply(self, command: FloatArray | None) -> None:
        """Apply an acceleration command ``(3,)`` [m/s^2] and go on by one period.

        None: no command came in this period, the one before goes on.
        """
        ...

    def truth(self) -> Truth:
        """Return what is really there, for the log."""
        ...


@runtime_checkable
class JointPlant(Plant, Protocol):
    """A plant that also says what its joints do: for a controller that bounds them."""

    def joint_space(self, force: FloatArray, previous: FloatArray) -> JointSpace:
        """Return the maps for the instant of the last `measure`.

        Args:
            force: contact force as it was measured, ``(3,)`` [N].
            previous: command that was applied last, ``(3,)`` [m/s^2].
        """
        ...
