"""A receding-horizon QP told stage by stage: what a structured backend is set up on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from qpmpc.arrays import Array, Indices
from qpmpc.structured.dynamics import Dynamics


@dataclass(frozen=True, eq=False)
class StagePart:
    """Inputs that no cost and no row couples with others, and all that depends on them.

        minimise    1/2 z' P z + q' z + penalties of `qpmpc.program.QuadraticProgram`
        subject to  l - s <= read s(i) <= u + s       on the steps i = 1..N that have rows

    where ``1/2 z' P z = sum_i s(i)' output' Q output s(i) + sum_i z(i)' R z(i)``, and s follows
    from z by `Dynamics`.
    """

    horizon: int
    """N."""
    moves: int
    """N_u."""
    inputs: Indices
    """Which inputs of the model, ``(m,)``."""
    outputs: Indices
    """Which outputs of the model, ``(p,)``."""
    dynamics: Dynamics
    output: Array
    """What the cost sees of the states, ``(p, n)``."""
    output_weight: Array
    """delta, ``(p,)``."""
    decision_weight: Array
    """lambda, ``(m,)``."""
    read: Array
    """What the rows of each step see of the states, ``(k, n)``."""
    rows: NDArray[np.intp]
    """Number of the row that bounds ``read`` at each step, ``(N, k)``; -1: none."""
    linear: Array
    """Penalty per unit of violation of the rows of each quantity, ``(k,)``; infinite: hard."""
    quadratic: Array
    """Penalty per squared unit, ``(k,)``."""

    @property
    def n(self) -> int:
        """Number of states."""
        return self.dynamics.n

    @property
    def m(self) -> int:
        """Number of inputs."""
        return int(self.inputs.size)


@dataclass(frozen=True, eq=False)
class StructuredProgram:
    """A QP in stages: the same as a `QuadraticProgram`, without its matrices."""

    n: int
    """Number of variables, ``N_u * n_inputs``: the decisions of one step side by side."""
    m: int
    """Number of rows."""
    parts: tuple[StagePart, ...]
    groups: tuple[slice, ...]
    """Rows that share one scale."""

    n_outputs: int
    """Outputs of one step."""

    @property
    def linear(self) -> Array:
        """Penalty per unit of violation of each row, ``(m,)``."""
        return self._of_rows("linear")

    @property
    def quadratic(self) -> Array:
        """Penalty per squared unit, ``(m,)``."""
        return self._of_rows("quadratic")

    def _of_rows(self, name: str) -> Array:
        values = np.zeros(self.m)
        for part in self.parts:
            there = part.rows >= 0
            values[part.rows[there]] = np.broadcast_to(getattr(part, name), there.shape)[there]
        return values

    def variables(self, part: StagePart) -> Indices:
        """Return which variables a part decides, ``(N_u * m,)``."""
        width = self.n // part.moves
        return np.asarray(
            (np.arange(part.moves)[:, None] * width + part.inputs).reshape(-1), dtype=np.intp
        )

    def outputs(self, part: StagePart) -> Indices:
        """Return which outputs of the horizon a part sees, ``(N * p,)``."""
        return np.asarray(
            (np.arange(part.horizon)[:, None] * self.n_outputs + part.outputs).reshape(-1),
            dtype=np.intp,
        )
