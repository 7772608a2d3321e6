"""Bounds as records: on the command, on its rate, on any output; hard or soft."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from qpmpc.arrays import Array
from qpmpc.errors import BoundsError, ModelError


@dataclass(frozen=True, eq=False)
class CommandBound:
    """Hard bound ``lower <= u(k+i) <= upper`` on the commands of the horizon."""

    lower: ArrayLike
    """Scalar, ``(n_inputs,)`` or ``(N_u, n_inputs)``; -inf: none."""
    upper: ArrayLike
    """Scalar, ``(n_inputs,)`` or ``(N_u, n_inputs)``; +inf: none."""
    name: str = "command"


@dataclass(frozen=True, eq=False)
class RateBound:
    """Hard bound ``lower <= Delta u(k+i) <= upper`` on the command's change per cycle."""

    lower: ArrayLike
    """Scalar, ``(n_inputs,)`` or ``(N_u, n_inputs)``."""
    upper: ArrayLike
    """Scalar, ``(n_inputs,)`` or ``(N_u, n_inputs)``."""
    name: str = "rate"


@dataclass(frozen=True, eq=False)
class OutputBound:
    """Soft bound ``lower <= z(k+i) <= upper`` on an output ``z = output x``, i = 1..N."""

    name: str
    """How errors, slack and statistics call it: "force", "velocity", ..."""
    output: Array
    """Output matrix, ``(n_z, n)``."""
    lower: ArrayLike
    """Scalar, ``(n_z,)`` or ``(N, n_z)``; -inf: none."""
    upper: ArrayLike
    """Scalar, ``(n_z,)`` or ``(N, n_z)``; +inf: none."""
    linear: float
    """Cost of one unit of violation at one step; infinite: hard."""
    quadratic: float = 0.0
    """Cost of one squared unit of violation at one step."""


Bound = CommandBound | RateBound | OutputBound


def over_horizon(bound: Bound, steps: int, width: int) -> tuple[Array, Array]:
    """Return lower and upper as ``(steps, width)``, checked.

    Raises:
        BoundsError: not of an accepted shape, NaN, or lower above upper.
    """
    sides = []
    for side, value in (("lower", bound.lower), ("upper", bound.upper)):
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise BoundsError(bound.name, f"{side} is not numeric ({error})") from error
        if array.shape not in ((), (width,), (steps, width)):
            raise BoundsError(
                bound.name,
                f"{side} must be a scalar, ({width},) or ({steps}, {width}), got {array.shape}",
            )
        if np.isnan(array).any():
            raise BoundsError(bound.name, f"{side} holds NaN")
        sides.append(np.broadcast_to(array, (steps, width)).copy())
    lower, upper = sides
    if (lower > upper).any():
        i, j = (int(v[0]) for v in np.nonzero(lower > upper))
        raise BoundsError(
            bound.name, f"lower {lower[i, j]:g} exceeds upper {upper[i, j]:g} (step {i}, row {j})"
        )
    if isinstance(bound, OutputBound) and not (bound.linear > 0 and bound.quadratic >= 0):
        raise ModelError(f"bound '{bound.name}': linear must be positive, quadratic not negative")
    return lower, upper
