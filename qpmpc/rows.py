"""Bounds as rows of the condensed QP: how each depends on decision, state and last command."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qpmpc.arrays import Array, matrix, vector
from qpmpc.bounds import Bound, CommandBound, MappedBound, OutputBound, over_horizon
from qpmpc.construction import Construction, Decision
from qpmpc.errors import BoundsError, ModelError
from qpmpc.models import LinearModel
from qpmpc.prediction import Prediction

Predict = Callable[[ArrayLike], Prediction]
"""From an output matrix to its prediction, in the decision of the problem."""

_NOTHING = 1e-12
"""Size beside the bound's other rows below which the decision does not move a row."""


@dataclass(frozen=True, eq=False)
class Setting:
    """What all rows of a problem have in common."""

    model: LinearModel
    horizon: int
    moves: int
    decision: Decision
    predict: Predict

    @classmethod
    def of(
        cls,
        model: LinearModel,
        horizon: int,
        control_horizon: int | None,
        decision: Decision,
        construction: Construction,
    ) -> Setting:
        """Fill in the control horizon and the way to a prediction."""
        moves = horizon if control_horizon is None else control_horizon

        def predict(output: ArrayLike) -> Prediction:
            return construction.prediction(model, horizon, moves, output, decision)

        return cls(model, horizon, moves, decision, predict)


@dataclass(frozen=True, eq=False)
class Affine:
    """A quantity over the horizon: ``decision z + state x + previous u(k-1)``."""

    decision: Array
    """``(steps * width, n_decision)``."""
    state: Array
    """``(steps * width, n)``."""
    previous: Array
    """``(steps * width, n_inputs)``."""


class RowBounds:
    """The rows of one bound without their dependence on the decision: limits, and who is in."""

    def __init__(self, bound: Bound, steps: int, reach: Array, parameters: Array) -> None:
        """Leave out rows that bound nothing or that no decision can move.

        Under a delay the first outputs of the horizon are already decided: a row of zeros is a
        fact, not a choice, and would leave a solver nothing to scale.

        Args:
            bound: the record. steps: how many it speaks of.
            reach: largest effect of the decision on each row, ``(steps * width,)``.
            parameters: effect of state and last command, ``(steps * width, n + n_inputs)``.

        Raises:
            BoundsError, ModelError: the bound does not fit.
        """
        self.name, self.steps = bound.name, steps
        self.linear, self.quadratic = np.inf, 0.0
        if isinstance(bound, OutputBound | MappedBound):
            self.linear, self.quadratic = bound.linear, bound.quadratic
            if not (self.linear > 0 and self.quadratic >= 0):
                raise ModelError(
                    f"bound '{bound.name}': linear must be positive, quadratic not negative"
                )
        self.mapped = isinstance(bound, MappedBound)
        """Whether `map` may be called."""
        self.width = reach.size // steps
        bounds = over_horizon(self.name, bound.lower, bound.upper, steps, self.width)
        self.first = bounds[0][0], bounds[1][0]
        """Lower and upper bound at the first step, ``(width,)`` each."""
        lower, upper = (side.ravel() for side in bounds)
        keep = np.asarray(reach > _NOTHING * reach.max(initial=0.0), dtype=np.bool_)
        self._idle = ~keep
        if not bound.moving:
            keep &= np.isfinite(lower) | np.isfinite(upper)
        self.keep: NDArray[np.bool_] = keep
        """Which of all rows there are, ``(steps * width,)``."""
        self.size = int(np.count_nonzero(keep))
        self.lower, self.upper = lower[keep], upper[keep]
        self._parameters = parameters

    @property
    def kept(self) -> NDArray[np.bool_]:
        """Which of the bound's rows these are, ``(steps, width)``."""
        return self.keep.reshape(self.steps, self.width)

    @property
    def parameters(self) -> Array:
        """How the rows depend on state and last command, ``(size, n + n_inputs)``; 0 if mapped."""
        if self.mapped:
            return np.zeros((self.size, self._parameters.shape[1]))
        return self._parameters[self.keep]

    def move(self, lower: ArrayLike, upper: ArrayLike) -> None:
        """Take other bounds.

        Raises:
            BoundsError: they do not fit, or bound a row that was left out.
        """
        low, high = over_horizon(self.name, lower, upper, self.steps, self.width)
        lost = (np.isfinite(low) | np.isfinite(high)).ravel() & ~self.keep & ~self._idle
        if lost.any():
            raise BoundsError(
                self.name, "has no rows where it was infinite; make it with moving=True"
            )
        self.first = low[0], high[0]
        np.compress(self.keep, low.reshape(-1), out=self.lower)
        np.compress(self.keep, high.reshape(-1), out=self.upper)

    def map(self, mapping: ArrayLike, offset: ArrayLike) -> None:  # noqa: ARG002
        """Take another map, where there is one.

        Raises:
            BoundsError: there is none.
        """
        raise BoundsError(self.name, "is not a MappedBound: there is nothing to map")


class Rows(RowBounds):
    """The rows of one bound: ``lower <= decision z + offset <= upper``."""

    def __init__(self, bound: Bound, setting: Setting) -> None:
        """Build them, see `RowBounds`.

        Raises:
            BoundsError, ModelError, ShapeError: the bound does not fit the model.
        """
        base = _base(bound, setting)
        steps = setting.horizon if of_outputs(bound) else setting.moves
        self._base = base.decision.reshape(steps, base.decision.shape[0] // steps, -1)
        width = self._base.shape[1]
        self._mapping, mapped = np.eye(width), isinstance(bound, MappedBound)
        if isinstance(bound, MappedBound):
            self._mapping = matrix(f"mapping of '{bound.name}'", bound.mapping, None, width)
        self._shift = np.zeros(len(self._mapping))
        decision = self._decision(mapped)
        size = np.abs(decision if not mapped else self._all_of_base()).max(axis=1, initial=0.0)
        super().__init__(bound, steps, size, np.hstack([base.state, base.previous]))
        self.decision = np.ascontiguousarray(decision[self.keep])
        """How the rows depend on the decision, ``(size, n_decision)``."""

    @property
    def pattern(self) -> NDArray[np.bool_]:
        """Where `decision` may ever be other than zero, ``(size, n_decision)``."""
        if not self.mapped:
            return np.asarray(self.decision != 0, dtype=np.bool_)
        return np.asarray(self._all_of_base()[self.keep] > 0, dtype=np.bool_)

    def map(self, mapping: ArrayLike, offset: ArrayLike) -> None:
        """Take another map ``(n_m, ...)`` and offset ``(n_m,)``; `decision` is new then.

        Raises:
            BoundsError: the bound is not a mapped one. ShapeError, ModelError: wrong shape, NaN.
        """
        if not self.mapped:
            super().map(mapping, offset)
        checked = matrix(f"mapping of '{self.name}'", mapping, *self._mapping.shape)
        self._shift = vector(f"offset of '{self.name}'", offset, self.width)
        self._mapping = checked
        np.compress(self.keep, self._decision(True), axis=0, out=self.decision)

    def mapped_offset(self, parameters: Array, out: Array) -> None:
        """Write what mapped rows are at a zero decision, ``(size,)``, into ``out``.

        Args:
            parameters: state and last command, ``(n + n_inputs,)``.
        """
        free = np.dot(self._parameters, parameters).reshape(self.steps, -1)
        moved = np.dot(free, self._mapping.T)
        moved += self._shift
        np.compress(self.keep, moved.reshape(-1), out=out)

    def _all_of_base(self) -> Array:
        """How far any map could let each row depend on the decision, up to a factor."""
        most = np.abs(self._base).max(axis=1)
        return np.asarray(np.repeat(most, len(self._mapping), axis=0))

    def _decision(self, mapped: bool) -> Array:
        rows = np.matmul(self._mapping, self._base) if mapped else self._base
        return np.asarray(rows.reshape(-1, self._base.shape[2]))


def of_outputs(bound: Bound) -> bool:
    """Whether a bound speaks of the steps k+1 ... k+N, not of the commands."""
    return isinstance(bound, OutputBound) or (isinstance(bound, MappedBound) and not bound.direct)


def _base(bound: Bound, setting: Setting) -> Affine:
    if isinstance(bound, OutputBound | MappedBound):
        return (
            _outputs(setting, bound.output) if of_outputs(bound) else _direct(setting, bound.output)
        )
    return _commands(setting) if isinstance(bound, CommandBound) else _increments(setting)


def _outputs(setting: Setting, output: ArrayLike) -> Affine:
    """``output x(k+i)``, i = 1..N."""
    p = setting.predict(output)
    return Affine(p.Theta, p.Psi, p.Upsilon)


def _commands(setting: Setting) -> Affine:
    """``u(k+i)``, i = 0..N_u-1: sums of increments, or the decision itself."""
    n, n_u, moves = setting.model.n_states, setting.model.n_inputs, setting.moves
    size = moves * n_u
    if setting.decision == "absolute":
        return Affine(np.eye(size), np.zeros((size, n)), np.zeros((size, n_u)))
    sums = np.kron(np.tril(np.ones((moves, moves))), np.eye(n_u))
    return Affine(
        np.asarray(sums, dtype=np.float64), np.zeros((size, n)), np.tile(np.eye(n_u), (moves, 1))
    )


def _increments(setting: Setting) -> Affine:
    """``Delta u(k+i)``, i = 0..N_u-1: the decision itself, or differences of commands."""
    n, n_u = setting.model.n_states, setting.model.n_inputs
    size = setting.moves * n_u
    if setting.decision == "increment":
        return Affine(np.eye(size), np.zeros((size, n)), np.zeros((size, n_u)))
    first = np.vstack([-np.eye(n_u), np.zeros((size - n_u, n_u))])
    return Affine(np.eye(size) - np.eye(size, k=-n_u), np.zeros((size, n)), first)


def _direct(setting: Setting, output: ArrayLike) -> Affine:
    """``[u(k+i); output x(k+i)]``, i = 0..N_u-1, step by step."""
    E = matrix("output", output, columns=setting.model.n_states)
    commands, later, moves = _commands(setting), _outputs(setting, E), setting.moves
    n_z, n_u = E.shape[0], setting.model.n_inputs

    def joined(command: Array, first: Array, rest: Array) -> Array:
        outputs = np.vstack([first, rest])[: moves * n_z].reshape(moves, n_z, -1)
        both = np.concatenate([command.reshape(moves, n_u, -1), outputs], axis=1)
        return np.asarray(both.reshape(moves * (n_u + n_z), -1))

    return Affine(
        joined(commands.decision, np.zeros((n_z, commands.decision.shape[1])), later.decision),
        joined(commands.state, E, later.state),
        joined(commands.previous, np.zeros((n_z, n_u)), later.previous),
    )
