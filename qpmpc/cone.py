"""A bound on the length of a vector as facets of a polygon: tangential force, no slip."""

from __future__ import annotations

import numpy as np

from qpmpc.arrays import Array, matrix
from qpmpc.bounds import OutputBound
from qpmpc.errors import BoundsError


def force_cone(
    name: str,
    tangential: Array,
    normal: Array,
    *,
    limit: float,
    friction: float = 0.0,
    facets: int = 8,
    linear: float = np.inf,
) -> OutputBound:
    """Bound the tangential force, ``|F_t| <= limit + friction * pressure``, by ``facets`` rows.

    The polygon is inscribed, so that what satisfies it satisfies the norm; at worst it forbids
    ``1 - cos(pi / facets)`` of what the norm would allow. With a ``limit`` of zero this is the cone
    of Coulomb's law: the instrument does not slip.

    Args:
        name: of the bound.
        tangential: rows that read the two tangential forces from the states, ``(2, n)``.
        normal: row that reads the pressing force, positive where it presses, ``(1, n)``.
        limit: of the norm without pressure [N].
        friction: coefficient [-].
        facets: k >= 3.
        linear: penalty per newton of violation; infinite: hard.

    Raises:
        BoundsError: a figure is out of range. ShapeError: rows of another shape.
    """
    tangential = matrix("tangential", tangential, 2)
    normal = matrix("normal", normal, 1, tangential.shape[1])
    if facets < 3:
        raise BoundsError(name, f"needs at least 3 facets, got {facets}")
    if not (limit >= 0 and friction >= 0):
        raise BoundsError(name, "limit and friction must not be negative")
    angle = 2.0 * np.pi * np.arange(facets) / facets
    directions = np.column_stack([np.cos(angle), np.sin(angle)])
    apothem = np.cos(np.pi / facets)
    output = directions @ tangential - friction * apothem * normal
    return OutputBound(name, output, -np.inf, limit * apothem, linear)
