"""What is applied where a solve gives nothing: never a silent zero, never NaN."""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from qpmpc.arrays import Array, all_finite
from qpmpc.problem import Problem


class Source(StrEnum):
    """Where the command of a cycle came from."""

    SOLUTION = "solution"
    """The QP was solved, or nearly."""
    PLAN = "plan"
    """The next command of the last plan that a solve made."""
    ANALYTIC = "analytic"
    """The closed form, clipped to the bounds on the command."""
    HOLD = "hold"
    """The last command, clipped to the bounds on the command."""


class Fallback:
    """Remembers the last plan, and knows what to do without a new one.

    The plan first: it satisfies the bounds as they were predicted. When it is used up, the closed
    form for the present state. When there is no present state, or nothing finite comes out of it,
    the last command.
    """

    def __init__(self, problem: Problem) -> None:
        """Prepare for a problem whose Hessian is positive definite."""
        self._problem = problem
        self.plan = np.zeros((problem.moves, problem.model.n_inputs))
        """Commands of the last plan, ``(N_u, n_inputs)``."""
        self.cursor = np.array([problem.moves])
        """Which of them is the next, ``(1,)``; N_u: none is left."""

    def forget(self) -> None:
        """Drop the plan: the plant is another, or somewhere else."""
        self.cursor[0] = self._problem.moves

    def remember(self, decision: Array, previous: Array) -> None:
        """Keep the plan ``decision (n_z,)`` that was made with u(k-1) = ``previous``."""
        plan = self.plan
        np.copyto(plan, decision.reshape(plan.shape))
        if self._problem.decision == "increment":
            np.cumsum(plan, axis=0, out=plan)
            plan += previous
        self.cursor[0] = 1

    def decide(self, previous: Array, *, measured: bool) -> tuple[Source, Array, Array]:
        """Return where the command comes from, the command ``(n_inputs,)``, and the plan.

        Args:
            previous: u(k-1), ``(n_inputs,)``.
            measured: whether the problem's vectors rest on a measurement of this cycle.
        """
        problem, plan, following = self._problem, self.plan, int(self.cursor[0])
        low, high = problem.limits(previous)
        if following < problem.moves:
            rest = np.clip(plan[following], low, high)
            commands = np.vstack([rest, plan[following + 1 :]])
            self.cursor[0] += 1
            return Source.PLAN, rest, problem.decide(commands, previous)
        if measured and all_finite(problem.q):
            decision = problem.unconstrained()
            if all_finite(decision):
                command = np.clip(problem.command(decision, previous), low, high)
                return Source.ANALYTIC, command, decision
        command = np.clip(previous, low, high)
        return Source.HOLD, command, problem.decide(command[None], previous)
