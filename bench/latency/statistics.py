"""From times to percentiles, and how many of them a budget allows."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench.latency.result import Percentiles

_SHARES = {"p50": 0.5, "p99": 0.99, "p999": 0.999, "p9999": 0.9999}


def percentiles(times: NDArray[np.int64]) -> Percentiles:
    """Return the percentiles [us] of times ``(passes, instances)`` [ns]."""
    ordered = np.sort(times, axis=None)
    floor = np.sort(times.min(axis=0))
    return Percentiles(
        **{name: at_share(ordered, share) for name, share in _SHARES.items()},
        max=float(ordered[-1]) / 1e3,
        floor_p50=at_share(floor, 0.5),
        floor_p999=at_share(floor, 0.999),
        floor_max=float(floor[-1]) / 1e3,
    )


def at_share(ordered: NDArray[np.int64], share: float) -> float:
    """Return the smallest time [us] that at least ``share`` of the sorted times do not exceed.

    One that was measured, never a mean of two: of 500 times with one stall p99.8 is a usual one
    and p99.9 the stall.
    """
    rank = math.ceil(share * ordered.size - 1e-9)
    return float(ordered[max(rank, 1) - 1]) / 1e3


def timer_cost(now: Callable[[], int], readings: int = 20_000) -> tuple[float, float]:
    """Return the least and the median difference [ns] of two readings of a clock in a row."""
    found = np.empty(readings, dtype=np.int64)
    for i in range(readings):
        begin = now()
        end = now()
        found[i] = end - begin
    return float(found.min()), float(np.median(found))


def representative(acting: NDArray[np.bool_], instances: int) -> int:
    """Return the start of the window whose share of acting cycles is nearest to that of all.

    Where not all cycles can be timed, those that are should be as hard as the whole.

    Args:
        acting: in which cycles a row acts, ``(K,)``.
        instances: length of the window, at most K.
    """
    total = np.concatenate([[0], np.cumsum(acting)])
    shares = (total[instances:] - total[: total.size - instances]) / instances
    return int(np.abs(shares - acting.mean()).argmin())
