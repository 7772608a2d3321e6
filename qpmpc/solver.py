"""Between a QP and a backend: scaling and splitting before, a check after, and the clock."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Protocol

import numpy as np

from qpmpc.arrays import Array, all_finite
from qpmpc.backends import Backend, Fact, Limits, RawSolution, backend_class
from qpmpc.errors import BackendSetupError
from qpmpc.parametric import Parametric
from qpmpc.program import QuadraticProgram
from qpmpc.residuals import UNKNOWN, Check, Residuals
from qpmpc.scaling import Scaling
from qpmpc.split import Parts, Pattern
from qpmpc.status import Status

NO_LIMITS = Limits()
TOLERANCE = 1e-6
"""Largest scaled residual with which an answer counts as solved."""
ACCEPTABLE = 1e-3
"""Largest scaled residual with which an answer that is not solved is better than none."""
_CROSSED = 1e-9
"""Share of its size by which rounding may bring a lower bound above the upper one."""
_JUDGED = (Status.SOLVED, Status.INACCURATE, Status.ITERATION_LIMIT)
"""What a backend may say of an answer that is worth a check."""
_DOUBTFUL = (Status.INACCURATE, Status.FAILED, Status.INFEASIBLE, Status.UNBOUNDED)
"""What is worth a second attempt from a cold start."""
_WITHOUT_ANSWER = (Status.INFEASIBLE, Status.UNBOUNDED, Status.FAILED)


@dataclass(frozen=True, slots=True)
class Solution:
    """A checked answer in the QP's own units. The arrays are valid until the next solve."""

    status: Status
    x: Array
    """Minimiser, ``(n,)``; NaN where there is none."""
    y: Array
    """Multipliers of the rows, ``(m,)``, positive at upper bounds, negative at lower ones."""
    slack: Array
    """Violation of each row, ``(m,)``: what soft rows gave way."""
    residuals: Residuals
    iterations: int
    update_time: float
    """Scaling of the vectors [s]."""
    build_time: float
    """What the backend took to build its problem anew, where it has to [s]."""
    solve_time: float
    """The backend without that [s]."""

    @property
    def usable(self) -> bool:
        """Whether the answer may be applied: solved, or not far from it."""
        return self.status is Status.SOLVED or (
            self.status in _JUDGED and self.residuals.scaled <= ACCEPTABLE
        )


class SolverScaling(Protocol):
    """What a solver asks of a scaling."""

    c: float
    E: Array
    q: Array
    l: Array  # noqa: E741
    u: Array

    def update(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Write the scaled vectors into ``q``, ``l`` and ``u``."""
        ...

    def unscale(self, z: Array, out: Array) -> Array:
        """Return the variables behind scaled ones, in ``out``."""
        ...


class SolverParts(Protocol):
    """What a solver asks of the parts that the QP falls into."""

    def __len__(self) -> int: ...

    def forget(self) -> None:
        """Forget what the next solve would start from."""
        ...

    def prepare(self) -> None:
        """Do what needs no vectors."""
        ...

    def facts(self) -> list[Mapping[str, Fact]]:
        """Return what is told of each part."""
        ...

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Solve all of them, scaled."""
        ...


class Solver:
    """One QP family and one backend, persistent: matrices once, vectors at each solve."""

    def __init__(
        self,
        qp: QuadraticProgram,
        backend: str | type[Backend] = "daqp",
        groups: Iterable[slice] | None = None,
        *,
        limits: Limits = NO_LIMITS,
        pattern: Pattern | None = None,
        smallest_part: int | None = None,
        parameters: Parametric | None = None,
    ) -> None:
        """Scale ``qp``, split it, and set the backend up on its constant part.

        Args:
            qp: the program; its vectors are those of the first solve only.
            backend: a registered name, or a subclass of `Backend`.
            groups: rows that share one scale, see `Scaling`.
            limits: when the backend has to stop.
            pattern: where rows may be other than zero after `replace_rows`, ``(m, n)``; where
                they are now, if not given.
            smallest_part: variables that make a component worth a call of its own; the backend's
                own figure if not given.
            parameters: what is known of the vectors to come, for backends that prepare for it.

        Raises:
            UnknownNameError, BackendUnavailableError, BackendSetupError.
        """
        kind = backend_class(backend) if isinstance(backend, str) else backend
        _require(kind, limits)
        self.kind, self.limits = kind, limits
        scaling = Scaling(qp, groups)
        if limits.time and kind.warm_starts:  # a second attempt must find half of the time left
            limits = replace(limits, time=limits.time / 2)
        parts = Parts(
            kind,
            scaling.qp,
            limits,
            patterns=(qp.P != 0, qp.A != 0 if pattern is None else pattern),
            smallest=smallest_part,
            parameters=scaling.parameters(parameters)
            if parameters is not None and kind.takes_parameters
            else None,
        )
        check = Check(qp, scaling, TOLERANCE)
        self.qp, self._dense = qp, (scaling, parts)
        self._set_up(
            kind.name, scaling, parts, check, heeds_rows=kind.heeds_rows, again=kind.warm_starts
        )

    def _set_up(
        self,
        name: str,
        scaling: SolverScaling,
        parts: SolverParts,
        check: Check,
        *,
        heeds_rows: bool,
        again: bool,
    ) -> None:
        """Take what was made for one form of the QP.

        Args:
            name: of the backend. scaling, parts, check: of the same QP.
            heeds_rows: whether answers satisfy the rows.
            again: whether a second attempt, begun from nothing, makes sense.
        """
        self.backend_name, self._heeds_rows, self._again = name, heeds_rows, again
        self._scaling, self._parts, self._check = scaling, parts, check
        n, m = scaling.q.size, scaling.E.size
        self._x, self._y, self._room = np.zeros(n), np.zeros(m), np.zeros(m)
        self._to_y = scaling.E / scaling.c

    @property
    def scaling(self) -> Scaling:
        """The scaling of a condensed QP."""
        return self._dense[0]

    @property
    def parts(self) -> int:
        """How many problems the QP falls into."""
        return len(self._parts)

    def replace_rows(self, A: Array) -> None:
        """Take other rows ``(m, n)`` from the next solve on; penalties and their scale stay."""
        scaling, parts = self._dense
        self._check.replace_rows(A)
        parts.replace_rows(scaling.rows(A))

    def forget(self) -> None:
        """Let the next solve start from nothing, where the backend starts from the last one."""
        self._parts.forget()

    def no_answer(self) -> Solution:
        """Return what stands in the place of an answer where there is no time left for one."""
        return self._failure(Status.LATE, 0, 0.0, 0.0, 0.0)

    def prepare(self) -> None:
        """Let the backend do what can be done between two solves; need not be called."""
        self._parts.prepare()

    def facts(self) -> list[Mapping[str, Fact]]:
        """Return what the backend tells of itself in each of the `parts`; mostly nothing."""
        return self._parts.facts()

    def solve(self, q: Array, l: Array, u: Array) -> Solution:  # noqa: E741
        """Solve for new vectors ``q (n,)``, ``l (m,)``, ``u (m,)`` in the QP's own units.

        Never raises for what the numbers hold: NaN gives ``Status.FAILED``.
        """
        begin = perf_counter()
        refusal = self._refusal(q, l, u)
        if refusal is not None:
            return self._failure(refusal, 0, perf_counter() - begin, 0.0, 0.0)
        self._scaling.update(q, l, u)
        ready = perf_counter()
        status, residuals, iterations, built, spent = self._attempt(q, l, u)
        if status in _DOUBTFUL and self._again:
            self._parts.forget()  # once more, without what the solver started from
            status, residuals, again, more, longer = self._attempt(q, l, u)
            iterations, built, spent = iterations + again, built + more, spent + longer
        if status in _WITHOUT_ANSWER:
            return self._failure(status, iterations, ready - begin, built, spent)
        return Solution(
            status, self._x, self._y, self._check.slack, residuals, iterations,
            ready - begin, built, spent,
        )  # fmt: skip

    def _refusal(self, q: Array, l: Array, u: Array) -> Status | None:  # noqa: E741
        """Return the status of vectors that no solver should see: NaN, or bounds that cross."""
        if not (
            all_finite(q)
            and np.count_nonzero(l < np.inf) == l.size
            and np.count_nonzero(u > -np.inf) == u.size
        ):
            return Status.FAILED
        room = np.subtract(u, l, out=self._room)
        if np.count_nonzero(room < 0):
            size = 1.0 + np.minimum(np.abs(l), np.abs(u))
            if (room < -_CROSSED * size).any():
                return Status.INFEASIBLE
        return None

    def _attempt(
        self,
        q: Array,
        l: Array,  # noqa: E741
        u: Array,
    ) -> tuple[Status, Residuals, int, float, float]:
        """Let the backend solve, bring its answer into the QP's units, and judge it."""
        scaling = self._scaling
        begin = perf_counter()
        raw = self._parts.solve(scaling.q, scaling.l, scaling.u)
        spent = perf_counter() - begin - raw.build_time
        if raw.status in _WITHOUT_ANSWER:  # whatever stands in the answer's place
            return raw.status, UNKNOWN, raw.iterations, raw.build_time, spent
        if not all_finite(raw.x):
            return Status.FAILED, UNKNOWN, raw.iterations, raw.build_time, spent
        scaling.unscale(raw.x, self._x)
        np.multiply(raw.y, self._to_y, out=self._y)
        residuals = self._check(q, l, u, self._x, self._y)
        status = self._judge(raw.status, residuals)
        return status, residuals, raw.iterations, raw.build_time, spent

    def _judge(self, status: Status, residuals: Residuals) -> Status:
        if not self._heeds_rows:
            return status
        if residuals.scaled <= TOLERANCE:
            return Status.SOLVED
        return Status.INACCURATE if status is Status.SOLVED else status

    def _failure(
        self, status: Status, iterations: int, update: float, built: float, spent: float
    ) -> Solution:
        self._x.fill(np.nan)
        self._y.fill(np.nan)
        self._check.slack.fill(np.nan)
        return Solution(
            status, self._x, self._y, self._check.slack, UNKNOWN, iterations, update, built, spent
        )


def solve(
    qp: QuadraticProgram, backend: str | type[Backend] = "daqp", *, limits: Limits = NO_LIMITS
) -> Solution:
    """Solve one QP, from wherever it comes; the arrays of the answer are the caller's.

    Raises:
        UnknownNameError, BackendUnavailableError, BackendSetupError: see `Solver`.
    """
    solution = Solver(qp, backend, limits=limits).solve(qp.q, qp.l, qp.u)
    return replace(solution, x=solution.x.copy(), y=solution.y.copy(), slack=solution.slack.copy())


def _require(kind: type[Backend], limits: Limits) -> None:
    """Refuse a limit that is not positive, or that the solver does not have."""
    for name, value in (("iterations", limits.iterations), ("time", limits.time)):
        if value is None:
            continue
        if not value > 0:
            raise BackendSetupError(kind.name, f"limit of {name} must be positive, got {value}")
        if name not in kind.limits:
            has = " and ".join(sorted(kind.limits)) or "none"
            raise BackendSetupError(kind.name, f"has no limit of {name} (it has: {has})")
