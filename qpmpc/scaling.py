"""Scale variables and rows to order one before any solver sees them.

Theta's entries run over decades (K_s T^2 against K_s N T), and first-order solvers with the usual
tolerances return nonsense on the raw problem. Where the Hessian allows it, variables are whitened
by its Cholesky factor, ``x = T z`` with ``T' P T`` a multiple of the identity, and rows of one
physical quantity are divided by their common size in the new variables. Elsewhere (a semidefinite
Hessian) variables and rows are equilibrated together (Ruiz 2001).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.linalg import solve_triangular

from qpmpc.arrays import Array
from qpmpc.errors import ModelError
from qpmpc.parametric import Parametric
from qpmpc.program import INFINITE, QuadraticProgram

_CONDITION = 1e12
"""Condition of the Hessian up to which it is worth inverting."""
_ROUNDING = 1e-9
"""Negative eigenvalue, beside the largest, that rounding may cause."""
_ROUNDS = 12
"""Rounds of equilibration; each takes the square root of what is left."""


class Scaling:
    """A QP in scaled variables and rows, and the way there and back.

    ``x = T z``, ``A_scaled = E A T``, objective times ``c``; with ``c`` and the size of T chosen
    such that z has the size of x and the scaled Hessian is the identity, where it can be.
    """

    def __init__(self, qp: QuadraticProgram, groups: Iterable[slice] | None = None) -> None:
        """Compute the scaling of ``qp``.

        Args:
            qp: the program in its own units.
            groups: rows of one quantity, which share one scale: a row that the decision hardly
                moves stays small beside its neighbours instead of being blown up. Each row is a
                group of its own if not given.

        Raises:
            ModelError: the Hessian is not positive semidefinite.
        """
        T = _whitening(qp.P)
        if T is None:
            T = np.diag(_equilibrium(qp))
        size = float(np.mean(np.abs(np.diag(T)))) or 1.0
        self.T = np.ascontiguousarray(T / size)
        self._Tt = np.ascontiguousarray(self.T.T)
        P = self._Tt @ qp.P @ self.T
        self.c = _cost_scale(P)
        P *= self.c
        A = qp.A @ self.T
        norms = np.linalg.norm(A, axis=1)
        for rows in groups or ():
            norms[rows] = norms[rows].max(initial=0.0)
        self.E = 1.0 / np.where(norms > 0, norms, 1.0)
        self.qp = QuadraticProgram(
            (P + P.T) / 2,
            self._Tt @ qp.q * self.c,
            self.E[:, None] * A,
            self.E * qp.l,
            self.E * qp.u,
            self.c * qp.linear / self.E,
            self.c * qp.quadratic / self.E**2,
        )
        self.q, self.l, self.u = np.zeros(qp.n), np.zeros(qp.m), np.zeros(qp.m)

    def update(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Write the scaled vectors into ``self.q``, ``self.l``, ``self.u``, in place."""
        np.dot(self._Tt, q, out=self.q)
        self.q *= self.c
        np.multiply(self.E, l, out=self.l)
        np.multiply(self.E, u, out=self.u)
        np.putmask(self.l, l <= -INFINITE, -np.inf)
        np.putmask(self.u, u >= INFINITE, np.inf)

    def unscale(self, z: Array, out: Array) -> Array:
        """Return the variables ``(n,)`` behind scaled ones, in ``out``."""
        return np.dot(self.T, z, out=out)

    def rows(self, A: Array) -> Array:
        """Return other rows ``(m, n)`` of the QP, scaled as the first ones are."""
        return np.ascontiguousarray(self.E[:, None] * (A @ self.T))

    def parameters(self, known: Parametric) -> Parametric:
        """Return what is known of the QP's vectors, of the scaled ones."""
        E = self.E[:, None]
        return Parametric(
            self._Tt @ known.gradient * self.c,
            self._Tt @ known.q0 * self.c,
            E * known.offset,
            np.where(known.l0 <= -INFINITE, -np.inf, self.E * known.l0),
            np.where(known.u0 >= INFINITE, np.inf, self.E * known.u0),
        )

    def gradient(self, g: Array, out: Array) -> Array:
        """Scale a gradient ``(n,)`` of the QP's own cost, into ``out``."""
        np.dot(self._Tt, g, out=out)
        out *= self.c
        return out

    def level(self) -> float:
        """Return the largest entry of the scaled ``q`` of the last `update`."""
        return float(np.abs(self.q).max(initial=0.0))


def _whitening(P: Array) -> Array | None:
    """Return T with T' P T = I, or None where P is only semidefinite, or nearly so."""
    eigenvalues = np.linalg.eigvalsh(P)
    if eigenvalues[0] < -_ROUNDING * max(eigenvalues[-1], -eigenvalues[0]):
        raise ModelError(
            f"P must be positive semidefinite, its least eigenvalue is {eigenvalues[0]:.3g}"
        )
    if not eigenvalues[-1] < _CONDITION * eigenvalues[0]:
        return None
    upper = np.linalg.cholesky(P).T
    # Entries of the inverse that the structure of P makes zero stay exactly zero.
    return np.asarray(solve_triangular(upper, np.eye(P.shape[0])))


def _equilibrium(qp: QuadraticProgram) -> Array:
    """Return the scales of the variables that make all columns of [P; A] about equally large."""
    P, A = np.abs(qp.P), np.abs(qp.A)
    d, e = np.ones(qp.n), np.ones(qp.m)
    for _ in range(_ROUNDS):
        scaled, rows = d[:, None] * P * d, e[:, None] * A * d
        column = np.maximum(scaled.max(axis=0, initial=0.0), rows.max(axis=0, initial=0.0))
        d /= np.sqrt(np.where(column > 0, column, 1.0))
        row = rows.max(axis=1, initial=0.0)
        e /= np.sqrt(np.where(row > 0, row, 1.0))
    return d


def _cost_scale(P: Array) -> float:
    """Return the factor that makes the Hessian's diagonal one in the mean, where it is not zero."""
    diagonal = np.diag(P)[np.diag(P) > 0]
    return 1.0 / float(diagonal.mean()) if diagonal.size else 1.0
