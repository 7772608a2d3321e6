"""A force as an arrow in the world."""

from dataclasses import dataclass

import numpy as np

from scenarios.scene.meshes import Array

_SHOWN = 0.05
"""Force below which there is no arrow [N]."""


@dataclass(frozen=True, eq=False)
class Arrow:
    """From where a force acts to where its arrow ends."""

    start: Array
    """``(3,)`` [m]"""
    end: Array
    """``(3,)`` [m]"""


def force_arrow(at: Array, force: Array, scale: float) -> Arrow | None:
    """Return the arrow of a force, or None where there is next to none.

    Args:
        at: where it acts, ``(3,)`` [m].
        force: ``(3,)`` [N].
        scale: length by force [m/N].
    """
    if not np.linalg.norm(force) > _SHOWN:  # nor where it is not known
        return None
    return Arrow(at, at + scale * force)
