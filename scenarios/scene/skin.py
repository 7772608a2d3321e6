"""What the tissue's surface looks like."""

import numpy as np
from numpy.typing import NDArray

from scenarios.scene.meshes import Array


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
        _vessel(colour, rng, start, heading, width=width, shade=np.array(shade), depth=3)
    picture: NDArray[np.uint8] = (255.0 * np.clip(colour, 0.0, 1.0)).astype(np.uint8)
    return picture


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
    colour: Array, rng: np.random.Generator, start: tuple[float, float], heading: float, *,
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
        near = np.exp(-((((u - x) ** 2 + (v - y) ** 2) / now**2) ** 2))[..., None]
        patch += 0.35 * near * (shade - patch)
        if depth and rng.uniform() < 0.016:
            turn = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 0.9)
            _vessel(
                colour, rng, (x, y), heading + turn, width=0.7 * now, shade=shade, depth=depth - 1
            )
