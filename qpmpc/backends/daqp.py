"""DAQP: a dual active-set method (Arnström, Bemporad, Axehill, IEEE TAC 67, 2022)."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from qpmpc.arrays import Array
from qpmpc.backends._registry import register
from qpmpc.backends.base import Backend, LimitKind, Limits, RawSolution
from qpmpc.errors import BackendSetupError
from qpmpc.feasibility import bottomless
from qpmpc.native.daqp_form import DaqpForm
from qpmpc.native.forms import CompiledForm
from qpmpc.polish import Polish
from qpmpc.program import QuadraticProgram, SlackForm
from qpmpc.status import Status

_PRIMAL = 1e-9
"""How far a row of order one may be missed."""
_ROUNDING = 1e-12
"""How far a row of order one may be from the bound that holds it."""
_SMALL = 1e-2
"""How far a multiplier may be moved to that end: more is no rounding."""
_INSIDE = 1e-8
"""How far a row that gives way may stand inside of its bound: the little curvature makes a rounding
error of its multiplier that long."""
_SOFT = 8
"""DAQP's mark of a row that may give way."""
_FLAT = 1e-10
"""Least quadratic penalty beside the linear one, where DAQP wants some. `_correct` takes its effect
out. With a hundredth of it DAQP ends wrong in some of a thousand QPs whose soft rows give way; with
this, in none of eleven thousand."""
_LEAST = 1e-8
"""The same at least, beside penalties of order one: its inverse costs DAQP digits."""
_FAR = 1e30
"""What DAQP takes for infinite: a warm row whose bound is truly infinite would turn to NaN."""
_GAVE_WAY = 2
"""DAQP's flag of an answer in which soft rows give way."""
_EQUATIONS = 500
"""Systems of equations that a polish may solve."""
_ITERATIONS, _EACH = 1000, 10
"""Its own limit, where none is given: so many at least, and so many for each variable and row."""
_STATUS = {
    _GAVE_WAY: Status.SOLVED,
    1: Status.SOLVED,
    -1: Status.INFEASIBLE,
    -2: Status.FAILED,  # cycling
    -3: Status.UNBOUNDED,
    -4: Status.ITERATION_LIMIT,
    -7: Status.ITERATION_LIMIT,  # of time
}


@register
class DaqpBackend(Backend):
    """DAQP with soft rows of its own, persistent, warm-started from the last active set."""

    name: ClassVar[str] = "daqp"
    package: ClassVar[str] = "daqp"
    summary: ClassVar[str] = "DAQP, dual active set, exact in few microseconds; all bounds"
    warm_starts: ClassVar[bool] = True
    replaces_rows: ClassVar[bool] = True
    compiled: ClassVar[CompiledForm | None] = DaqpForm(
        primal_tol=_PRIMAL,
        rounding=_ROUNDING,
        inside=_INSIDE,
        far=_FAR,
        iterations=_ITERATIONS,
        each=_EACH,
        flat=_FLAT,
        least=_LEAST,
    )
    structured: ClassVar[bool] = True
    limits: ClassVar[frozenset[LimitKind]] = frozenset(("iterations", "time"))

    smallest_part: ClassVar[int] = 64  # 24 variables cost one call what 8 do: it is all overhead

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Set the solver up and solve once.

        Raises:
            BackendSetupError: DAQP refuses the problem.
        """
        import daqp  # noqa: PLC0415 - only this backend needs it

        self._model: Any = daqp.Model()
        self._model.settings = {
            "primal_tol": _PRIMAL,
            "iter_limit": limits.iterations or max(_ITERATIONS, _EACH * (qp.n + qp.m)),
            "time_limit": limits.time or 0.0,
        }
        soft = np.isfinite(qp.linear)
        rows = max(qp.m, 1)  # DAQP wants one: without rows, one that bounds nothing
        self._l, self._u = np.full(rows, -_FAR), np.full(rows, _FAR)
        self._sense = np.resize(np.where(soft, _SOFT, 0), rows).astype(np.int32)
        flag, _ = self._model.setup(
            np.array(qp.P), np.array(qp.q), np.array(qp.A) if qp.m else np.ones((1, qp.n)),
            self._u, self._l, self._sense,
        )  # fmt: skip
        if flag < 0:
            raise BackendSetupError(self.name, f"DAQP refused the problem (flag {flag})")
        self._soft, self._linear = np.flatnonzero(soft), np.where(soft, qp.linear, 0.0)
        curve = np.where(
            soft, np.maximum(qp.quadratic, np.maximum(_FLAT * self._linear, _LEAST)), np.inf
        )
        self._give, self._excess = 0.5 / curve, np.where(soft, 2.0 * (curve - qp.quadratic), 0.0)
        try:
            self._polish = Polish(qp)
        except np.linalg.LinAlgError as error:
            raise BackendSetupError(self.name, "P is not positive semidefinite") from error
        self._form, self._limits = SlackForm(qp), limits
        self._A, self._rows = np.array(qp.A), np.zeros(qp.m)
        self._corrects = bool(self._excess.any())
        self._price, self._most = np.zeros(qp.m), np.array(qp.linear)
        self._below = self._most * (1.0 - _PRIMAL)  # whose price is nearer may give way
        if soft.any():
            self._weigh(self._linear)
        self._answer = RawSolution(Status.SOLVED, np.zeros(qp.n), np.zeros(qp.m), 0)
        self.solve(np.zeros(qp.n), self._l[: qp.m].copy(), self._u[: qp.m].copy())

    def replace_rows(self, A: Array) -> None:
        """Refactor inside DAQP, without new memory; the active set stays."""
        self._A[:] = A
        self._polish.replace_rows(self._A)
        self._form.replace_rows(A)
        self._model.update(A=A)

    def forget(self) -> None:
        """Empty the active set: from a warm one DAQP now and then ends where it should not."""
        self._model.update(sense=self._sense)

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Update the vectors and solve from the last active set."""
        rows = l.size
        np.maximum(l, -_FAR, out=self._l[:rows])
        np.minimum(u, _FAR, out=self._u[:rows])
        self._model.update(f=q, bupper=self._u, blower=self._l)
        x, _, flag, info = self._model.solve()
        if self._corrects and flag > 0 and self._gives(info["lam"][:rows]):
            x, flag, info = self._correct(x, l, u)
        answer = self._answer
        answer.x, answer.y, answer.iterations = x, info["lam"][:rows], info["iterations"]
        answer.status = _STATUS.get(flag, Status.FAILED)
        if not self._polish.definite:
            self._finish(answer, q, l, u)
        elif answer.status is Status.SOLVED and np.count_nonzero(answer.y):
            self._refine(answer, q, l, u)
        return answer

    def _refine(
        self,
        answer: RawSolution,
        q: Array,
        l: Array,  # noqa: E741
        u: Array,
    ) -> None:
        """Put rows that are held by a bound onto it: many of them, nearly dependent, cost digits.

        DAQP does so itself, but not where any soft row is among them.
        """
        x, y = answer.x, answer.y
        active = np.flatnonzero(y)
        price = y[active]
        off = np.dot(self._A[active], x)
        off -= np.where(price > 0, u[active], l[active])
        inside = np.where(price > 0, -off, off) > _INSIDE  # within DAQP's dual tolerance
        stay = (np.abs(price) < self._below[active]) | inside
        held, off = active[stay], off[stay]
        if not held.size or not np.abs(off).max() > _ROUNDING:
            return
        rows, response = self._A[held], self._polish.response[:, held]
        try:
            change = np.linalg.solve(rows @ response, off)
        except np.linalg.LinAlgError:
            change = np.full(held.size, _SMALL)
        way = response @ change
        left = np.abs(off - np.dot(rows, way)).max()
        if np.abs(change).max() < _SMALL and left < np.abs(off).max() and not inside.any():
            answer.x = x - way
            answer.y = y.copy()
            answer.y[held] += change
            return
        self._polish.allow(self._limits.iterations or _EQUATIONS, np.inf)
        if self._polish(q, l, u, x, y):  # other rows are to be held, or they depend on each other
            answer.x, answer.y = self._polish.x, self._polish.y

    def _finish(self, answer: RawSolution, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Better an answer of proximal steps, which DAQP takes where P is only semidefinite."""
        if answer.status is Status.SOLVED and self._limits.time is None:
            self._polish.allow(self._limits.iterations or _EQUATIONS, np.inf)
            if self._polish(q, l, u, answer.x, answer.y):
                answer.x, answer.y = self._polish.x, self._polish.y
        elif answer.status is Status.ITERATION_LIMIT and self._limits == Limits():
            form = self._form
            form.update(q, l, u)
            if bottomless(form.P, form.q, form.A, form.l, form.u):
                answer.status = Status.UNBOUNDED

    def _gives(self, multipliers: Array) -> bool:
        """Whether any soft row gives way, however little: then its price is its penalty, or more.

        DAQP's own flag is not enough, as it looks away from what is less than its tolerance.
        """
        np.abs(multipliers, out=self._price)
        np.subtract(self._price, self._most, out=self._price)
        return bool(np.count_nonzero(self._price > 0))

    def _correct(self, x: Array, l: Array, u: Array) -> tuple[Array, int, Any]:  # noqa: E741
        """Solve again with the curvature that is not in the problem around the slack there is.

        Its price is taken off the linear penalty, so that both together are the true penalty where
        the rows stand (a proximal point). The active set stays: this costs one step.
        """
        Ax = np.dot(self._A, x, out=self._rows)
        slack = np.maximum(np.maximum(Ax - u, l - Ax), 0.0)
        slack *= self._excess
        self._weigh(self._linear - slack)
        x, _, flag, info = self._model.solve()
        self._weigh(self._linear)
        return x, flag, info

    def _weigh(self, linear: Array) -> None:
        give = self._give
        self._model.soft_weights(rho_l=give, rho_u=give, w_l=linear, w_u=linear)
