"""From model, weights and bounds to a condensed QP: constant matrices, and maps for its vectors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qpmpc.arrays import Array, vector
from qpmpc.backends import Backend, Limits
from qpmpc.bounds import Bound, CommandBound, RateBound
from qpmpc.construction import NUMPY, Construction, Decision
from qpmpc.errors import BoundsError, ModelError, UnknownNameError
from qpmpc.models import LinearModel
from qpmpc.parametric import Parametric
from qpmpc.prediction import Prediction
from qpmpc.program import QuadraticProgram
from qpmpc.rows import RowBounds, Rows, Setting
from qpmpc.solver import NO_LIMITS, Solver

Affine = tuple[Array, Array]
"""Constant ``(n,)`` and map ``(n, d)`` of parameters."""


@dataclass(frozen=True, eq=False)
class Maps:
    """How the vectors of the QP depend on what is known in a cycle; constant."""

    gradient: Array
    """From reference minus free response to q, ``(n_z, N * n_outputs)``."""
    free: Array
    """From state and last command to the free response, ``(N * n_outputs, n + n_inputs)``."""
    rows: Array
    """From the same to what each row is at a zero decision, ``(m, n + n_inputs)``."""


@dataclass(frozen=True, eq=False)
class Present:
    """What bounds are in this cycle; `Problem.move` writes into these arrays."""

    lower: Array
    """Of each row, whatever the state, ``(m,)``."""
    upper: Array
    low: Array
    """Of u(k), ``(n_inputs,)``."""
    high: Array
    fall: Array
    """Of the change of u(k), ``(n_inputs,)``."""
    rise: Array


class Problem:
    """A receding-horizon problem in condensed form, set up once.

        J = (y_hat - w)' Q (y_hat - w) + z' R z,     y_hat = Psi x + Upsilon u(k-1) + Theta z

    ``Q`` repeats the output weight (delta), ``R`` the increment weight (lambda) over the horizon;
    the decision ``z`` stacks the increments, or the absolute commands where eq. (10) is read to
    the letter. J equals ``1/2 z' P z + q' z`` up to a constant.
    """

    form: ClassVar[str] = "condensed"
    """What stands for the problem: its matrices, or its stages."""

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
        construction: Construction = NUMPY,
    ) -> None:
        """Condense.

        Args:
            model: (A, B, C), augmented as needed; C x is what follows the reference.
            horizon: N >= 1 steps.
            output_weight: delta, cost of a squared unit of output error, scalar or
                ``(n_outputs,)``, not negative.
            increment_weight: lambda, cost of a squared unit of decision, scalar or
                ``(n_inputs,)``, positive.
            bounds: any number; rows that no decision of the horizon can change (under a delay)
                are left out, and those that are infinite on both sides and will not move.
            control_horizon: N_u in 1..N; N if not given.
            decision: ``"increment"`` or ``"absolute"``.
            construction: who builds the matrices.

        Raises:
            ModelError, ShapeError, BoundsError, UnknownNameError: an argument is out of range or
                does not fit.
        """
        if decision not in get_args(Decision):
            raise UnknownNameError("decision", decision, get_args(Decision))
        self.model, self.horizon, self.decision = model, horizon, decision
        setting = Setting.of(model, horizon, control_horizon, decision, construction)
        self.moves = setting.moves
        delta = vector("output_weight", output_weight, model.n_outputs)
        lam = vector("increment_weight", increment_weight, model.n_inputs)
        if (delta < 0).any() or (lam <= 0).any():
            raise ModelError("output_weight must not be negative, increment_weight positive")
        names = [bound.name for bound in bounds]
        if len(set(names)) != len(names):
            raise BoundsError(", ".join(names), "two bounds have the same name")
        self.bounds = tuple(bounds)
        """As they were given."""
        self._condensed: dict[str, Rows] = {}
        self._bounds = {bound.name: self._rows_of(bound, setting) for bound in bounds}
        self._kinds = {bound.name: type(bound) for bound in bounds}
        self.rows: dict[str, slice] = {}
        """Where the rows of each bound are that has any."""
        start = 0
        for name, rows in self._bounds.items():
            if rows.size:
                self.rows[name] = slice(start, start + rows.size)
                start += rows.size
        self._first = {
            kind: (np.full(model.n_inputs, -np.inf), np.full(model.n_inputs, np.inf))
            for kind in (CommandBound, RateBound)
        }
        """What u(k) and Delta u(k) may be, for `limits`."""
        self._note_first()
        self._build(setting, construction, delta, lam)

    def _rows_of(self, bound: Bound, setting: Setting) -> RowBounds:
        rows = self._condensed[bound.name] = Rows(bound, setting)
        return rows

    def _build(
        self, setting: Setting, construction: Construction, delta: Array, lam: Array
    ) -> None:
        """Condense: everything that has as many columns as there are decisions, and vectors."""
        self.prediction: Prediction = setting.predict(self.model.C)
        P, self._error_to_q = construction.cost(
            self.prediction.Theta, np.tile(delta, self.horizon), np.tile(lam, self.moves)
        )
        n, n_u, n_z = self.model.n_states, self.model.n_inputs, P.shape[0]
        rows = [self._condensed[name] for name in self.rows]
        self.A = np.vstack([np.zeros((0, n_z)), *(r.decision for r in rows)])
        """Rows of the present cycle, ``(m, n_z)``."""
        self._l0 = np.concatenate([np.zeros(0), *(r.lower for r in rows)])
        self._u0 = np.concatenate([np.zeros(0), *(r.upper for r in rows)])
        self.qp = QuadraticProgram(
            P, np.zeros(n_z), self.A, self._l0, self._u0,
            np.concatenate([np.zeros(0), *(np.full(r.size, r.linear) for r in rows)]),
            np.concatenate([np.zeros(0), *(np.full(r.size, r.quadratic) for r in rows)]),
        )  # fmt: skip
        self.pattern: NDArray[np.bool_] = np.vstack(
            [np.zeros((0, n_z), dtype=np.bool_), *(r.pattern for r in rows)]
        )
        """Where `A` may ever be other than zero, ``(m, n_z)``."""
        self.rows_changed = False
        """Whether `A` is another than at the last solve; who hands it on sets it back."""
        self._closed_form = -np.linalg.inv(P)
        self._mapped = [(r, self.rows[r.name]) for r in rows if r.mapped]
        self._row_map = np.vstack([np.zeros((0, n + n_u)), *(r.parameters for r in rows)])
        self._free_map = np.hstack([self.prediction.Psi, self.prediction.Upsilon])
        self._parameters = np.zeros(n + n_u)
        self.free = np.zeros(self._free_map.shape[0])
        """Free response Psi x + Upsilon u(k-1) of the last `update`, ``(N * n_outputs,)``."""
        self._error = np.zeros_like(self.free)
        self._offset = np.zeros(self.qp.m)
        self.q = np.zeros(self.qp.n)
        """Gradient of the last `update`, ``(n_z,)``."""
        self.l, self.u = np.zeros(self.qp.m), np.zeros(self.qp.m)

    @property
    def maps(self) -> Maps:
        """The maps behind `update`, without the rows of mapped bounds."""
        return Maps(self._error_to_q, self._free_map, self._row_map)

    @property
    def present(self) -> Present:
        """The memory that holds the bounds as they are now."""
        return Present(self._l0, self._u0, *self._first[CommandBound], *self._first[RateBound])

    @property
    def mapped(self) -> list[str]:
        """Names of the bounds whose rows `map` changes."""
        return [rows.name for rows, _ in self._mapped]

    def move(self, name: str, lower: ArrayLike, upper: ArrayLike) -> None:
        """Change the bound called ``name`` from the next `update` on: a cap that moves in time.

        Args:
            name: of one of the bounds.
            lower, upper: as in its record: scalar, one value a row, or one a step and row.

        Raises:
            UnknownNameError: there is none. BoundsError: the values do not fit, or rows are missing
                as they bounded nothing (see ``moving``).
        """
        rows = self._find(name)
        rows.move(lower, upper)
        if rows.size:
            self._l0[self.rows[name]], self._u0[self.rows[name]] = rows.lower, rows.upper
        if self._kinds[name] in self._first:
            self._note_first()

    def map(self, name: str, mapping: ArrayLike, offset: ArrayLike) -> None:
        """Change the map and offset of a `MappedBound` from the next `update` on.

        Raises:
            UnknownNameError, BoundsError: there is no such bound, or it has no map.
            ShapeError, ModelError: wrong shape, NaN.
        """
        rows = self._find(name)
        rows.map(mapping, offset)
        if rows.size:
            self.A[self.rows[name]] = self._condensed[name].decision
            self.rows_changed = True

    def kept(self, name: str) -> NDArray[np.bool_]:
        """Return which rows of the bound called ``name`` are in the QP, ``(steps, width)``.

        Raises:
            UnknownNameError: there is no such bound.
        """
        return self._find(name).kept

    def _find(self, name: str) -> RowBounds:
        if name not in self._bounds:
            raise UnknownNameError("bound", name, self._bounds)
        return self._bounds[name]

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
        for rows, where in self._mapped:
            rows.mapped_offset(p, self._offset[where])
        np.subtract(self._l0, self._offset, out=self.l)
        np.subtract(self._u0, self._offset, out=self.u)

    def parametric(self, state: Affine, previous: Affine, reference: Affine) -> Parametric | None:
        """Return how the vectors follow from parameters, or None where rows change in time.

        Args:
            state: x(k), previous: u(k-1), reference: w(k+1) ... w(k+N), ``(N * n_outputs,)``:
                each as constant and map of the parameters.
        """
        if self._mapped:
            return None
        constant = np.concatenate([state[0], previous[0]])
        slope = np.vstack([state[1], previous[1]])
        return Parametric(
            self._error_to_q @ (reference[1] - self._free_map @ slope),
            self._error_to_q @ (reference[0] - self._free_map @ constant),
            self._row_map @ slope,
            self._l0 - self._row_map @ constant,
            self._u0 - self._row_map @ constant,
        )

    @property
    def commands(self) -> tuple[Array, Array]:
        """What u(k) may be by the bounds on it alone, ``(n_inputs,)`` each."""
        return self._first[CommandBound]

    def predict(self, decision: Array) -> Array:
        """Return y(k+1) ... y(k+N) under a decision ``(n_z,)``, since the last `update`."""
        outputs = np.dot(self.prediction.Theta, decision)
        outputs += self.free
        return np.asarray(outputs.reshape(self.horizon, -1))

    def excess(self, decision: Array) -> Array:
        """Return how far a decision ``(n_z,)`` is beyond each row, ``(m,)``."""
        rows = np.dot(self.A, decision)
        return np.asarray(np.maximum(np.maximum(rows - self.u, self.l - rows), 0.0))

    def unconstrained(self) -> Array:
        """Return the decision ``(n_z,)`` that is best without bounds, since the last `update`."""
        return np.asarray(np.dot(self._closed_form, self.q))

    def solver(
        self,
        backend: str | type[Backend],
        limits: Limits = NO_LIMITS,
        smallest_part: int | None = None,
        *,
        parameters: Parametric | None = None,
    ) -> Solver:
        """Return a solver for the QP of this problem; arguments as for `Solver`.

        Raises:
            UnknownNameError, BackendUnavailableError, BackendSetupError: see `Solver`.
        """
        return Solver(
            self.qp,
            backend,
            self.rows.values(),
            limits=limits,
            pattern=self.pattern,
            smallest_part=smallest_part,
            parameters=parameters,
        )

    def command(self, decision: Array, previous: Array) -> Array:
        """Return u(k) ``(n_inputs,)`` from the first part of a decision ``(n_z,)`` and u(k-1)."""
        first = decision[: self.model.n_inputs]
        return previous + first if self.decision == "increment" else first.copy()

    def decide(self, commands: Array, previous: Array) -> Array:
        """Return the decision ``(n_z,)`` that gives ``commands``, the last of them held on.

        Args:
            commands: u(k), u(k+1), ..., ``(1 .. N_u, n_inputs)``.
            previous: u(k-1), ``(n_inputs,)``.
        """
        decision = np.empty((self.moves, self.model.n_inputs))
        decision[: len(commands)] = commands
        decision[len(commands) :] = commands[-1]
        if self.decision == "increment":
            decision[1:] = np.diff(decision, axis=0)
            decision[0] -= previous
        return decision.reshape(-1)

    def limits(self, previous: Array) -> tuple[Array, Array]:
        """Return what u(k) may be, ``(n_inputs,)`` each, by command and rate bounds together."""
        low, high = self._first[CommandBound]
        if not self._rate_bounded:
            return low, high
        fall, rise = self._first[RateBound]
        # The command bound wins where u(k-1) lies so far outside that both cannot hold.
        return (
            np.minimum(np.maximum(low, previous + fall), high),
            np.maximum(np.minimum(high, previous + rise), low),
        )

    def _note_first(self) -> None:
        """Intersect the bounds on u(k), and those on Delta u(k)."""
        for kind, (lower, upper) in self._first.items():
            lower.fill(-np.inf)
            upper.fill(np.inf)
            for name, rows in self._bounds.items():
                if self._kinds[name] is kind:
                    low, high = rows.first
                    np.maximum(lower, low, out=lower)
                    np.minimum(upper, high, out=upper)
        fall, rise = self._first[RateBound]
        self._rate_bounded = bool((np.isfinite(fall) | np.isfinite(rise)).any())

    def __repr__(self) -> str:
        return (
            f"Problem({self.model!r}, horizon={self.horizon}, rows={list(self.rows)}, {self.qp!r})"
        )
