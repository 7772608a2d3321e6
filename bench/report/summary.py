"""What is told first: tiles with the figures that matter most, and instants to look at."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.report.markup import Markup, element
from bench.report.runs import Run
from bench.report.tables import dig
from bench.report.words import NOTHING, UNITS, newton, percent, plural
from scenarios.schedule import BoundName

_AROUND = 0.25
"""Time shown to either side of an instant [s]."""
_SHOWN = 8
"""Instants that are shown at once."""
_WATCHED: tuple[tuple[BoundName, str], ...] = (("force", "force"), ("velocity", "tool_velocity"))
"""Bounds whose worst violation is an instant to look at, and the columns that they bound."""


@dataclass(frozen=True)
class Tile:
    """A figure of a run, for each axis or the like."""

    title: str
    values: tuple[tuple[str, str], ...]
    """What each is of, and the number."""
    below: str
    """What it is to be compared with."""


@dataclass(frozen=True)
class Event:
    """An instant to look at, and the figure that shows it."""

    label: str
    time: float
    figure: str


def tiles(run: Run) -> Markup:
    """Return the figures of one run that matter most."""
    made = (*_force_tiles(run), _solves(run), _cycles(run), _bounds(run))
    return element(
        "dl",
        *(
            element(
                "div",
                element("dt", tile.title),
                element("dd", *(_value(*value) for value in tile.values), class_="value"),
                element("dd", tile.below),
            )
            for tile in made
        ),
        class_="tiles",
    )


def events(runs: Sequence[Run]) -> Markup | None:
    """Return buttons that show the instants worth a look; None where there is none."""
    items = []
    for run in runs:
        for event in _events(run):
            label = event.label if len(runs) == 1 else f"{run.name}: {event.label}"
            button = element(
                "button",
                f"{label}, {event.time:.3f} s",
                type="button",
                hidden=True,
                data_from=f"{event.time - _AROUND:.4f}",
                data_to=f"{event.time + _AROUND:.4f}",
                data_at=event.figure,
            )
            items.append(element("li", button))
    if not items:
        return None
    title = "Instants worth a look"
    found = element("ul", *items, class_="events", aria_label=title)
    if len(items) <= _SHOWN:
        return found
    return element("details", element("summary", f"{title}: {len(items)}"), found)


def notes(run: Run) -> list[str]:
    """Return what has to be known about a run before its figures are read."""
    said = list(run.notes)
    summary, trip = run.summary, run.summary.get("trip")
    if summary.get("complete") is not True:
        reason = summary.get("stopped") or "not said why"
        cycles = plural(run.cycles, "cycle")
        said.append(f"The run did not reach its end: {reason}, after {cycles}.")
    if isinstance(trip, dict):
        said.append(
            f"The protection tripped at {trip.get('time')} s: {trip.get('cause')}. From then on no "
            "cycle counts in errors, saturation and violations."
        )
    if not run.cycles:
        said.append("No cycle was run: there is nothing to draw.")
    return said


# ---- instants


def _events(run: Run) -> Iterator[Event]:
    errors = {axis: error for axis in run.axes if (error := run.error(axis)) is not None}
    largest = {axis: np.abs(error) for axis, error in errors.items() if error.size}
    if largest:
        axis = max(largest, key=lambda axis: float(largest[axis].max()))
        cycle = int(largest[axis].argmax())
        yield Event(f"largest force error, {axis}", _instant(run, cycle), "error")
    for name, column in _WATCHED:
        worst = _worst(run, name, column)
        if worst is not None:
            axis, cycle, beyond = worst
            text = f"{name} on {axis} beyond its bound by {beyond:.3g} {UNITS[name]}"
            yield Event(text, _instant(run, cycle), name)
    times = run.values("cycle_time")
    if times is not None and times.size:
        cycle = int(times.argmax())
        text = f"slowest cycle, {1e6 * times[cycle]:.0f} µs"
        yield Event(text, _instant(run, cycle), "cycle-time")
    for column, usual, what in (
        ("status", "solved", "solve"),
        ("source", "solution", "command from"),
    ):
        found = run.codes(column)
        if found is None or usual not in found[1]:
            continue
        codes, names = found
        other = np.flatnonzero(codes != names.index(usual))
        if other.size:
            state = names[int(codes[other[0]])].replace("_", " ")
            yield Event(f"first {what} {state}", _instant(run, int(other[0])), "status")
    trip = run.summary.get("trip")
    if isinstance(trip, dict) and isinstance(trip.get("time"), int | float):
        yield Event(f"protection tripped: {trip.get('cause')}", float(trip["time"]), "force")


def _worst(run: Run, name: BoundName, column: str) -> tuple[str, int, float] | None:
    """Axis, cycle and size of the worst violation of a bound; None where there is none."""
    found: tuple[str, int, float] | None = None
    for axis in run.axes:
        pair, values = run.bounds(name, axis), run.values(f"{column}_{axis}")
        if pair is None or values is None or not run.counted:
            continue
        beyond = np.maximum(pair[0] - values, values - pair[1])[: run.counted]
        cycle = int(beyond.argmax())
        if beyond[cycle] > (1e-6 if found is None else found[2]):
            found = axis, cycle, float(beyond[cycle])
    return found


def _instant(run: Run, cycle: int) -> float:
    return run.start + cycle * run.period


# ---- tiles


def _force_tiles(run: Run) -> Iterator[Tile]:
    axes = [axis for axis in "xyz" if axis in run.summary["axes"]]

    def each(form: Callable[[float], str], *path: str) -> tuple[tuple[str, str], ...]:
        return tuple((a, _number(dig(run.summary, "axes", a, *path), form)) for a in axes)

    def beside(*path: str) -> str:
        return " / ".join(number for _, number in each(newton, "uncompensated", *path))

    yield Tile(
        "Force error, RMS [N]", each(newton, "compensated", "rms"), f"held still {beside('rms')}"
    )
    yield Tile(
        "Largest force error [N]", each(newton, "compensated", "max"), f"held still {beside('max')}"
    )
    paper = (dig(run.summary, "paper", "reduction", axis, "rms") for axis in axes)
    printed = " / ".join(_number(number, "{:.0f}".format) for number in paper)
    yield Tile(
        "Reduction of the RMS", each("{:.1f} %".format, "reduction", "rms"),
        f"in the paper {printed} %",
    )  # fmt: skip


def _solves(run: Run) -> Tile:
    counts, sources = (_counts(run.summary.get(key)) for key in ("status", "source"))
    below = ", ".join(
        f"{name} {count:,}" for name, count in sources.items() if count and name != "solution"
    )
    values = tuple((name.replace("_", " "), f"{count:,}") for name, count in counts.items())
    told = f"command from {below}" if below else "every command from a solve"
    return Tile("Solves", values or (("", NOTHING),), told)


def _cycles(run: Run) -> Tile:
    timing = run.summary.get("timing")
    values = tuple(
        (label, _number(dig(timing, "cycle_us", key), _micro))
        for key, label in (("p50", "median"), ("p999", "p99.9"), ("max", "max"))
    )
    misses = dig(timing, "misses")
    told = plural(misses, "cycle") if isinstance(misses, int) else NOTHING
    return Tile("Control cycle [µs]", values, f"{told} beyond {1e6 * run.period:,.0f} µs")


def _bounds(run: Run) -> Tile:
    found, shares = (run.summary.get(key) for key in ("violations", "saturation"))
    counts = {
        name: count
        for name, told in (found.items() if isinstance(found, dict) else ())
        if isinstance(count := dig(told, "count"), int)
    }
    below = ", ".join(
        f"{name} {percent(share)}"
        for name, share in (shares.items() if isinstance(shares, dict) else ())
        if isinstance(share, int | float)
    )
    values = tuple((name.replace("_", " "), f"{count:,}") for name, count in counts.items())
    told = f"saturated: {below}" if below else ""
    return Tile("Cycles beyond a bound", values or (("", NOTHING),), told)


def _counts(found: Any) -> dict[str, int]:
    told = found if isinstance(found, dict) else {}
    return {str(name): count for name, count in told.items() if isinstance(count, int)}


def _value(label: str, number: str) -> Markup:
    return element("span", element("i", label, " ") if label else None, number)


def _micro(value: float) -> str:
    return f"{value:.3g}" if value < 100 else f"{value:.0f}"


def _number(value: Any, form: Callable[[float], str]) -> str:
    return form(value) if isinstance(value, int | float) else NOTHING
