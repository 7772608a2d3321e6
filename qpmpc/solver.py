"""Between a QP and a backend: scaling before, a check of the answer after, and the clock."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from qpmpc.arrays import Array, all_finite
from qpmpc.backends import Backend, Limits, backend_class
from qpmpc.program import QuadraticProgram
from qpmpc.scaling import Scaling
from qpmpc.status import Status

NO_LIMITS = Limits()
TOLERANCE = 1e-6
"""Largest residual with which an answer counts as solved, relative to the problem's size."""
_JUDGED = (Status.SOLVED, Status.INACCURATE, Status.ITERATION_LIMIT)
"""What a backend may say of an answer that is worth a check."""
_DOUBTFUL = (Status.INACCURATE, Status.FAILED)
"""What is worth a second attempt from a cold start."""
_WITHOUT_ANSWER = (Status.INFEASIBLE, Status.FAILED)


@dataclass(frozen=True, slots=True)
class Residuals:
    """How far an answer is from optimal, in scaled units, computed by the library."""

    primal: float
    """Largest violation of a hard row."""
    dual: float
    """Largest entry of ``P x + q + A' y``."""
    gap: float
    """Largest violation of complementarity: a multiplier on a row that is not at its bound."""


_UNKNOWN = Residuals(float("nan"), float("nan"), float("nan"))


@dataclass(frozen=True, slots=True)
class Solution:
    """A checked answer in the QP's own units. The arrays are valid until the next solve."""

    status: Status
    x: Array
    """Minimiser, ``(n,)``."""
    slack: Array
    """Violation of each row, ``(m,)``: what soft rows gave way."""
    residuals: Residuals
    iterations: int
    update_time: float
    """Scaling of the vectors [s]."""
    solve_time: float
    """The backend alone [s]."""


class Solver:
    """One QP family and one backend, persistent: matrices once, vectors at each solve."""

    def __init__(
        self,
        qp: QuadraticProgram,
        backend: str | type[Backend] = "daqp",
        groups: Iterable[slice] | None = None,
        limits: Limits = NO_LIMITS,
    ) -> None:
        """Scale ``qp`` and set the backend up on its constant part.

        Args:
            qp: the program; its vectors are those of the first solve only.
            backend: a registered name, or a class with the members of `Backend`.
            groups: rows that share one scale, see `Scaling`.

        Raises:
            UnknownNameError, BackendUnavailableError, BackendSetupError.
        """
        kind = backend_class(backend) if isinstance(backend, str) else backend
        self.qp, self.backend_name = qp, kind.name
        self._heeds_rows = kind.heeds_rows
        self._scaling = Scaling(qp, groups)
        scaled = self._scaling.qp
        self._backend = kind(scaled, limits)
        self._P, self._A = np.array(scaled.P), np.array(scaled.A)
        self._At = np.ascontiguousarray(self._A.T)
        self._hard = np.isinf(scaled.linear)
        self._linear = np.where(self._hard, 0.0, scaled.linear)
        self._quadratic2 = 2.0 * scaled.quadratic
        self._answer = np.zeros(qp.n)
        self._x, self._gradient, self._work = (np.zeros(qp.n) for _ in range(3))
        self._Ax, self._over, self._under, self._s, self._price = (np.zeros(qp.m) for _ in range(5))

    def solve(self, q: Array, l: Array, u: Array) -> Solution:  # noqa: E741
        """Solve for new vectors ``q (n,)``, ``l (m,)``, ``u (m,)`` in the QP's own units.

        Never raises for what the numbers hold: NaN gives ``Status.FAILED``.
        """
        begin = perf_counter()
        scaling = self._scaling
        if not _solvable(q, l, u):
            return self._failure(Status.FAILED, 0, perf_counter() - begin, 0.0)
        scaling.update(q, l, u)
        ready = perf_counter()
        status, residuals, iterations, spent = self._attempt()
        if status in _DOUBTFUL:  # once more, without what the solver started from
            self._backend.forget()
            status, residuals, again, more = self._attempt()
            iterations, spent = iterations + again, spent + more
        if status in _WITHOUT_ANSWER:
            return self._failure(status, iterations, ready - begin, spent)
        np.dot(scaling.T, self._answer, out=self._x)
        self._s /= scaling.E
        return Solution(status, self._x, self._s, residuals, iterations, ready - begin, spent)

    def _attempt(self) -> tuple[Status, Residuals, int, float]:
        """Let the backend solve, keep its answer in scaled variables, and judge it."""
        scaling = self._scaling
        begin = perf_counter()
        raw = self._backend.solve(scaling.q, scaling.l, scaling.u)
        spent = perf_counter() - begin
        if raw.status is Status.INFEASIBLE:  # there is no answer, whatever stands in its place
            return raw.status, _UNKNOWN, raw.iterations, spent
        if not all_finite(raw.x):
            return Status.FAILED, _UNKNOWN, raw.iterations, spent
        self._answer = raw.x
        residuals = self._check(raw.x, raw.y)
        return self._judge(raw.status, residuals), residuals, raw.iterations, spent

    def _check(self, x: Array, y: Array) -> Residuals:
        """Compute residuals and, as a by-product, the violation of each row into ``_s``."""
        s, over, under = self._s, self._over, self._under
        Ax = np.dot(self._A, x, out=self._Ax)
        np.subtract(Ax, self._scaling.u, out=over)
        np.subtract(self._scaling.l, Ax, out=under)
        np.maximum(over, under, out=s)
        np.maximum(s, 0.0, out=s)
        gradient = np.dot(self._P, x, out=self._gradient)
        gradient += self._scaling.q
        primal = gap = 0.0
        violated = np.count_nonzero(s) > 0  # a third of the time of any()
        if violated:
            primal = float(np.max(s, where=self._hard, initial=0.0))
        if violated or np.count_nonzero(y):
            gradient += np.dot(self._At, y, out=self._work)
            gap = self._gap(y)
        np.abs(gradient, out=gradient)
        return Residuals(primal, float(gradient.max(initial=0.0)), gap)

    def _gap(self, y: Array) -> float:
        """Return how far multipliers and rows are from complementary; uses up the work arrays."""
        s, price, over, under = self._s, self._price, self._over, self._under
        # A row away from its bounds must have no multiplier: min(distance, multiplier) is 0 there.
        np.negative(over, out=over)
        np.negative(under, out=under)
        gap = max(float(np.minimum(over, y).max()), float(np.minimum(under, -y).max()))
        # A soft row that gives way by s has the multiplier linear + 2 quadratic s, never more.
        np.multiply(self._quadratic2, s, out=price)
        price += self._linear
        price -= np.abs(y, out=over)
        price[self._hard] = 0.0
        return max(gap, float(-price.min()), float(np.minimum(price, s).max()), 0.0)

    def _judge(self, status: Status, residuals: Residuals) -> Status:
        if not self._heeds_rows or status not in _JUDGED:
            return status
        if _within(residuals, 1.0, 1.0):
            return Status.SOLVED
        # Relative to the size of the problem: far from the setpoint all figures are large.
        level = 1.0 + float(np.abs(self._scaling.q).max(initial=0.0))
        reach = 1.0 + float(np.abs(self._Ax).max(initial=0.0))
        if _within(residuals, level, reach):
            return Status.SOLVED
        return Status.INACCURATE if status is Status.SOLVED else status

    def _failure(self, status: Status, iterations: int, update: float, spent: float) -> Solution:
        self._x.fill(np.nan)
        self._s.fill(np.nan)
        return Solution(status, self._x, self._s, _UNKNOWN, iterations, update, spent)


def _solvable(q: Array, l: Array, u: Array) -> bool:  # noqa: E741
    """Whether no vector holds NaN, and infinity stands only where a bound is left out."""
    return (
        all_finite(q)
        and np.count_nonzero(l < np.inf) == l.size
        and np.count_nonzero(u > -np.inf) == u.size
    )


def _within(residuals: Residuals, level: float, reach: float) -> bool:
    """Whether all residuals are tolerable; one by one, as the largest of them may hide a NaN."""
    return (
        residuals.primal <= TOLERANCE * reach
        and residuals.dual <= TOLERANCE * level
        and residuals.gap <= TOLERANCE * max(level, reach)
    )
