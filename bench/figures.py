"""Pictures of a run."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from scenarios.log import Log

# Okabe and Ito's palette: told apart by everyone.
_HELD, _CONTROLLED, _SETPOINT = "#D55E00", "#0072B2", "#222222"


def draw_forces(log: Log, path: Path) -> None:
    """Redraw the paper's Figs. 6 and 7: each axis held still above, controlled below.

    The two upper rows share their scale; the lowest one enlarges the controlled error.
    """
    end, n = log.cycles, len(log.axes)
    figure = Figure(figsize=(1.5 + 4.2 * n, 7.5), layout="constrained", dpi=110)
    grid = figure.subplots(3, n, sharex=True, squeeze=False)
    time = log.time[:end]
    for j, axis in enumerate(log.axes):
        i = "xyz".index(axis)
        setpoint = log.setpoint[:end, j]
        held, controlled = log.force_uncompensated[:end, i], log.force[:end, i]
        upper, middle, lower = grid[:, j]
        middle.sharey(upper)
        upper.set_title(f"{axis} axis")
        for panel, force, colour, what in (
            (upper, held, _HELD, "held still"),
            (middle, controlled, _CONTROLLED, "controlled"),
        ):
            panel.plot(time, force, color=colour, linewidth=0.8, label=what)
            panel.plot(
                time, setpoint, color=_SETPOINT, linewidth=0.8, linestyle="--", label="setpoint"
            )
            reference = setpoint if panel is middle else log.setpoint[0, j]
            _caption(panel, force - reference)
        lower.plot(time, controlled - setpoint, color=_CONTROLLED, linewidth=0.6)
        lower.set_xlabel("time [s]")
        for panel in (upper, middle, lower):
            panel.grid(alpha=0.3)
    for row, what in enumerate(("held still", "controlled", "error, enlarged")):
        grid[row, 0].set_ylabel(f"contact force [N]\n{what}")
    figure.savefig(path)


def _caption(panel: Axes, error: np.ndarray) -> None:
    if error.size and np.isfinite(error).all():
        text = f"error: RMS {np.sqrt(np.mean(error**2)):.3f} N, max {np.abs(error).max():.2f} N"
    else:
        text = "not run"
    panel.text(
        0.02, 0.97, text, transform=panel.transAxes, va="top", fontsize=9,
        bbox={"facecolor": "white", "alpha": 0.8, "edgecolor": "none"},
    )  # fmt: skip
