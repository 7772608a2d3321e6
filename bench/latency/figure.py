"""Percentile curves: how long the slowest share of the steps takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator
from numpy.typing import NDArray

# Okabe and Ito's palette: told apart by everyone; line styles tell the second dozen.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#444444", "#E69F00")
_LINES = ("-", "--", ":", "-.")
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
        name: (_COLOURS[i % len(_COLOURS)], _LINES[i // len(_COLOURS) % len(_LINES)])
        for i, name in enumerate(everyone)
    }
    for panel, mode in zip(panels, modes, strict=False):
        ordered = {name: np.sort(times, axis=None) for name, times in curves[mode].items()}
        shown = sorted(ordered, key=lambda name: float(np.median(ordered[name])))[:_MOST]
        for name in shown:
            colour, line = styles[name]
            x, y = _curve(ordered[name])
            panel.plot(x, y, color=colour, linestyle=line, linewidth=1.5, label=name)
        _finish(panel, list(ordered.values()), period_us)
        dropped = len(ordered) - len(shown)
        left = f", the {len(shown)} fastest of {len(ordered)}" if dropped else ""
        what = "step" if mode == "hot" else "response from the intended release"
        panel.set_title(f"{mode}: {what}{left}", fontsize=10)
        # In the order of the curves, from the slowest at the top.
        handles, labels = panel.get_legend_handles_labels()
        panel.legend(handles[::-1], labels[::-1], fontsize=8, loc="upper left")
    panels[0].set_ylabel("time [us]")
    figure.suptitle(title, fontsize=11)
    figure.savefig(path)


def _curve(ordered: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return one in how many steps, and what that one takes at least [us].

    Few hundred points: every one of the slowest steps, and the others where a logarithmic axis
    tells them apart.
    """
    n = ordered.size
    above = np.unique(np.concatenate([np.arange(1, min(n, 100) + 1), np.geomspace(1, n, 400)]))
    above = np.unique(above.astype(np.int64))[::-1]  # how many steps take as long or longer
    return n / above, ordered[n - above] / 1e3


def _finish(panel: Axes, times: Sequence[NDArray[np.int64]], period_us: float) -> None:
    panel.set_xscale("log")
    panel.set_yscale("log")
    most = max((t.size for t in times), default=10)
    decades = [10**d for d in range(1, max(2, int(np.ceil(np.log10(most)))) + 1)]
    panel.set_xlim(1, most)
    panel.xaxis.set_major_locator(FixedLocator([2, *decades]))
    panel.xaxis.set_minor_locator(NullLocator())
    panel.xaxis.set_major_formatter(FuncFormatter(lambda x, _: f"{100 * (1 - 1 / x):.6g} %"))
    panel.axhline(period_us, color="#222222", linestyle="--", linewidth=1.0)
    panel.annotate(
        f"deadline {period_us:g} us", (0.99, period_us), xycoords=("axes fraction", "data"),
        xytext=(0, 3), textcoords="offset points", ha="right", fontsize=8,
    )  # fmt: skip
    panel.set_xlabel("share of the cycles that take no longer")
    panel.yaxis.set_major_formatter(FuncFormatter(lambda y, _: f"{y:,.10g}"))
    panel.grid(alpha=0.3)
