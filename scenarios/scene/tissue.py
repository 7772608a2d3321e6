"""The tissue: how it gives way under the tip."""

import numpy as np
from numpy.typing import NDArray

from scenarios.scene.meshes import Array, Mesh, shading

RADIUS = 0.0372
"""Of the pad [m]."""
_DENT = 0.0075
"""Distance from the tip at which the surface has given way by 45 % as much as under it [m]."""
_RINGS, _SPOKES = 44, 96
_GROWTH = 1.6
"""Rings lie closer near the middle, where the surface bends most."""


class Tissue:
    """Surface of the pad in the frame of ``heart_surface``: z up, touched at the origin."""

    def __init__(self, thickness: float) -> None:
        """Make the surface at rest.

        Args:
            thickness: how deep its rim lies in the cup [m].
        """
        share = np.linspace(0.0, 1.0, _RINGS + 1)[1:] ** _GROWTH
        angle = np.linspace(0.0, 2.0 * np.pi, _SPOKES, endpoint=False)
        r, t = np.meshgrid(RADIUS * share, angle, indexing="ij")
        x, y = r * np.cos(t), r * np.sin(t)
        s = r / RADIUS
        # A shallow dome, rounded steeply at the rim; a few low bumps so that it looks grown.
        z = -0.30 * thickness * s**2 - 0.70 * thickness * s**8
        bumps = np.sin(190.0 * x + 1.0) * np.sin(160.0 * y) + 0.6 * np.sin(310.0 * x - 240.0 * y)
        z += 0.00035 * bumps * s**2 * (1.0 - s**4)
        self._rest = np.concatenate(
            [[[0.0, 0.0, 0.0]], np.stack([x, y, z], axis=-1).reshape(-1, 3)]
        )
        self._faces = _web(_RINGS, _SPOKES)
        # The skin's picture is laid on along the surface, so that it is not stretched at the rim.
        way = np.cumsum(np.hypot(np.diff(r, axis=0, prepend=0.0), np.diff(z, axis=0, prepend=0.0)),
                        axis=0)  # fmt: skip
        way *= 0.48 / way.max()
        u, v = 0.5 + way * np.cos(t), 0.5 - way * np.sin(t)
        self._coordinates = np.concatenate([[[0.5, 0.5]], np.stack([u, v], axis=-1).reshape(-1, 2)])
        distance = np.linalg.norm(self._rest[:, :2], axis=1)
        self._share = _yield(distance)[:, None]

    @property
    def mesh(self) -> Mesh:
        """The surface at rest."""
        return self.pressed(np.zeros(3))

    def pressed(self, displacement: Array) -> Mesh:
        """Return the surface with its middle displaced, ``(3,)`` [m].

        All of the displacement at the tip, nothing at the rim: the contact's spring has no shape,
        so this one is chosen.
        """
        vertices = self._rest + self._share * displacement
        return Mesh(vertices, shading(vertices, self._faces), self._faces, self._coordinates)


def _yield(distance: Array) -> Array:
    """Share of the displacement that a point of the surface goes along with."""
    fall: Array = 1.0 / (1.0 + (distance / _DENT) ** 2) ** 0.86
    rim: Array = np.clip(1.0 - (distance / RADIUS) ** 2, 0.0, None)
    return fall * rim


def _web(rings: int, spokes: int) -> NDArray[np.int32]:
    here = 1 + np.arange(rings * spokes).reshape(rings, spokes)
    nxt = np.roll(here, -1, axis=1)
    middle = np.stack([np.zeros(spokes, dtype=np.int64), here[0], nxt[0]], axis=-1)
    a, b, c, d = here[:-1], nxt[:-1], here[1:], nxt[1:]
    rest = np.stack([a, c, d, a, d, b], axis=-1).reshape(-1, 3)
    return np.concatenate([middle, rest]).astype(np.int32)
