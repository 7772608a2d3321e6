"""Where the motion is: a waveform, how large and how late it is this time, and all the rest."""

from __future__ import annotations

from math import sqrt

import numpy as np

from qpmpc.arrays import Array
from qpmpc.rhythm.plain import ORDER, transition

_PACE = 0.05
"""Share of the newest innovation in `MotionFilter.surprise` [-]."""


class MotionFilter:
    """Extended Kalman filter of ``rest + (1 + a) waveform(time - delay)``, axis by axis.

    States: ``a`` of each axis, one delay for all, then the rest of each axis. The waveform is no
    state: whoever calls reads it at the delay of this cycle.
    """

    def __init__(self, axes: int, period: float, noise: float) -> None:
        """Set up.

        Args:
            axes: number of axes.
            period: of the samples [s].
            noise: standard deviation of a sample on any axis.
        """
        n = axes * (1 + ORDER) + 1
        self.axes = axes
        self.state, self.covariance = np.zeros(n), np.zeros((n, n))
        self.change = self.state[:axes]
        """a, relative change of the amplitude, ``(axes,)``; a view."""
        self.rest = self.state[axes + 1 :].reshape(axes, ORDER)
        """Value and derivatives of the rest, ``(axes, ORDER)``; a view."""
        self._F = np.eye(n)
        self._F[axes + 1 :, axes + 1 :] = np.kron(np.eye(axes), transition(period))
        self._H = np.zeros((axes, n))
        self._axis = np.arange(axes)
        self._H[self._axis, axes + 1 + self._axis * ORDER] = 1.0
        self._last = axes + ORDER + self._axis * ORDER
        self._noise = noise**2
        self.surprise = 1.0
        """Squared innovation over its expectation, mean of axes and of the last cycles [-]."""

    @property
    def delay(self) -> float:
        """Of the waveform in this beat [s]."""
        return float(self.state[self.axes])

    @property
    def delay_deviation(self) -> float:
        """Standard deviation of the delay [s]."""
        return sqrt(max(float(self.covariance[self.axes, self.axes]), 0.0))

    def begin(self, value: Array, spread: Array) -> None:
        """Start at a value ``(axes,)``; ``spread (ORDER,)``: of the rest, standard deviations."""
        self.state[:] = 0.0
        self.rest[:, 0] = value
        self.covariance[:] = 0.0
        known = self.axes + 1
        np.fill_diagonal(self.covariance[known:, known:], np.tile(spread**2, self.axes))
        self.surprise = 1.0

    def expect(self, kept: float, change: float, delay: float) -> None:
        """Let a beat begin whose amplitude and delay are not quite those of the last.

        Args:
            kept: share of the amplitude's change that goes on [-]; of the delay nothing does.
            change, delay: standard deviations of what is new.
        """
        k, P = self.axes, self.covariance
        self.change *= kept
        P[:k] *= kept
        P[:, :k] *= kept
        P[self._axis, self._axis] += change**2
        self.state[k] = 0.0
        P[k] = 0.0
        P[:, k] = 0.0
        P[k, k] = delay**2

    def correct(self, value: Array, wave: Array, lateness: Array, doubt: Array) -> None:
        """Blend in a sample.

        Args:
            value: the sample, ``(axes,)``.
            wave: mean of the waveform over the delays that are possible, ``(axes,)``.
            lateness: its derivative by the delay, ``(axes,)``.
            doubt: variance of the waveform that these two leave, ``(axes,)``.
        """
        H, P = self._H, self.covariance
        size = 1.0 + self.change
        H[self._axis, self._axis] = wave
        H[:, self.axes] = size * lateness
        innovation = value - self.rest[:, 0] - size * wave
        PH = P @ H.T
        S = H @ PH
        S[self._axis, self._axis] += self._noise + size**2 * doubt
        gain = np.linalg.solve(S, PH.T)
        self.state += innovation @ gain
        P -= PH @ gain
        self.surprise += _PACE * (float(np.mean(innovation**2 / np.diagonal(S))) - self.surprise)

    def predict(self, drift: float) -> None:
        """Go on by one cycle; ``drift``: standard deviation of the last derivative's change."""
        P = self.covariance
        self.state[:] = self._F @ self.state
        np.dot(self._F @ P, self._F.T, out=P)
        P[self._last, self._last] += drift**2
        P += P.T.copy()
        P *= 0.5
