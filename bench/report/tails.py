"""Percentile curves of times."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.percentiles import steps, tail
from bench.report.drawing import Figure, Line, Panel, Scale, Style, series
from bench.report.payload import Payload
from bench.report.words import figure_of, percent

Array = NDArray[np.float64]
Curve = tuple[Array, Array]
"""1 / (1 - share at or below), and the time there [us]."""
_LEVELS = (0.0, 50.0, 90.0, 99.0, 99.9, 99.99, 99.999, 99.9999)
_FLOORS = ("empty", "plant")
"""Names of curves that the others are to be compared with."""


def times_figure(
    id_: str,
    title: str,
    panels: Mapping[str, Mapping[str, ArrayLike]],
    payload: Payload,
    limit_us: float,
) -> Figure:
    """Return percentile curves of samples.

    Args:
        id_, title: of the figure.
        panels: from the title of each to its samples, from name to times [us].
        payload: takes the curves.
        limit_us: a time that is not to be passed [us].
    """
    curves: dict[str, dict[str, Curve]] = {}
    caption = []
    for panel, samples in panels.items():
        for name, times in samples.items():
            values = np.asarray(times, dtype=np.float64)
            if not values.size:
                continue
            curves.setdefault(panel, {})[name] = steps(values)
            told = {key: figure_of(value or 0.0) for key, value in tail(values).items()}
            beyond = percent(float((values > limit_us).mean()))
            caption.append(
                f"{panel}, {name}: median {told['p50']} µs, p99.9 {told['p999']} µs, slowest "
                f"{told['max']} µs, beyond {limit_us:g} µs: {beyond}."
            )
    return curves_figure(id_, title, curves, payload, limit_us=limit_us, caption=caption)


def curves_figure(
    id_: str,
    title: str,
    panels: Mapping[str, Mapping[str, Curve]],
    payload: Payload,
    *,
    limit_us: float,
    caption: Sequence[str],
) -> Figure:
    """Return percentile curves that are there already; see `times_figure`."""
    names = dict.fromkeys(name for curves in panels.values() for name in curves)
    plain = [name for name in names if name not in _FLOORS]
    rarest = 10.0
    made = []
    for panel, curves in panels.items():
        lines = []
        for name, (rarity, times) in curves.items():
            floor = name in _FLOORS
            style = (
                Style("held", ("dash", "dot")[_FLOORS.index(name)], 1.8)
                if floor
                else series(plain.index(name), 1.8)
            )
            x, y = payload.add(rarity), payload.add(times)
            lines.append(Line(name, y, style, x=x, wave=False))
            rarest = max(rarest, float(rarity.max(initial=0.0)))
        height = 300 if len(panels) == 1 else 230
        title_ = f"{panel} [µs]"
        made.append(Panel(title_, tuple(lines), height=height, log=True, limit=limit_us, unit="µs"))
    ticks = {f"{level:g} %": 100.0 / (100.0 - level) for level in _LEVELS}
    shown = {label: at for label, at in ticks.items() if at <= rarest}
    scale = Scale("percentile", log=True, ticks=shown, range=(1.0, rarest))
    return Figure(id_, title, tuple(panel for panel in made if panel.lines), tuple(caption), scale)
