"""OSQP: operator splitting (Stellato et al., Math. Prog. Comp. 12, 2020), with a polish of our own.

OSQP starts from the multipliers of the cycle before. Its loosely converged iterate is polished:
OSQP's own polish fails on the nearly dependent rows of a force bound over the horizon, and prints a
line per solve where it has nothing to do; the one of `qpmpc.polish` ends at the exact answer of the
soft QP, or leaves OSQP's as it is. Then OSQP goes on, longer each time.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from qpmpc.arrays import Array, all_finite
from qpmpc.backends._registry import register
from qpmpc.backends.base import Backend, LimitKind, Limits, RawSolution
from qpmpc.errors import BackendSetupError
from qpmpc.feasibility import contradictory
from qpmpc.polish import Polish
from qpmpc.program import QuadraticProgram, SlackForm
from qpmpc.status import Status

_RHO = 1.0
"""Step size to begin with; OSQP adapts it."""
# Deterministic: the default interval of rho's adaptation follows the clock. Scaling is done before.
_SETTINGS = {
    "verbose": False,
    "eps_abs": 1e-9,
    "eps_rel": 1e-9,
    "eps_prim_inf": 1e-6,
    "eps_dual_inf": 1e-6,
    "check_termination": 5,
    "adaptive_rho_interval": 25,
    "rho": _RHO,
    "scaling": 0,
    "polishing": False,
    "warm_starting": True,
}
_ROUNDS = (25, 225, 250, 500, 1000, 2000)
"""OSQP's iterations before each polish. In a cycle much like the last the first are enough."""
_WITH_ITERATE = (Status.SOLVED, Status.INACCURATE, Status.ITERATION_LIMIT)


@register
class OsqpBackend(Backend):
    """OSQP on the form with explicit slack, persistent, warm-started, polished.

    Iterations are OSQP's and the polish's together.
    """

    name: ClassVar[str] = "osqp"
    package: ClassVar[str] = "osqp"
    summary: ClassVar[str] = "OSQP, operator splitting with polishing; all bounds"
    warm_starts: ClassVar[bool] = True
    replaces_rows: ClassVar[bool] = True
    limits: ClassVar[frozenset[LimitKind]] = frozenset(("iterations", "time"))
    smallest_part: ClassVar[int] = 32  # three calls of 8 variables cost twice one of 24

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Set the solver up and solve once.

        Raises:
            BackendSetupError: P is not positive semidefinite, or OSQP refuses the problem.
        """
        import osqp  # noqa: PLC0415 - only this backend needs it

        status = osqp.SolverStatus
        self._status = {
            status.OSQP_SOLVED: Status.SOLVED,
            status.OSQP_SOLVED_INACCURATE: Status.INACCURATE,
            status.OSQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
            status.OSQP_PRIMAL_INFEASIBLE_INACCURATE: Status.INFEASIBLE,
            status.OSQP_DUAL_INFEASIBLE: Status.UNBOUNDED,
            status.OSQP_DUAL_INFEASIBLE_INACCURATE: Status.UNBOUNDED,
            status.OSQP_MAX_ITER_REACHED: Status.ITERATION_LIMIT,
            status.OSQP_TIME_LIMIT_REACHED: Status.ITERATION_LIMIT,
        }
        self._new, self._refusal = osqp.OSQP, (ValueError, osqp.OSQPException)
        self._most, self._time = limits.iterations or 10**9, limits.time or np.inf
        self._form = SlackForm(qp)
        self._soft, self._hard = qp.soft, np.flatnonzero(np.isinf(qp.linear))
        self._A, self._linear = np.array(qp.A), np.array(qp.linear)
        try:
            self._polish = Polish(qp)
        except np.linalg.LinAlgError as error:
            raise BackendSetupError(
                self.name, f"P is not positive semidefinite ({error})"
            ) from error
        self._x, self._y = np.zeros(qp.n), np.zeros(qp.m)
        self._start, self._pull = np.zeros(self._form.q.size), np.zeros(self._form.l.size)
        self._answer = RawSolution(Status.SOLVED, np.zeros(qp.n), np.zeros(qp.m), 0)
        self._rough = False  # whether the last polish was a long one: OSQP then starts with more
        self._pattern = self._form.A != 0
        self._setup()
        self.solve(np.zeros(qp.n), np.full(qp.m, -np.inf), np.full(qp.m, np.inf))

    def replace_rows(self, A: Array) -> None:
        """Refactor inside OSQP; set it up anew where an entry was zero in all rows before.

        Raises:
            BackendSetupError: OSQP refuses the rows.
        """
        np.copyto(self._A, A)
        self._polish.replace_rows(self._A)
        self._form.replace_rows(A)
        entries = self._form.A != 0
        if (entries & ~self._pattern).any():
            self._pattern |= entries
            self._setup()
        else:
            self._solver.update(Ax=self._form.A.T[self._pattern.T])

    def forget(self) -> None:
        """Begin from zero, and with the first step size."""
        self._x.fill(0.0)
        self._y.fill(0.0)
        self._rough = False
        self._solver.update_settings(rho=_RHO)

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Update the vectors, run OSQP, polish, and so on."""
        answer, polish, n = self._answer, self._polish, self._x.size
        deadline = perf_counter() + self._time
        answer.iterations = 0
        if np.count_nonzero(l > u):  # by rounding: OSQP would print, and keep the vectors it has
            u = np.maximum(l, u)
        idle = self._begin(q, l, u)
        first = 1 if self._rough else 0
        for attempt, planned in enumerate(_ROUNDS[first:], first):
            self._allow(min(planned, (self._most - answer.iterations + 1) // 2), deadline)
            result = self._solver.solve(raise_error=False)
            answer.iterations += result.info.iter
            answer.status = self._status.get(result.info.status_val, Status.FAILED)
            if idle and answer.status in _WITH_ITERATE:
                answer.status, answer.x = Status.SOLVED, self._x.copy()
                answer.y.fill(0.0)
                return answer
            answer.x = result.x[:n]
            if answer.status in _WITH_ITERATE and not all_finite(answer.x):
                answer.status = Status.FAILED
            if answer.status not in _WITH_ITERATE:
                self.forget()
                return answer
            self._form.multipliers(result.y, answer.y)
            polish.allow(self._most - answer.iterations, deadline)
            exact = polish(q, l, u, answer.x, answer.y, thorough=attempt > 0)
            answer.iterations += polish.steps
            if exact:
                self._rough = polish.climbed
                answer.status, answer.x = Status.SOLVED, polish.x
                np.copyto(answer.y, polish.y)
                break
            if answer.status is not Status.ITERATION_LIMIT:
                break
            if answer.iterations >= self._most or perf_counter() > deadline:
                break
        else:
            if contradictory(self._A[self._hard], l[self._hard], u[self._hard]):
                answer.status = Status.INFEASIBLE
        answer.y[(answer.y > 0) & (u == np.inf) | (answer.y < 0) & (l == -np.inf)] = 0.0
        np.copyto(self._x, answer.x)
        np.copyto(self._y, answer.y)
        return answer

    def _setup(self) -> None:
        form, pattern = self._form, self._pattern
        A = sparse.csc_matrix(pattern.astype(np.float64))
        A.data[:] = form.A.T[pattern.T]  # zeros inside the pattern stay entries
        self._solver: Any = self._new()
        try:
            self._solver.setup(
                sparse.csc_matrix(sparse.triu(form.P)), form.q, A, form.l, form.u, **_SETTINGS
            )
        except self._refusal as error:
            raise BackendSetupError(self.name, f"OSQP refused the problem: {error}") from error
        self._allowed = 0

    def _allow(self, iterations: int, deadline: float) -> None:
        """Set OSQP's own limits for its next call."""
        if deadline < np.inf:
            left = max(deadline - perf_counter(), 1e-9)
            self._solver.update_settings(max_iter=iterations, time_limit=left)
        elif iterations != self._allowed:
            self._solver.update_settings(max_iter=iterations)
        self._allowed = iterations

    def _begin(self, q: Array, l: Array, u: Array) -> bool:  # noqa: E741
        """Give OSQP vectors and a start; whether that breaks no row and is the minimiser."""
        form, x, y, start, pull = self._form, self._x, self._y, self._start, self._pull
        n, h, k, soft = x.size, self._hard.size, self._soft.size, self._soft
        form.update(q, l, u)
        self._solver.update(q=form.q, l=form.l, u=form.u)
        idle = False
        if self._polish.definite:
            np.copyto(x, self._polish.minimiser(q))
        rows = self._A @ x
        give = np.maximum(rows - u, l - rows)
        if self._polish.definite:
            idle = bool(give.max(initial=0.0) <= 0.0)
            if idle:
                y.fill(0.0)
            elif np.count_nonzero(y):
                x -= self._polish.response @ y
                rows = self._A @ x
                give = np.maximum(rows - u, l - rows)
        start[:n] = x
        np.maximum(give[soft], 0.0, out=start[n:])
        price = y[soft]
        pull[:h] = y[self._hard]
        np.minimum(price, 0.0, out=pull[h : h + k])
        np.maximum(price, 0.0, out=pull[h + k : h + 2 * k])
        np.subtract(np.abs(price), self._linear[soft], out=pull[h + 2 * k :])
        self._solver.warm_start(x=start, y=pull)
        return idle
