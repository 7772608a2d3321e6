"""Tails of measured times: the figures that are told, and the percentile curve."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedFormatter, FixedLocator, NullLocator
from numpy.typing import ArrayLike, NDArray

Tail = dict[str, float | None]
LEVELS = {"p50": 50.0, "p99": 99.0, "p999": 99.9, "p9999": 99.99}
"""Percentiles that are told beside the largest value."""
# Okabe and Ito's palette: told apart by everyone.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00")
LINES = ("-", "--", ":", "-.")
_SHOWN = (0.0, 50.0, 90.0, 99.0, 99.9, 99.99, 99.999, 99.9999)


def tail(values: ArrayLike) -> Tail:
    """Return p50, p99, p999, p9999 and max of ``values``, in their unit.

    Each is a value that occurred, the smallest with at least that share at or below it: nothing is
    interpolated into a gap of the tail. Without values all are None.
    """
    found = np.asarray(values, dtype=np.float64)
    if not found.size:
        return dict.fromkeys([*LEVELS, "max"])
    told = np.percentile(found, list(LEVELS.values()), method="inverted_cdf")
    return dict(zip(LEVELS, told.tolist(), strict=True)) | {"max": float(found.max())}


@dataclass(frozen=True, eq=False)
class Curve:
    """One line of the picture."""

    name: str
    values: NDArray[np.float64]
    """Times [us], in any order."""
    floor: bool = False
    """Whether it is what the others are compared with, drawn in grey."""


def draw_percentiles(
    curves: Sequence[Curve], path: Path, *, what: str, title: str, limit: float | None = None
) -> None:
    """Draw times over percentiles, as tails are read: ever rarer to the right.

    Args:
        curves: those without values are left out.
        path: of the picture.
        what: label of the times, with the unit.
        title: one line above.
        limit: a time that is not to be passed [us], drawn as a line.
    """
    figure = Figure(figsize=(9, 5.5), layout="constrained", dpi=110)
    panel = figure.subplots()
    drawn = [curve for curve in curves if curve.values.size]
    for curve in drawn:
        rarity, values = steps(curve.values)
        i = [c for c in drawn if c.floor == curve.floor].index(curve)
        panel.plot(
            rarity, values, label=curve.name,
            color="#888888" if curve.floor else COLOURS[i % len(COLOURS)],
            linestyle=LINES[(i if curve.floor else i // len(COLOURS)) % len(LINES)],
            linewidth=2.2 if curve.floor else 1.3,
        )  # fmt: skip
    if limit is not None:
        draw_limit(panel, limit)
    percentile_axis(panel, max((curve.values.size for curve in drawn), default=1))
    panel.set_ylabel(what)
    panel.set_title(title, fontsize=10)
    if drawn:
        panel.legend(loc="upper left", fontsize=8)
    figure.savefig(path)


def draw_limit(panel: Axes, limit: float) -> None:
    """Draw a time that is not to be passed [us]."""
    panel.axhline(limit, color="#222222", linewidth=1.0, linestyle=":")
    panel.annotate(
        f"{limit:g} µs", (1.0, limit), xycoords=("axes fraction", "data"),
        xytext=(-4, 3), textcoords="offset points", ha="right", fontsize=8,
    )  # fmt: skip


def steps(values: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return 1 / (1 - share at or below) and the value there, thinned where nothing is seen."""
    ordered = np.sort(np.asarray(values, dtype=np.float64), axis=None)
    n = ordered.size
    # The i-th of n is at share (i + 1) / n; the last one, at 1, is drawn half a step before.
    above = n - 1 - np.arange(n)
    above = np.where(above > 0, above, 0.5)
    rarity = n / above
    keep = np.unique(
        np.concatenate([
            np.searchsorted(rarity, np.geomspace(1.0, rarity[-1], 2000)).clip(0, n - 1),
            np.arange(max(0, n - 200), n),
        ])
    )  # fmt: skip
    return rarity[keep], np.maximum(ordered[keep], 1e-3)


def percentile_axis(panel: Axes, most: int) -> None:
    """Make the axes those of a percentile curve of at most ``most`` values."""
    shown = [level for level in _SHOWN if 100.0 / (100.0 - level) <= max(2 * most, 10)]
    panel.set_xscale("log")
    panel.set_xlim(1.0, max(2.0 * most, 10.0))
    panel.xaxis.set_major_locator(FixedLocator([100.0 / (100.0 - level) for level in shown]))
    panel.xaxis.set_major_formatter(FixedFormatter([f"{level:g} %" for level in shown]))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.set_xlabel("percentile")
    panel.set_yscale("log")
    panel.grid(alpha=0.3)
