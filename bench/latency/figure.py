"""Percentile curves: how long the slowest share of the steps takes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from bench.percentiles import COLOURS, LINES, draw_limit, percentile_axis, steps

_MOST = 12
"""Curves in a panel that can still be read."""


def draw_latency(
    curves: Mapping[str, Mapping[str, NDArray[np.int64]]],
    title: str,
    period_us: float,
    path: Path,
) -> None:
    """Draw one panel a mode, side by side, one curve a backend, on common axes.

    Args:
        curves: mode, then name, to the times of all samples [ns]; steps where hot, responses from
            the intended release where paced.
        title: what was measured.
        period_us: the deadline [us].
        path: where the picture goes.
    """
    modes = [mode for mode in curves if curves[mode]]
    figure = Figure(figsize=(1.5 + 5.6 * max(len(modes), 1), 5.6), layout="constrained", dpi=110)
    panels = figure.subplots(1, max(len(modes), 1), squeeze=False, sharey=True)[0]
    everyone = list(dict.fromkeys(name for mode in modes for name in curves[mode]))
    styles = {
        name: (COLOURS[i % len(COLOURS)], LINES[i // len(COLOURS) % len(LINES)])
        for i, name in enumerate(everyone)
    }
    for panel, mode in zip(panels, modes, strict=False):
        times = curves[mode]
        shown = sorted(times, key=lambda name: float(np.median(times[name])))[:_MOST]
        for name in shown:
            colour, line = styles[name]
            x, y = steps(times[name] / 1e3)
            panel.plot(x, y, color=colour, linestyle=line, linewidth=1.5, label=name)
        percentile_axis(panel, max(t.size for t in times.values()))
        draw_limit(panel, period_us)
        panel.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:,.10g}"))
        dropped = len(times) - len(shown)
        left = f", the {len(shown)} fastest of {len(times)}" if dropped else ""
        what = "step" if mode == "hot" else "response from the intended release"
        panel.set_title(f"{mode}: {what}{left}", fontsize=10)
        # In the order of the curves, from the slowest at the top.
        handles, labels = panel.get_legend_handles_labels()
        panel.legend(handles[::-1], labels[::-1], fontsize=8, loc="upper left")
    panels[0].set_ylabel("time [us]")
    figure.suptitle(title, fontsize=11)
    figure.savefig(path)
