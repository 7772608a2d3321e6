"""What the beats have in common: an average by time in the beat that forgets, beat by beat."""

from __future__ import annotations

import numpy as np

from qpmpc.arrays import Array
from qpmpc.rhythm.spline import Spline

_TREND = 3
"""Terms of the polynomial in time that stands for whatever is slower than a beat."""
_NEIGHBOURS, _SIZE = 0.3, 0.1
"""Information about differences of neighbouring coefficients and about their size, before any beat,
in units of that of a sample as noisy as the waveform is large."""


class Waveform:
    """A spline for each axis, fitted to the beats so far by recursive least squares.

    Samples of a beat are kept until it is over, then fitted at once together with a polynomial for
    slower motion, which is dropped. Amplitude and delay are taken as estimated by its end.
    """

    def __init__(
        self, axes: int, spline: Spline, *, capacity: int, noise: float, memory: float
    ) -> None:
        """Start without knowledge.

        Args:
            axes: number of axes.
            spline: of the waveform.
            capacity: samples that are kept of one beat; what comes later is not learned.
            noise: standard deviation of a kept sample as a share of the waveform's size [-].
            memory: beats after which one has lost 63 % of its weight.
        """
        self.spline = spline
        self.coefficients = np.zeros((spline.count, axes))
        """``(count, axes)``."""
        self.beats = 0
        """Beats learned."""
        self._forget = float(np.exp(-1.0 / memory))
        self._weight = noise**-2
        neighbours = np.diff(np.eye(spline.count), axis=0)
        self._prior = _NEIGHBOURS * neighbours.T @ neighbours + _SIZE * np.eye(spline.count)
        self._information = self._prior.copy()
        self._time, self._value = np.zeros(capacity), np.zeros((capacity, axes))
        self._count = 0

    @property
    def kept(self) -> tuple[Array, Array]:
        """Times ``(n,)`` and samples ``(n, axes)`` of the beat that is under way."""
        return self._time[: self._count], self._value[: self._count]

    def note(self, time: float, value: Array) -> None:
        """Keep a sample ``(axes,)`` of a time since the beat began, as long as there is room."""
        if self._count < self._time.size:
            self._time[self._count], self._value[self._count] = time, value
            self._count += 1

    def drop(self) -> None:
        """Forget the samples of the beat that is under way."""
        self._count = 0

    def forget(self) -> None:
        """Forget everything."""
        self.coefficients[:] = 0.0
        self._information[:] = self._prior
        self.beats = self._count = 0

    def learn(self, stretch: float, delay: float, amplitude: Array) -> None:
        """Fit the beat that is over, and drop its samples.

        Args:
            stretch: time of this beat for a unit of the spline's argument.
            delay: of the waveform behind the beat's beginning.
            amplitude: of the beat relative to the waveform, ``(axes,)``.
        """
        time, value = self.kept
        self._count = 0
        if time.size < 2 * _TREND:
            return
        rows = self.spline.design((time - delay) / stretch)
        basis = trend(time.size)
        free = rows - basis @ (basis.T @ rows)
        size = float(np.mean(amplitude))
        self._information *= self._forget
        self._information += (1.0 - self._forget) * self._prior
        self._information += (self._weight * size**2) * (free.T @ free)
        gradient = free.T @ (value - (rows @ self.coefficients) * amplitude)
        gradient *= self._weight * size
        self.coefficients += np.linalg.solve(self._information, gradient)
        self.beats += 1


def trend(count: int) -> Array:
    """Return an orthonormal basis of what counts as slow over ``count`` samples."""
    powers = np.linspace(-1.0, 1.0, count)[:, None] ** np.arange(_TREND)
    return np.asarray(np.linalg.qr(powers)[0])
