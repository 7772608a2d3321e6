"""From times to percentiles, and how many of them a budget allows."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from bench.latency.result import Percentiles
from bench.percentiles import tail


def percentiles(times: NDArray[np.int64]) -> Percentiles:
    """Return the percentiles [us] of times ``(passes, instances)`` [ns]."""
    whole, floor = tail(times.ravel() / 1e3), tail(times.min(axis=0) / 1e3)
    return Percentiles(
        **whole, floor_p50=floor["p50"], floor_p999=floor["p999"], floor_max=floor["max"]
    )


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
