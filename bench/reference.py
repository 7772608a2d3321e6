"""What a backend's command should have been: the same QP solved again, and certified."""

import numpy as np
from numpy.typing import NDArray

from qpmpc import ForceController, Solution, Solver, Step

CERTIFIED = 1e-7
"""Scaled residual below which a reference is one, whoever found it."""
_BACKENDS = ("daqp", "piqp")
"""Tried in this order, from a cold start."""


class Reference:
    """Solves the QP that a controller's problem holds at the moment again, and certifies it.

    Optimality conditions certify a reference: their residual bounds its error, whichever solver it
    came from.
    """

    def __init__(self, controller: ForceController) -> None:
        """Set the reference solvers up for the controller's problem."""
        self._problem = controller.general.problem
        groups = list(self._problem.rows.values())
        self._solvers = [
            Solver(self._problem.qp, name, groups, pattern=self._problem.pattern)
            for name in _BACKENDS
        ]
        self._maps = bool(self._problem.pattern.any()) and controller.bounds_joints

    def __call__(self) -> Solution | None:
        """Return the certified answer, valid until the next call, or None where there is none."""
        problem = self._problem
        for solver in self._solvers:
            if self._maps:
                solver.replace_rows(problem.A)
            solver.forget()
            solution = solver.solve(problem.q, problem.l, problem.u)
            if solution.residuals.scaled <= CERTIFIED:
                return solution
        return None


class CommandError:
    """Keeps how far the command applied in each cycle is from what it should have been.

    Where no reference is certified the cycle has none, and is counted.
    """

    def __init__(self, controller: ForceController, cycles: int) -> None:
        """Set the reference up for the controller's problem."""
        self._problem, self._reference = controller.general.problem, Reference(controller)
        self._applied = controller.general.command
        self._previous = np.zeros(self._problem.model.n_inputs)
        self._errors = np.full((cycles, self._problem.model.n_inputs), np.nan)
        self._cycle = 0

    def __call__(self, step: Step) -> None:
        """Judge the step of this cycle."""
        solution = self._reference()
        if solution is not None:
            command = self._problem.command(solution.x, self._previous)
            low, high = self._problem.limits(self._previous)
            right = np.minimum(np.maximum(command, low), high)
            self._errors[self._cycle] = np.abs(step.command - right)
        self._previous[:] = self._applied  # the step's own, unless another was applied
        self._cycle += 1

    @property
    def errors(self) -> NDArray[np.float64]:
        """``|u - u_reference|`` of the cycles so far, ``(cycles, n_inputs)`` [m/s^2]; NaN: none."""
        return self._errors[: self._cycle]
