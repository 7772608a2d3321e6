"""Steady-state Kalman observer for any (A, B) and measured rows; augmented models included."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, solve_discrete_are
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from qpmpc.arrays import Array, matrix
from qpmpc.errors import ObserverError
from qpmpc.models import LinearModel


def kalman_gain(A: Array, C: Array, W: Array, V: Array) -> Array:
    """Return the filter gain L of the steady-state Kalman observer, ``(n, n_measured)``.

    ``x(k|k) = x(k|k-1) + L (y(k) - C x(k|k-1))`` with L from the discrete algebraic Riccati
    equation for process noise W ``(n, n)`` and measurement noise V ``(n_measured, n_measured)``.

    What nothing couples is solved apart, so that axes do not leak into each other by rounding.

    Raises:
        ObserverError: the equation has no stabilising solution: what is measured does not tell
            some state that does not decay by itself.
    """
    n = A.shape[0]
    L = np.zeros((n, C.shape[0]))
    links = np.block([[A, C.T], [C, V]]) != 0
    links[:n, :n] |= W != 0
    count, label = connected_components(csr_matrix(links), directed=False)
    for i in range(count):
        x, y = np.flatnonzero(label[:n] == i), np.flatnonzero(label[n:] == i)
        if x.size:
            own, seen = np.ix_(x, x), np.ix_(y, x)
            L[np.ix_(x, y)] = _coupled_gain(A[own], C[seen], W[own], V[np.ix_(y, y)])
    return L


def _coupled_gain(A: Array, C: Array, W: Array, V: Array) -> Array:
    """Return the gain of one subsystem."""
    if not C.size:
        _require_stable(A)
        return np.zeros((A.shape[0], 0))
    # Forces in N, accelerations of tens of m/s^2 and noise of micrometres per second meet here:
    # scale states and measurements to unit noise gains before the Riccati solver sees them.
    scale_y = 1.0 / np.sqrt(np.diag(V))
    scale_x = _state_scale(A, scale_y[:, None] * C)
    A_s = scale_x[:, None] * A / scale_x
    C_s = scale_y[:, None] * C / scale_x
    W_s = scale_x[:, None] * W * scale_x
    V_s = scale_y[:, None] * V * scale_y
    try:
        P = solve_discrete_are(A_s.T, C_s.T, W_s, V_s)
    except (LinAlgError, ValueError) as error:
        raise ObserverError(
            f"no steady-state observer: the measured outputs do not determine every state ({error})"
        ) from error
    L = np.linalg.solve(C_s @ P @ C_s.T + V_s, C_s @ P).T
    _require_stable((np.eye(A.shape[0]) - L @ C_s) @ A_s)
    return np.asarray(L / scale_x[:, None] * scale_y)


def _require_stable(closed: Array) -> None:
    radius = np.abs(np.linalg.eigvals(closed)).max()
    if not radius < 1.0:
        raise ObserverError(f"no stable observer: its slowest pole would lie at {radius:.6f}")


def _state_scale(A: Array, C: Array) -> Array:
    """Largest effect of each state on the weighted outputs over the first steps."""
    effect = np.zeros(A.shape[0])
    power = C
    for _ in range(2 * A.shape[0]):
        effect = np.maximum(effect, np.abs(power).max(axis=0))
        power = power @ A
    return np.where(effect > 0, effect, 1.0)


class KalmanObserver:
    """State estimate that a controller carries from cycle to cycle.

    `correct` takes a measurement, `predict` the command that was applied; both work in place.
    """

    def __init__(
        self,
        model: LinearModel,
        measured: ArrayLike,
        process_noise: ArrayLike,
        measurement_noise: ArrayLike,
    ) -> None:
        """Compute the steady-state gain.

        Args:
            model: (A, B) with all augmentation; its C is not used.
            measured: rows that are measured, ``(n_measured, n)``.
            process_noise: W, covariance of the states' increments per cycle, ``(n, n)``.
            measurement_noise: V, covariance of the measurement, ``(n_measured, n_measured)``,
                positive definite.

        Raises:
            ObserverError: no steady-state observer exists.
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
        self.gain = kalman_gain(self.A, self.measured, W, V)
        self.state = np.zeros(n)
        self._innovation = np.zeros(m)
        self._work, self._work2 = np.zeros(n), np.zeros(n)

    def reset(self, state: ArrayLike = 0.0) -> None:
        """Set the estimate, ``(n,)`` or a scalar for all."""
        self.state[:] = state

    def correct(self, measurement: Array) -> Array:
        """Blend in a measurement ``(n_measured,)``; return the estimate x(k|k), in place."""
        innovation = np.dot(self.measured, self.state, out=self._innovation)
        np.subtract(measurement, innovation, out=innovation)
        self.state += np.dot(self.gain, innovation, out=self._work)
        return self.state

    def predict(self, command: Array) -> Array:
        """Advance by one cycle under the applied command ``(n_inputs,)``; return x(k+1|k)."""
        np.dot(self.A, self.state, out=self._work)
        self._work += np.dot(self.B, command, out=self._work2)
        self.state[:] = self._work
        return self.state
