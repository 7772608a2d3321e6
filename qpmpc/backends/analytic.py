"""The closed form of the paper, eq. (13): the unconstrained minimiser."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from qpmpc.arrays import Array
from qpmpc.backends._registry import register
from qpmpc.backends.base import Backend, LimitKind, Limits, RawSolution
from qpmpc.errors import BackendSetupError
from qpmpc.native.closed_form import ClosedForm
from qpmpc.native.forms import CompiledForm
from qpmpc.program import QuadraticProgram
from qpmpc.status import Status


@register
class AnalyticBackend(Backend):
    """``x = -P^-1 q`` with a gain computed once; rows are not looked at.

    Where the result leaves the bounds on the command the controller clips it and says so; bounds
    on force and velocity are not honoured.
    """

    name: ClassVar[str] = "analytic"
    package: ClassVar[str] = "numpy"
    summary: ClassVar[str] = "closed form of the paper; clips the command, ignores other bounds"
    heeds_rows: ClassVar[bool] = False
    replaces_rows: ClassVar[bool] = True
    compiled: ClassVar[CompiledForm | None] = ClosedForm()
    limits: ClassVar[frozenset[LimitKind]] = frozenset(("iterations", "time"))  # takes no iteration

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:  # noqa: ARG002
        """Invert the Hessian.

        Raises:
            BackendSetupError: it is not positive definite.
        """
        try:
            self._gain = -cho_solve(cho_factor(qp.P), np.eye(qp.n))
        except np.linalg.LinAlgError as error:
            raise BackendSetupError(self.name, f"P is not positive definite ({error})") from error
        self._answer = RawSolution(Status.SOLVED, np.zeros(qp.n), np.zeros(qp.m), 0)

    def replace_rows(self, A: Array) -> None:
        """Rows are not looked at."""

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: ARG002, E741
        """Multiply the gain with ``q``."""
        np.dot(self._gain, q, out=self._answer.x)
        return self._answer
