"""Kalman filters some of whose measurements are missing or wrong: gains from cycle to cycle."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

import numpy as np

from qpmpc.arrays import Array, Indices
from qpmpc.kalman import Subsystem, updated

MOST_REFUSED = 3
"""Measurements of a row, one after the other, that the gate refuses; the next is taken."""
_UNKNOWN = 1e10
"""Growth of the largest variance beyond which it grows no further: nothing is known any more."""
_SETTLED = 1e-4
"""Share of the largest gain by which gains may differ from the steady ones and count as these."""


class Intermittent:
    """Subsystems of one shape, side by side: in numpy three axes cost what one does."""

    def __init__(self, parts: Sequence[Subsystem], prior: Array) -> None:
        """Begin in the steady state.

        Args:
            parts: ``g`` of them, each of n states and m > 0 rows.
            prior: standard deviation of each state of the whole as it is known beforehand, around
                0; infinite: not known.
        """
        self.states = np.stack([part.states for part in parts])
        """Which states of the whole, ``(g, n)``."""
        self.rows = np.stack([part.rows for part in parts])
        """Which measured rows of the whole, ``(g, m)``."""
        self.state_scale = np.stack([part.state_scale for part in parts])
        self.row_scale = np.stack([part.row_scale for part in parts])
        self._A, self._C, self._W, self._V, self._steady, self._gain = (
            np.stack([getattr(part, name) for part in parts])
            for name in ("A", "C", "W", "V", "P", "L")
        )
        self._AT, self._CT = self._A.swapaxes(1, 2), self._C.swapaxes(1, 2)
        self._deviation = np.stack([part.deviation for part in parts])
        self._unit = np.eye(self._C.shape[1])
        before = self._A @ self._steady @ self._AT + self._W
        self._most = _UNKNOWN * np.maximum(1.0, np.abs(before).max(axis=(1, 2), keepdims=True))
        self._near = _SETTLED * np.abs(self._gain).max(axis=(1, 2))
        self._prior = prior[self.states] * self.state_scale
        self.P = self._steady.copy()
        """Covariance after the last measurement, scaled, ``(g, n, n)``."""
        self.settled = np.ones(len(parts), dtype=np.bool_)
        """Which of them are in the steady state, ``(g,)``."""

    def reset(self) -> None:
        """Begin anew in the steady state."""
        self.P[:] = self._steady
        self.settled[:] = True

    def correct(self, state: Array, innovation: Array, gate: Array, missing: Indices) -> None:
        """Take a measurement, with the rows that are there and believable.

        Args:
            state: of the whole, as predicted; corrected in place.
            innovation: of the whole, ``(n_measured,)``; NaN or infinite where nothing is measured.
            gate: innovation up to which a row is believed in the steady state; in proportion to the
                deviation of the innovation elsewhere.
            missing: cycles for which each row has not been used; brought up to date.
        """
        x = state[self.states] * self.state_scale
        e = innovation[self.rows] * self.row_scale
        gaps = missing[self.rows]
        P = self._A @ self.P @ self._AT
        P += self._W
        P = np.where(np.abs(P).max(axis=(1, 2), keepdims=True) <= self._most, P, self.P)
        S = self._C @ P @ self._CT + self._V
        seen = np.isfinite(e)
        e[~seen] = 0.0
        widening = np.sqrt(np.diagonal(S, axis1=1, axis2=2)) / self._deviation
        seen &= (np.abs(e) <= gate[self.rows] * self.row_scale * widening) | (gaps >= MOST_REFUSED)
        whole = seen.all(axis=1)
        begins = self.settled & ~whole
        if begins.any():
            for i in np.flatnonzero(begins).tolist():
                self._recall(i, P[i], x[i], e[i])
            S = self._C @ P @ self._CT + self._V
        used = seen.astype(np.float64)
        C = self._C * used[:, :, None]
        S *= used[:, :, None] * used[:, None, :]
        S += self._unit * (1.0 - used)[:, :, None]
        L = _gain(P, C, S)
        x += (L @ (e * used)[:, :, None])[:, :, 0]
        self.P[:] = updated(P, L, C, self._V)
        self.settled[:] = whole & (np.abs(L - self._gain).max(axis=(1, 2)) <= self._near)
        self.P[self.settled] = self._steady[self.settled]
        state[self.states] = x / self.state_scale
        missing[self.rows] = np.where(seen, 0, gaps + 1)

    def _recall(self, i: int, P: Array, x: Array, e: Array) -> None:
        """Bring in what is known beforehand, in place.

        The steady state makes no use of it, as measurements tell more. It is brought in once, where
        they begin to fail: as a measurement that reads 0.
        """
        known = np.flatnonzero(np.isfinite(self._prior[i]))
        if not known.size:
            return
        C, V = np.eye(x.size)[known], np.diag(self._prior[i][known] ** 2)
        L = _gain(P, C, C @ P @ C.T + V)
        change = L @ x[known]
        x -= change
        e += self._C[i] @ change
        P[:] = updated(P, L, C, V)


def _gain(P: Array, C: Array, S: Array) -> Array:
    return np.asarray(P @ C.swapaxes(-1, -2) @ np.linalg.inv(S))


def intermittent(parts: Sequence[Subsystem], prior: Array) -> list[Intermittent]:
    """Put subsystems of one shape together; those that nothing measures are left out."""

    def shape(part: Subsystem) -> tuple[int, int]:
        return part.states.size, part.rows.size

    measured = sorted((part for part in parts if part.rows.size), key=shape)
    return [Intermittent(list(each), prior) for _, each in groupby(measured, key=shape)]
