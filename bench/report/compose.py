"""From results to the page: which sections there are, and what stands in each."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from bench.report import tables
from bench.report.benches import DeadlineBench, LatencyBench
from bench.report.distributions import error_histogram, error_spectrum
from bench.report.drawing import BOTTOM, GAP, TICKS, TITLE, Figure
from bench.report.folders import Found
from bench.report.markup import Markup, element
from bench.report.page import page, place, section, time_bar
from bench.report.payload import Payload
from bench.report.runs import Run
from bench.report.summary import events, notes, tiles
from bench.report.tails import curves_figure, times_figure
from bench.report.timeline import Timeline
from bench.report.words import cell, plural
from scenarios.metrics import versions


class _Report:
    """Collects sections, figures and notes."""

    def __init__(self) -> None:
        self.payload = Payload()
        self.figures: dict[str, Figure] = {}
        self.sections: list[tuple[str, str, Markup]] = []
        self.notes: list[str] = []

    def draw(self, figure: Figure | None) -> Markup | None:
        """Take a figure in and return its place; None where it has nothing to show."""
        if figure is None or not figure.panels:
            return None
        self.figures[figure.id] = figure
        return place(figure)

    def add(self, id_: str, title: str, *parts: Markup | None) -> None:
        """Add a section; one without content is left out."""
        if any(part for part in parts):
            self.sections.append((id_, title, section(id_, title, *parts)))


def compose(found: Sequence[Found], said: Sequence[str]) -> str:
    """Return the page about results, and ``said``, what reading them had to say."""
    runs = [one for one in found if isinstance(one, Run)]
    report = _Report()
    report.notes += said
    if runs:
        _add_runs(report, runs)
    for i, one in enumerate(found):
        if isinstance(one, LatencyBench):
            _add_latency(report, one, i)
        elif isinstance(one, DeadlineBench):
            _add_deadline(report, one, i)
    told: dict[str, Any] = {one.name: _versions(one) for one in found}
    report.add(
        "configuration",
        "Configuration and versions",
        tables.configuration(runs) if runs else None,
        element(
            "div",
            tables.versions_table({name: v for name, v in told.items() if isinstance(v, dict)}),
            *(
                tables.machine_table(one.name, _machine(one))
                for one in found
                if not isinstance(one, Run)
            ),
            class_="tables",
        ),
    )
    figures = {id_: asdict(figure) for id_, figure in report.figures.items()}
    starts = [run.start for run in runs if run.cycles]
    ends = [run.start + (run.cycles - 1) * run.period for run in runs if run.cycles]
    header = {
        "figures": figures,
        "layout": {"title": TITLE, "gap": GAP, "ticks": TICKS, "bottom": BOTTOM},
        "span": [min(starts), max(*ends, min(starts) + 1e-3)] if starts else [0.0, 1.0],
        "finest": min((run.period for run in runs), default=1e-3),
    }
    return page(
        title=_title(found),
        lead=_lead(found),
        notes=report.notes,
        sections=report.sections,
        payload=report.payload.encode(header),
        footer=f"Made by pulsempc {versions()['pulsempc']}. The file is whole: it loads nothing.",
    )


def _add_runs(report: _Report, runs: Sequence[Run]) -> None:
    for run in runs:
        prefix = "" if len(runs) == 1 else f"{run.name}: "
        report.notes += [prefix + note for note in notes(run)]
    timeline = Timeline(runs, report.payload)
    over_time = [report.draw(figure) for figure in timeline.figures()]
    for name, width in timeline.widths.items():
        report.notes.append(
            f"{name} is long: figures over time show the least and the largest of every {width} "
            "cycles. Tables, spectra and percentiles are of all."
        )
    report.add(
        "summary",
        "At a glance",
        tiles(runs[0]) if len(runs) == 1 else None,
        tables.force_tables(runs) if len(runs) > 1 else tables.axes_table(runs[0]),
    )
    if over_time:
        report.add("time", "Over time", events(runs), time_bar(), *over_time)
    report.add(
        "distribution",
        "Error and spectrum",
        report.draw(error_histogram(runs, report.payload)),
        report.draw(error_spectrum(runs, report.payload)),
    )
    report.add(
        "latency",
        "Latency",
        report.draw(_run_percentiles(runs, report.payload)),
        tables.timing_tables(runs),
    )
    report.add("figures", "Bounds and solver", tables.other_tables(runs))


def _run_percentiles(runs: Sequence[Run], payload: Payload) -> Figure:
    panels = {
        title: {
            run.name: 1e6 * times
            for run in runs
            if (times := run.values(column)) is not None and times.size
        }
        for column, title in (("cycle_time", "control cycle"), ("solve_time", "solve"))
    }
    limit = 1e6 * min(run.period for run in runs)
    return times_figure("percentiles", "Latency over percentiles", panels, payload, limit)


def _add_latency(report: _Report, bench: LatencyBench, number: int) -> None:
    report.notes += [f"{bench.name}: {note}" for note in bench.notes]
    if not bench.result.complete:
        report.notes.append(f"{bench.name}: the measurement was interrupted.")
    parts: list[Markup | None] = []
    for k, stream in enumerate(bench.result.streams):
        key = (stream.axes, stream.horizon)
        panels: dict[str, dict[str, Any]] = {}
        for (backend, path, mode), times in bench.samples.get(key, {}).items():
            what = "step, hot" if mode == "hot" else "response, paced"
            name = backend if path == "interpreted" else f"{backend}, {path}"
            panels.setdefault(what, {})[name] = times
        figure = times_figure(
            f"bench-{number}-{k}",
            f"Axes {stream.axes}, N = {stream.horizon}",
            panels,
            report.payload,
            bench.result.period_us,
        )
        parts += [report.draw(figure), tables.latency_table(bench, *key)]
    left = [
        f"{one.backend}{f', {one.path}' if one.path else ''}: {one.reason}"
        for one in bench.result.left_out
    ]
    if left:
        parts += [
            element("h3", "Left out"), element("ul", *(element("li", text) for text in left))
        ]  # fmt: skip
    report.add(f"bench-latency-{number}", f"Latency of recorded cycles: {bench.name}", *parts)


def _add_deadline(report: _Report, bench: DeadlineBench, number: int) -> None:
    report.notes += [f"{bench.name}: {note}" for note in bench.notes]
    if bench.result.get("complete") is not True:
        report.notes.append(f"{bench.name}: the measurement is not complete.")
    for row in bench.result["rows"]:
        if row.get("error"):
            report.notes.append(f"{bench.name}, {row['name']}: {row['error']}")
    limit, caption = float(bench.result["deadline_us"]), []
    for row in bench.result["rows"]:
        median, rare, slowest = (
            tables.dig(row, "response_us", key) for key in ("p50", "p999", "max")
        )
        if isinstance(median, int | float):
            caption.append(
                f"{row['name']}: median {cell(median)} µs, p99.9 {cell(rare)} µs, "
                f"slowest {cell(slowest)} µs, beyond {limit:g} µs: "
                f"{cell(row.get('misses'))} cycles."
            )
    title = "Response from the intended release"
    figure = curves_figure(
        f"deadline-{number}",
        title,
        {title: bench.curves},
        report.payload,
        limit_us=limit,
        caption=caption,
    )
    report.add(
        f"bench-deadline-{number}",
        f"Cycles against their deadline: {bench.name}",
        report.draw(figure),
        tables.deadline_table(bench),
    )


def _machine(bench: LatencyBench | DeadlineBench) -> dict[str, Any]:
    machine = (
        bench.result.machine if isinstance(bench, LatencyBench) else bench.result.get("machine")
    )
    return machine if isinstance(machine, dict) else {}


def _measured(bench: LatencyBench | DeadlineBench) -> str:
    """Say what was measured."""
    if isinstance(bench, LatencyBench):
        cycles = ", ".join(f"{stream.cycles:,}" for stream in bench.result.streams)
        return (
            f"{bench.name}: {cycles} recorded cycles of the scenario {bench.result.scenario}, seed "
            f"{bench.result.seed}, solved by each backend."
        )
    told = bench.result
    how = "paced by the clock" if told.get("mode") == "paced" else "as fast as it goes"
    return (
        f"{bench.name}: {cell(told.get('cycles'))} cycles of the scenario {told.get('scenario')}, "
        f"seed {told.get('seed')}, in closed loop with the cell, {how}."
    )


def _versions(one: Found) -> Any:
    return one.summary.get("versions") if isinstance(one, Run) else _machine(one).get("versions")


def _title(found: Sequence[Found]) -> str:
    names = list(
        dict.fromkeys(
            str(one.summary["scenario"]) if isinstance(one, Run) else one.name for one in found
        )
    )
    if len(found) == 1:
        return names[0]
    shown = ", ".join(names[:3]) + (", …" if len(names) > 3 else "")
    runs = sum(isinstance(one, Run) for one in found)
    return f"{shown}: {plural(runs, 'run')}" if runs == len(found) else shown


def _lead(found: Sequence[Found]) -> list[str]:
    lead = []
    runs = [one for one in found if isinstance(one, Run)]
    described = list(
        dict.fromkeys(run.scenario.description for run in runs if run.scenario is not None)
    )
    lead += [text for text in described[:3] if text]
    for run in runs[:1] if len(runs) == 1 else ():
        seconds = run.cycles * run.period
        backend = run.summary.get("backend")
        parts = [
            f"Folder {run.name}", f"{seconds:g} s in {plural(run.cycles, 'cycle')}",
            f"axes {', '.join(run.axes)}", f"seed {run.summary.get('seed')}",
        ]  # fmt: skip
        if isinstance(backend, str):
            parts.append(f"backend {backend}")
        lead.append("; ".join(parts) + ".")
    lead += [_measured(one) for one in found if not isinstance(one, Run)]
    if len(runs) > 1:
        spans = sorted({round(run.cycles * run.period, 6) for run in runs})
        lead.append(
            f"{', '.join(run.name for run in runs)}, side by side; "
            f"{' and '.join(f'{span:g}' for span in spans)} s each."
        )
    return lead
