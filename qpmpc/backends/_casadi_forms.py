"""Soft QPs as the hard ones that CasADi's solvers take, with bounds on single variables apart."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from qpmpc.arrays import Array
from qpmpc.program import QuadraticProgram, SlackForm

_UNIT = 0.25
"""Slack is measured in units of the price to minus this power: 0 is the row's own unit, 1 the one
in which the price is 1. At either end OSQP needs many times the iterations."""


class Form(Protocol):
    """A hard QP over ``(x, slack)``, its vectors written in place.

    minimise 1/2 z' P z + q' z  subject to  l <= A z <= u,  z >= lower.
    """

    n: int
    """Number of variables of the soft QP; they come first."""
    P: Array
    A: Array
    lower: Array
    """-inf for x, 0 for slack."""
    q: Array
    l: Array  # noqa: E741 - the field's name for it
    u: Array

    def replace_rows(self, A: Array) -> None:
        """Write other rows ``(m, n)`` of the soft QP into ``self.A``, in place."""
        ...

    def update(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Write the vectors of the soft QP, in place."""
        ...

    def multipliers(self, y: Array, out: Array) -> Array:
        """Fold the multipliers of the rows into one per row of the soft QP, into ``out``."""
        ...


class OneSlack(SlackForm):
    """`SlackForm` with ``s >= 0`` as bounds on variables instead of rows.

    Least variables, twice the soft rows: best where each bound that is met costs an iteration.
    """

    def __init__(self, qp: QuadraticProgram) -> None:
        """Build the constant part from ``qp``."""
        super().__init__(qp)
        rows = self.l.size - self._n_soft
        self.A, self.l, self.u = self.A[:rows], self.l[:rows], self.u[:rows]
        self.lower = np.zeros(self.q.size)
        self.lower[: self.n] = -np.inf


class TwoSlacks:
    """A slack below and one above each soft row: ``l <= A x + s_l - s_u <= u``.

    The rows of the soft QP with their own multipliers, and never two that are all but parallel:
    in `OneSlack` these make ProxQP call feasible problems infeasible, and OSQP slow.
    """

    def __init__(self, qp: QuadraticProgram) -> None:
        """Build the constant part from ``qp``."""
        soft = qp.soft
        n, m, k = qp.n, qp.m, soft.size
        size = qp.linear[soft] ** -_UNIT
        self.n = n
        self.P = np.zeros((n + 2 * k, n + 2 * k))
        self.P[:n, :n] = qp.P
        slack = np.arange(n, n + 2 * k)
        self.P[slack, slack] = np.tile(2.0 * qp.quadratic[soft] * size**2, 2)
        self.A = np.zeros((m, n + 2 * k))
        self.A[soft, slack[:k]], self.A[soft, slack[k:]] = size, -size
        self.lower = np.zeros(n + 2 * k)
        self.lower[:n] = -np.inf
        self.q = np.concatenate([qp.q, np.tile(qp.linear[soft] * size, 2)])
        self.l, self.u = np.array(qp.l), np.array(qp.u)
        self.replace_rows(qp.A)

    def replace_rows(self, A: Array) -> None:
        """See `Form`."""
        self.A[:, : self.n] = A

    def update(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """See `Form`."""
        self.q[: self.n] = q
        np.copyto(self.l, l)
        np.copyto(self.u, u)

    def multipliers(self, y: Array, out: Array) -> Array:
        """See `Form`."""
        np.copyto(out, y)
        return out
