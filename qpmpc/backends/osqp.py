"""OSQP: operator splitting (Stellato et al., Math. Prog. Comp. 12, 2020), with a polish of our own.

Where the minimiser of the cost breaks no row it is the answer, and OSQP has nothing to do.
Elsewhere it starts from the multipliers of the cycle before and runs for a fixed, small number of
iterations: not to converge, which takes thousands where soft rows give way, but to say which rows
are active. `qpmpc.polish` goes from there to the exact answer. (OSQP's own polish fails on the
nearly dependent rows of a force bound over the horizon.) Where it does not get there, OSQP goes
on, longer each time. `docs/osqp.md` has the study behind it.
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

_SETTINGS = {
    "verbose": False,
    "eps_abs": 1e-9,
    "eps_rel": 1e-9,
    "eps_prim_inf": 1e-6,
    "eps_dual_inf": 1e-6,
    "check_termination": 25,
    "adaptive_rho_interval": 50,  # the default follows the clock: not the same twice
    "scaling": 0,  # done before
    "polishing": False,
    "warm_starting": True,
}
_FAR = 1e30
"""What OSQP takes for infinite."""
_EFFORT = 400.0
"""Systems of equations that a polish may solve for each iteration of OSQP, times the number of
variables and rows: the larger a problem, the more iterations a system costs."""
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

    step_size: ClassVar[float] = 1.0
    """OSQP's rho to begin with; from the second round on OSQP adapts it."""
    rounds: ClassVar[tuple[int, ...]] = (25, 75, 150, 250, 500, 1000, 2000)
    """OSQP's iterations before each polish."""

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Set the solver up and solve once.

        Raises:
            BackendSetupError: P is not positive semidefinite, or OSQP refuses the problem.
        """
        import osqp  # noqa: PLC0415 - only this backend needs it

        status = osqp.SolverStatus
        self._status = {
            int(status.OSQP_SOLVED): Status.SOLVED,
            int(status.OSQP_SOLVED_INACCURATE): Status.INACCURATE,
            int(status.OSQP_PRIMAL_INFEASIBLE): Status.INFEASIBLE,
            int(status.OSQP_PRIMAL_INFEASIBLE_INACCURATE): Status.INFEASIBLE,
            int(status.OSQP_DUAL_INFEASIBLE): Status.UNBOUNDED,
            int(status.OSQP_DUAL_INFEASIBLE_INACCURATE): Status.UNBOUNDED,
            int(status.OSQP_MAX_ITER_REACHED): Status.ITERATION_LIMIT,
            int(status.OSQP_TIME_LIMIT_REACHED): Status.ITERATION_LIMIT,
        }
        # OSQP in C. The Python class around it takes longer than OSQP does for one axis.
        self._osqp: Any = osqp.OSQP().ext
        self._settings: Any = self._osqp.OSQPSettings()
        self._osqp.osqp_set_default_settings(self._settings)
        for name, value in _SETTINGS.items():
            setattr(self._settings, name, value)
        self._settings.rho = self.step_size
        self._most, self._time = limits.iterations or 10**9, limits.time or np.inf
        self._effort = _EFFORT / (qp.n + qp.m)
        self._form = SlackForm(qp)
        self._soft, self._hard = qp.soft, np.flatnonzero(np.isinf(qp.linear))
        self._A, self._linear = np.array(qp.A), qp.linear[self._soft]
        try:
            self._polish = Polish(qp)
        except np.linalg.LinAlgError as error:
            raise BackendSetupError(
                self.name, f"P is not positive semidefinite ({error})"
            ) from error
        rows = self._form.l.size
        self._x, self._y = np.zeros(qp.n), np.zeros(qp.m)
        self._start, self._pull = np.zeros(self._form.q.size), np.zeros(rows)
        self._l, self._u = np.zeros(rows), np.zeros(rows)
        self._rows, self._give, self._work = (np.zeros(qp.m) for _ in range(3))
        self._answer = RawSolution(Status.SOLVED, np.zeros(qp.n), np.zeros(qp.m), 0)
        self._adapted = False  # whether the step size is another than at first
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
            values = self._form.A.T[self._pattern.T]
            self._solver.update_data_mat(P_x=None, P_i=None, A_x=values, A_i=None)

    def forget(self) -> None:
        """Begin from zero."""
        self._x = np.zeros_like(self._x)  # the old one may still be somebody's answer
        self._y.fill(0.0)

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Return the minimiser without rows, or run OSQP, polish, and so on."""
        answer = self._answer
        answer.iterations = 0
        if np.count_nonzero(l > u):  # by rounding: OSQP would keep the vectors it has
            u = np.maximum(l, u)
        if self._polish.definite:
            self._x = self._polish.minimiser(q)
            if self._measure(l, u) <= 0.0:
                self._y.fill(0.0)
                answer.y.fill(0.0)
                answer.status, answer.x = Status.SOLVED, self._x
                return answer
        self._begin(q, l, u)
        self._run(q, l, u)
        if answer.status in _WITH_ITERATE:
            answer.y[(answer.y > 0) & (u == np.inf) | (answer.y < 0) & (l == -np.inf)] = 0.0
            self._x = answer.x
            np.copyto(self._y, answer.y)
        else:
            self.forget()
        return answer

    def _run(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Let OSQP and the polish take turns until one of them has an answer, or time is up."""
        answer, solver, polish = self._answer, self._solver, self._polish
        deadline = perf_counter() + self._time
        for planned in self.rounds:
            self._allow(min(planned, (self._most - answer.iterations + 1) // 2), deadline)
            solver.solve()
            info, found = solver.info, solver.solution
            answer.iterations += info.iter
            self._adapted |= info.rho_updates > 0
            answer.status = self._status.get(info.status_val, Status.FAILED)
            answer.x = found.x[: self._x.size]
            if answer.status not in _WITH_ITERATE:
                return
            if not all_finite(answer.x):
                answer.status = Status.FAILED
                return
            self._form.multipliers(found.y, answer.y)
            equations = max(int(planned * self._effort), 3)
            polish.allow(min(equations, self._most - answer.iterations), deadline)
            exact = polish(q, l, u, answer.x, answer.y)
            answer.iterations += polish.steps
            if exact:
                answer.status, answer.x = Status.SOLVED, polish.x
                np.copyto(answer.y, polish.y)
                return
            if answer.status is not Status.ITERATION_LIMIT:
                return
            if answer.iterations >= self._most or perf_counter() > deadline:
                return
        if contradictory(self._A[self._hard], l[self._hard], u[self._hard]):
            answer.status = Status.INFEASIBLE

    def _setup(self) -> None:
        form, pattern, C = self._form, self._pattern, self._osqp
        A = sparse.csc_matrix(pattern.astype(np.float64))
        A.data[:] = form.A.T[pattern.T]  # zeros inside the pattern stay entries
        P = sparse.csc_matrix(sparse.triu(form.P))
        rows, n = A.shape
        try:
            self._solver: Any = C.OSQPSolver(
                C.CSC(P), form.q, C.CSC(A), np.full(rows, -_FAR), np.full(rows, _FAR), rows, n,
                self._settings,
            )  # fmt: skip
        except ValueError as error:
            raise BackendSetupError(self.name, f"OSQP refused the problem: {error}") from error

    def _allow(self, iterations: int, deadline: float) -> None:
        """Set OSQP's own limits for its next call."""
        settings = self._settings
        if deadline < np.inf:
            settings.time_limit = max(deadline - perf_counter(), 1e-9)
        elif iterations == settings.max_iter:
            return
        settings.max_iter = iterations
        self._solver.update_settings(settings)

    def _measure(self, l: Array, u: Array) -> float:  # noqa: E741
        """Set by how much the rows are beyond their bounds at ``_x``; return the most."""
        rows, give = np.dot(self._A, self._x, out=self._rows), self._give
        np.subtract(rows, u, out=give)
        np.subtract(l, rows, out=self._work)
        np.maximum(give, self._work, out=give)
        return float(give.max(initial=0.0))

    def _begin(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Give OSQP vectors, and a start from the last multipliers."""
        form, y, start, pull = self._form, self._y, self._start, self._pull
        n, h, k, soft = self._x.size, self._hard.size, self._soft.size, self._soft
        if np.count_nonzero(y) or not self._polish.definite:
            if self._polish.definite:
                self._x -= self._polish.response @ y
            self._measure(l, u)
        form.update(q, l, u)
        np.maximum(form.l, -_FAR, out=self._l)
        np.minimum(form.u, _FAR, out=self._u)
        start[:n] = self._x
        np.maximum(self._give[soft], 0.0, out=start[n:])
        price = y[soft]
        pull[:h] = y[self._hard]
        np.minimum(price, 0.0, out=pull[h : h + k])
        np.maximum(price, 0.0, out=pull[h + k : h + 2 * k])
        np.subtract(np.abs(price), self._linear, out=pull[h + 2 * k :])
        if self._adapted:
            self._solver.update_rho(self.step_size)
            self._adapted = False
        self._solver.update_data_vec(form.q, self._l, self._u)
        self._solver.warm_start(start, pull)
