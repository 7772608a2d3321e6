"""Scale variables and rows to order one before any solver sees them.

Theta's entries run over decades (K_s T^2 against K_s N T), and first-order solvers with the usual
tolerances return nonsense on the raw problem. Variables are whitened by the Cholesky factor of the
Hessian, ``x = T z`` with ``T' P T`` a multiple of the identity; rows of one physical quantity are
divided by their common size in the new variables.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.linalg import solve_triangular

from qpmpc.arrays import Array
from qpmpc.program import QuadraticProgram


class Scaling:
    """A QP in scaled variables and rows, and the way there and back.

    ``x = T z``, ``A_scaled = E A T``, objective times ``c``; with ``c`` and the size of T chosen
    such that z has the size of x and the scaled Hessian is the identity.
    """

    def __init__(self, qp: QuadraticProgram, groups: Iterable[slice] | None = None) -> None:
        """Compute the scaling of ``qp``.

        Args:
            qp: the program in its own units.
            groups: rows of one quantity, which share one scale: a row that the decision hardly
                moves stays small beside its neighbours instead of being blown up. Each row is a
                group of its own if not given.
        """
        T = _whitening(qp.P)
        size = float(np.mean(np.abs(np.diag(T)))) or 1.0
        self.T = np.ascontiguousarray(T / size)
        self._Tt = np.ascontiguousarray(self.T.T)
        self.c = size**2
        P = self._Tt @ qp.P @ self.T * self.c
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


def _whitening(P: Array) -> Array:
    """Return T with T' P T = I; diagonal scaling where P is only semidefinite."""
    try:
        upper = np.linalg.cholesky(P).T
    except np.linalg.LinAlgError:
        return np.diag(1.0 / np.sqrt(np.where(np.diag(P) > 0, np.diag(P), 1.0)))
    return np.asarray(solve_triangular(upper, np.eye(P.shape[0])))
