"""What solvers share that start each solve from cold, on the form with explicit slack."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import ClassVar, Protocol

import numpy as np

from qpmpc.arrays import Array, all_finite
from qpmpc.backends._layout import Layout, Setups
from qpmpc.backends.base import Backend, Limits, RawSolution
from qpmpc.errors import BackendSetupError
from qpmpc.feasibility import bottomless, contradictory
from qpmpc.polish import Polish
from qpmpc.program import QuadraticProgram, SlackForm
from qpmpc.status import Status

_FAR = 1e6
"""Bound that is left out at first: numbers of this size beside rows of order one spoil the steps
of an interior-point method, and mostly stand for infinity."""
_LOOSE = 1e-9
"""Violation of an optimality condition, relative to the size of the problem, from which an answer
is polished."""
_CLOSE = 1e-3
"""The same up to which an answer that the solver does not stand by is one all the same."""
_ENDLESS = 1e50
"""Number that no answer holds."""
_EQUATIONS = 100
"""Systems of equations that a polish may solve."""


@dataclass(slots=True)
class Attempt:
    """What a solver says of the hard QP.

    INACCURATE where it does not stand by its answer; FAILED where it does not say why it has none.
    """

    status: Status
    x: Array
    """Minimiser with slack, ``(form.q.size,)``."""
    y: Array
    """Multipliers of the form's rows, ``(form.l.size,)``, positive at upper bounds."""
    iterations: int
    build_time: float = 0.0
    """As in `RawSolution`."""


class Setup(Protocol):
    """A solver set up for one layout of the bounds."""

    stale: bool
    """Whether the form's rows have been replaced since the last run."""

    def run(self) -> Attempt:
        """Solve with the form's present vectors and rows."""
        ...


class ColdBackend(Backend):
    """Set up once for each layout of the bounds; a loose answer is polished.

    Bounds at infinity are left out and rows with equal bounds become equations, so a layout that
    was not there before costs a set-up, told as build time. Where an interior-point method stops,
    the product of each row's distance and multiplier is nearly zero; where both are zero at the
    optimum each is still the root of that product, and the polish takes it to zero.
    """

    replaces_rows: ClassVar[bool] = True
    smallest_part: ClassVar[int] = 12

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Prepare the polish, and set up for the bounds that ``qp`` has.

        Raises:
            BackendSetupError: P is not positive semidefinite.
        """
        self._form = SlackForm(qp)
        self._setups: Setups[Setup] = Setups(self._setup)
        try:
            self._polish = Polish(qp)
        except np.linalg.LinAlgError as error:
            raise BackendSetupError(self.name, "P is not positive semidefinite") from error
        self._time, self._y = limits.time or np.inf, np.zeros(qp.m)
        self._limited = limits != Limits()
        self._polished = {Status.SOLVED, Status.INACCURATE}
        if not self._limited:  # then what stopped it was a limit of its own
            self._polished.add(Status.ITERATION_LIMIT)
        self._answer = RawSolution(Status.SOLVED, np.zeros(qp.n), self._y, 0)
        self._setups(self._form.l, self._form.u, _FAR)

    def _setup(self, layout: Layout) -> Setup:
        """Set the solver up for a layout of the form's rows."""
        raise NotImplementedError

    def replace_rows(self, A: Array) -> None:
        """Have the solver's rows replaced at its next run."""
        self._form.replace_rows(A)
        self._polish.replace_rows(A)
        for setup in self._setups:
            setup.stale = True

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Update the vectors and solve, without the far bounds if they make no difference."""
        form, answer, polish = self._form, self._answer, self._polish
        deadline = perf_counter() + self._time
        form.update(q, l, u)
        answer.build_time, answer.iterations = 0.0, 0
        for far in (_FAR, np.inf):
            setup, spent = self._setups(form.l, form.u, far)
            attempt = setup.run()
            answer.build_time += spent + attempt.build_time
            answer.iterations += attempt.iterations
            if not self._overlooked(attempt.status, attempt.x):
                break
        error = _error(form, attempt.x, attempt.y)
        answer.status = self._reason(attempt.status, error, deadline)
        answer.x, answer.y = attempt.x[: form.n], form.multipliers(attempt.y, self._y)
        if answer.status is Status.ITERATION_LIMIT and error == np.inf:  # stopped before any
            answer.x, answer.y = np.zeros(form.n), np.zeros(self._y.size)
        if answer.status in self._polished and error > _LOOSE:
            polish.allow(_EQUATIONS, deadline)
            if polish(q, l, u, answer.x, answer.y):
                answer.x, answer.y = polish.x, polish.y
        return answer

    def _reason(self, status: Status, error: float, deadline: float) -> Status:
        """Say what an answer with such an error is: some solvers cannot, or tell wrongly."""
        hurry = self._time < np.inf  # a proof takes milliseconds
        if (status in self._polished and error <= _CLOSE) or (
            status is Status.INFEASIBLE and hurry
        ):
            return status
        if self._limited and (status is Status.ITERATION_LIMIT or perf_counter() > deadline):
            return Status.ITERATION_LIMIT
        form = self._form
        if all_finite(form.q):
            if contradictory(form.A, form.l, form.u):
                return Status.INFEASIBLE
            if bottomless(form.P, form.q, form.A, form.l, form.u):
                return Status.UNBOUNDED
            if self._limited and status is Status.FAILED:
                return Status.ITERATION_LIMIT
        return Status.INACCURATE if error < np.inf else Status.FAILED

    def _overlooked(self, status: Status, x: Array) -> bool:
        """Whether bounds that were left out as far off would make a difference."""
        form = self._form
        low = (form.l <= -_FAR) & (form.l > -np.inf)
        high = (form.u >= _FAR) & (form.u < np.inf)
        if not (np.count_nonzero(low) or np.count_nonzero(high)):
            return False
        if status is not Status.SOLVED:
            return status not in (Status.INFEASIBLE, Status.ITERATION_LIMIT)
        value = form.A @ x
        return bool((value < form.l)[low].any() or (value > form.u)[high].any())


def _error(form: SlackForm, x: Array, y: Array) -> float:
    """Return the largest violation of an optimality condition, relative to the problem's size."""
    size = max(np.abs(x).max(initial=0.0), np.abs(y).max(initial=0.0))
    if not size < _ENDLESS:
        return np.inf
    value = form.A @ x
    over, under = value - form.u, form.l - value
    slope = form.P @ x + form.q + form.A.T @ y
    reach = 1.0 + float(np.abs(value).max(initial=0.0))
    level = 1.0 + float(np.abs(form.q[: form.n]).max(initial=0.0))
    gap, price = -np.where(y > 0, over, under) / reach, np.abs(y) / level
    priced = np.where(y != 0, np.minimum(price, gap), 0.0)
    rows = max(float(each.max(initial=0.0)) for each in (over / reach, under / reach, priced))
    return max(float(np.abs(slope).max()) / level, rows)  # in this order NaN stays NaN
