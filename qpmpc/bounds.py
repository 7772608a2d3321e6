"""Bounds as records: on the command, on its rate, on any output; hard or soft, fixed or moving."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from qpmpc.arrays import Array
from qpmpc.errors import BoundsError


@dataclass(frozen=True, eq=False)
class CommandBound:
    """Hard bound ``lower <= u(k+i) <= upper`` on the commands of the horizon."""

    lower: ArrayLike
    """Scalar, ``(n_inputs,)`` or ``(N_u, n_inputs)``; -inf: none."""
    upper: ArrayLike
    """Scalar, ``(n_inputs,)`` or ``(N_u, n_inputs)``; +inf: none."""
    name: str = "command"
    moving: bool = False
    """Whether `Problem.move` will change it: rows that bound nothing now are kept then."""


@dataclass(frozen=True, eq=False)
class RateBound:
    """Hard bound ``lower <= Delta u(k+i) <= upper`` on the command's change per cycle."""

    lower: ArrayLike
    """Scalar, ``(n_inputs,)`` or ``(N_u, n_inputs)``."""
    upper: ArrayLike
    """Scalar, ``(n_inputs,)`` or ``(N_u, n_inputs)``."""
    name: str = "rate"
    moving: bool = False
    """Whether `Problem.move` will change it: rows that bound nothing now are kept then."""


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
    moving: bool = False
    """Whether `Problem.move` will change it: rows that bound nothing now are kept then."""


@dataclass(frozen=True, eq=False)
class MappedBound:
    """Soft bound on what is a linear map of outputs and command, a map that changes in time.

        lower <= mapping z(k+i) + offset <= upper,                    i = 1..N
        lower <= mapping [u(k+i); z(k+i)] + offset <= upper,          i = 0..N_u-1, if ``direct``

    with ``z = output x``. `Problem.map` brings a new mapping and offset at any cycle; they hold
    over the whole horizon. Joint speeds (through the Jacobian) and joint torques (which the command
    enters directly) are bounded in this way.
    """

    name: str
    """How errors, slack and statistics call it."""
    output: Array
    """Output matrix, ``(n_z, n)``."""
    mapping: Array
    """The map to begin with, typical in size, ``(n_m, n_z)``, or ``(n_m, n_inputs + n_z)``."""
    lower: ArrayLike
    """Scalar or ``(n_m,)``; -inf: none."""
    upper: ArrayLike
    """Scalar or ``(n_m,)``; +inf: none."""
    linear: float
    """Cost of one unit of violation at one step; infinite: hard."""
    quadratic: float = 0.0
    """Cost of one squared unit of violation at one step."""
    direct: bool = False
    """Whether the command is part of what is mapped."""
    moving: ClassVar[bool] = True


Bound = CommandBound | RateBound | OutputBound | MappedBound


def over_horizon(
    name: str, lower: ArrayLike, upper: ArrayLike, steps: int, width: int
) -> tuple[Array, Array]:
    """Return lower and upper as ``(steps, width)``, checked.

    Raises:
        BoundsError: not of an accepted shape, NaN, or lower above upper.
    """
    sides = []
    for side, value in (("lower", lower), ("upper", upper)):
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise BoundsError(name, f"{side} is not numeric ({error})") from error
        if array.shape not in ((), (width,), (steps, width)):
            raise BoundsError(
                name,
                f"{side} must be a scalar, ({width},) or ({steps}, {width}), got {array.shape}",
            )
        if np.isnan(array).any():
            raise BoundsError(name, f"{side} holds NaN")
        sides.append(np.broadcast_to(array, (steps, width)).copy())
    low, high = sides
    crossed = low > high
    if crossed.any():
        i, j = (int(v[0]) for v in np.nonzero(crossed))
        raise BoundsError(
            name, f"lower {low[i, j]:g} exceeds upper {high[i, j]:g} (step {i}, row {j})"
        )
    return low, high
