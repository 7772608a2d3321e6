"""What the physics loop works on, in one block of memory: for Python as arrays, for C as a struct.

The layout stands here once. `struct_text` writes it as the C struct that ``stepping.c`` is compiled
with, so the two cannot disagree. Every member is eight bytes wide: no padding, on any platform.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

_POINTERS = (
    "qpos", "qvel", "bias", "ctrl", "length", "speed", "law", "tip", "tip_frame", "surface_frame",
)  # fmt: skip
"""Arrays of MuJoCo's: joint angles and speeds, Coriolis and gravity torques, controls, lengths,
speeds and coefficients of the contact actuators, poses of tool tip and tissue surface."""

LAYOUT = np.dtype(
    [(name, np.uintp) for name in _POINTERS]
    + [
        # counts and states
        ("substeps", np.int64),
        ("law_stride", np.int64),
        ("unilateral", np.int64),
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
        ("anchor", np.float64, 2),
        # what the guard keeps
        ("timestep", np.float64),
        ("lower", np.float64, 6),
        ("upper", np.float64, 6),
        ("stopping", np.float64, 6),
        ("reaction", np.float64),
        ("joint_speed", np.float64, 6),
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
        ("heart", np.float64, 6),
        ("heart_step", np.float64, 6),
        # a trip, and the way back
        ("value", np.float64),
        ("limit", np.float64),
        ("peak", np.float64),
        ("normal", np.float64, 3),
        ("tip_tripped", np.float64, 3),
        ("depth", np.float64),
        ("goal", np.float64, 6),
        ("goal_speed", np.float64, 6),
        ("goal_lower", np.float64, 6),
        ("goal_upper", np.float64, 6),
        ("inertia", np.float64, 36),
        ("stiff", np.float64),
        ("damp", np.float64),
        ("torque_limit", np.float64, 6),
        ("leash", np.float64),
    ]
)  # fmt: skip

Memory = NDArray[np.void]
"""One record of `LAYOUT`, without dimension: ``memory["goal"]`` is a view."""


def memory(model: Any, data: Any) -> Memory:
    """Return a block of zeros that knows where MuJoCo's arrays lie.

    Args:
        model, data: of MuJoCo, made by ``plant.mjcf.cell_mjcf``; they must outlive the block.
    """
    block = np.zeros((), LAYOUT)
    law = model.actuator_biasprm[12:]
    for name, array in (
        ("qpos", data.qpos),
        ("qvel", data.qvel),
        ("bias", data.qfrc_bias[6:]),
        ("ctrl", data.ctrl[6:]),
        ("length", data.actuator_length[12:]),
        ("speed", data.actuator_velocity[12:]),
        ("law", law),
        ("tip", data.site("tool_tip").xpos),
        ("tip_frame", data.site("tool_tip").xmat),
        ("surface_frame", data.site("heart_surface").xmat),
    ):
        block[name] = array.ctypes.data
    block["law_stride"] = law.strides[0] // law.itemsize
    block["timestep"] = model.opt.timestep
    return block


def struct_text() -> str:
    """Return `LAYOUT` as the C text of ``typedef struct {...} memory;``."""
    lines = []
    for name in LAYOUT.names or ():
        kind, shape = LAYOUT[name].base, LAYOUT[name].shape
        c_type = {"u": "double *", "i": "int64_t ", "f": "double "}[kind.kind]
        lines.append(f"  {c_type}{name}{f'[{shape[0]}]' if shape else ''};")
    return "typedef struct {\n" + "\n".join(lines) + "\n} memory;\n"
