"""From model, weights and bounds to a condensed QP: constant matrices, and maps for its vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from qpmpc.arrays import Array, vector
from qpmpc.bounds import Bound, CommandBound, OutputBound, RateBound, over_horizon
from qpmpc.errors import BoundsError, ModelError, UnknownNameError
from qpmpc.models import LinearModel
from qpmpc.prediction import Prediction, absolute_prediction, prediction
from qpmpc.program import QuadraticProgram

Decision = Literal["increment", "absolute"]


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of one bound: ``lower <= decision z + state x + previous u(k-1) <= upper``."""

    name: str
    decision: Array
    state: Array
    previous: Array
    lower: Array
    upper: Array
    linear: float = np.inf
    quadratic: float = 0.0


class Problem:
    """A receding-horizon problem in condensed form, set up once.

        J = (y_hat - w)' Q (y_hat - w) + z' R z,     y_hat = Psi x + Upsilon u(k-1) + Theta z

    ``Q`` repeats the output weight (delta), ``R`` the increment weight (lambda) over the horizon;
    the decision ``z`` stacks the increments, or the absolute commands where eq. (10) is read to
    the letter. J equals ``1/2 z' P z + q' z`` up to a constant.
    """

    def __init__(
        self,
        model: LinearModel,
        horizon: int,
        *,
        output_weight: ArrayLike,
        increment_weight: ArrayLike,
        bounds: Sequence[Bound] = (),
        control_horizon: int | None = None,
        decision: Decision = "increment",
    ) -> None:
        """Condense.

        Args:
            model: (A, B, C), augmented as needed; C x is what follows the reference.
            horizon: N >= 1 steps.
            output_weight: delta, cost of a squared unit of output error, scalar or
                ``(n_outputs,)``, not negative.
            increment_weight: lambda, cost of a squared unit of decision, scalar or
                ``(n_inputs,)``, positive.
            bounds: any number; rows that are infinite on both sides, or that no decision of the
                horizon can change (under a delay), are left out.
            control_horizon: N_u in 1..N; N if not given.
            decision: ``"increment"`` or ``"absolute"``.

        Raises:
            ModelError, ShapeError, BoundsError, UnknownNameError: an argument is out of range or
                does not fit.
        """
        if decision not in get_args(Decision):
            raise UnknownNameError("decision", decision, get_args(Decision))
        self.model, self.horizon, self.decision = model, horizon, decision
        self._predict = prediction if decision == "increment" else absolute_prediction
        self.prediction: Prediction = self._predict(model, horizon, control_horizon)
        n_y, n_u = model.n_outputs, model.n_inputs
        self.moves = self.prediction.Theta.shape[1] // n_u
        delta = vector("output_weight", output_weight, n_y)
        lam = vector("increment_weight", increment_weight, n_u)
        if (delta < 0).any() or (lam <= 0).any():
            raise ModelError("output_weight must not be negative, increment_weight positive")
        Theta = self.prediction.Theta
        weighted = np.tile(delta, horizon)[:, None] * Theta
        P = 2.0 * (Theta.T @ weighted + np.diag(np.tile(lam, self.moves)))
        rows = [_effective(self._rows(bound)) for bound in bounds]
        names = [bound.name for bound in bounds]
        if len(set(names)) != len(names):
            raise BoundsError(", ".join(names), "two bounds have the same name")
        rows = [r for r in rows if r.lower.size]
        self.rows: dict[str, slice] = {}
        start = 0
        for r in rows:
            self.rows[r.name] = slice(start, start + r.lower.size)
            start += r.lower.size
        n_z = Theta.shape[1]
        self.qp = QuadraticProgram(
            (P + P.T) / 2,
            np.zeros(n_z),
            np.vstack([np.zeros((0, n_z)), *(r.decision for r in rows)]),
            np.concatenate([np.zeros(0), *(r.lower for r in rows)]),
            np.concatenate([np.zeros(0), *(r.upper for r in rows)]),
            np.concatenate([np.zeros(0), *(np.full(r.lower.size, r.linear) for r in rows)]),
            np.concatenate([np.zeros(0), *(np.full(r.lower.size, r.quadratic) for r in rows)]),
        )
        self._first_command = self._intersection(bounds)
        self._rate_bounded = bool(np.isfinite(self._first_command[1]).any())
        self._allocate(weighted, rows)

    def _allocate(self, weighted: Array, rows: list[_Rows]) -> None:
        n, n_u = self.model.n_states, self.model.n_inputs
        none = np.zeros((0, n + n_u))
        self._free_map = np.hstack([self.prediction.Psi, self.prediction.Upsilon])
        self._error_to_q = -2.0 * np.ascontiguousarray(weighted.T)
        self._row_map = np.vstack([none, *(np.hstack([r.state, r.previous]) for r in rows)])
        self._l0, self._u0 = np.array(self.qp.l), np.array(self.qp.u)
        self._parameters = np.zeros(n + n_u)
        self.free = np.zeros(self._free_map.shape[0])
        """Free response Psi x + Upsilon u(k-1) of the last `update`, ``(N * n_outputs,)``."""
        self._error = np.zeros_like(self.free)
        self._offset = np.zeros(self.qp.m)
        self.q = np.zeros(self.qp.n)
        """Gradient of the last `update`, ``(n_z,)``."""
        self.l, self.u = np.zeros(self.qp.m), np.zeros(self.qp.m)

    def update(self, state: Array, previous: Array, reference: Array) -> None:
        """Write ``q``, ``l`` and ``u`` for the present cycle, in place.

        Args:
            state: x(k), ``(n,)``.
            previous: u(k-1), ``(n_inputs,)``.
            reference: w(k+1) ... w(k+N), ``(N, n_outputs)``.
        """
        p, n = self._parameters, self.model.n_states
        p[:n], p[n:] = state, previous
        np.dot(self._free_map, p, out=self.free)
        np.subtract(reference.reshape(-1), self.free, out=self._error)
        np.dot(self._error_to_q, self._error, out=self.q)
        np.dot(self._row_map, p, out=self._offset)
        np.subtract(self._l0, self._offset, out=self.l)
        np.subtract(self._u0, self._offset, out=self.u)

    def command(self, decision: Array, previous: Array) -> Array:
        """Return u(k) ``(n_inputs,)`` from the first part of a decision ``(n_z,)`` and u(k-1)."""
        first = decision[: self.model.n_inputs]
        return previous + first if self.decision == "increment" else first.copy()

    def hold(self, previous: Array, command: Array) -> Array:
        """Return the decision ``(n_z,)`` that goes to ``command`` at once and stays there."""
        decision = np.zeros((self.moves, self.model.n_inputs))
        if self.decision == "absolute":
            decision[:] = command
        else:
            decision[0] = command - previous
        return decision.reshape(-1)

    def limits(self, previous: Array) -> tuple[Array, Array]:
        """Return what u(k) may be, ``(n_inputs,)`` each, by command and rate bounds together."""
        (low, high), (fall, rise) = self._first_command
        if not self._rate_bounded:
            return low, high
        # The command bound wins where u(k-1) lies so far outside that both cannot hold.
        return (
            np.minimum(np.maximum(low, previous + fall), high),
            np.maximum(np.minimum(high, previous + rise), low),
        )

    def _intersection(self, bounds: Sequence[Bound]) -> tuple[tuple[Array, Array], ...]:
        """Intersect the bounds on u(k) and on Delta u(k), for `limits`."""
        n_u = self.model.n_inputs
        result = []
        for kind in (CommandBound, RateBound):
            lower, upper = np.full(n_u, -np.inf), np.full(n_u, np.inf)
            for bound in bounds:
                if isinstance(bound, kind):
                    low, high = over_horizon(bound, self.moves, n_u)
                    lower, upper = np.maximum(lower, low[0]), np.minimum(upper, high[0])
            result.append((lower, upper))
        return tuple(result)

    def _rows(self, bound: Bound) -> _Rows:
        n, n_u = self.model.n_states, self.model.n_inputs
        if isinstance(bound, OutputBound):
            p = self._predict(self.model, self.horizon, self.moves, bound.output)
            lower, upper = over_horizon(bound, self.horizon, p.Psi.shape[0] // self.horizon)
            return _Rows(
                bound.name, p.Theta, p.Psi, p.Upsilon,
                lower.ravel(), upper.ravel(), bound.linear, bound.quadratic,
            )  # fmt: skip
        lower, upper = over_horizon(bound, self.moves, n_u)
        size = self.moves * n_u
        alone: tuple[Array, Array] = np.eye(size), np.zeros((size, n_u))
        increments = self.decision == "increment"
        if isinstance(bound, CommandBound):  # commands: sums of increments, or the decision itself
            steps = np.tril(np.ones((self.moves, self.moves)))
            sums = np.asarray(np.kron(steps, np.eye(n_u)), dtype=np.float64)
            held = np.tile(np.eye(n_u), (self.moves, 1))
            decision, previous = (sums, held) if increments else alone
        else:  # increments: the decision itself, or differences of commands
            first = np.vstack([-np.eye(n_u), np.zeros((size - n_u, n_u))])
            differences = np.eye(size) - np.eye(size, k=-n_u)
            decision, previous = alone if increments else (differences, first)
        return _Rows(
            bound.name, decision, np.zeros((size, n)), previous, lower.ravel(), upper.ravel()
        )

    def __repr__(self) -> str:
        return (
            f"Problem({self.model!r}, horizon={self.horizon}, rows={list(self.rows)}, {self.qp!r})"
        )


def _effective(rows: _Rows) -> _Rows:
    """Keep the rows that bound something and that the decision can still change.

    Under a delay the first outputs of the horizon are already decided: a row of zeros is a fact,
    not a choice, and would leave a solver nothing to scale.
    """
    size = np.abs(rows.decision).max(axis=1)
    bounded = np.isfinite(rows.lower) | np.isfinite(rows.upper)
    keep = bounded & (size > 1e-12 * size.max())
    return _Rows(
        rows.name, rows.decision[keep], rows.state[keep], rows.previous[keep],
        rows.lower[keep], rows.upper[keep], rows.linear, rows.quadratic,
    )  # fmt: skip
