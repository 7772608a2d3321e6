"""The record of one cycle of a controller."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from qpmpc.arrays import Array
from qpmpc.fallback import Source
from qpmpc.residuals import Residuals
from qpmpc.status import Status


@dataclass(frozen=True, slots=True)
class Times:
    """Where a step's time went [s]."""

    update: float
    """Observer, reference, vectors of the QP and their scaling."""
    build: float
    """Bringing new rows into the solver, and what a backend that cannot be updated takes to build
    its problem anew; 0 otherwise."""
    solve: float
    """The backend without that."""
    step: float
    """The whole step, from measurement to command."""


@dataclass(frozen=True, slots=True)
class Step:
    """What one cycle decided and how. Arrays are the step's own."""

    status: Status
    """How the solve ended."""
    source: Source
    """Where the command came from: the solve, or what stood in for it."""
    command: Array
    """u(k), to be applied now, ``(n_inputs,)``."""
    decision: Array
    """Increments Delta u(k) ... (absolute commands where so configured), ``(N_u, n_inputs)``."""
    predicted: Array
    """Outputs y(k+1) ... y(k+N) under the decision, ``(N, n_outputs)``."""
    violation: Array
    """What each row of the QP gave way, in its own unit, ``(m,)``."""
    rows: Mapping[str, slice]
    """Where each bound's rows are."""
    residuals: Residuals
    iterations: int
    times: Times

    @property
    def slack(self) -> dict[str, Array]:
        """Violation by the plan of every bound that has rows, by its name, in its unit."""
        return {name: self.violation[rows] for name, rows in self.rows.items()}

    def __repr__(self) -> str:
        return (
            f"Step({self.status}, command={np.array2string(self.command, precision=4)}, "
            f"{self.times.step * 1e6:.0f} us)"
        )


@dataclass(frozen=True)
class Layout:
    """Where the parts of a step are in the one array that a compiled step leaves behind."""

    rows: Mapping[str, slice]
    command: slice
    decision: tuple[slice, tuple[int, int]]
    predicted: tuple[slice, tuple[int, int]]
    violation: slice

    @classmethod
    def of(
        cls,
        rows: Mapping[str, slice],
        decision: tuple[int, int],
        predicted: tuple[int, int],
        m: int,
    ) -> Layout:
        """Lay out a step whose decision and prediction have these shapes, with ``m`` rows.

        Command, decision, predicted, violation; behind them the four residuals (primal, dual, gap,
        scaled) and the times of update and solve.
        """
        sizes = [0, decision[1], decision[0] * decision[1], predicted[0] * predicted[1], m]
        parts = [slice(*ends) for ends in pairwise(np.cumsum(sizes).tolist())]
        return cls(rows, parts[0], (parts[1], decision), (parts[2], predicted), parts[3])


class CompiledRecord(Step):
    """A `Step` in one array of its own; a part becomes an array when it is looked at."""

    __slots__ = ("_iterations", "_layout", "_status", "_took", "_values")
    # To whoever asks it is a Step: so `dataclasses.replace` and comparisons take it for one.
    __class__ = property(lambda _: Step)
    _status: Status
    _values: Array
    _layout: Layout
    _iterations: int
    _took: float

    def __init__(
        self, status: Status, values: Array, layout: Layout, iterations: int, took: float
    ) -> None:
        """Keep what a compiled step left behind.

        Args:
            status: how the solve ended.
            values: all numbers, see `Layout`; the record's own.
            layout: of ``values``.
            iterations: of the solver.
            took: the whole step [s].
        """
        _keep(self, "_status", status)
        _keep(self, "_values", values)
        _keep(self, "_layout", layout)
        _keep(self, "_iterations", iterations)
        _keep(self, "_took", took)

    @property
    def status(self) -> Status:
        """See `Step`."""
        return self._status

    @property
    def source(self) -> Source:
        """See `Step`."""
        return Source.SOLUTION

    @property
    def command(self) -> Array:
        """See `Step`."""
        return self._values[self._layout.command]

    @property
    def decision(self) -> Array:
        """See `Step`."""
        where, shape = self._layout.decision
        return self._values[where].reshape(shape)

    @property
    def predicted(self) -> Array:
        """See `Step`."""
        where, shape = self._layout.predicted
        return self._values[where].reshape(shape)

    @property
    def violation(self) -> Array:
        """See `Step`."""
        return self._values[self._layout.violation]

    @property
    def rows(self) -> Mapping[str, slice]:
        """See `Step`."""
        return self._layout.rows

    @property
    def residuals(self) -> Residuals:
        """See `Step`."""
        return Residuals(*self._values[-6:-2].tolist())

    @property
    def iterations(self) -> int:
        """See `Step`."""
        return self._iterations

    @property
    def times(self) -> Times:
        """See `Step`."""
        update, solve = self._values[-2:].tolist()
        return Times(update, 0.0, solve, self._took)


_keep = object.__setattr__
"""A `Step` is frozen."""
