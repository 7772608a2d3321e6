"""The physics loop, compiled where a compiler is: the plant has the text, `qpmpc` the toolchain."""

import ctypes
from dataclasses import dataclass
from functools import cache

from plant.stepping import FLAGS, source_text
from qpmpc.errors import QpmpcError
from qpmpc.native import compile_library


@dataclass(frozen=True)
class PhysicsLoop:
    """What a cell is given to run its physics with."""

    binary: ctypes.CDLL | None
    """None: the loop runs in Python, with the same result."""
    told: str
    """"compiled", or "python" and why."""


@cache
def physics_loop(joints: int) -> PhysicsLoop:
    """Compile the loop for a tool with this many joints, or find it compiled; once in a process."""
    try:
        built = compile_library(source_text(joints), name="physics", flags=FLAGS)
    except QpmpcError as error:
        return PhysicsLoop(None, f"python ({error})")
    return PhysicsLoop(built.handle, "compiled")
