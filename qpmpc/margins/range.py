"""Between which values of a parameter a loop is stable, by bisection."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_STEPS = 24
"""Steps in which the way to the end of the search is first gone."""


def stable_range(
    stable: Callable[[float], bool],
    nominal: float,
    lowest: float,
    highest: float,
    tolerance: float = 1e-6,
) -> tuple[float, float] | None:
    """Return the range around ``nominal`` in which ``stable`` is true; None if it is not there.

    From the nominal value outwards in steps of equal ratio (of equal length where the nominal value
    is 0), then by bisection: an island of instability between two steps may be missed.

    Args:
        stable: whether the loop is, for a value of the parameter.
        nominal: where the search begins.
        lowest, highest: where it ends; these are returned where all up to them is stable.
        tolerance: of the result, relative to ``highest - lowest`` or to the value.
    """
    if not stable(nominal):
        return None
    return tuple(_edge(stable, nominal, end, tolerance) for end in (lowest, highest))  # type: ignore[return-value]


def _edge(stable: Callable[[float], bool], nominal: float, end: float, tolerance: float) -> float:
    if end == nominal:
        return end
    geometric = nominal > 0 and end > 0
    way = np.geomspace(nominal, end, _STEPS) if geometric else np.linspace(nominal, end, _STEPS)
    inside = nominal
    for value in way[1:].tolist():
        if not stable(value):
            break
        inside = value
    else:
        return end
    outside = value
    while abs(outside - inside) > tolerance * max(abs(inside), abs(end - nominal) * 1e-3):
        middle = (inside * outside) ** 0.5 if geometric else (inside + outside) / 2
        inside, outside = (middle, outside) if stable(middle) else (inside, middle)
    return inside
