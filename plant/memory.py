"""What the physics loop works on, in one block of memory: for Python as arrays, for C as a struct.

The layout stands here once, for a tool of any number of joints. `struct_text` writes it as the C
struct that ``stepping.c`` is compiled with, so the two cannot disagree. Every member is eight bytes
wide: no padding, on any platform.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

_POINTERS = (
    "qpos", "qvel", "bias", "ctrl", "length", "speed", "law", "tip", "tip_frame", "surface_frame",
    "motor", "motor_speed", "frictionloss",
)  # fmt: skip
"""Arrays of MuJoCo's: joint angles and speeds, Coriolis and gravity torques, controls, lengths,
speeds and coefficients of the contact actuators, poses of tool tip and tissue surface; angles,
speeds and friction limits of the tool's motors, which are its joints where these are rigid."""

HEART_JOINTS = 6
"""Of Robot_Heart, which is a Viper; the tool's stand behind them."""


_EACH, _PAIRS = -1, -2
"""Sizes that stand for one entry for each joint of the tool, and for each pair of joints."""

_MEMBERS: Any = (
    [(name, np.uintp) for name in _POINTERS]
    + [
        # counts and states
        ("substeps", np.int64),
        ("law_stride", np.int64),
        ("kind", np.int64),
        ("unilateral", np.int64),
        ("varies", np.int64),  # whether stiffness goes with the beat
        ("renewed", np.int64),  # whether the law changes from step to step
        ("touching", np.int64),
        ("sticks", np.int64),
        ("mode", np.int64),
        ("step", np.int64),  # physics step of this period, from 1
        ("cause", np.int64),
        ("joint", np.int64),
        # the contact's law
        ("stiffness", np.float64),
        ("damping", np.float64),
        ("grip", np.float64),
        ("factor", np.float64),
        ("factor_step", np.float64),
        ("anchor", np.float64, 2),
        ("relaxing", np.float64),
        ("keeps", np.float64),
        ("takes", np.float64),
        ("recovers", np.float64),
        ("strain", np.float64, 3),
        ("before", np.float64, 3),
        ("coefficient", np.float64),
        ("exponent", np.float64),
        ("dissipation", np.float64),
        ("static_friction", np.float64),
        ("kinetic_friction", np.float64),
        ("stribeck_velocity", np.float64),
        ("break_away", np.float64),
        ("bristle", np.float64, 2),
        # what the guard keeps
        ("timestep", np.float64),
        ("lower", np.float64, _EACH),
        ("upper", np.float64, _EACH),
        ("stopping", np.float64, _EACH),
        ("reaction", np.float64),
        ("joint_speed", np.float64, _EACH),
        ("tip_speed", np.float64),
        ("tracking_velocity", np.float64),
        ("tracking_orientation", np.float64),
        ("tracking_heart", np.float64),
        ("force", np.float64),
        # what it compares with
        ("decay", np.float64),
        ("gain", np.float64),
        ("asked", np.float64, 3),
        ("expected", np.float64, 3),
        ("tip_before", np.float64, 3),
        ("frame_held", np.float64, 9),
        ("heart", np.float64, HEART_JOINTS),
        ("heart_step", np.float64, HEART_JOINTS),
        # a trip, and the way back
        ("value", np.float64),
        ("limit", np.float64),
        ("peak", np.float64),
        ("normal", np.float64, 3),
        ("tip_tripped", np.float64, 3),
        ("depth", np.float64),
        ("goal", np.float64, _EACH),
        ("goal_speed", np.float64, _EACH),
        ("goal_lower", np.float64, _EACH),
        ("goal_upper", np.float64, _EACH),
        ("inertia", np.float64, _PAIRS),
        ("stiff", np.float64),
        ("damp", np.float64),
        ("torque_limit", np.float64, _EACH),
        ("leash", np.float64),
        # Stribeck friction, encoders, what the tip passed through
        ("stribeck", np.int64),
        ("encoded", np.int64),
        ("heavy", np.int64),
        ("coulomb", np.float64, _EACH),
        ("excess", np.float64, _EACH),
        ("stribeck_speed", np.float64),
        ("resolution", np.float64),
        ("speed_share", np.float64),
        ("encoder_angle", np.float64, _EACH),
        ("encoder_speed", np.float64, _EACH),
        ("tip_passed", np.float64, 6),
    ]
)  # fmt: skip


@cache
def layout(joints: int) -> np.dtype[np.void]:
    """Return the record's layout for a tool with this many joints."""
    sizes = {_EACH: joints, _PAIRS: joints**2}
    members: list[Any] = [
        (name, kind, *(sizes.get(size, size) for size in shape)) for name, kind, *shape in _MEMBERS
    ]
    return np.dtype(members)


Memory = NDArray[np.void]
"""One record of `layout`, without dimension: ``memory["goal"]`` is a view."""


def memory(model: Any, data: Any, joints: int) -> Memory:
    """Return a block of zeros that knows where MuJoCo's arrays lie.

    Args:
        model, data: of MuJoCo, made by ``plant.mjcf.cell_mjcf``; they must outlive the block.
        joints: of the tool.
    """
    block = np.zeros((), layout(joints))
    contact = model.actuator("contact_x").id
    law = model.actuator_biasprm[contact:]
    for name, array in (
        ("qpos", data.qpos),
        ("qvel", data.qvel),
        ("bias", data.qfrc_bias[HEART_JOINTS:]),
        ("ctrl", data.ctrl[HEART_JOINTS:]),
        ("length", data.actuator_length[contact:]),
        ("speed", data.actuator_velocity[contact:]),
        ("law", law),
        ("tip", data.site("tool_tip").xpos),
        ("tip_frame", data.site("tool_tip").xmat),
        ("surface_frame", data.site("heart_surface").xmat),
        ("motor", data.qpos[-joints:]),
        ("motor_speed", data.qvel[-joints:]),
        ("frictionloss", model.dof_frictionloss[-joints:]),
    ):
        block[name] = array.ctypes.data
    block["law_stride"] = law.strides[0] // law.itemsize
    block["timestep"] = model.opt.timestep
    return block


def struct_text(joints: int) -> str:
    """Return `layout` as the C text of ``typedef struct {...} memory;``, and both JOINTS."""
    own, lines = layout(joints), []
    for name in own.names or ():
        kind, shape = own[name].base, own[name].shape
        c_type = {"u": "double *", "i": "int64_t ", "f": "double "}[kind.kind]
        lines.append(f"  {c_type}{name}{f'[{shape[0]}]' if shape else ''};")
    counts = f"enum {{ HEART_JOINTS = {HEART_JOINTS}, JOINTS = {joints} }};\n"
    return counts + "typedef struct {\n" + "\n".join(lines) + "\n} memory;\n"
