"""Discrete linear models: the record, ways to get one, ways to join several."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, expm

from qpmpc.arrays import Array, matrix
from qpmpc.errors import ModelError


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A discrete linear time-invariant model without feed-through.

        x(k+1) = A x(k) + B u(k)
        y(k)   = C x(k)

    Raises:
        ShapeError: A is not square, or B or C does not fit it.
        ModelError: an entry is not finite, or the period is not positive.
    """

    A: Array
    """State matrix, ``(n, n)``."""
    B: Array
    """Input matrix, ``(n, n_inputs)``."""
    C: Array
    """Output matrix, ``(n_outputs, n)``."""
    period: float
    """Sampling period [s]."""

    def __post_init__(self) -> None:
        A = matrix("A", self.A)
        matrix("A", A, A.shape[0], A.shape[0])
        object.__setattr__(self, "A", A)
        object.__setattr__(self, "B", matrix("B", self.B, rows=A.shape[0]))
        object.__setattr__(self, "C", matrix("C", self.C, columns=A.shape[0]))
        if not (np.isfinite(self.period) and self.period > 0):
            raise ModelError(f"period must be positive, got {self.period}")

    @property
    def n_states(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    @property
    def n_inputs(self) -> int:
        """Number of inputs."""
        return int(self.B.shape[1])

    @property
    def n_outputs(self) -> int:
        """Number of outputs."""
        return int(self.C.shape[0])

    def __repr__(self) -> str:
        return (
            f"LinearModel(states={self.n_states}, inputs={self.n_inputs}, "
            f"outputs={self.n_outputs}, period={self.period:g} s)"
        )


def zero_order_hold(A: ArrayLike, B: ArrayLike, period: float) -> tuple[Array, Array]:
    """Discretise ``dx/dt = A x + B u`` exactly for an input held constant over each period.

    Args:
        A: continuous state matrix, ``(n, n)``.
        B: continuous input matrix, ``(n, n_inputs)``.
        period: sampling period [s].

    Returns:
        The discrete pair, of the same shapes, from the exponential of ``[[A, B], [0, 0]]``.
    """
    A = matrix("A", A)
    matrix("A", A, A.shape[0], A.shape[0])
    B = matrix("B", B, rows=A.shape[0])
    if not (np.isfinite(period) and period > 0):
        raise ModelError(f"period must be positive, got {period}")
    n, m = B.shape
    generator = np.zeros((n + m, n + m))
    generator[:n, :n], generator[:n, n:] = A, B
    exponential = expm(generator * period)
    return exponential[:n, :n], exponential[:n, n:]


def from_state_space(system: Any, period: float | None = None) -> LinearModel:
    """Take a model from a ``scipy.signal`` or ``control`` state-space object.

    Args:
        system: anything with ``A``, ``B``, ``C``, ``D`` and ``dt``. ``dt`` of ``None`` or 0 means
            continuous time: such a system is discretised by exact zero-order hold.
        period: sampling period [s]; needed for a continuous system or one whose ``dt`` is
            unspecified (``True``), and must agree with ``dt`` otherwise.

    Raises:
        ModelError: a matrix is missing, there is feed-through, or the period is missing or
            contradicts ``dt``.
    """
    try:
        A, B, C, D, dt = system.A, system.B, system.C, system.D, system.dt
    except AttributeError as error:
        raise ModelError(
            f"{type(system).__name__} is no state-space object (A, B, C, D, dt): {error}"
        ) from error
    if np.any(np.asarray(D, dtype=float) != 0):
        raise ModelError("D must be zero: a command cannot act on the output it is computed from")
    continuous = dt is None or (dt is not True and dt == 0)
    if continuous or dt is True:
        if period is None:
            raise ModelError("period is needed: the system states no sampling time")
        if continuous:
            A, B = zero_order_hold(A, B, period)
        return LinearModel(A, B, C, period)
    if period is not None and not np.isclose(period, dt, rtol=1e-9, atol=0):
        raise ModelError(f"period {period} s contradicts the system's own dt = {dt} s")
    return LinearModel(A, B, C, float(dt))


def stack(models: Sequence[LinearModel]) -> LinearModel:
    """Join independent models: states, inputs and outputs side by side (block-diagonal)."""
    period = _common_period(models)
    return LinearModel(
        block_diag(*(m.A for m in models)),
        block_diag(*(m.B for m in models)),
        block_diag(*(m.C for m in models)),
        period,
    )


def _common_period(models: Sequence[LinearModel]) -> float:
    periods = {m.period for m in models}
    if len(periods) != 1:
        raise ModelError(f"models to be joined must share one period, got {sorted(periods)}")
    return periods.pop()
