"""The tissue: how it gives way under the tip, and what its skin looks like."""

import numpy as np
from numpy.typing import NDArray

from scenarios.film.meshes import Array, Mesh, shading

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
        self._coordinates = np.concatenate(
            [[[0.5, 0.5]], np.stack([u, v], axis=-1).reshape(-1, 2)]
        )
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


def skin(size: int = 512) -> NDArray[np.uint8]:
    """Picture of heart muscle with fat and vessels, ``(size, size, 3)``; always the same."""
    rng = np.random.default_rng(2009)
    y, x = np.mgrid[0:size, 0:size] / size
    grain = sum(_noise(rng, size, cells) / weight for cells, weight in ((6, 1), (14, 2), (40, 4)))
    fibre = np.sin(2.0 * np.pi * (26.0 * (x + 0.5 * y) + 1.1 * grain))
    colour = np.array([0.60, 0.105, 0.10]) * (1.0 + 0.20 * grain + 0.05 * fibre)[..., None]
    fat = np.clip(1.6 * _noise(rng, size, 5) + 0.7 * _noise(rng, size, 17) - 0.75, 0.0, 1.0)
    colour += 0.55 * fat[..., None] * (np.array([0.80, 0.58, 0.34]) - colour)
    for start, heading, width, shade in (
        ((0.10, 0.30), 0.35, 0.013, (0.34, 0.03, 0.05)),
        ((0.30, 0.95), -1.20, 0.010, (0.33, 0.05, 0.10)),
        ((0.92, 0.62), 2.80, 0.009, (0.34, 0.03, 0.05)),
    ):
        _vessel(colour, rng, start, heading, width, np.array(shade), depth=3)
    return (255.0 * np.clip(colour, 0.0, 1.0)).astype(np.uint8)


def _noise(rng: np.random.Generator, size: int, cells: int) -> Array:
    """Smooth noise between about -1 and 1, of a number of cells across."""
    lattice = rng.uniform(-1.0, 1.0, (cells + 2, cells + 2))
    at = np.linspace(0.0, cells, size, endpoint=False)
    i, f = at.astype(int), at % 1.0
    f = f * f * (3.0 - 2.0 * f)
    rows = lattice[i] * (1.0 - f[:, None]) + lattice[i + 1] * f[:, None]
    mixed: Array = rows[:, i] * (1.0 - f) + rows[:, i + 1] * f
    return mixed


def _vessel(
    colour: Array, rng: np.random.Generator, start: tuple[float, float], heading: float,
    width: float, shade: Array, depth: int,
) -> None:  # fmt: skip
    """Draw a winding line that thins and branches."""
    size = len(colour)
    x, y = start
    for step in range(200):
        heading += rng.normal(0.0, 0.05)
        x, y = x + 0.004 * np.cos(heading), y + 0.004 * np.sin(heading)
        now = width * (1.0 - 0.75 * step / 200)
        if not (0.0 <= x < 1.0 and 0.0 <= y < 1.0) or now < 0.0028:
            return
        reach = int(2.5 * now * size) + 2
        i, j = int(y * size), int(x * size)
        rows, columns = slice(max(i - reach, 0), i + reach), slice(max(j - reach, 0), j + reach)
        v, u = np.mgrid[rows, columns][:, : size - rows.start, : size - columns.start] / size
        patch = colour[rows, columns]
        v, u = v[: patch.shape[0], : patch.shape[1]], u[: patch.shape[0], : patch.shape[1]]
        near = np.exp(-(((u - x) ** 2 + (v - y) ** 2) / now**2) ** 2)[..., None]
        patch += 0.35 * near * (shade - patch)
        if depth and rng.uniform() < 0.016:
            turn = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 0.9)
            _vessel(colour, rng, (x, y), heading + turn, 0.7 * now, shade, depth - 1)
