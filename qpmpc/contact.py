"""The contact model of the paper, one axis: a unit mass pressed on moving, springy tissue.

With computed torque and a velocity loop closed around the tool (eqs. (5), (6)), continuous time is

    dy/dt = K_s (v - v_e)        y  contact force [N], v tool velocity, v_e tissue velocity [m/s]
    dv/dt = u - K2 v + d         u  acceleration command, d  disturbing acceleration [m/s^2]

so that ``y'' + K2 y' = K_s (u + d - a_e - K2 v_e)``: the motion of the tissue is a disturbance
*matched* to the input. Read with the relative velocity ``v - v_e`` for the second state, the same
two equations hold with ``d - a_e - K2 v_e`` for ``d`` and no ``v_e`` in the first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qpmpc.arrays import Array
from qpmpc.errors import ModelError
from qpmpc.models import LinearModel, zero_order_hold


@dataclass(frozen=True, eq=False)
class ContactModel:
    """Eqs. (7)-(9) by exact hold, and the ways in which the world disturbs them.

    States are ``(y, v)``, then the tool's velocity where it is kept apart from the relative one,
    then the lagged command where there is a lag.
    """

    model: LinearModel
    """(A, B, C) from u to y."""
    load: Array
    """Column by which a disturbing acceleration d [m/s^2] enters, ``(n, 1)``. With the tool
    kept apart it drives the relative velocity alone: there it is mostly the tissue's motion."""
    tissue: Array
    """Column by which the tissue's velocity v_e [m/s] enters, ``(n, 1)``."""
    velocity: Array
    """Row that reads the tool's velocity from the states, ``(1, n)``."""


def contact_model(
    stiffness: float,
    velocity_damping: float,
    period: float,
    *,
    lag: float = 0.0,
    separate_tool: bool = False,
) -> ContactModel:
    """Build the contact model of one axis.

    Args:
        stiffness: K_s, estimated stiffness of the tissue [N/m].
        velocity_damping: K2, gain of the velocity loop around the unit mass [1/s].
        period: sampling period [s].
        lag: time constant of a first-order lag from command to acceleration [s]; 0: none.
        separate_tool: whether the second state is the relative velocity, seen only through the
            force, and the tool's own velocity a state beside it, seen by the encoders.

    Raises:
        ModelError: a figure is out of range.
    """
    if not stiffness > 0:
        raise ModelError(f"stiffness must be positive, got {stiffness} N/m")
    if not velocity_damping >= 0:
        raise ModelError(f"velocity_damping must not be negative, got {velocity_damping} 1/s")
    if not lag >= 0:
        raise ModelError(f"lag must not be negative, got {lag} s")
    n = 2 + separate_tool + (lag > 0)
    tool = 2 if separate_tool else 1
    A, inputs = np.zeros((n, n)), np.zeros((n, 3))  # inputs u, d, v_e
    A[0, 1] = stiffness
    inputs[0, 2] = -stiffness
    inputs[1, 1] = 1.0
    for velocity in {1, tool}:
        A[velocity, velocity] = -velocity_damping
        if lag > 0:
            A[velocity, -1] = 1.0
        else:
            inputs[velocity, 0] = 1.0
    if lag > 0:
        A[-1, -1], inputs[-1, 0] = -1.0 / lag, 1.0 / lag
    A, inputs = zero_order_hold(A, inputs, period)
    force, reading = np.zeros((1, n)), np.zeros((1, n))
    force[0, 0], reading[0, tool] = 1.0, 1.0
    model = LinearModel(A, inputs[:, :1], force, period)
    return ContactModel(model, inputs[:, 1:2], inputs[:, 2:], reading)
