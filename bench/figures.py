"""Pictures of a run."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from bench import plots
from bench.compare import Comparison
from scenarios.approach import ContactState
from scenarios.log import Array, Log
from scenarios.schedule import BoundName, Schedule

_LOST = "#999999"
_COLOURS = ("#D55E00", "#0072B2", "#009E73", "#CC79A7", "#56B4E9", "#444444")
_LINES = ("-", "--", ":", "-.")
_CLOSE = 0.15
"""Time to either side of the instant that is enlarged [s]."""


def draw_forces(log: Log, path: Path) -> None:
    """Redraw the paper's Figs. 6 and 7: each axis held still above, controlled below.

    The two upper rows share their scale; the lowest one enlarges the controlled error.
    """
    n = len(log.axes)
    figure = Figure(figsize=(1.5 + 4.2 * n, 7.5), layout="constrained", dpi=110)
    grid = figure.subplots(3, n, sharex=True, squeeze=False)
    for j, axis in enumerate(log.axes):
        upper, middle, lower = grid[:, j]
        middle.sharey(upper)
        plots.force(upper, log, axis, held=True)
        plots.force(middle, log, axis)
        plots.error(lower, log, axis)
        lower.set_xlabel("time [s]")
        shade_lost(log, (middle, lower))
        for panel in (upper, middle, lower):
            panel.grid(alpha=0.3)
    for row, what in enumerate(("contact force [N]", "contact force [N]", "force error [N]")):
        grid[row, 0].set_ylabel(what)
    grid[0, 0].legend(loc="lower right", fontsize=8)
    figure.savefig(path)


def shade_lost(log: Log, panels: Sequence[Axes]) -> None:
    """Shade the times in which the tool counted as off the tissue."""
    lost = (log.contact[: log.cycles] == ContactState.LOST).astype(np.int8)
    edges = np.flatnonzero(np.diff(lost, prepend=0, append=0)).reshape(-1, 2)
    time = log.time[: log.cycles]
    for begin, end in edges.tolist():
        for panel in panels:
            panel.axvspan(time[begin], time[end - 1], color=_LOST, alpha=0.25, linewidth=0)


def draw_comparison(comparison: Comparison, path: Path) -> None:
    """Force and velocity against their bounds under each backend, and a close view.

    For either quantity the axis is the one on which any backend is furthest beyond its bound (or
    nearest to it), and the close view is around that instant.
    """
    done = [e for e in comparison.experiments if e is not None and e.log.cycles]
    figure = Figure(figsize=(13, 7.5), layout="constrained", dpi=110)
    grid = figure.subplots(2, 2, squeeze=False, width_ratios=(3, 2))
    schedule = Schedule(comparison.scenario)
    quantities: tuple[tuple[BoundName, str], ...] = (
        ("force", "contact force [N]"),
        ("velocity", "tool velocity [m/s]"),
    )
    for (whole, close), (name, label) in zip(grid, quantities, strict=True):
        if not done:
            continue
        axes = done[0].log.axes
        runs = [_values(e.log, name) for e in done]
        beyond = [_beyond(run, *schedule.over(name, len(run))) for run in runs]
        most = max(range(len(runs)), key=lambda i: float(beyond[i].max()))
        k, j = np.unravel_index(int(beyond[most].argmax()), beyond[most].shape)
        lower, upper = schedule.over(name, max(len(run) for run in runs))
        time = done[most].log.time
        for panel in (whole, close):
            for i, (e, run) in enumerate(zip(done, runs, strict=True)):
                panel.plot(
                    e.log.time[: len(run)], run[:, j], color=_COLOURS[i % len(_COLOURS)],
                    linestyle=_LINES[i // len(_COLOURS) % len(_LINES)],
                    linewidth=1.6 if i == 0 else 0.9, label=e.scenario.backend,
                )  # fmt: skip
            for side in (lower[:, j], upper[:, j]):
                shown = np.isfinite(side)
                panel.plot(
                    np.where(shown, done[0].scenario.cell.period * np.arange(len(side)), np.nan),
                    side, color=plots.SETPOINT, linestyle="--", linewidth=1.0,
                )  # fmt: skip
            panel.grid(alpha=0.3)
            panel.set_xlabel("time [s]")
        whole.set_ylabel(label)
        whole.set_title(f"{name} on {axes[int(j)]}, dashed: its bounds", fontsize=10)
        close.set_title(f"around t = {time[k]:.2f} s", fontsize=10)
        close.set_xlim(time[k] - _CLOSE, time[k] + _CLOSE)
        around = max(1, round(_CLOSE / done[most].scenario.cell.period))
        window = slice(max(0, int(k) - around), int(k) + around)
        values = np.concatenate([run[window, j] for run in runs])
        room = 0.1 * float(np.ptp(values)) or 1.0
        close.set_ylim(values.min() - room, values.max() + room)
    if done:
        grid[0, 0].legend(loc="best", fontsize=8, ncols=2)
    figure.savefig(path)


def _values(log: Log, name: BoundName) -> Array:
    index = ["xyz".index(axis) for axis in log.axes]
    values = {"force": log.force, "velocity": log.tool_velocity}[name]
    return values[: log.cycles, index]


def _beyond(values: Array, lower: Array, upper: Array) -> Array:
    """How far values are beyond their bounds, negative inside; a large negative where free."""
    return np.nan_to_num(np.maximum(values - upper, lower - values), neginf=-1e9)
