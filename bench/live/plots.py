"""Plots that scroll: the last seconds of force and of the cycle's time."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from viser import uplot

from scenarios.livecell.ring import COLUMNS, Ring
from scenarios.motion.config import AXES

Array = NDArray[np.float64]
_SPAN, _BIN = 4000, 10
"""Cycles that are shown, and that make a point."""
_COLOURS = {"x": "#0072b2", "y": "#e69f00", "z": "#009e73"}
_GREY = "#8a8f98"


class Plots:
    """The plots of the page."""

    def __init__(self, gui: Any, period: float) -> None:
        """Lay them out; ``period`` of control [s]."""
        self._period = period
        nothing = np.array([0.0, 1.0])
        lines = [uplot.Series(label="t [s]")]
        for axis in AXES:
            lines.append(uplot.Series(label=axis, stroke=_COLOURS[axis], width=1.5))
        for axis in AXES:
            lines.append(
                uplot.Series(
                    label=f"{axis} wished", stroke=_COLOURS[axis], width=1.0, dash=(4.0, 3.0)
                )
            )
        self._force = gui.add_uplot(
            (nothing,) * 7, tuple(lines), title="measured force [N]", aspect=1.5,
            scales={"x": uplot.Scale(time=False)},
        )  # fmt: skip
        self._time = gui.add_uplot(
            (nothing,) * 4,
            (
                uplot.Series(label="t [s]"),
                uplot.Series(label="cycle, slowest of ten", stroke=_COLOURS["x"], width=1.5),
                uplot.Series(label="solve, slowest of ten", stroke=_COLOURS["y"], width=1.5),
                uplot.Series(label="period", stroke=_GREY, width=1.0, dash=(4.0, 3.0)),
            ),
            title="time of the controller [ms]",
            aspect=1.9,
            scales={"x": uplot.Scale(time=False)},
        )

    def show(self, ring: Ring) -> None:
        """Bring them up to date."""
        rows = ring.last(_SPAN)
        rows = rows[: len(rows) // _BIN * _BIN]
        if not len(rows):
            return
        bins = rows.reshape(-1, _BIN, rows.shape[1])
        time = bins[:, -1, COLUMNS["time"]].ravel()
        if (np.diff(time) <= 0).any():  # a reset: what was before has no place
            keep = slice(int(np.flatnonzero(np.diff(time) <= 0)[-1]) + 1, None)
            bins, time = bins[keep], time[keep]
        force, wished = bins[:, -1, COLUMNS["measured"]], bins[:, -1, COLUMNS["setpoint"]]
        self._force.data = (time, *force.T.copy(), *wished.T.copy())
        slowest = 1e3 * bins.max(axis=1)
        cycle, solve = (slowest[:, COLUMNS[name]].ravel() for name in ("cycle_time", "solve_time"))
        self._time.data = (time, cycle, solve, np.full_like(time, 1e3 * self._period))
