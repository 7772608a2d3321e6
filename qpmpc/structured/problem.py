"""From model, weights and bounds to a QP in stages: `Problem` without a matrix of N columns."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qpmpc.arrays import Array
from qpmpc.backends import Backend, Limits, backend_class
from qpmpc.bounds import Bound
from qpmpc.construction import Construction, Decision
from qpmpc.errors import BackendSetupError
from qpmpc.models import LinearModel
from qpmpc.parametric import Parametric
from qpmpc.prediction import Prediction, check_horizons
from qpmpc.problem import Affine, Problem
from qpmpc.program import QuadraticProgram
from qpmpc.rows import RowBounds, Setting
from qpmpc.solver import NO_LIMITS, Solver
from qpmpc.structured.dynamics import Dynamics, coupled, joined_dynamics, reachable
from qpmpc.structured.program import StagePart, StructuredProgram
from qpmpc.structured.rows import Responses, StructuredRows, needs_rates
from qpmpc.structured.solver import Assembled, Compiled, StructuredSolver


class StructuredProblem(Problem):
    """The same receding-horizon problem, told stage by stage: set-up and cycle linear in N.

    Decision, rows, vectors and their order are those of `Problem`. The condensed matrices are made
    only where someone asks for them (`qp`, `A`, `pattern`).
    """

    form: ClassVar[str] = "structured"

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
        compiled: Compiled = "auto",
    ) -> None:
        """Find the stages.

        Args:
            model, horizon, output_weight, increment_weight, bounds, control_horizon, decision:
                as for `Problem`; of bounds any but a `MappedBound`.
            compiled: whether the passes over the horizon are compiled.

        Raises:
            ModelError, ShapeError, BoundsError, UnknownNameError: as for `Problem`, or a bound is
                mapped. CompilerUnavailableError, CompilationError, CacheError: ``on``, and it
                cannot be.
        """
        moves = check_horizons(horizon, control_horizon)
        self._compile: Compiled = compiled
        self._stages: dict[str, StructuredRows] = {}
        self._common: tuple[Dynamics, Responses] | None = None
        self._rates = needs_rates(bounds)
        self._twin: dict[str, Any] = {
            "output_weight": output_weight, "increment_weight": increment_weight,
            "bounds": bounds, "control_horizon": moves, "decision": decision,
        }  # fmt: skip
        super().__init__(
            model,
            horizon,
            output_weight=output_weight,
            increment_weight=increment_weight,
            bounds=bounds,
            control_horizon=control_horizon,
            decision=decision,
        )

    def _roll_out(self, setting: Setting) -> tuple[Dynamics, Responses]:
        if self._common is None:
            dynamics = joined_dynamics(self.model, self.decision, rates=self._rates)
            self._common = dynamics, Responses(dynamics, setting)
        return self._common

    def _rows_of(self, bound: Bound, setting: Setting) -> RowBounds:
        dynamics, responses = self._roll_out(setting)
        rows = StructuredRows(bound, setting, responses, dynamics.n)
        self._stages[bound.name] = rows
        return rows

    def _build(
        self,
        setting: Setting,
        construction: Construction,  # noqa: ARG002 - it makes what is not made here
        delta: Array,
        lam: Array,
    ) -> None:
        dynamics, responses = self._roll_out(setting)
        model, N = self.model, self.horizon
        output = np.hstack([model.C, np.zeros((model.n_outputs, dynamics.n - model.n_states))])
        self.program = self._stage(dynamics, output, delta, lam)
        """The QP in stages."""
        self._products = Assembled(self.program, self._compile)
        n, m = self.program.n, self.program.m
        rows = [self._stages[name] for name in self.rows]
        known = model.n_states + model.n_inputs
        self._l0 = np.concatenate([np.zeros(0), *(r.lower for r in rows)])
        self._u0 = np.concatenate([np.zeros(0), *(r.upper for r in rows)])
        self._row_map = np.vstack([np.zeros((0, known)), *(r.parameters for r in rows)])
        self._free_map = responses.parameters(output, N)
        self._weight = np.tile(-2.0 * delta, N)
        self._parameters, self._offset = np.zeros(known), np.zeros(m)
        self.free, self._error = np.zeros((2, N * model.n_outputs))
        self.q, self.l, self.u = np.zeros(n), np.zeros(m), np.zeros(m)
        self._outputs, self._rows = np.zeros_like(self.free), np.zeros(m)
        self._decision, self._closed = np.zeros(n), np.zeros(n)
        self.rows_changed = False

    def _stage(
        self, dynamics: Dynamics, output: Array, delta: Array, lam: Array
    ) -> StructuredProgram:
        """Split into parts, each on the states that its inputs reach."""
        stages = [self._stages[name] for name in self.rows]
        numbers = [
            rows.numbers(where.start, self.horizon)
            for rows, where in zip(stages, self.rows.values(), strict=True)
        ]
        number = np.hstack([np.zeros((self.horizon, 0), dtype=np.intp), *numbers])
        readings = np.vstack([np.zeros((0, dynamics.n)), *(rows.reading for rows in stages)])
        widths = [rows.width for rows in stages]
        linear = np.repeat([rows.linear for rows in stages], widths)
        quadratic = np.repeat([rows.quadratic for rows in stages], widths)
        p = len(output)
        used: NDArray[np.bool_] = np.asarray((number >= 0).any(axis=0), dtype=np.bool_)
        parts = []
        for inputs, seen in coupled(dynamics, np.vstack([output, readings])):
            outputs, own = seen[seen < p], seen[seen >= p] - p
            own = own[used[own]]
            both = np.vstack([output[outputs], readings[own]])
            smaller, reads = reachable(dynamics, inputs, both)
            part = StagePart(
                horizon=self.horizon,
                moves=self.moves,
                inputs=inputs,
                outputs=outputs,
                dynamics=smaller,
                output=reads[: outputs.size],
                output_weight=delta[outputs],
                decision_weight=lam[inputs],
                read=reads[outputs.size :],
                rows=np.ascontiguousarray(number[:, own]),
                linear=linear[own],
                quadratic=quadratic[own],
            )
            parts.append(part)
        return StructuredProgram(
            self.moves * self.model.n_inputs,
            sum(rows.size for rows in stages),
            tuple(parts),
            tuple(self.rows.values()),
            self.model.n_outputs,
        )

    @property
    def compiled(self) -> bool:
        """Whether the passes over the horizon are compiled."""
        return self._products.compiled

    @cached_property
    def condensed(self) -> Problem:
        """The same problem with its matrices: for comparison, and for who wants to see them."""
        return Problem(self.model, self.horizon, **self._twin)

    @property
    def qp(self) -> QuadraticProgram:  # type: ignore[override]
        """The condensed program."""
        return self.condensed.qp

    @property
    def A(self) -> Array:  # type: ignore[override]  # noqa: N802
        """Rows of the condensed program, ``(m, n_z)``."""
        return self.condensed.A

    @property
    def pattern(self) -> NDArray[np.bool_]:  # type: ignore[override]
        """Where `A` is other than zero, ``(m, n_z)``."""
        return self.condensed.pattern

    @property
    def prediction(self) -> Prediction:  # type: ignore[override]
        """Psi, Upsilon and Theta."""
        return self.condensed.prediction

    def update(self, state: Array, previous: Array, reference: Array) -> None:
        """See `Problem.update`."""
        p, n = self._parameters, self.model.n_states
        p[:n], p[n:] = state, previous
        np.dot(self._free_map, p, out=self.free)
        np.subtract(reference.reshape(-1), self.free, out=self._error)
        self._error *= self._weight
        self._products.output_gradient(self._error, self.q)
        np.dot(self._row_map, p, out=self._offset)
        np.subtract(self._l0, self._offset, out=self.l)
        np.subtract(self._u0, self._offset, out=self.u)

    def predict(self, decision: Array) -> Array:
        """See `Problem.predict`."""
        np.copyto(self._decision, decision)
        outputs = self._products.outputs(self._decision, self._outputs) + self.free
        return outputs.reshape(self.horizon, -1)

    def excess(self, decision: Array) -> Array:
        """See `Problem.excess`."""
        np.copyto(self._decision, decision)
        rows = self._products.rows(self._decision, self._rows)
        return np.maximum(np.maximum(rows - self.u, self.l - rows), 0.0)

    def unconstrained(self) -> Array:
        """See `Problem.unconstrained`."""
        return self._products.minimise(self.q, self._closed).copy()

    def parametric(self, state: Affine, previous: Affine, reference: Affine) -> None:
        """Return None: who works with the condensed vectors as functions takes that form."""

    def solver(
        self,
        backend: str | type[Backend],
        limits: Limits = NO_LIMITS,
        smallest_part: int | None = None,  # noqa: ARG002 - parts are never packed here
        *,
        parameters: Parametric | None = None,  # noqa: ARG002 - nothing is made of them
    ) -> Solver:
        """Return the structured solver, in place of a backend that allows it.

        Raises:
            BackendSetupError: the backend does not, or a limit is none that the solver has.
        """
        kind = backend_class(backend) if isinstance(backend, str) else backend
        if not kind.structured:
            raise BackendSetupError(kind.name, "solves the condensed form only")
        return StructuredSolver(self.program, self._products, limits=limits, compiled=self._compile)

    def __repr__(self) -> str:
        p = self.program
        return (
            f"StructuredProblem({self.model!r}, horizon={self.horizon}, rows={list(self.rows)}, "
            f"variables={p.n}, rows={p.m}, parts={[(part.n, part.m) for part in p.parts]})"
        )
