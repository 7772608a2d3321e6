"""Meshes that what is drawn is made of: turned, lofted and cut out with rounded edges.

All are closed surfaces given by rings of points, from one end to the other. Where a ring comes
twice the surface has an edge; elsewhere it is shaded smoothly.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SEGMENTS = 40
"""Points of a ring."""
_FILLET = np.linspace(0.0, np.pi / 2.0, 5)


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with a normal at each vertex."""

    vertices: Array
    """``(n, 3)`` [m]."""
    normals: Array
    """``(n, 3)``, of unit length, outwards."""
    faces: NDArray[np.int32]
    """``(m, 3)``, counter-clockwise seen from outside."""
    coordinates: Array | None = None
    """Where each vertex lies in the texture, ``(n, 2)``, if there is one."""

    def placed(self, placement: Array) -> "Mesh":
        """Return the mesh moved by a pose, ``(4, 4)``."""
        turn = placement[:3, :3]
        return Mesh(
            self.vertices @ turn.T + placement[:3, 3],
            self.normals @ turn.T,
            self.faces,
            self.coordinates,
        )


def loft(rings: Sequence[Array] | Array) -> Mesh:
    """Surface over rings, ``(k, n, 3)``, both ends closed.

    Points of a ring go counter-clockwise seen from the end towards which rings go.
    """
    grid = np.asarray(rings, dtype=np.float64)
    k, n, _ = grid.shape
    ends = grid[[0, -1]].mean(axis=1)
    vertices = np.concatenate([grid.reshape(-1, 3), ends])
    here = np.arange(k * n).reshape(k, n)
    nxt = np.roll(here, -1, axis=1)
    a, b, c, d = here[:-1], nxt[:-1], here[1:], nxt[1:]
    sides = np.stack([a, b, d, a, d, c], axis=-1).reshape(-1, 3)
    first = np.stack([np.full(n, k * n), nxt[0], here[0]], axis=-1)
    last = np.stack([np.full(n, k * n + 1), here[-1], nxt[-1]], axis=-1)
    faces = np.concatenate([sides, first, last]).astype(np.int32)
    return Mesh(vertices, shading(vertices, faces), faces)


def shading(vertices: Array, faces: NDArray[np.int32]) -> Array:
    """Normals at vertices, ``(n, 3)``: those of the faces around, by their area."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for i in range(3):
        np.add.at(normals, faces[:, i], area)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # Where a surface shrinks to a point with no area any direction will do.
    unit: Array = np.where(length > 0, normals / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    return unit


def lathe(profile: Sequence[tuple[float, float]]) -> Mesh:
    """Turn a profile of (radius, height) [m], from bottom to top, about z."""
    angle = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(SEGMENTS)], axis=-1)
    return loft([radius * circle + [0.0, 0.0, height] for radius, height in profile])


def drum(radius: float, bottom: float, top: float, fillet: float, upper: float = 0.0) -> Mesh:
    """Cylinder about z with rounded edges; ``upper`` is its radius at the top if it tapers [m]."""
    return lathe(
        [
            *((radius - fillet * (1.0 - np.sin(t)), bottom + fillet * (1.0 - np.cos(t)))
              for t in _FILLET),
            *(((upper or radius) - fillet * (1.0 - np.cos(t)), top - fillet * (1.0 - np.sin(t)))
              for t in _FILLET),
        ]
    )  # fmt: skip


def slab(outline: "Outline", bottom: float, top: float, fillet: float) -> Mesh:
    """Cut a convex outline out of a plate between two heights [m], with rounded edges."""
    lower = [
        _at(outline(fillet * (1.0 - np.sin(t))), bottom + fillet * (1.0 - np.cos(t)))
        for t in _FILLET
    ]
    upper = [
        _at(outline(fillet * (1.0 - np.cos(t))), top - fillet * (1.0 - np.sin(t))) for t in _FILLET
    ]
    return loft([*lower, *upper])


class Outline:
    """A convex outline in a plane: a function from inset [m] to points ``(n, 2)`` [m]."""

    def __init__(self, corners: Array, radii: Array) -> None:
        """Hull of circles: ``corners (m, 2)`` counter-clockwise, ``radii (m,)``."""
        self._corners, self._radii = np.asarray(corners), np.asarray(radii)

    def __call__(self, inset: float) -> Array:
        """Points of the outline moved inwards, counter-clockwise."""
        angle = np.linspace(0.0, 2.0 * np.pi, SEGMENTS, endpoint=False)
        direction = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        # The hull's point furthest in a direction is that of the circle which reaches furthest.
        reach = direction @ self._corners.T + self._radii
        furthest = reach.argmax(axis=1)
        radii = np.maximum(self._radii[furthest] - inset, 1e-4)
        points: Array = self._corners[furthest] + radii[:, None] * direction
        return points


def stadium(start: tuple[float, float], r0: float, end: tuple[float, float], r1: float) -> Outline:
    """Hull of two circles."""
    return Outline(np.array([start, end]), np.array([r0, r1]))


def rectangle(x: tuple[float, float], y: tuple[float, float], corner: float) -> Outline:
    """Rectangle between two abscissae and two ordinates with round corners [m]."""
    (x0, x1), (y0, y1), c = x, y, corner
    corners = [(x0 + c, y0 + c), (x1 - c, y0 + c), (x1 - c, y1 - c), (x0 + c, y1 - c)]
    return Outline(np.array(corners), np.full(4, c))


def blend(sections: Sequence[tuple[Outline, float]], fillet: float) -> Mesh:
    """Loft from outline to outline, each at its height [m]; rounded at both ends."""
    (first, bottom), (last, top) = sections[0], sections[-1]
    lower = [
        _at(first(fillet * (1.0 - np.sin(t))), bottom + fillet * (1.0 - np.cos(t))) for t in _FILLET
    ]
    middle = [_at(outline(0.0), height) for outline, height in sections[1:-1]]
    upper = [
        _at(last(fillet * (1.0 - np.cos(t))), top - fillet * (1.0 - np.sin(t))) for t in _FILLET
    ]
    return loft([*lower, *middle, *upper])


def _at(outline: Array, height: float) -> Array:
    return np.column_stack([outline, np.full(len(outline), height)])
