"""OSQP: operator splitting (Stellato et al., Math. Prog. Comp. 12, 2020), with polishing.

Every solve starts from the unconstrained minimiser. Where no bound is active, that is the answer,
and the first termination check accepts it; where some are, the multipliers of the cycle before
help, and polishing takes the loosely converged iterate to solver accuracy.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from scipy import sparse
from scipy.linalg import cho_factor, cho_solve

from qpmpc.arrays import Array
from qpmpc.backends._registry import register
from qpmpc.backends.base import RawSolution
from qpmpc.errors import BackendSetupError
from qpmpc.program import QuadraticProgram, SlackForm
from qpmpc.status import Status

# Deterministic: the default interval of rho's adaptation follows the clock. Scaling is done before.
_SETTINGS = {
    "verbose": False,
    "eps_abs": 1e-5,
    "eps_rel": 1e-5,
    "max_iter": 4000,
    "check_termination": 5,
    "adaptive_rho_interval": 25,
    "rho": 1.0,
    "scaling": 0,
    "polishing": True,
    "polish_refine_iter": 5,
    "delta": 1e-8,
    "warm_starting": True,
}


@register
class OsqpBackend:
    """OSQP on the form with explicit slack, persistent, warm-started, polished."""

    name: ClassVar[str] = "osqp"
    package: ClassVar[str] = "osqp"
    summary: ClassVar[str] = "OSQP, operator splitting with polishing; all bounds"
    heeds_rows: ClassVar[bool] = True

    def __init__(self, qp: QuadraticProgram) -> None:
        """Set the solver up, with the multipliers of the case that no row is active."""
        import osqp  # noqa: PLC0415 - only this backend needs it

        self._form = form = SlackForm(qp)
        self._n, self._n_slack = qp.n, form.q.size - qp.n
        self._soft, self._A_soft = qp.soft, np.ascontiguousarray(qp.A[qp.soft])
        try:
            self._gain = -cho_solve(cho_factor(qp.P), np.eye(qp.n))
        except np.linalg.LinAlgError:  # only semidefinite: no unconstrained minimiser to start from
            self._gain = np.zeros((qp.n, qp.n))
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
                form.q, sparse.csc_matrix(form.A), form.l, form.u, **_SETTINGS,
            )  # fmt: skip
        except (ValueError, osqp.OSQPException) as error:
            raise BackendSetupError(self.name, f"OSQP refused the problem: {error}") from error
        self._idle = np.zeros(form.l.size)
        self._idle[form.l.size - self._n_slack :] = -qp.linear[qp.soft]
        self._start = np.zeros(form.q.size)
        self._answer = RawSolution(Status.SOLVED, np.zeros(qp.n), np.zeros(qp.m), 0)
        self._solver.warm_start(x=self._start, y=self._idle)
        self._solver.solve()

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Update the vectors and solve from the unconstrained minimiser."""
        form, start, n = self._form, self._start, self._n
        form.update(q, l, u)
        np.dot(self._gain, q, out=start[:n])
        if self._n_slack:
            rows = np.dot(self._A_soft, start[:n])
            np.maximum(rows - u[self._soft], l[self._soft] - rows, out=start[n:])
            np.maximum(start[n:], 0.0, out=start[n:])
        self._solver.update(q=form.q, l=form.l, u=form.u)
        self._solver.warm_start(x=start)
        result = self._solver.solve(raise_error=False)
        answer = self._answer
        answer.status = self._status.get(result.info.status_val, Status.FAILED)
        answer.iterations = result.info.iter
        answer.x = result.x[:n]
        form.multipliers(result.y, answer.y)
        return answer
