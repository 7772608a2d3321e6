"""From a loose answer of a QP to the exact one."""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve, lu_factor, lu_solve

from qpmpc.arrays import Array
from qpmpc.multipliers import MultiplierSearch, Sides
from qpmpc.program import QuadraticProgram

_EXACT = 1e-10
"""How far an exact answer may leave what it is to satisfy, relative to the size of rows and q."""
_MET = 1e-9
"""The same of rows where dependent ones keep it from better."""
_INEXACT = (1e-8, 1e-5)
"""The same two between proximal points."""
_DEFINITE = 1e-7
"""Least eigenvalue, relative to the largest, of a Hessian that is inverted as it is."""
_PROXIMAL = 1e-6
"""Curvature added to other Hessians, relative to their largest eigenvalue."""
_CENTRES = 30
"""Proximal points."""
_KKT = 1e-8
"""Curvature in the equations of the last correction; repeating them takes its effect out."""
_CORRECTIONS = 20


class Polish:
    """Takes loose answers of one family of QPs to exact ones, or leaves them.

    Where the Hessian is not definite, curvature is added around a point that moves to the answer
    (proximal points); when the active rows stay, their equations are solved with the Hessian as it
    is.
    """

    def __init__(self, qp: QuadraticProgram) -> None:
        """Take the constant part of ``qp``: variables and rows of order one.

        Raises:
            numpy.linalg.LinAlgError: the Hessian is not positive semidefinite.
        """
        self._P, self._linear = np.array(qp.P), np.array(qp.linear)
        eigenvalues = np.linalg.eigvalsh(self._P)
        largest = float(eigenvalues[-1]) or 1.0
        self.definite = bool(eigenvalues[0] > _DEFINITE * largest)
        """Whether the Hessian is inverted as it is."""
        self._curve = 0.0 if self.definite else _PROXIMAL * largest
        eye = np.eye(qp.n)
        self._inverse: Array = cho_solve(cho_factor(self._P + self._curve * eye), eye)
        tolerances = (_EXACT, _MET) if self.definite else _INEXACT
        self._search = MultiplierSearch(self._linear, np.array(qp.quadratic), *tolerances)
        self._patience = 3 * qp.n + 20
        self.x, self.y = np.zeros(qp.n), np.zeros(qp.m)
        """The exact answer, after a call that returned True."""
        self.replace_rows(np.array(qp.A))

    @property
    def steps(self) -> int:
        """Systems of equations solved since `allow`."""
        return self._search.steps

    def allow(self, steps: int, deadline: float) -> None:
        """Set how many systems of equations may be solved, and until when by `perf_counter`."""
        self._search.allow(steps, deadline)

    def replace_rows(self, A: Array) -> None:
        """Take other rows, ``(m, n)``."""
        self._A = A
        # What one unit of each multiplier takes from the minimiser, (n, m).
        self.response = np.ascontiguousarray(self._inverse @ A.T)
        self._search.replace_gram(A @ self.response)

    def minimiser(self, q: Array) -> Array:
        """Return the x that minimises the cost without rows, where the Hessian is definite."""
        return -(self._inverse @ q)

    def __call__(
        self,
        q: Array,
        l: Array,  # noqa: E741
        u: Array,
        x: Array,
        y: Array,
    ) -> bool:
        """Set `x` and `y` to the exact answer, if it is found.

        Args:
            q, l, u: vectors of the QP; bounds may cross by rounding. x, y: loose answer.
        """
        search, A, P = self._search, self._A, self._P
        patience, u = self._patience, np.maximum(l, u)
        search.bound(l, u)
        low = np.where(l > -np.inf, -self._linear, 0.0)
        y = np.minimum(np.maximum(y, low), np.where(u < np.inf, self._linear, 0.0))
        side, last = search.sides(y, A @ x), None
        for _ in range(_CENTRES):
            centre = x
            x = x - self._inverse @ (P @ x + q + y @ A)
            v = A @ x
            found = search.leap(side, y, v)
            if found is None:
                steps = search.steps
                found = search.climb(y, v, patience)
                patience -= search.steps - steps
            if found is None:
                return False
            x = x - self.response @ (found[0] - y)
            y, v, side = found
            if self.definite:
                self.x, self.y = x, y
                return True
            again = last is not None and np.array_equal(last, side)
            if self._finish(side, q, x, y, again=again):
                return True
            if again:
                x = x + self._ahead(x - centre, v, side, l, u)
            last = side
        return False

    def _ahead(
        self,
        way: Array,
        v: Array,
        side: Sides,
        l: Array,  # noqa: E741
        u: Array,
    ) -> Array:
        """Return how far the next points would go on as the last one did, ``way (n,)``.

        To the minimum of the cost, or the first row: then the equations change.
        """
        move = self._A @ way
        ends = np.where(move > 0, u, l) - v
        free = (side == 0) & (np.abs(move) > _EXACT * float(np.abs(move).max(initial=0.0)))
        room = float((ends[free] / move[free]).min(initial=np.inf))
        curvature = float(way @ self._P @ way)
        if curvature > 0.0:
            room = min(room, self._curve * float(way @ way) / curvature)
        return max(room, 0.0) * way if room < np.inf else np.zeros_like(way)

    def _finish(self, side: Sides, q: Array, x: Array, y: Array, *, again: bool) -> bool:
        """Set the answer, if this is one; ``again``: or can be corrected to be one."""
        search, n = self._search, x.size
        x, y, factors, before = x.copy(), y.copy(), None, np.inf
        level = _EXACT * (1.0 + float(np.abs(q).max(initial=0.0)))
        for _ in range(_CORRECTIONS):
            v, slope = self._A @ x, self._P @ x + q + y @ self._A
            held, lead, give = search.equations(side, y, v)
            reach = max(1.0, float(np.abs(v).max(initial=0.0)))
            error = max(
                np.abs(slope).max() / level, np.abs(lead).max(initial=0.0) / (_EXACT * reach)
            )
            if error <= 1.0:
                self.x, self.y = x, y
                return bool(search.wrong(side, y, v).max(initial=0.0) <= _MET * reach)
            if not again or not error < before:
                return False
            before = error
            if factors is None:
                if not search.pay():
                    return False
                rows = self._A[held]
                K = np.block([[self._P, rows.T], [rows, -np.diag(give)]])
                K.flat[:: K.shape[0] + 1] += np.repeat([_KKT, -_KKT], [n, held.size])
                factors = lu_factor(K, overwrite_a=True, check_finite=False)
            step = lu_solve(factors, -np.concatenate([slope, lead]), check_finite=False)
            x += step[:n]
            y[held] += step[n:]
        return False
