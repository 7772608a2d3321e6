"""Array type and the checks that every record of the library makes on what it is given."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from qpmpc.errors import ModelError, ShapeError

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


def matrix(
    name: str, value: ArrayLike, rows: int | None = None, columns: int | None = None
) -> Array:
    """Return a read-only, finite copy of ``value`` as a matrix of the given shape.

    Raises:
        ShapeError: it is not two-dimensional or a stated dimension differs.
        ModelError: it is not numeric or holds NaN or infinity.
    """
    array = _numeric(name, value)
    wanted = f"({'any' if rows is None else rows}, {'any' if columns is None else columns})"
    fits = (
        array.ndim == 2
        and (rows is None or array.shape[0] == rows)
        and (columns is None or array.shape[1] == columns)
    )
    if not fits:
        raise ShapeError(name, wanted, array.shape)
    if not np.isfinite(array).all():
        raise ModelError(f"{name} must be finite, but holds NaN or infinity")
    return _frozen(array)


def vector(name: str, value: ArrayLike, size: int, *, finite: bool = True) -> Array:
    """Return a read-only copy of ``value`` as a vector; a scalar is repeated ``size`` times.

    With ``finite=False`` infinities are allowed (bounds), NaN never is.

    Raises:
        ShapeError: it is neither a scalar nor of shape ``(size,)``.
        ModelError: it is not numeric or holds NaN (or infinity where not allowed).
    """
    array = _numeric(name, value)
    if array.ndim == 0:
        array = np.full(size, float(array))
    if array.shape != (size,):
        raise ShapeError(name, f"({size},) or a scalar", array.shape)
    if np.isnan(array).any() or (finite and not np.isfinite(array).all()):
        raise ModelError(f"{name} holds NaN{' or infinity' if finite else ''}")
    return _frozen(array)


def all_finite(values: Array) -> bool:
    """Whether a short vector holds neither NaN nor infinity; faster than numpy's, and silent."""
    return math.isfinite(sum(values.tolist()))


def _numeric(name: str, value: ArrayLike) -> Array:
    try:
        return np.array(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ModelError(f"{name} must be numeric: {error}") from error


def _frozen(array: Array) -> Array:
    array.flags.writeable = False
    return array
