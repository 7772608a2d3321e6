"""Pictures of a run."""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from scenarios.log import Array, Log

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
        for panel, force, colour, what in (
            (upper, held, _HELD, "held still"),
            (middle, controlled, _CONTROLLED, "controlled"),
        ):
            panel.plot(time, force, color=colour, linewidth=0.8, label=what)
            panel.plot(
                time, setpoint, color=_SETPOINT, linewidth=0.8, linestyle="--", label="setpoint"
            )
            reference = setpoint if panel is middle else log.setpoint[0, j]
            panel.set_title(f"{axis}, {what}: error {_figures(force - reference)}", fontsize=9)
        lower.plot(time, controlled - setpoint, color=_CONTROLLED, linewidth=0.6)
        lower.set_title(f"{axis}, error of the controlled force, enlarged", fontsize=9)
        lower.set_xlabel("time [s]")
        for panel in (upper, middle, lower):
            panel.grid(alpha=0.3)
    for row, what in enumerate(("contact force [N]", "contact force [N]", "force error [N]")):
        grid[row, 0].set_ylabel(what)
    grid[0, 0].legend(loc="lower right", fontsize=8)
    figure.savefig(path)


def _figures(error: Array) -> str:
    if not error.size or np.isnan(error).any():
        return "not known, the run was interrupted"
    return f"RMS {np.sqrt(np.mean(error**2)):.3f} N, max {np.abs(error).max():.2f} N"
