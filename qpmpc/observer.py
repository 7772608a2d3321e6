"""Kalman observer for any (A, B) and measured rows; augmented models included."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from qpmpc.arrays import Array, all_finite, matrix, vector
from qpmpc.errors import ObserverError
from qpmpc.intermittent import intermittent
from qpmpc.kalman import joined, kalman_gain, subsystems
from qpmpc.models import LinearModel

__all__ = ["KalmanObserver", "kalman_gain"]

_NEVER = np.int64(2**40)
"""Cycles without a row that has not been measured yet."""


class KalmanObserver:
    """State estimate that a controller carries from cycle to cycle.

    `correct` takes a measurement, `predict` the command that was applied; both work in place.

    As long as everything is measured, the gain is that of the steady state. Rows that are missing
    (NaN or infinite), or that the gate refuses, are left out: the covariance is then followed from
    cycle to cycle, and with it the gain for the rows that are there, until everything has been
    there long enough for the steady state to be back.
    """

    def __init__(
        self,
        model: LinearModel,
        measured: ArrayLike,
        process_noise: ArrayLike,
        measurement_noise: ArrayLike,
        *,
        patience: int = 0,
        gate: ArrayLike = np.inf,
        prior: ArrayLike = np.inf,
    ) -> None:
        """Compute the steady-state gain.

        Args:
            model: (A, B) with all augmentation; its C is not used.
            measured: rows that are measured, ``(n_measured, n)``.
            process_noise: W, covariance of the states' increments per cycle, ``(n, n)``.
            measurement_noise: V, covariance of the measurement, ``(n_measured, n_measured)``,
                positive definite.
            patience: cycles that a row may be missing until the estimate counts as uninformed.
            gate: how far a row may lie off what is expected before it is taken for wrong, at most
                three times in a row, in its unit and in the steady state; where less is known it
                is wider, as the deviation of the innovation is; scalar or ``(n_measured,)``.
            prior: standard deviation of each state as it is known beforehand, around 0; taken into
                account when measurements begin to fail; scalar or ``(n,)``, infinite: not known.

        Raises:
            ObserverError: no steady-state observer exists, or an argument is out of range.
        """
        n = model.n_states
        self.A, self.B = np.array(model.A), np.array(model.B)
        """The model's matrices, ``(n, n)`` and ``(n, n_inputs)``."""
        self.measured = np.array(matrix("measured", measured, columns=n))
        """Rows that are measured, ``(n_measured, n)``."""
        m = self.measured.shape[0]
        W = matrix("process_noise", process_noise, n, n)
        V = matrix("measurement_noise", measurement_noise, m, m)
        if np.linalg.eigvalsh(V).min() <= 0:
            raise ObserverError("measurement_noise must be positive definite")
        self.gate = np.array(vector("gate", gate, m, finite=False))
        """Innovation up to which a row is taken in the steady state, ``(n_measured,)``."""
        if not (self.gate > 0).all():
            raise ObserverError(f"gate must be positive, got {self.gate.min():g}")
        if patience < 0:
            raise ObserverError(f"patience must not be negative, got {patience} cycles")
        parts = subsystems(self.A, self.measured, W, V)
        self.gain = joined(parts, self.measured.shape)
        """Filter gain of the steady state, ``(n, n_measured)``."""
        self.state = np.zeros(n)
        self.patience = patience
        self.missing = np.full(m, _NEVER)
        """Cycles for which each row has not been used, ``(n_measured,)``."""
        self.settled = np.ones(1, dtype=np.int64)
        """Whether every gain is that of the steady state, ``(1,)``; 1 or 0."""
        self._gated = bool(np.isfinite(self.gate).any())
        known = vector("prior", prior, n, finite=False)
        if not (known > 0).all():
            raise ObserverError(f"prior must be positive, got {known.min():g}")
        self._parts = intermittent(parts, known)
        self._innovation = np.zeros(m)
        self._work, self._work2 = np.zeros(n), np.zeros(n)

    @property
    def informed(self) -> bool:
        """Whether every row has been measured, and none was missing longer than `patience`."""
        return int(self.missing.max(initial=0)) <= self.patience

    def reset(self, state: ArrayLike = 0.0) -> None:
        """Set the estimate, ``(n,)`` or a scalar for all; it counts for no measurement."""
        self.state[:] = state
        self.missing[:] = _NEVER
        self.settled[0] = 1
        for parts in self._parts:
            parts.reset()

    def correct(self, measurement: Array) -> Array:
        """Blend in a measurement ``(n_measured,)``; return the estimate x(k|k), in place.

        What is not finite is not measured.
        """
        innovation = np.dot(self.measured, self.state, out=self._innovation)
        np.subtract(measurement, innovation, out=innovation)
        if self.settled[0] and all_finite(innovation) and self._within(innovation):
            self.state += np.dot(self.gain, innovation, out=self._work)
            self.missing.fill(0)
        else:
            for parts in self._parts:
                parts.correct(self.state, innovation, self.gate, self.missing)
            self.settled[0] = all(parts.settled.all() for parts in self._parts)
        return self.state

    def predict(self, command: Array) -> Array:
        """Advance by one cycle under the applied command ``(n_inputs,)``; return x(k+1|k)."""
        np.dot(self.A, self.state, out=self._work)
        self._work += np.dot(self.B, command, out=self._work2)
        self.state[:] = self._work
        return self.state

    def _within(self, innovation: Array) -> bool:
        return not self._gated or bool((np.abs(innovation) <= self.gate).all())
