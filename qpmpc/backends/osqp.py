"""OSQP: operator splitting (Stellato et al., Math. Prog. Comp. 12, 2020), with a polish of our own.

Every solve starts from the unconstrained minimiser. Where that breaks no row it is the answer, and
OSQP's first termination check says so. Elsewhere OSQP starts from the multipliers of the cycle
before, and its loosely converged iterate is polished: OSQP's own polish fails on the nearly
dependent rows of a force bound over the horizon, and prints a line per solve where it has nothing
to do; the one here ends at the exact answer of the soft QP, or leaves OSQP's as it is.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from qpmpc.arrays import Array
from qpmpc.backends._registry import register
from qpmpc.backends.base import Backend, LimitKind, Limits, RawSolution
from qpmpc.errors import BackendSetupError
from qpmpc.program import QuadraticProgram, SlackForm
from qpmpc.status import Status

# Deterministic: the default interval of rho's adaptation follows the clock. Scaling is done before.
_SETTINGS = {
    "verbose": False,
    "eps_abs": 1e-5,
    "eps_rel": 1e-5,
    "max_iter": 250,
    "check_termination": 5,
    "adaptive_rho_interval": 25,
    "rho": 1.0,
    "scaling": 0,
    "polishing": False,
    "warm_starting": True,
}
_ROUNDS = 16
"""Times that OSQP is sent on where the polish did not end in an exact answer."""
_EXACT = 1e-10
"""How far an exact answer may leave a row's range, in scaled units."""
_MET = 1e-8
"""How far an exact answer may miss a bound that it is to sit on, in scaled units."""
_HUGE = 1e9
"""Multiplier that no row has whose equations can be met."""
_REGULAR = 1e-12
"""Curvature that keeps dependent rows solvable; the steps that follow take its effect out."""


@register
class OsqpBackend(Backend):
    """OSQP on the form with explicit slack, persistent, warm-started, polished."""

    name: ClassVar[str] = "osqp"
    package: ClassVar[str] = "osqp"
    summary: ClassVar[str] = "OSQP, operator splitting with polishing; all bounds"
    warm_starts: ClassVar[bool] = True
    replaces_rows: ClassVar[bool] = True
    limits: ClassVar[frozenset[LimitKind]] = frozenset(("iterations", "time"))

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Set the solver up, with the multipliers of the case that no row is active."""
        import osqp  # noqa: PLC0415 - only this backend needs it

        self._form = form = SlackForm(qp)
        self._n, self._n_slack = qp.n, form.q.size - qp.n
        self._soft, self._A = qp.soft, np.array(qp.A)
        self._linear = np.array(qp.linear)
        quadratic = np.array(qp.quadratic)
        self._half = np.full(qp.m, np.inf)
        np.divide(0.5, quadratic, out=self._half, where=quadratic > 0)
        try:
            self._gain = -cho_solve(cho_factor(qp.P), np.eye(qp.n))
            self._definite = True
        except np.linalg.LinAlgError:  # only semidefinite: no minimiser to start from
            self._gain, self._definite = np.zeros((qp.n, qp.n)), False
        self._back = -self._gain @ self._A.T
        self._gram = self._A @ self._back
        self._solver: Any = osqp.OSQP()
        self._status = {
            osqp.SolverStatus.OSQP_SOLVED: Status.SOLVED,
            osqp.SolverStatus.OSQP_SOLVED_INACCURATE: Status.INACCURATE,
            osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
            osqp.SolverStatus.OSQP_PRIMAL_INFEASIBLE_INACCURATE: Status.INFEASIBLE,
            osqp.SolverStatus.OSQP_MAX_ITER_REACHED: Status.ITERATION_LIMIT,
            osqp.SolverStatus.OSQP_TIME_LIMIT_REACHED: Status.ITERATION_LIMIT,
        }
        try:
            self._solver.setup(
                sparse.csc_matrix(sparse.triu(form.P)),
                form.q, sparse.csc_matrix(form.A), form.l, form.u,
                **_SETTINGS | ({} if self._definite else {"eps_abs": 1e-8, "eps_rel": 1e-8}),
            )  # fmt: skip
        except (ValueError, osqp.OSQPException) as error:
            raise BackendSetupError(self.name, f"OSQP refused the problem: {error}") from error
        self._idle = np.zeros(form.l.size)
        self._idle[form.l.size - self._n_slack :] = -self._linear[qp.soft]
        self._start = np.zeros(form.q.size)
        self._answer = RawSolution(Status.SOLVED, np.zeros(qp.n), np.zeros(qp.m), 0)
        self._solver.warm_start(x=self._start, y=self._idle)
        self._solver.solve(raise_error=False)

    def forget(self) -> None:
        """Take the multipliers of the case that no row is active."""
        self._solver.warm_start(y=self._idle)

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Update the vectors, run OSQP from the unconstrained minimiser, polish."""
        form, answer, start, n = self._form, self._answer, self._start, self._n
        np.dot(self._gain, q, out=start[:n])
        rows = self._A @ start[:n]
        over = np.maximum(np.maximum(rows - u, l - rows), 0.0)
        start[n:] = over[self._soft]
        form.update(q, l, u)
        self._solver.update(q=form.q, l=form.l, u=form.u)
        idle = self._definite and not over.any()
        self._solver.warm_start(x=start, y=self._idle if idle else None)
        answer.iterations = 0
        for _ in range(_ROUNDS):
            result = self._solver.solve(raise_error=False)
            answer.iterations += result.info.iter
            answer.status = self._status.get(result.info.status_val, Status.FAILED)
            answer.x = result.x[:n]
            form.multipliers(result.y, answer.y)
            if not answer.status.usable and answer.status is not Status.ITERATION_LIMIT:
                break
            if idle:
                answer.status, answer.x = Status.SOLVED, start[:n]
                answer.y.fill(0.0)
                break
            if self._definite and self._polish(start[:n], rows, l, u):
                answer.status = Status.SOLVED
                break
            if answer.status is not Status.ITERATION_LIMIT:
                break
        return answer

    def _polish(self, free: Array, rows: Array, l: Array, u: Array) -> bool:  # noqa: E741
        """Climb from OSQP's multipliers to the exact ones by an active-set method on the dual.

        A row is inside (side 0), at a bound (±1) or, soft, beyond it (±2). Rows at a bound are
        equations; a step towards their solution ends where a multiplier reaches 0 or the penalty.

        Args:
            free: the unconstrained minimiser. rows: the rows there. l, u: their bounds.

        Returns:
            Whether it got there; only then does the answer change.
        """
        linear, half, y = self._linear, self._half, self._answer.y.copy()
        y[(y > 0) & (u == np.inf) | (y < 0) & (l == -np.inf)] = 0.0
        side = np.sign(y).astype(int)
        side[np.abs(y) <= 1e-6] = 0
        side[np.abs(y) >= linear * (1 - 1e-6)] *= 2
        y = np.where(side == 0, 0.0, y)
        firm = np.isinf(half)
        fixed = (np.abs(side) == 2) & firm
        y[fixed] = np.sign(y[fixed]) * linear[fixed]
        for _ in range(3 * self._n + 20):
            size = np.abs(side)
            held = np.flatnonzero((size == 1) | (size == 2) & ~firm)
            sign, beyond = np.sign(side), size == 2
            bound = np.where(side > 0, u, l)
            Ax = rows - self._gram @ y
            if held.size:
                K = self._gram[np.ix_(held, held)]
                lead = (Ax - bound)[held]
                two = np.flatnonzero(beyond[held])
                K[two, two] += half[held[two]]
                give = held[two]
                lead[two] -= half[give] * (y[give] - sign[give] * linear[give])
                K[np.diag_indices(held.size)] += _REGULAR
                step = cho_solve(cho_factor(K, check_finite=False), lead, check_finite=False)
                pull, towards = (y * sign)[held], step * sign[held]
                low = np.where(beyond[held], linear[held], 0.0)
                high = np.where(beyond[held], np.inf, linear[held])
                room = np.where(towards > 0, high - pull, low - pull)
                with np.errstate(divide="ignore", invalid="ignore"):
                    reach = np.where(towards != 0, room / towards, np.inf)
                first = int(np.argmin(reach))
                if reach[first] < 1.0:
                    y[held] += max(reach[first], 0.0) * step
                    i, up = held[first], towards[first] > 0
                    y[i] = sign[i] * (linear[i] if up or beyond[i] else 0.0)
                    side[i] = 2 * sign[i] if up else sign[i] if beyond[i] else 0
                    continue
                y[held] += step
                Ax = rows - self._gram @ y
            fixed = beyond & firm
            outside = np.where(side == 0, np.maximum(Ax - u, l - Ax), 0.0)
            with np.errstate(invalid="ignore"):  # 0 times an infinite bound, where it is not used
                wrong = np.where(fixed, sign * (bound - Ax), outside)
            i = int(np.argmax(wrong))
            if wrong[i] <= _EXACT:
                level = held[size[held] == 1]
                if np.abs(Ax - bound)[level].max(initial=0.0) > _MET or np.abs(y).max() > _HUGE:
                    return False  # the equations contradict each other
                self._answer.x, self._answer.y = free - self._back @ y, y
                return True
            side[i] = sign[i] if fixed[i] else 1 if Ax[i] > u[i] else -1
        return False
