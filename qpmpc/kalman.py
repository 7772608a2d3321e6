"""Kalman filters in their steady state, subsystem by subsystem."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError, solve_discrete_are, solve_discrete_lyapunov
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from qpmpc.arrays import Array, Indices
from qpmpc.errors import ObserverError


@dataclass(frozen=True, eq=False)
class Subsystem:
    """States and measurements that nothing couples to others, in scaled units.

    Forces in N, accelerations of tens of m/s^2 and noise of micrometres per second meet here:
    states and measurements are scaled to unit noise gains before anything is solved for.
    """

    states: Indices
    """Which states of the whole."""
    rows: Indices
    """Which measured rows of the whole."""
    state_scale: Array
    """What a state is multiplied by, ``(n,)``."""
    row_scale: Array
    """What a measurement is multiplied by, ``(m,)``."""
    A: Array
    C: Array
    W: Array
    V: Array
    """Model and noise, scaled."""
    P: Array
    """Covariance of the estimate after the measurement, in the steady state, ``(n, n)``."""
    L: Array
    """Filter gain of the steady state, ``(n, m)``."""

    @cached_property
    def deviation(self) -> Array:
        """Standard deviation of the innovation in the steady state, scaled, ``(m,)``."""
        S = self.C @ (self.A @ self.P @ self.A.T + self.W) @ self.C.T + self.V
        return np.asarray(np.sqrt(np.diag(S)))


def subsystems(A: Array, C: Array, W: Array, V: Array) -> list[Subsystem]:
    """Split an observer into what nothing couples, and solve each.

    Axes then do not leak into each other by rounding.

    Args:
        A: state matrix, ``(n, n)``.
        C: measured rows, ``(n_measured, n)``.
        W, V: covariance of process and measurement noise.

    Raises:
        ObserverError: there is no stabilising solution: what is measured does not tell some state
            that does not decay by itself.
    """
    n = A.shape[0]
    links = np.block([[A, C.T], [C, V]]) != 0
    links[:n, :n] |= W != 0
    count, label = connected_components(csr_matrix(links), directed=False)
    found = []
    for i in range(count):
        x, y = np.flatnonzero(label[:n] == i), np.flatnonzero(label[n:] == i)
        if x.size:
            own = np.ix_(x, x)
            found.append(_solved((x, y), A[own], C[np.ix_(y, x)], W[own], V[np.ix_(y, y)]))
    return found


def kalman_gain(A: Array, C: Array, W: Array, V: Array) -> Array:
    """Return the filter gain L of the steady-state Kalman observer, ``(n, n_measured)``.

    ``x(k|k) = x(k|k-1) + L (y(k) - C x(k|k-1))`` with L from the discrete algebraic Riccati
    equation for process noise W ``(n, n)`` and measurement noise V ``(n_measured, n_measured)``.

    Raises:
        ObserverError: see `subsystems`.
    """
    return joined(subsystems(A, C, W, V), C.shape)


def joined(parts: Sequence[Subsystem], shape: tuple[int, ...]) -> Array:
    """Return the gain of the whole in its own units, for C of ``shape`` (n_measured, n)."""
    L = np.zeros(shape[::-1])
    for part in parts:
        L[np.ix_(part.states, part.rows)] = part.L / part.state_scale[:, None] * part.row_scale
    return L


def _solved(where: tuple[Indices, Indices], A: Array, C: Array, W: Array, V: Array) -> Subsystem:
    """Scale and solve one subsystem; ``where``: its states and rows in the whole."""
    x, y = where
    row_scale = 1.0 / np.sqrt(np.diag(V))
    state_scale = _state_scale(A, row_scale[:, None] * C)
    A_s = state_scale[:, None] * A / state_scale
    C_s = row_scale[:, None] * C / state_scale
    W_s = state_scale[:, None] * W * state_scale
    V_s = row_scale[:, None] * V * row_scale
    if not y.size:
        _require_stable(A)
        P, L = _at_rest(A_s, W_s), np.zeros((x.size, 0))
    else:
        try:
            P = solve_discrete_are(A_s.T, C_s.T, W_s, V_s)
        except (LinAlgError, ValueError) as error:
            raise ObserverError(
                f"no steady-state observer: the measured outputs do not determine every state "
                f"({error})"
            ) from error
        L = np.linalg.solve(C_s @ P @ C_s.T + V_s, C_s @ P).T
        _require_stable((np.eye(x.size) - L @ C_s) @ A_s)
        P = updated(P, L, C_s, V_s)
    return Subsystem(x, y, state_scale, row_scale, A_s, C_s, W_s, V_s, P, L)


def updated(P: Array, L: Array, C: Array, V: Array) -> Array:
    """Return the covariance after a measurement with any gain L: Joseph's form, which stays
    positive whatever is rounded; of one system, or of a stack of them.
    """
    rest = np.eye(P.shape[-1]) - L @ C
    return np.asarray(rest @ P @ rest.swapaxes(-1, -2) + L @ V @ L.swapaxes(-1, -2))


def _at_rest(A: Array, W: Array) -> Array:
    """Return the covariance of a stable system that nothing measures."""
    return np.asarray(solve_discrete_lyapunov(A, W))


def _require_stable(closed: Array) -> None:
    radius = np.abs(np.linalg.eigvals(closed)).max()
    if not radius < 1.0:
        raise ObserverError(f"no stable observer: its slowest pole would lie at {radius:.6f}")


def _state_scale(A: Array, C: Array) -> Array:
    """Largest effect of each state on the weighted outputs over the first steps."""
    effect = np.zeros(A.shape[0])
    power = C
    for _ in range(2 * A.shape[0]):
        effect = np.maximum(effect, np.abs(power).max(axis=0, initial=0.0))
        power = power @ A
    return np.where(effect > 0, effect, 1.0)
