"""Figures over the time of the runs: what moves, as lines."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from bench.report.drawing import Figure, Line, Panel, Scale, Style, series
from bench.report.payload import Payload
from bench.report.reduce import bucket, extremes
from bench.report.runs import Run
from bench.report.states import Bands
from bench.report.words import figure_of, named, newton, plural
from scenarios.schedule import BoundName

Array = NDArray[np.float64]
Pick = Callable[[Run], Array | None]
TIME = Scale("time [s]", unit="s")
_LIMIT, _FEWEST, _IN_ALL = 32_000, 8_000, 96_000
"""Samples of a column: at most, at least where there are many runs, and of all runs together."""
_BOUND = Style("bound", "longdash", 1.4)
_SHORTEST = 1e-2
"""What is drawn for a stage that took no time, as a logarithmic scale has no place for it [us]."""


class Timeline:
    """Draws columns of runs over time, reduced where they are longer than a page can hold."""

    def __init__(self, runs: Sequence[Run], payload: Payload) -> None:
        self._runs = runs
        self._names = [run.name for run in runs]
        self._payload = payload
        self._limit = min(_LIMIT, max(_FEWEST, _IN_ALL // max(len(runs), 1)))
        self._bands = Bands(runs, payload, self._limit)
        self._axes = [axis for axis in "xyz" if any(axis in run.axes for run in runs)]

    @property
    def widths(self) -> dict[str, int]:
        """Cycles that share two samples, of the runs that are reduced."""
        found = {run.name: bucket(run.cycles, self._limit) for run in self._runs}
        return {name: width for name, width in found.items() if width > 1}

    def figures(self) -> list[Figure]:
        """Return every figure that the logs have columns for."""
        bands = self._bands
        made = (
            self._force(),
            self._error(),
            self._command(),
            self._velocity(),
            self._torque(),
            Figure("activity", "Constraints", *bands.activity(), TIME, time=True),
            Figure("status", "Solver and cell", *bands.status(), TIME, time=True),
            self._cycle_time(),
        )
        return [figure for figure in made if figure.panels]

    # ---- lines

    def _line(self, run: Run, values: Array, name: str, style: Style, *, wave: bool = True) -> Line:
        width = bucket(run.cycles, self._limit)
        step = run.period if width == 1 else run.period * width / 2
        column = self._payload.add(extremes(values, width))
        return Line(name, column, style, start=run.start, step=step, wave=wave)

    def _common(self, pick: Pick, label: str, style: Style, *, wave: bool = True) -> Iterable[Line]:
        """One line a run; the same curve is drawn once, under a name without the run's."""
        found = [(run, pick(run)) for run in self._runs]
        lines = [
            self._line(run, values, f"{label}, {run.name}", style, wave=wave)
            for run, values in found
            if values is not None and np.isfinite(values).any()
        ]
        distinct = {(line.y, line.start, line.step): line for line in lines}
        if len(distinct) == 1:
            yield replace(lines[0], name=label)
        else:
            yield from distinct.values()

    def _own(self, pick: Pick, label: str) -> Iterable[Line]:
        """One line a run in the run's style."""
        for i, run in enumerate(self._runs):
            values = pick(run)
            if values is not None and values.size:
                name = label if len(self._runs) == 1 else run.name
                yield self._line(run, values, name, series(i))

    def _bounds(self, name: BoundName, axis: str) -> Iterable[Line]:
        for side in (0, 1):
            yield from self._common(_bound(name, axis, side), "bound", _BOUND, wave=False)

    # ---- figures

    def _force(self) -> Figure:
        panels, caption = [], []
        for axis in self._axes:
            lines = (
                *self._common(_held(axis), "held still", Style("held", width=0.9)),
                *self._bounds("force", axis),
                *self._own(_column(f"force_{axis}"), "controlled"),
                *self._common(
                    _column(f"setpoint_{axis}"), "setpoint", Style("ink", "dash", 1.1), wave=False
                ),
            )
            panels.append(Panel(f"{axis}: contact force [N]", lines, height=170, unit="N"))
        for run in self._runs:
            for axis in run.axes:
                held, force = run.held(axis), run.values(f"force_{axis}")
                if force is None or not run.counted:
                    continue
                now = force[: run.counted]
                text = f"{newton(now.min())} to {newton(now.max())} N"
                if held is not None:
                    text += f", held still {newton(held.min())} to {newton(held.max())} N"
                caption.append(named(self._names, run.name, f"{axis}: {text}."))
        return Figure("force", "Contact force", _some(panels), tuple(caption), TIME, time=True)

    def _error(self) -> Figure:
        panels, caption = [], []
        for axis in self._axes:
            lines = tuple(self._own(_error(axis), "controlled"))
            panels.append(Panel(f"{axis}: force error [N]", lines, height=130, unit="N"))
        for run in self._runs:
            for axis in run.axes:
                error = run.error(axis)
                if error is None or not error.size:
                    continue
                worst = int(np.abs(error).argmax())
                text = (
                    f"{axis}: RMS {newton(np.sqrt(np.mean(error**2)))} N, largest "
                    f"{newton(abs(error[worst]))} N at {run.start + worst * run.period:.3f} s."
                )
                caption.append(named(self._names, run.name, text))
        title = "Force error: force minus setpoint"
        return Figure("error", title, _some(panels), tuple(caption), TIME, time=True)

    def _command(self) -> Figure:
        panels = []
        for axis in self._axes:
            lines = (
                *self._bounds("command", axis),
                *self._own(_column(f"command_{axis}"), "command"),
            )
            panels.append(Panel(f"{axis}: command [m/s²]", lines, height=110, unit="m/s²"))
        bands, caption = self._bands.flagged("command_saturated", "command on its bound")
        return Figure("command", "Command", (*_some(panels), *bands), caption, TIME, time=True)

    def _velocity(self) -> Figure:
        panels, caption = [], []
        for axis in self._axes:
            lines = (
                *self._bounds("velocity", axis),
                *self._own(_column(f"tool_velocity_{axis}"), "velocity"),
            )
            panels.append(Panel(f"{axis}: tool velocity [m/s]", lines, height=110, unit="m/s"))
        for run in self._runs:
            peaks = [
                f"{axis} {figure_of(np.abs(speed[: run.counted]).max())}"
                for axis in run.axes
                if (speed := run.values(f"tool_velocity_{axis}")) is not None and run.counted
            ]
            if peaks:
                text = f"largest speed {', '.join(peaks)} m/s."
                caption.append(named(self._names, run.name, text))
        title = "Velocity of the tool"
        return Figure("velocity", title, _some(panels), tuple(caption), TIME, time=True)

    def _torque(self) -> Figure:
        names = {name for run in self._runs for name in run.log.column_names}
        joints = sorted(
            int(name.removeprefix("torque_"))
            for name in names
            if name.startswith("torque_") and name.removeprefix("torque_").isdecimal()
        )
        panels = [
            Panel(
                f"joint {joint}: torque [N m]",
                tuple(self._own(_column(f"torque_{joint}"), "torque")),
                height=80,
                unit="N m",
            )
            for joint in joints
        ]
        bands, caption = self._bands.flagged("torque_saturated", "torque cut at its limit")
        title = "Torque of the tool's joints"
        return Figure("torque", title, (*_some(panels), *bands), caption, TIME, time=True)

    def _cycle_time(self) -> Figure:
        limit = 1e6 * min((run.period for run in self._runs), default=1e-3)
        panels = [
            Panel(
                f"{what} [µs]",
                tuple(self._own(_micro(column), what)),
                height=120,
                log=True,
                limit=limit,
                unit="µs",
            )
            for column, what in (("cycle_time", "control cycle"), ("solve_time", "solve"))
        ]
        caption = []
        for run in self._runs:
            times = run.values("cycle_time")
            if times is None or not times.size:
                continue
            worst, beyond = int(times.argmax()), int((times > run.period).sum())
            text = (
                f"slowest cycle {1e6 * times[worst]:.0f} µs at "
                f"{run.start + worst * run.period:.3f} s; {plural(beyond, 'cycle')} beyond the "
                f"period of {1e6 * run.period:,.0f} µs."
            )
            caption.append(named(self._names, run.name, text))
        title = "Time of each cycle"
        return Figure("cycle-time", title, _some(panels), tuple(caption), TIME, time=True)


# ---- what a line is drawn of


def _column(name: str) -> Pick:
    return lambda run: run.values(name)


def _held(axis: str) -> Pick:
    return lambda run: run.held(axis)


def _error(axis: str) -> Pick:
    return lambda run: run.error(axis)


def _bound(name: BoundName, axis: str, side: int) -> Pick:
    def pick(run: Run) -> Array | None:
        pair = run.bounds(name, axis)
        return None if pair is None else pair[side]

    return pick


def _micro(name: str) -> Pick:
    def pick(run: Run) -> Array | None:
        seconds = run.values(name)
        return None if seconds is None else np.maximum(1e6 * seconds, _SHORTEST)

    return pick


def _some(panels: Iterable[Panel]) -> tuple[Panel, ...]:
    """Leave out panels without a line."""
    return tuple(panel for panel in panels if panel.lines)
