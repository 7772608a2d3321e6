"""Tables of a report, made of the keys that summaries have."""

import tomllib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.report.benches import DeadlineBench, LatencyBench
from bench.report.markup import Markup, element, join
from bench.report.runs import Run
from bench.report.words import NOTHING, cell, newton, percent

_STATISTICS = {"rms": "RMS", "max": "largest", "p99": "99 % within", "peak_to_peak": "peak to peak"}
_SETS = {"uncompensated": "held still", "compensated": "controlled"}
_PERCENTILES = {"p50": "median", "p99": "p99", "p999": "p99.9", "p9999": "p99.99", "max": "slowest"}
_TOLD = {"axes", "paper", "timing", "versions", "scenario", "backend_facts"}
"""Keys of a summary that have a table, or a place, of their own."""
_FAMILIES = {
    "": "Run",
    "form": "Form of the problem",
    "trip": "Protection",
    "saturation": "Saturated cycles",
    "increment_rms": "RMS of the command's increment [m/s²]",
    "violations.force": "Force beyond its bound [N]",
    "violations.velocity": "Velocity beyond its bound [m/s]",
    "violations.command": "Command beyond its bound [m/s²]",
    "status": "How solves ended",
    "source": "Where commands came from",
    "compiled": "Compiled step",
    "comparison": "Beside a certified answer",
    "live_setpoint": "Live setpoint",
    "timing": "Cycles",
    "timing.cycle_us": "Control cycle [µs]",
    "timing.solve_us": "Solve [µs]",
    "timing.build_us": "Building of the problem [µs]",
    "timing.plant_us": "Simulated cell [µs]",
    "timing.wall_s": "Time that it took [s]",
    "timing.real_time_factor": "Times real time",
}
"""Titles of the tables of keys that have the same parent; others are titled by its name."""
_CALLED = _PERCENTILES | {
    "count": "cycles",
    "worst": "at worst",
    "integral": "excess summed over time",
    "counted": "cycles that count",
    "complete": "ran to its end",
    "stopped": "ended by",
    "force_peak": "largest force at any physics step [N]",
    "physics": "loop over physics steps",
    "trip": "protection tripped",
    "misses": "beyond their period",
    "used": "used",
    "reason": "why, or why not",
    "command_error": "largest error of the command [m/s²]",
    "command_error_rms": "RMS error of the command [m/s²]",
    "without_reference": "cycles without one",
}
_SHARES = {"saturation"}
_LONG = 24
"""Letters of a cell that may be broken."""


@dataclass(frozen=True)
class Row:
    """A row: its head, and one cell a column."""

    head: str
    cells: tuple[str, ...]


def table(caption: str, columns: Sequence[str], rows: Iterable[Row], *, corner: str = "") -> Markup:
    """Return a table with its caption, heads of columns and rows, in a region that scrolls."""
    head = element(
        "tr",
        element("th", corner, scope="col") if corner else element("td"),
        *(element("th", name, scope="col") for name in columns),
    )
    body = []
    for row in rows:
        cells = (
            element("td", text, class_="long" if len(text) > _LONG else None) for text in row.cells
        )
        body.append(element("tr", element("th", row.head, scope="row"), *cells))
    return element(
        "div",
        element(
            "table",
            element("caption", caption),
            element("thead", head),
            element("tbody", *body),
        ),
        class_="scroll",
        tabindex="0",
        role="region",
        aria_label=caption,
    )


def axes_table(run: Run) -> Markup:
    """Contact force error of a run, one row an axis, and the paper's figures."""
    paper = run.summary.get("paper")
    columns = (
        "held still, RMS [N]", "peak to peak [N]", "controlled, RMS [N]", "largest [N]",
        "peak to peak [N]", "reduction of the RMS", "paper: held still, RMS [N]",
        "peak to peak [N]", "reduction of the RMS",
    )  # fmt: skip
    rows = []
    for axis in [axis for axis in "xyz" if axis in run.summary["axes"]]:
        own, printed = run.summary["axes"][axis], dig(paper, "uncompensated", axis)
        cells = (
            _newton(dig(own, "uncompensated", "rms")),
            _newton(dig(own, "uncompensated", "peak_to_peak")),
            _newton(dig(own, "compensated", "rms")),
            _newton(dig(own, "compensated", "max")),
            _newton(dig(own, "compensated", "peak_to_peak")),
            _percent(dig(own, "reduction", "rms")),
            cell(dig(printed, "rms")),
            cell(dig(printed, "peak_to_peak")),
            _whole(dig(paper, "reduction", axis, "rms")),
        )
        rows.append(Row(axis, cells))
    caption = f"Contact force error. {_source(paper)}"
    return table(caption, columns, rows, corner="axis")


def force_tables(runs: Sequence[Run]) -> Markup:
    """Contact force error in every run and in the paper, one table an axis."""
    paper = next((p for run in runs if isinstance(p := run.summary.get("paper"), dict)), {})
    columns = [*(run.name for run in runs), "paper"]
    made = []
    for axis in [a for a in "xyz" if any(a in run.summary["axes"] for run in runs)]:
        rows = []
        for key, called in _SETS.items():
            for statistic in _present(runs, "axes", axis, key):
                what = _STATISTICS.get(statistic, statistic)
                path = ("axes", axis, key, statistic)
                cells = [_newton(dig(run.summary, *path)) for run in runs]
                cells.append(cell(dig(paper, key, axis, statistic)))
                rows.append(Row(f"{called}, {what} [N]", tuple(cells)))
        for statistic in _present(runs, "axes", axis, "reduction"):
            what = _STATISTICS.get(statistic, statistic)
            path = ("axes", axis, "reduction", statistic)
            cells = [_percent(dig(run.summary, *path)) for run in runs]
            cells.append(_whole(dig(paper, "reduction", axis, statistic)))
            rows.append(Row(f"reduction of the {what}", tuple(cells)))
        made.append(table(f"Contact force error on {axis}", columns, rows, corner="figure"))
    return join(element("p", _source(paper)), element("div", *made, class_="tables"))


def timing_tables(runs: Sequence[Run]) -> Markup:
    """What the stages of a cycle took."""
    return _families(runs, [{"timing": run.summary.get("timing")} for run in runs])


def other_tables(runs: Sequence[Run]) -> Markup:
    """Every figure of the summaries that has no other place."""
    return _families(
        runs,
        [
            {key: value for key, value in run.summary.items() if key not in _TOLD} | run.extra
            for run in runs
        ],
    )


def _families(runs: Sequence[Run], found: Sequence[Mapping[str, Any]]) -> Markup:
    """One table for all keys of the same parent."""
    flat = [_flat(one) for one in found]
    families: dict[str, list[Row]] = {}
    for key in dict.fromkeys(key for one in flat for key in one):
        family, _, name = key.rpartition(".")
        values = [one.get(key) for one in flat]
        shares = family in _SHARES
        cells = (
            percent(value) if shares and isinstance(value, int | float) else cell(value)
            for value in values
        )
        called = _CALLED.get(name, name.replace("_", " "))
        families.setdefault(family, []).append(Row(called, tuple(cells)))
    names = [run.name for run in runs]
    made = (
        table(_FAMILIES.get(family, family.replace("_", " ").replace(".", ": ")), names, rows)
        for family, rows in families.items()
    )
    return element("div", *made, class_="tables")


def configuration(runs: Sequence[Run]) -> Markup:
    """What differs between the runs, and the whole configuration of each."""
    parts: list[Markup] = []
    flat = [_configured(run) for run in runs]
    if len(runs) > 1:
        keys = [
            key
            for key in dict.fromkeys(key for one in flat for key in one)
            if len({repr(found.get(key)) for found in flat}) > 1 and key != "description"
        ]
        rows = [Row(key, tuple(cell(found.get(key)) for found in flat)) for key in keys]
        if rows:
            parts.append(table("Keys that differ", [run.name for run in runs], rows, corner="key"))
        else:
            parts.append(element("p", "All runs have the same configuration."))
    parts += [
        element(
            "details",
            element("summary", f"config.toml of {run.name}"),
            element("pre", element("code", run.config), tabindex="0"),
        )
        for run in runs
    ]
    return join(*parts)


def versions_table(found: Mapping[str, Mapping[str, Any]]) -> Markup:
    """Versions of packages, one column a result."""
    packages = list(dict.fromkeys(key for told in found.values() for key in told))
    rows = [
        Row(package, tuple(cell(told.get(package)) for told in found.values()))
        for package in packages
    ]
    return table("Versions", list(found), rows, corner="package")


def latency_table(bench: LatencyBench, axes: str, horizon: int) -> Markup:
    """Figures of ``bench latency`` on one set of axes at one horizon."""
    columns = (
        "path", "mode", "median [µs]", "p99.9 [µs]", "slowest [µs]", "floor p99.9 [µs]",
        "times the closed form", "beyond the period", "error [m/s²]",
    )  # fmt: skip
    rows = [
        Row(
            row.backend,
            (
                row.path, row.mode,
                *map(cell, (row.step_us.p50, row.step_us.p999, row.step_us.max)),
                cell(row.step_us.floor_p999), cell(row.ratio_to_analytic), cell(row.misses),
                NOTHING if row.error is None else f"{row.error:.0e}",
            ),
        )
        for row in bench.result.rows
        if (row.axes, row.horizon) == (axes, horizon)
    ]  # fmt: skip
    return table(f"Whole step, axes {axes}, N = {horizon}", columns, rows, corner="backend")


def deadline_table(bench: DeadlineBench) -> Markup:
    """Figures of ``bench deadline``."""
    limit = bench.result["deadline_us"]
    columns = (
        "path", "solve p99.9 [µs]", "response, median [µs]", "p99.9 [µs]", "p99.99 [µs]",
        "slowest [µs]", f"beyond {limit:g} µs", "in a row", "late solves",
    )  # fmt: skip
    rows = [
        Row(
            row["name"],
            (
                cell(row.get("path")),
                cell(dig(row, "solve_us", "p999")),
                *(cell(dig(row, "response_us", key)) for key in ("p50", "p999", "p9999", "max")),
                cell(row.get("misses")), cell(row.get("longest_run")),
                cell(dig(row, "late", "count")),
            ),
        )
        for row in bench.result["rows"]
    ]  # fmt: skip
    return table("Whole cycles against the deadline", columns, rows, corner="row")


def machine_table(name: str, machine: Mapping[str, Any]) -> Markup:
    """What the measurement of this name ran on."""
    flat = _flat({key: value for key, value in machine.items() if key != "versions"})
    rows = [Row(key.replace("_", " "), (cell(value),)) for key, value in flat.items()]
    return table(f"Machine, {name}", ["value"], rows, corner="fact")


def dig(found: Any, *path: str) -> Any:
    """Return what is at the end of a path of keys; None where it leads nowhere."""
    for key in path:
        if not isinstance(found, Mapping):
            return None
        found = found.get(key)
    return found


def _present(runs: Sequence[Run], *path: str) -> list[str]:
    """Keys that any summary has at the end of ``path``, in their order."""
    found = (dig(run.summary, *path) for run in runs)
    return list(dict.fromkeys(key for part in found if isinstance(part, Mapping) for key in part))


def _flat(found: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    result: dict[str, Any] = {}
    for key, value in found.items():
        if isinstance(value, Mapping) and value:
            result |= _flat(value, f"{prefix}{key}.")
        elif isinstance(value, list):
            result[prefix + key] = ", ".join(map(str, value)) or None
        else:
            result[prefix + key] = None if value == {} else value
    return result


def _configured(run: Run) -> dict[str, Any]:
    try:
        return _flat(tomllib.loads(run.config))
    except tomllib.TOMLDecodeError:
        return {}


def _newton(value: Any) -> str:
    return newton(value) if isinstance(value, int | float) else NOTHING


def _source(paper: Any) -> str:
    source = dig(paper, "source")
    if not isinstance(source, str):
        return ""
    return f"The paper: {source}, with real robots and another motion."


def _whole(value: Any) -> str:
    return f"{value:.0f} %" if isinstance(value, int | float) else NOTHING


def _percent(value: Any) -> str:
    return f"{value:.2f} %" if isinstance(value, int | float) else NOTHING
