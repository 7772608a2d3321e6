"""The quadratic program that controller and backends speak about, with soft rows in it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from qpmpc.arrays import Array, Indices, matrix, vector
from qpmpc.errors import BoundsError, ModelError

INFINITE = 1e20
"""Size from which a bound is none."""


@dataclass(frozen=True, eq=False)
class QuadraticProgram:
    """A convex QP over ``x`` of size n, with m rows of which some may be soft.

        minimise    1/2 x' P x + q' x + sum_i (linear_i s_i + quadratic_i s_i^2)
        subject to  l - s <= A x <= u + s,   s >= 0,   s_i = 0 where linear_i is infinite

    A soft row gives way at the price ``linear_i`` per unit of violation: an exact penalty, as long
    as it exceeds the multiplier that the row would have if it were hard.

    Bounds of 1e20 and more are taken as infinite, as is the custom of files of QPs.

    Raises:
        ShapeError: sizes do not fit. ModelError: NaN, P not symmetric, negative penalty. (That P
            is positive semidefinite is seen when a `Solver` is made.)
        BoundsError: a lower bound above the upper one.
    """

    P: Array
    """Hessian, ``(n, n)``, symmetric, positive semidefinite."""
    q: Array
    """Gradient at zero, ``(n,)``."""
    A: Array
    """Rows, ``(m, n)``."""
    l: Array  # noqa: E741 - the field's name for it
    """Lower bounds, ``(m,)``, may be -inf."""
    u: Array
    """Upper bounds, ``(m,)``, may be +inf."""
    linear: Array = field(default_factory=lambda: np.array(np.inf))
    """Penalty per unit of violation of each row, ``(m,)`` or a scalar for all; infinite: hard."""
    quadratic: Array = field(default_factory=lambda: np.array(0.0))
    """Penalty per squared unit of violation of each row, ``(m,)`` or a scalar for all."""

    def __post_init__(self) -> None:
        P = matrix("P", self.P)
        n = P.shape[0]
        if n == 0:
            raise ModelError("P must have at least one variable")
        matrix("P", P, n, n)
        if not np.allclose(P, P.T, rtol=1e-9, atol=1e-12 * max(1.0, np.abs(P).max(initial=0.0))):
            raise ModelError("P must be symmetric")
        A = matrix("A", self.A, columns=n)
        m = A.shape[0]
        fields = {
            "P": P,
            "q": vector("q", self.q, n),
            "A": A,
            "l": _with_infinity(vector("l", self.l, m, finite=False)),
            "u": _with_infinity(vector("u", self.u, m, finite=False)),
            "linear": vector("linear", self.linear, m, finite=False),
            "quadratic": vector("quadratic", self.quadratic, m),
        }
        for name, value in fields.items():
            object.__setattr__(self, name, value)
        if (fields["linear"] <= 0).any() or (fields["quadratic"] < 0).any():
            raise ModelError("penalties must be positive (linear) and not negative (quadratic)")
        crossed = np.flatnonzero(fields["l"] > fields["u"])
        if crossed.size:
            i = int(crossed[0])
            raise BoundsError(f"row {i}", f"lower {self.l[i]:g} exceeds upper {self.u[i]:g}")

    @property
    def n(self) -> int:
        """Number of variables."""
        return int(self.P.shape[0])

    @property
    def m(self) -> int:
        """Number of rows."""
        return int(self.A.shape[0])

    @property
    def soft(self) -> Indices:
        """Indices of the soft rows, ``(n_soft,)``."""
        return np.flatnonzero(np.isfinite(self.linear))

    def __repr__(self) -> str:
        return f"QuadraticProgram(variables={self.n}, rows={self.m}, soft={self.soft.size})"


def _with_infinity(bounds: Array) -> Array:
    far = np.abs(bounds) >= INFINITE
    if not far.any():
        return bounds
    result = np.where(far, np.copysign(np.inf, bounds), bounds)
    result.flags.writeable = False
    return result


class SlackForm:
    """A soft QP written as a hard one with explicit slack, for solvers that know no soft rows.

    Variables become ``(x, s)``. A soft row ``l - s <= a x <= u + s`` becomes the two rows
    ``a x + s >= l`` and ``a x - s <= u``, and every slack gets a row ``s >= 0``; hard rows stay.
    Which rows are there depends on the constant part alone: bounds may move, in and out of
    infinity too, without a change of the matrix.
    """

    def __init__(self, qp: QuadraticProgram) -> None:
        """Build the constant part ``P``, ``A`` and the maps of the vectors from ``qp``."""
        soft = qp.soft
        hard = np.setdiff1d(np.arange(qp.m), soft)
        k = soft.size
        zero = np.zeros((qp.n, k))
        self.n, self._n_hard, self._n_soft = qp.n, hard.size, k
        self._hard, self._soft = hard, soft
        self.P = np.block([[qp.P, zero], [zero.T, 2.0 * np.diag(qp.quadratic[soft])]])
        eye = np.eye(k)
        rows = hard.size + 3 * k
        self.A = np.zeros((rows, qp.n + k))
        self.A[hard.size :, qp.n :] = np.vstack([eye, -eye, eye])
        self.replace_rows(qp.A)
        self.q = np.concatenate([qp.q, qp.linear[soft]])
        self.l, self.u = np.full(rows, -np.inf), np.full(rows, np.inf)
        self.l[rows - k :] = 0.0
        self.update(qp.q, qp.l, qp.u)

    def replace_rows(self, A: Array) -> None:
        """Write other rows ``(m, n)`` of the soft QP into ``self.A``, in place."""
        h, k, n = self._n_hard, self._n_soft, self.n
        self.A[:h, :n] = A[self._hard]
        self.A[h : h + k, :n] = self.A[h + k : h + 2 * k, :n] = A[self._soft]

    def update(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Write the vectors of the soft QP into ``self.q``, ``self.l``, ``self.u``, in place."""
        h, k = self._n_hard, self._n_soft
        self.q[: self.n] = q
        np.take(l, self._hard, out=self.l[:h])
        np.take(u, self._hard, out=self.u[:h])
        np.take(l, self._soft, out=self.l[h : h + k])
        np.take(u, self._soft, out=self.u[h + k : h + 2 * k])

    def multipliers(self, y: Array, out: Array) -> Array:
        """Fold the multipliers of the slack form into one per row of the soft QP, into ``out``."""
        h, k = self._n_hard, self._n_soft
        out[self._hard] = y[:h]
        out[self._soft] = y[h : h + k] + y[h + k : h + 2 * k]
        return out
