"""Uniform cubic B-splines: a waveform of time as a few coefficients, smooth where it is read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from qpmpc.arrays import Array

_SIXTHS = np.array([[1.0, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]])
_VALUE = np.ascontiguousarray(_SIXTHS.T) / 6.0
"""From powers of the place between two knots to the weights of four neighbours."""
_SLOPE = np.vstack([_VALUE[1:] * [[1.0], [2.0], [3.0]], np.zeros((1, 4))])
_POWERS = np.arange(4)


class Spline:
    """Reads splines on ``[0, length]``; outside they stay what they are at the end."""

    def __init__(self, length: float, spacing: float) -> None:
        """Lay the knots.

        Args:
            length: of the waveform, in the unit of its argument.
            spacing: of the knots, in the same unit.
        """
        self.spacing = spacing
        self.count = int(np.ceil(length / spacing)) + 3
        """Coefficients of one spline."""
        self._last = self.count - 3 - 1e-9

    def locate(self, place: Array) -> tuple[NDArray[np.int64], Array, Array]:
        """Return where places ``(m,)`` fall.

        Returns:
            numbers of the four coefficients that count, ``(m, 4)``; their weights, ``(m, 4)``; the
            slopes of these [1/unit of the argument], ``(m, 4)``, zero outside.
        """
        u = place / self.spacing
        inside = np.minimum(np.maximum(u, 0.0), self._last)
        first = inside.astype(np.int64)
        powers = (inside - first)[:, None] ** _POWERS
        slopes = (powers @ _SLOPE) * ((u == inside) / self.spacing)[:, None]
        return first[:, None] + _POWERS, powers @ _VALUE, slopes

    def design(self, place: Array) -> Array:
        """Return the matrix from coefficients to values at places ``(m,)``, ``(m, count)``."""
        numbers, weights, _ = self.locate(place)
        rows = np.zeros((place.size, self.count))
        np.put_along_axis(rows, numbers, weights, axis=1)
        return rows
