"""A search with a budget: points that fill the space, then a simplex from the best of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.stats import qmc

from qpmpc.kinds import Tunable

Array = NDArray[np.float64]
Objective = Callable[[Array], float]
"""From values, in the order of the ranges, to what is to be small."""


@dataclass(frozen=True)
class Found:
    """The best point of a search."""

    values: Array
    cost: float
    evaluations: int


def fill(objective: Objective, ranges: Sequence[Tunable], count: int, seed: int) -> Found:
    """Evaluate ``count`` points of a scrambled Sobol sequence, in equal ratios along each range."""
    points = qmc.Sobol(len(ranges), rng=seed).random_base2(int(np.ceil(np.log2(count))))[:count]
    values = [spread(point, ranges) for point in points]
    costs = [objective(value) for value in values]
    best = int(np.argmin(costs))
    return Found(values[best], costs[best], count)


def descend(
    objective: Objective, ranges: Sequence[Tunable], start: Array, count: int, size: float
) -> Found:
    """Go down from ``start`` by Nelder and Mead's simplex, with ``count`` evaluations exactly.

    Args:
        objective, ranges: see there.
        start: values to begin with.
        count: of evaluations; where the simplex has shrunk to nothing before, a new one begins.
        size: of the first simplex, as a share of each range.
    """
    n = len(ranges)
    best, lowest, left = gathered(start, ranges), np.inf, count

    def asked(point: Array) -> float:
        nonlocal best, lowest, left
        if left <= 0:
            raise _Enough
        left -= 1
        inside = np.clip(point, 0.0, 1.0)
        value = objective(spread(inside, ranges)) + float(np.abs(point - inside).sum())
        if value < lowest:
            best, lowest = inside, value
        return value

    try:
        while left > 0:
            steps = np.where(best + size <= 1.0, size, -size)
            simplex = np.vstack([best, best + np.diag(steps)])
            minimize(
                asked, best, method="Nelder-Mead",
                options={"initial_simplex": simplex, "maxfev": max(left, n + 1), "xatol": 1e-3,
                         "fatol": 1e-5},
            )  # fmt: skip
            size /= 2
    except _Enough:
        pass
    return Found(spread(best, ranges), lowest, count)


def spread(point: Array, ranges: Sequence[Tunable]) -> Array:
    """From the unit cube to values, in equal ratios."""
    return np.array([r.low * (r.high / r.low) ** p for r, p in zip(ranges, point, strict=True)])


def gathered(values: Array, ranges: Sequence[Tunable]) -> Array:
    """From values to the unit cube; the inverse of `spread`."""
    return np.array(
        [np.log(v / r.low) / np.log(r.high / r.low) for r, v in zip(ranges, values, strict=True)]
    )


class _Enough(Exception):  # noqa: N818
    """The budget is used up."""
