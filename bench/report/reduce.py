"""What a report draws instead of every sample: extremes, shares, spectra."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def bucket(cycles: int, limit: int) -> int:
    """Return how many cycles become two samples, so that ``limit`` are enough; 1: all are kept."""
    return 1 if cycles <= limit else int(np.ceil(2 * cycles / limit))


def extremes(values: Array, width: int) -> Array:
    """Return the least and the largest of every ``width`` samples, in the order they occur.

    Args:
        values: ``(n,)``; NaN is kept where a bucket holds nothing else.
        width: samples of a bucket; with 1 ``values`` are returned.
    """
    if width == 1:
        return values
    rows: Array = _rows(values, width)
    nothing = np.isnan(rows)
    low = np.where(nothing, np.inf, rows).argmin(axis=1)
    high = np.where(nothing, -np.inf, rows).argmax(axis=1)
    picked = np.sort(np.stack([low, high], axis=1), axis=1)
    found: Array = np.take_along_axis(rows, picked, axis=1).ravel()
    return found


def together(masks: NDArray[np.uint16], width: int) -> NDArray[np.uint16]:
    """Return the bits that occur among every ``width`` samples, twice each, as `extremes` has."""
    if width == 1:
        return masks
    return np.repeat(np.bitwise_or.reduce(_rows(masks, width), axis=1), 2)


def histogram(values: Array, edges: Array) -> Array:
    """Return the share of ``values`` in each bin [%], ``(edges - 1,)``."""
    counts, _ = np.histogram(values, edges)
    return 100.0 * counts / max(values.size, 1)


def spectrum(values: Array, period: float, longest: int = 8192) -> tuple[Array, Array]:
    """Return frequencies [Hz] and amplitude density [unit / sqrt(Hz)] of ``values (n,)``.

    One-sided, by Welch's method: means over segments under a Hann window that overlap by half,
    each without its mean. ``longest`` samples a segment; fewer than 16 samples give nothing.
    """
    n = min(longest, values.size)
    if n < 16:
        return np.zeros(0), np.zeros(0)
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(n) / n)
    starts = range(0, values.size - n + 1, n // 2)
    power = np.zeros(n // 2 + 1)
    for start in starts:
        segment = values[start : start + n]
        power += np.abs(np.fft.rfft((segment - segment.mean()) * window)) ** 2
    power *= 2 * period / (len(starts) * (window**2).sum())
    return np.fft.rfftfreq(n, period)[1:].astype(np.float64), np.sqrt(power[1:])


def smooth(f: Array, density: Array, above: float = 10.0) -> tuple[Array, Array]:
    """Return a spectrum whose power is averaged in bands 1.5 % wide ``above`` a frequency [Hz].

    On a logarithmic axis its scatter would otherwise be all that is seen there.
    """
    if not f.size:
        return f, density
    band = np.where(f <= above, 0, np.floor(np.log(np.maximum(f, above) / above) / 0.015) + 1)
    band[f <= above] = -np.arange((f <= above).sum())[::-1]
    _, first, counts = np.unique(band, return_index=True, return_counts=True)
    centre = np.add.reduceat(f, first) / counts
    return centre, np.sqrt(np.add.reduceat(density**2, first) / counts)


def _rows(values: NDArray[Any], width: int) -> NDArray[Any]:
    """Cut into rows of ``width``; the last one is filled up with its last value."""
    missing = -values.size % width
    filled = np.concatenate([values, np.repeat(values[-1:], missing)])
    return filled.reshape(-1, width)
