"""What the vectors of a controller's QP are expected to be: ranges of state and setpoint."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qpmpc.arrays import Array
from qpmpc.models import LinearModel
from qpmpc.parametric import Parametric
from qpmpc.problem import Problem
from qpmpc.reference import Reference


@dataclass(frozen=True, eq=False)
class Ranges:
    """Where state and setpoint are expected; no promise, but what is worth preparing for."""

    state: Array
    """Least and largest value of each state, ``(n, 2)``."""
    setpoint: Array
    """The same of the setpoint, ``(n_outputs, 2)``."""


def expected(problem: Problem, ranges: Ranges, reference: Reference) -> Parametric | None:
    """Return how the QP's vectors follow from parameters of size one.

    Parameters are the states, the last command (within the bounds on it) and a setpoint that stays
    over the horizon. States that hold the last command are no parameters of their own.

    Args:
        problem, ranges: see there.
        reference: affine in setpoint and output; one that is not is taken for its tangent.

    Returns:
        None where a range or a bound on the command is infinite, or where rows change in time.
    """
    low, high = problem.commands
    bounds = np.vstack([ranges.state, np.column_stack([low, high]), ranges.setpoint])
    if not np.isfinite(bounds).all():
        return None
    n, n_u, n_y = problem.model.n_states, problem.model.n_inputs, problem.model.n_outputs
    centre, half = bounds.mean(axis=1), (bounds[:, 1] - bounds[:, 0]) / 2
    every = np.eye(bounds.shape[0])
    slope = half[:, None] * every
    for state, command in _registers(problem.model):
        slope[state], centre[state] = slope[n + command], centre[n + command]
    slope = slope[:, slope.any(axis=0)]
    x, u, s = (slice(0, n), slice(n, n + n_u), slice(n + n_u, n + n_u + n_y))
    follow = _tangent(reference, problem.horizon, n_y)
    at_rest = follow[0] + follow[1] @ np.concatenate([centre[s], problem.model.C @ centre[x]])
    moved = follow[1] @ np.vstack([slope[s], problem.model.C @ slope[x]])
    return problem.parametric((centre[x], slope[x]), (centre[u], slope[u]), (at_rest, moved))


def _registers(model: LinearModel) -> list[tuple[int, int]]:
    """Return states that are the last command, each with the number of that command."""
    A, B = model.A, model.B
    return [
        (i, int(np.argmax(B[i])))
        for i in range(model.n_states)
        if not A[i].any() and np.count_nonzero(B[i]) == 1 and B[i].max() == 1.0
    ]


def _tangent(reference: Reference, horizon: int, n_y: int) -> tuple[Array, Array]:
    """Return constant and map of a reference over constant setpoint and output."""
    zero = np.zeros(n_y)

    def trajectory(setpoint: Array, output: Array) -> Array:
        return reference(np.tile(setpoint, (horizon + 1, 1)), output).ravel().copy()

    constant = trajectory(zero, zero)
    columns = [trajectory(unit, zero) - constant for unit in np.eye(n_y)]
    columns += [trajectory(zero, unit) - constant for unit in np.eye(n_y)]
    return constant, np.column_stack(columns)
