"""What a force controller has to know about joints in order to bound them."""

from __future__ import annotations

from typing import Protocol

from qpmpc.arrays import Array


class JointSpace(Protocol):
    """Joint speeds and torques as linear maps of what the controller predicts, at one instant.

        speed  = speed_gain v + speed_offset
        torque = command_gain u + velocity_gain v + force_gain F + torque_offset

    with v the tool's velocity [m/s], F the contact force [N] and u the acceleration command
    [m/s^2] of the axes under force control, in their order. The maps hold for the present
    configuration of the arm; over the few milliseconds of a horizon it hardly moves.
    """

    @property
    def speed_gain(self) -> Array:
        """``(n_joints, n_axes)`` [rad/m]."""
        ...

    @property
    def speed_offset(self) -> Array:
        """``(n_joints,)`` [rad/s]."""
        ...

    @property
    def command_gain(self) -> Array:
        """``(n_joints, n_axes)`` [N m s^2/m]."""
        ...

    @property
    def velocity_gain(self) -> Array:
        """``(n_joints, n_axes)`` [N m s/m]."""
        ...

    @property
    def force_gain(self) -> Array:
        """``(n_joints, n_axes)`` [m]."""
        ...

    @property
    def torque_offset(self) -> Array:
        """``(n_joints,)`` [N m]."""
        ...

    @property
    def speed_limit(self) -> Array:
        """Of each joint, ``(n_joints,)`` [rad/s]."""
        ...

    @property
    def torque_limit(self) -> Array:
        """Of each joint, ``(n_joints,)`` [N m]."""
        ...
