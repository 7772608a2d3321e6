"""Bounds as readings of the states of each step, and what these are before a decision."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from qpmpc.arrays import Array, Indices, matrix
from qpmpc.bounds import Bound, CommandBound, MappedBound, OutputBound, RateBound
from qpmpc.errors import BoundsError
from qpmpc.models import LinearModel
from qpmpc.rows import RowBounds, Setting
from qpmpc.structured.dynamics import Dynamics


class Responses:
    """What readings of the states do over the horizon, as far as bounds and vectors need it."""

    def __init__(self, dynamics: Dynamics, setting: Setting) -> None:
        """Roll out from each state and each decision.

        Args:
            dynamics: of `joined_dynamics`, of this setting.
        """
        N, M, n = setting.horizon, setting.moves, dynamics.n
        self._moves, self._horizon = M, N
        known = setting.model.n_states + setting.model.n_inputs
        self._free = np.zeros((N, n, known))
        """From state and last command to the states of each step."""
        self._step, self._held = np.zeros((2, N, n, dynamics.G.shape[1]))
        """From a decision to the states 1, 2, ... steps later; and from the last decision."""
        state, step, held = np.eye(n, known), dynamics.G, dynamics.G
        for i in range(N):
            state = (dynamics.F if i < M else dynamics.F_held) @ state
            self._free[i], self._step[i], self._held[i] = state, step, held
            step, held = dynamics.F @ step, dynamics.F_held @ held

    def parameters(self, reading: Array, steps: int) -> Array:
        """Return how readings ``(w, n)`` depend on state and command, ``(steps * w, n + n_u)``."""
        rows = np.matmul(reading, self._free[:steps])
        return np.asarray(rows.reshape(-1, rows.shape[2]))

    def reach(self, reading: Array, steps: int) -> Array:
        """Return the largest effect that one decision has on each reading, ``(steps * w,)``."""
        size = np.abs(np.matmul(reading, self._step[:steps])).max(axis=2, initial=0.0)
        # A step is moved by the decisions of the N_u steps before it, or of all there were.
        padded = np.vstack([np.zeros((self._moves - 1, size.shape[1])), size])
        peak = sliding_window_view(padded, self._moves, axis=0).max(axis=2)
        late = steps - self._moves
        if late > 0:
            last = np.abs(np.matmul(reading, self._held[1 : late + 1])).max(axis=2, initial=0.0)
            peak[self._moves :] = last
            if self._moves > 1:
                before = sliding_window_view(padded[1:], self._moves - 1, axis=0)
                np.maximum(last, before.max(axis=2)[self._moves :], out=peak[self._moves :])
        return np.asarray(peak.reshape(-1))


def reading(bound: Bound, model: LinearModel, states: int) -> Array:
    """Return what a bound reads from the states of `joined_dynamics`, ``(width, states)``.

    Raises:
        BoundsError: the bound has no such form. ShapeError: it does not fit the model.
    """
    n, m = model.n_states, model.n_inputs
    if isinstance(bound, OutputBound):
        rows = matrix("output", bound.output, columns=n)
        return np.hstack([rows, np.zeros((len(rows), states - n))])
    if isinstance(bound, MappedBound):
        raise BoundsError(bound.name, "has a map that changes; that takes the condensed form")
    first = n if isinstance(bound, CommandBound) else n + m
    return np.eye(n + 2 * m)[first : first + m, :states]


def needs_rates(bounds: Sequence[Bound]) -> bool:
    """Whether the change of the command has to be among the states: whether it has rows."""
    return any(
        bound.moving or bool(np.isfinite(bound.lower).any() or np.isfinite(bound.upper).any())
        for bound in bounds
        if isinstance(bound, RateBound)
    )


class StructuredRows(RowBounds):
    """The rows of one bound as readings of the states."""

    def __init__(self, bound: Bound, setting: Setting, responses: Responses, states: int) -> None:
        """Find out which rows there are.

        Raises:
            BoundsError, ModelError, ShapeError: the bound does not fit.
        """
        self.reading = reading(bound, setting.model, states)
        """``(width, n)``."""
        steps = setting.horizon if isinstance(bound, OutputBound) else setting.moves
        super().__init__(
            bound,
            steps,
            responses.reach(self.reading, steps),
            responses.parameters(self.reading, steps),
        )

    def numbers(self, first: int, horizon: int) -> Indices:
        """Return the number of the row at each step, ``(horizon, width)``; -1: none.

        Args:
            first: number of the bound's first row.
        """
        result = np.full((horizon, self.width), -1, dtype=np.intp)
        keep = self.keep.reshape(self.steps, self.width)
        counted = first - 1 + np.cumsum(self.keep).reshape(keep.shape)
        result[: self.steps] = np.where(keep, counted, -1)
        return result
