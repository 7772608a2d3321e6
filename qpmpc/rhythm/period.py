"""How long a beat is: autocorrelation of the motion's velocity, in numbers that stay few."""

from __future__ import annotations

import numpy as np

from qpmpc.arrays import Array

_SHORTEST, _LONGEST = 0.3, 2.0
"""Periods that are looked for [s]."""
_MEMORY = 4.0
"""Time after which a product has lost 63 % of its weight [s]."""
_NEAR_BEST = 0.85
"""Share of the best correlation from which on a shorter period is taken for the period [-]."""


class Periodicity:
    """Running autocorrelation of a vector signal, one sample every ``spacing`` seconds."""

    def __init__(self, axes: int, spacing: float) -> None:
        """Set up for samples ``(axes,)`` that are ``spacing`` [s] apart."""
        self.spacing = spacing
        self._first, self._last = round(_SHORTEST / spacing), round(_LONGEST / spacing)
        self._past = np.zeros((2 * self._last, axes))
        self._products = np.zeros(self._last + 1)
        self._energy = np.zeros(self._last + 1)
        self._mean = np.zeros(axes)
        self._count = 0
        self._forget = float(np.exp(-spacing / _MEMORY))

    def reset(self) -> None:
        """Forget all samples."""
        for memory in (self._past, self._products, self._energy, self._mean):
            memory[:] = 0.0
        self._count = 0

    def note(self, value: Array) -> None:
        """Take the next sample."""
        self._mean += (1.0 - self._forget) * (value - self._mean)
        self._past[1:] = self._past[:-1]
        self._past[0] = value - self._mean
        window = self._past[: self._last + 1]
        self._products *= self._forget
        self._products += window @ self._past[0]
        self._energy *= self._forget
        self._energy += np.einsum("ij,ij->i", window, window)
        self._count += 1

    def find(self) -> tuple[float, float]:
        """Return the period [s] and its correlation [-]; (NaN, 0) where none stands out."""
        scale = np.sqrt(self._energy * self._energy[0])
        if self._count <= self._last or not scale.min() > 0:
            return np.nan, 0.0
        r = self._products / scale
        inner = r[self._first : self._last]
        peaks = self._first + np.flatnonzero(
            (inner >= r[self._first - 1 : self._last - 1])
            & (inner > r[self._first + 1 : self._last + 1])
        )
        if not peaks.size:
            return np.nan, 0.0
        k = int(peaks[r[peaks] >= _NEAR_BEST * r[peaks].max()][0])
        before, at, after = r[k - 1 : k + 2].tolist()
        curvature = before - 2.0 * at + after
        shift = 0.5 * (before - after) / curvature if curvature < 0 else 0.0
        return (k + shift) * self.spacing, max(at, 0.0)

    def since_quiet(self, period: float) -> float:
        """Return how long ago the quietest quarter of the last ``period`` had its middle [s]."""
        n = max(4, min(round(period / self.spacing), self._past.shape[0]))
        width = max(1, n // 4)
        energy = np.einsum("ij,ij->i", self._past[: n + width], self._past[: n + width])
        means = np.convolve(energy, np.full(width, 1.0 / width), "valid")
        return (int(np.argmin(means[:n])) + 0.5 * (width - 1)) * self.spacing
