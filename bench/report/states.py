"""Figures over the time of the runs: in which state each cycle was, as bands."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.report.drawing import Band, Level, Panel, State
from bench.report.payload import Payload
from bench.report.reduce import bucket, together
from bench.report.runs import Run
from bench.report.words import UNITS, figure_of, named, percent
from scenarios.schedule import BoundName

Told = tuple[tuple[Panel, ...], tuple[str, ...]]
"""Panels, and sentences about them."""
_GOOD = {"solved", "solution", "none", "planned", "live"}
_CAUTION = {"clipped", "inaccurate", "iteration_limit", "plan", "analytic", "waiting"}
_SHADES: dict[Level, tuple[str, ...]] = {
    "good": ("calm",),
    "caution": ("watch", "series-4", "series-3"),
    "bad": ("alarm", "ink"),
}
_NAMED = (
    ("status", "solve"),
    ("source", "command from"),
    ("setpoint_source", "setpoint from"),
    ("trip", "protection"),
)
"""Columns of names, and what they are called."""
_ACTIVITY = (
    State(0, "free", "good", "calm"),
    State(1, "at the bound", "caution", "series-4"),
    State(2, "the plan gave way", "caution", "watch"),
    State(3, "passed", "bad", "alarm"),
)
_BOUNDED: dict[BoundName, str] = {
    "force": "force",
    "velocity": "tool_velocity",
    "command": "command",
}
"""Bounds whose quantity is in the log, and its column."""
_NEAR = 0.01
"""Share of a bound's size that counts as being at it."""
_GAVE_WAY = 1e-4
"""Share of a bound's size by which a plan must pass it to have given way."""
_ROUNDING = 1e-6


class Bands:
    """Draws states of runs over time; where pixels stand for many cycles, none is lost."""

    def __init__(self, runs: Sequence[Run], payload: Payload, limit: int) -> None:
        """Prepare.

        Args:
            runs: in the order of the rows.
            payload: takes the columns.
            limit: samples of a column, at most.
        """
        self._runs, self._payload, self._limit = runs, payload, limit
        self._names = [run.name for run in runs]

    def flagged(self, column: str, what: str) -> Told:
        """Return a band of a column of flags that had better not be set."""
        bands, caption = [], []
        for run in self._runs:
            flags = run.values(column)
            if flags is None or not flags.size:
                continue
            states = (State(0, "free", "good", "calm"), State(1, what, "bad", "alarm"))
            bands.append(self._band(run, what, 1 << flags.astype(np.int64), states))
            share = float(flags[: run.counted].mean()) if run.counted else 0.0
            text = f"{what} in {percent(share)} of the cycles."
            caption.append(named(self._names, run.name, text))
        return _panel(bands), tuple(caption)

    def status(self) -> Told:
        """Return bands of how solves ended, of contact, protection and period."""
        panels: list[Panel] = []
        caption: list[str] = []
        for column, label in _NAMED:
            bands = []
            for run in self._runs:
                found = run.codes(column)
                live = run.summary.get("live_setpoint")
                if found is None or not run.cycles or (column == "setpoint_source" and not live):
                    continue
                codes, names = found
                counts = np.bincount(codes, minlength=len(names)).tolist()
                bands.append(self._band(run, label, 1 << codes, _states(names)))
                told = ", ".join(
                    f"{name.replace('_', ' ')} {n:,}"
                    for name, n in zip(names, counts, strict=True)
                    if n
                )
                caption.append(named(self._names, run.name, f"{label}: {told}."))
            panels += _panel(bands)
        for label, pick, states in _FLAGGED:
            bands = []
            for run in self._runs:
                flags = pick(run)
                if flags is None or not flags.size:
                    continue
                bands.append(self._band(run, label, 1 << flags.astype(np.int64), states))
                text = f"{label}: {states[1].name} in {percent(float(flags.mean()))} of the cycles."
                caption.append(named(self._names, run.name, text))
            panels += _panel(bands)
        return tuple(panels), tuple(caption)

    def activity(self) -> Told:
        """Return bands of what each bound did."""
        panels: list[Panel] = []
        caption: list[str] = []
        columns = dict.fromkeys(name for run in self._runs for name in run.log.column_names)
        for name in (c.removeprefix("slack_") for c in columns if c.startswith("slack_")):
            bands = []
            for run in self._runs:
                found = activity(run, name)
                if found is None:
                    continue
                mask, worst = found
                at, gave, passed = (float((mask >> bit & 1).mean()) for bit in (1, 2, 3))
                label = name.replace("_", " ")
                bands.append(self._band(run, label, mask, _ACTIVITY))
                text = f"{label}: the plan gave way in {percent(gave)} of the cycles"
                if gave:
                    text += f", by {figure_of(worst)} {UNITS.get(name, '')} at most".rstrip()
                if name in _BOUNDED:
                    text += f"; really within 1 % of the bound in {percent(at)}"
                    text += f", beyond it in {percent(passed)}"
                caption.append(named(self._names, run.name, f"{text}."))
            panels += _panel(bands)
        return tuple(panels), tuple(caption)

    def _band(self, run: Run, label: str, mask: NDArray[Any], states: Sequence[State]) -> Band:
        width = bucket(run.cycles, self._limit)
        step = run.period if width == 1 else run.period * width / 2
        column = self._payload.add(together(mask.astype(np.uint16), width))
        occurring = int(np.bitwise_or.reduce(mask.astype(np.int64)))
        present = tuple(state for state in states if occurring >> state.bit & 1)
        called = label if len(self._runs) == 1 else f"{label}, {run.name}"
        return Band(called, column, run.start, step, present)


def activity(run: Run, name: str) -> tuple[NDArray[np.int64], float] | None:
    """Return which states of a bound held in each cycle, as bits, and the plan's worst violation.

    Bit 0: free, none of the others; 1: the quantity is near its bound; 2: the plan gave way; 3: the
    quantity is beyond it. None where the log has no such bound.
    """
    slack = run.values(f"slack_{name}")
    if slack is None or not slack.size:
        return None
    near = np.zeros(slack.size, dtype=bool)
    passed = np.zeros(slack.size, dtype=bool)
    size = np.zeros(slack.size)
    for bound, column in _BOUNDED.items():
        for axis in run.axes if bound == name else ():
            pair, values = run.bounds(bound, axis), run.values(f"{column}_{axis}")
            if pair is None or values is None:
                continue
            for side, beyond in ((pair[0], pair[0] - values), (pair[1], values - pair[1])):
                finite = np.isfinite(side)
                here = np.where(finite, np.abs(side), 0.0)
                size = np.maximum(size, here)
                near |= finite & (beyond >= -_NEAR * here)
                passed |= finite & (beyond > _ROUNDING * here + 1e-9)
    passed[run.counted :] = False
    gave = slack > np.maximum(_GAVE_WAY * size, 1e-9)
    mask = near * 2 + gave * 4 + passed * 8
    return np.where(mask == 0, 1, mask).astype(np.int64), float(slack.max())


def _touching(run: Run) -> NDArray[np.float64] | None:
    return run.values("touching")


def _late(run: Run) -> NDArray[np.float64] | None:
    times = run.values("cycle_time")
    return None if times is None else (times > run.period).astype(np.float64)


_FLAGGED: tuple[
    tuple[str, Callable[[Run], NDArray[np.float64] | None], tuple[State, State]], ...
] = (
    (
        "contact",
        _touching,
        (State(0, "not touching", "caution", "watch"), State(1, "touching", "good", "calm")),
    ),
    (
        "period",
        _late,
        (State(0, "kept", "good", "calm"), State(1, "period passed", "bad", "alarm")),
    ),
)
"""Flags: what they are called, where they come from, and the states without and with."""


def _states(names: Sequence[str]) -> list[State]:
    """Give names their level, and a colour of their own within it."""
    used: dict[Level, int] = {"good": 0, "caution": 0, "bad": 0}
    states = []
    for bit, name in enumerate(names):
        level: Level = "good" if name in _GOOD else "caution" if name in _CAUTION else "bad"
        shade = _SHADES[level][used[level] % len(_SHADES[level])]
        used[level] += 1
        states.append(State(bit, name.replace("_", " "), level, shade))
    return states


def _panel(bands: Sequence[Band]) -> tuple[Panel, ...]:
    if not bands:
        return ()
    return (Panel("", bands=tuple(bands), height=26 * len(bands)),)
