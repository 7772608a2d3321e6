"""Motion of which nothing is known but that it is smooth: a fixed filter for each axis."""

from __future__ import annotations

from math import factorial

import numpy as np

from qpmpc.arrays import Array
from qpmpc.observer import kalman_gain

ORDER = 4
"""States of an axis: its value and three derivatives, the last a random walk."""


def transition(period: float) -> Array:
    """Return the matrix that takes value and derivatives on by a period, ``(ORDER, ORDER)``."""
    A = np.eye(ORDER)
    for i in range(ORDER):
        for j in range(i + 1, ORDER):
            A[i, j] = period ** (j - i) / factorial(j - i)
    return A


def extrapolation(ahead: Array) -> Array:
    """Return the map from value and derivatives to values ``ahead (n,)`` later, ``(n, ORDER)``."""
    return np.stack([np.asarray(ahead**i / factorial(i)) for i in range(ORDER)], axis=1)


class PlainFilter:
    """Steady-state Kalman filter of value and derivatives, the same for each axis."""

    def __init__(self, axes: int, period: float, noise: float, drift: float) -> None:
        """Set up.

        Args:
            axes: number of axes.
            period: of the samples [s].
            noise: standard deviation of a sample.
            drift: of the last derivative's change per cycle.
        """
        self.state = np.zeros((axes, ORDER))
        """Value and derivatives of each axis."""
        self._A = transition(period)
        read, noises = np.eye(1, ORDER), np.zeros((ORDER, ORDER))
        noises[-1, -1] = drift**2
        self._gain = kalman_gain(self._A, read, noises, np.array([[noise**2]]))[:, 0]

    def begin(self, value: Array) -> None:
        """Start at rest at a value ``(axes,)``."""
        self.state[:] = 0.0
        self.state[:, 0] = value

    def correct(self, value: Array) -> None:
        """Blend in a sample ``(axes,)``."""
        self.state += np.multiply.outer(value - self.state[:, 0], self._gain)

    def predict(self) -> None:
        """Go on by one cycle."""
        self.state[:] = self.state @ self._A.T
