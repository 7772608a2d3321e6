"""Bounds on the whole force as bounds on the part of it that the model predicts."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from qpmpc.arrays import Array
from qpmpc.bounds import OutputBound, over_horizon
from qpmpc.problem import Problem


class ShiftedBounds:
    """Moves bounds by what is previewed and not in the model, cycle by cycle."""

    def __init__(self, problem: Problem, bounds: Mapping[str, OutputBound]) -> None:
        """Note the bounds.

        Args:
            problem: has these bounds; its outputs are those that are previewed.
            bounds: by their names; what they bound is a linear map of the outputs.
        """
        self._problem = problem
        back = np.linalg.pinv(problem.model.C)
        self._maps = {name: np.ascontiguousarray((b.output @ back).T) for name, b in bounds.items()}
        self._bounds: dict[str, tuple[Array, Array]] = {}
        for name, bound in bounds.items():
            self.move(name, np.asarray(bound.lower), np.asarray(bound.upper))

    def __contains__(self, name: str) -> bool:
        return name in self._maps

    def move(self, name: str, lower: Array, upper: Array) -> None:
        """Take other bounds for `shift` to work on; values as for `Problem.move`."""
        steps, width = self._problem.horizon, self._maps[name].shape[1]
        self._bounds[name] = over_horizon(name, lower, upper, steps, width)

    def shift(self, known: Array) -> None:
        """Take what is known of the outputs ``(N, n_outputs)`` off the bounds."""
        for name, (lower, upper) in self._bounds.items():
            off = known @ self._maps[name]
            self._problem.move(name, lower - off, upper - off)
