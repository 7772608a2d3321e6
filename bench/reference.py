"""What a backend's command should have been: the same QP solved again, and certified."""

import numpy as np
from numpy.typing import NDArray

from qpmpc import Controller, ForceController, Solver, Step

CERTIFIED = 1e-7
"""Scaled residual below which a reference is one, whoever found it."""
_BACKENDS = ("daqp", "piqp")
"""Tried in this order, from a cold start."""


class CommandError:
    """Solves the QP of every cycle again and keeps how far the command applied is from it.

    Optimality conditions certify a reference: their residual bounds its error, whichever solver it
    came from. Where none is certified the cycle has no reference, and is counted.
    """

    def __init__(self, controller: ForceController, cycles: int) -> None:
        """Set the reference solvers up for the controller's problem."""
        self._controller: Controller = controller.general
        problem = self._controller.problem
        groups = list(problem.rows.values())
        self._solvers = [
            Solver(problem.qp, name, groups, pattern=problem.pattern) for name in _BACKENDS
        ]
        self._maps = bool(problem.pattern.any()) and controller.bounds_joints
        self._previous = np.zeros(problem.model.n_inputs)
        self._errors = np.full((cycles, problem.model.n_inputs), np.nan)
        self._cycle = 0

    def __call__(self, step: Step) -> None:
        """Judge the step of this cycle."""
        reference = self._reference()
        if reference is not None:
            self._errors[self._cycle] = np.abs(step.command - reference)
        self._previous[:] = step.command
        self._cycle += 1

    @property
    def errors(self) -> NDArray[np.float64]:
        """``|u - u_reference|`` of the cycles so far, ``(cycles, n_inputs)`` [m/s^2]; NaN: none."""
        return self._errors[: self._cycle]

    def _reference(self) -> NDArray[np.float64] | None:
        problem = self._controller.problem
        for solver in self._solvers:
            if self._maps:
                solver.replace_rows(problem.A)
            solver.forget()
            solution = solver.solve(problem.q, problem.l, problem.u)
            if solution.residuals.scaled <= CERTIFIED:
                command = problem.command(solution.x, self._previous)
                low, high = problem.limits(self._previous)
                return np.minimum(np.maximum(command, low), high)
        return None
