"""What a deadline run comes to: rows with stable keys, a table, histograms and the picture."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from bench.cycles import NONE, SOURCES, STATUSES, Codes, Cycles, longest_run
from bench.deadline import BLOCK, LEAD_IN, PAUSE, WARM_UP, Entry, Race
from bench.hdr import Histogram, histogram_log
from bench.machine import Facts
from bench.percentiles import Curve, draw_percentiles, tail
from qpmpc import Source, Status
from scenarios.metrics import statistics

Row = dict[str, Any]
FORMAT = "pulsempc.deadline/1"
_STAND_INS = (Source.PLAN, Source.ANALYTIC, Source.HOLD)
_MEASURE = {
    "affinity": "one core",
    "scheduler": "real-time scheduler",
    "memory_locked": "memory locked",
    "garbage_collection": "no garbage collection",
    "timer_slack": "timers without slack",
    "idle_latency": "processor kept awake",
}


def summary(race: Race, *, paced: bool, spin: float, sleeps_by: str, machine: Facts) -> Row:
    """Return everything that goes into ``deadline.json``; `deadline.schema.json` is its schema.

    Args:
        race: run, or interrupted.
        paced: whether by the wall clock.
        spin: how long before a release sleeps ended [s].
        sleeps_by: what the clock waited with.
        machine: of `bench.machine.machine`, while it ran.
    """
    scenario = race.scenario
    return {
        "format": FORMAT,
        "scenario": scenario.name,
        "seed": scenario.seed,
        "axes": list(scenario.axes),
        "horizon": scenario.controller.horizon,
        "mode": "paced" if paced else "hot",
        "period_us": scenario.cell.period * 1e6,
        "deadline_us": race.deadline * 1e6,
        "cycles": race.cycles,
        "complete": race.complete,
        "pacing": {
            "sleeps_by": sleeps_by,
            "spin_us": spin * 1e6,
            "block": BLOCK,
            "warm_up": WARM_UP,
            "lead_in": LEAD_IN,
            "pause_us": PAUSE * 1e-3,
        },
        "rows": [_row(entry, scenario.axes) for entry in race.entries]
        + [_refused(refusal.name, refusal.reason) for refusal in race.refused],
        "machine": machine,
    }


def _row(entry: Entry, axes: Iterable[str]) -> Row:
    cycles, subject = entry.cycles, entry.subject
    controlled = subject.kind == "backend"
    missed = cycles.missed
    late = cycles.status == STATUSES.index(Status.LATE)
    return {
        "name": subject.name,
        "kind": subject.kind,
        "backend": subject.name if controlled else None,
        "path": subject.path,
        "cycles": cycles.count,
        "error": entry.stopped,
        "wake_us": _tail(cycles.wake),
        "timer_us": _tail(cycles.timer),
        "solve_us": _tail(cycles.solve),
        "compute_us": _tail(cycles.compute),
        "response_us": _tail(cycles.response),
        "plant_us": _tail(cycles.plant),
        "misses": int(missed.sum()),
        "solve_misses": int((cycles.solve > cycles.deadline).sum()),
        "longest_run": longest_run(missed),
        "miss_actions": _count(SOURCES, cycles.source[missed]) if controlled else None,
        "misses_behind_plant": int((missed & cycles.behind).sum()),
        "plant_overruns": int(cycles.overran.sum()),
        "put_off_us": float(cycles.put_off.sum()) * 1e-3,
        "late": _late(cycles, late) if controlled else None,
        "status": _count(STATUSES, cycles.status, absent=False) if controlled else None,
        "source": _count(SOURCES, cycles.source) if controlled else None,
        "force_error": _force_error(entry, axes) if controlled else None,
        "usage": entry.usage or None,
    }


def _refused(name: str, reason: str) -> Row:
    return {"name": name, "kind": "backend", "backend": name, "cycles": 0, "error": reason}


def _tail(times: NDArray[np.int64]) -> dict[str, float | None]:
    return tail(_in_us(times))


def _in_us(times: NDArray[np.int64]) -> NDArray[np.float64]:
    return times.astype(np.float64) * 1e-3


def _count(
    names: tuple[Status, ...] | tuple[Source, ...], codes: Codes, *, absent: bool = True
) -> dict[str, int]:
    counts = np.bincount(codes[codes != NONE], minlength=len(names)).tolist()
    return {str(name): n for name, n in zip(names, counts, strict=True) if n or absent}


def _late(cycles: Cycles, late: NDArray[np.bool_]) -> Row:
    actions = _count(SOURCES, cycles.source[late])
    return {
        "count": int(late.sum()),
        "longest_run": longest_run(late),
        "actions": {str(source): actions[source] for source in _STAND_INS},
    }


def _force_error(entry: Entry, axes: Iterable[str]) -> Row:
    """Return RMS and largest error after the warm-up, of the cycles between blocks too [N]."""
    errors = entry.subject.errors()[WARM_UP:]
    found = {}
    for j, axis in enumerate(axes):
        told = statistics(errors[:, j])
        found[axis] = {"rms": told["rms"], "max": told["max"]}
    return found


# ---- files


def write_histograms(race: Race, folder: Path, *, start: float, seconds: float) -> None:
    """Write the responses as HDR histograms [ns]: one log of all, one percentile table each.

    Args:
        race: entries without a counted cycle are left out.
        folder: where to.
        start: of the run, seconds since the epoch.
        seconds: that it took.
    """
    histograms = {
        entry.subject.name: Histogram.of(entry.cycles.response)
        for entry in race.entries
        if entry.cycles.count
    }
    note = "pulsempc bench deadline: response from the intended release [ns], a tag for each row"
    log = histogram_log(histograms, start=start, seconds=seconds, comments=[note])
    (folder / "response.hlog").write_text(log, encoding="utf-8")
    for name, histogram in histograms.items():
        file = f"response-{name.replace(':', '-').replace(' ', '-')}.hgrm"
        (folder / file).write_text(histogram.percentile_table(), encoding="utf-8")


def draw(race: Race, told: Row, path: Path) -> None:
    """Draw the responses over percentiles, the empty loop beside the backends."""
    curves = [
        Curve(entry.subject.name, _in_us(entry.cycles.response), entry.subject.kind != "backend")
        for entry in race.entries
    ]
    paced = "paced by the wall clock" if told["mode"] == "paced" else "as fast as it goes"
    title = f"{told['scenario']}: {race.entries[0].cycles.count} cycles each, {paced}"
    what = "response from the intended release [µs]"
    draw_percentiles(curves, path, what=what, title=title, limit=told["deadline_us"])


# ---- on the terminal


def deadline_tables(told: Row) -> list[Table]:
    """Return the tables of a run: times, and what became of the cycles."""
    count = max(row["cycles"] for row in told["rows"])
    about = f"{told['scenario']}, {told['mode']}, N = {told['horizon']}, {count} cycles"
    times = Table(title=f"{about}: times [µs]")
    fates = Table(title=f"Against {told['deadline_us']:g} µs from the intended release")
    heads = ("solve\np50", "\np99.9", "compute\np50", "\np99.9")
    tails = ("response\np50", "\np99.9", "\np99.99", "\nmax")
    counts = ("misses", "in a\nrow", "solves\nbeyond")
    stand_ins = ("late:\nplan", "closed\nform", "\nheld")
    others = ("plant\nbeyond", "RMS\n[N]")
    for table, columns in ((times, heads + tails), (fates, counts + stand_ins + others)):
        table.add_column("", overflow="fold")
        for column in columns:
            table.add_column(column, justify="right")
    for row in told["rows"]:
        if "misses" not in row:
            continue
        figures = [row[f"{part}_us"][q] for part in ("solve", "compute") for q in ("p50", "p999")]
        figures += [row["response_us"][q] for q in ("p50", "p999", "p9999", "max")]
        times.add_row(row["name"], *map(_us, figures))
        late, error = row["late"], row["force_error"]
        actions = late["actions"].values() if late else ("", "", "")
        known = [e["rms"] for e in (error or {}).values() if e["rms"] is not None]
        fates.add_row(
            row["name"], str(row["misses"]), str(row["longest_run"]),
            str(row["solve_misses"]) if late else "", *map(str, actions),
            str(row["plant_overruns"]), f"{max(known):.3f}" if known else "",
        )  # fmt: skip
    return [times, fates]


def machine_lines(machine: Mapping[str, Any]) -> list[str]:
    """Return what it ran on, and which measures were in force, in a few lines."""
    lines = [
        f"{machine['cpu']}, {machine['cores']} cores"
        f"{', a virtual machine' if machine['hypervisor'] else ''}; "
        f"{machine['system']} {machine['kernel']} ({machine['preemption']}), "
        f"load {machine['load_average'][0]:g}"
    ]
    held = machine["measures"]
    names = [_MEASURE[name] for name, measure in held.items() if measure["in_force"]]
    lines.append(f"in force: {', '.join(names) or 'nothing'}")
    for name, measure in held.items():
        if not measure["in_force"]:
            lines.append(f"not in force: {_MEASURE[name]}: {measure['reason']}")
    return lines


def _us(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.1f}" if value < 100 else f"{value:.0f}"
