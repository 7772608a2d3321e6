"""The measurement: every backend through the same cycles, passes interleaved, hot and paced."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.latency.judge import Standard, Verdict, judge
from bench.latency.lanes import CompiledCall, Interpreted, Lane, Times, drive
from bench.latency.result import LeftOut, Mode, Percentiles, Row, Way
from bench.latency.result import Stream as StreamFacts
from bench.latency.statistics import percentiles, representative
from bench.realtime import Clock, Pacer
from bench.stream import Replay, Stream
from qpmpc.backends import backend_class
from qpmpc.controller import Compiled
from qpmpc.errors import QpmpcError
from scenarios.experiment import Report
from scenarios.loop import Stop, quiet_memory

YARDSTICK = "analytic"
"""The closed form: measured in every run, as the others are told in multiples of it."""
_WARM_UP = {"hot": 200, "paced": 50}
"""Cycles before each pass that are not counted: memory, caches and branch predictors settle."""
_PROBE = 20
"""Cycles that tell what a backend costs, before it is decided how many it gets."""
_FEWEST = 20
"""Instances that a backend gets however slow it is."""


@dataclass(frozen=True)
class Settings:
    """What is asked of a measurement."""

    backends: Sequence[str]
    """Names; `YARDSTICK` is added where it is missing."""
    paths: Sequence[Way]
    passes: int
    paced: bool
    paced_instances: int
    """Instances of each paced pass, at most."""
    budget: float
    """Time for the hot passes of one backend [s]; slower ones get fewer instances."""


@dataclass(eq=False)
class Entry:
    """A lane and what was found about it."""

    lane: Lane
    verdicts: dict[Mode, Verdict] = field(default_factory=dict)
    windows: dict[Mode, tuple[int, int]] = field(default_factory=dict)
    cuts: dict[Mode, str | None] = field(default_factory=dict)
    times: dict[Mode, Times] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Group:
    """What was found at one horizon on one set of axes."""

    rows: list[Row]
    left_out: list[LeftOut]
    facts: StreamFacts
    times: dict[tuple[str, Way, Mode], Times]


class _Told:
    """Tells how far a group is."""

    def __init__(self, report: Report, stage: str, total: int) -> None:
        self._report, self._stage, self._total, self._done = report, stage, total, 0
        report(stage, 0, total)

    def __call__(self, more: int = 1) -> None:
        self._done += more
        self._report(self._stage, self._done, self._total)


def measure(
    stream: Stream,
    horizon: int,
    settings: Settings,
    *,
    clock: Clock,
    report: Report,
    stop: Stop,
) -> Group | None:
    """Measure every backend on a stream at one horizon; None where it was stopped.

    Raises:
        QpmpcError: the closed form cannot be had either: the problem itself is wrong.
    """
    standard = Standard(stream, horizon)
    if not standard.certify(stop):
        return None
    entries, left_out = _line_up(stream, horizon, settings)
    modes: tuple[Mode, ...] = ("hot", "paced") if settings.paced else ("hot",)
    told = _Told(
        report,
        f"N={horizon} {stream.axes.replace(',', '')}",
        len(entries) * (1 + settings.passes * len(modes)),
    )
    for entry in entries:
        if not _judge_all(entry, standard, settings, clock, stop):
            return None
        told()
    for mode in modes:
        running = entries
        if mode == "paced":
            running, slow = _keeping_up(entries, stream)
            left_out += slow
            told(settings.passes * (len(entries) - len(running)))
        for entry in running:
            start, end = entry.windows[mode]
            entry.times[mode] = Times(settings.passes, end - start)
        if not _passes(
            running,
            mode,
            passes=settings.passes,
            period=round(1e9 * stream.scenario.cell.period),
            clock=clock,
            told=told,
            stop=stop,
        ):
            return None
    rows = [
        _row(entry, mode, stream, horizon, standard)
        for mode in modes
        for entry in entries
        if mode in entry.times
    ]
    return Group(
        _with_ratios(rows),
        left_out,
        standard.facts(),
        {
            (entry.lane.backend, entry.lane.path, mode): times
            for entry in entries
            for mode, times in entry.times.items()
        },
    )


def _line_up(stream: Stream, horizon: int, settings: Settings) -> tuple[list[Entry], list[LeftOut]]:
    """Set every backend up on every path; what refuses is told with its reason."""
    entries, left_out = [], []
    for backend in dict.fromkeys((YARDSTICK, *settings.backends)):
        for path in settings.paths:
            if path == "compiled" and vars(backend_class(backend)).get("compiled") is None:
                continue
            lane, compiled = _LANES[path]
            try:
                replay = Replay(stream, horizon, backend, compiled=compiled)
                entries.append(Entry(lane(backend, replay)))
            except QpmpcError as error:
                left_out.append(
                    LeftOut(backend, path, horizon, stream.axes, None, str(error).strip())
                )
    return entries, left_out


_LANES: dict[Way, tuple[type[Interpreted], Compiled]] = {
    "interpreted": (Interpreted, "off"),
    "compiled": (CompiledCall, "on"),
}


def _judge_all(
    entry: Entry, standard: Standard, settings: Settings, clock: Clock, stop: Stop
) -> bool:
    """Decide how many instances a lane gets and compare its answers on them."""
    cycles = len(standard.increments)
    probe = min(_PROBE, cycles)
    begin = 0
    for _ in range(2):  # the first time costs more than all that follow
        begin = clock.now()
        if not drive(entry.lane, 0, probe, clock=clock, stop=stop):
            return False
    cost = max(clock.now() - begin, 1) / probe / 1e9
    affordable = max(int(settings.budget / settings.passes / cost), min(_FEWEST, cycles))
    hot, paced = min(cycles, affordable), min(cycles, affordable, settings.paced_instances)
    slow = (
        f"{1e3 * cost:.3g} ms a cycle: {hot} of {cycles} instances fit into the budget of "
        f"{settings.budget:g} s"
    )
    limits: tuple[tuple[Mode, int, str], ...] = (
        ("hot", hot, slow),
        ("paced", paced, slow if paced == affordable else f"{paced} instances are paced"),
    )
    for mode, instances, why in limits:
        start = representative(standard.acting, instances)
        entry.windows[mode] = (start, start + instances)
        entry.cuts[mode] = None if instances == cycles else why
    if entry.windows["hot"] == entry.windows["paced"]:
        found = judge(entry.lane, standard, *entry.windows["hot"], stop)
        if found is not None:
            entry.verdicts = {"hot": found, "paced": found}
        return found is not None
    for mode, window in entry.windows.items():
        found = judge(entry.lane, standard, *window, stop)
        if found is None:
            return False
        entry.verdicts[mode] = found
    return True


def _keeping_up(entries: list[Entry], stream: Stream) -> tuple[list[Entry], list[LeftOut]]:
    """Leave out who needs more than the period as a rule: a backlog is no measurement."""
    period = 1e9 * stream.scenario.cell.period
    running, slow = [], []
    for entry in entries:
        lane, times = entry.lane, entry.times["hot"].of
        usual = float(np.median(times["step"] + times["prepare"]))
        if usual < period:
            running.append(entry)
        else:
            reason = f"takes {usual / 1e6:.3g} ms as a rule: cannot be paced at this period"
            slow.append(
                LeftOut(lane.backend, lane.path, lane.replay.horizon, stream.axes, "paced", reason)
            )
    return running, slow


def _passes(
    entries: list[Entry],
    mode: Mode,
    *,
    passes: int,
    period: int,
    clock: Clock,
    told: _Told,
    stop: Stop,
) -> bool:
    """Run the passes of all lanes, interleaved: what the machine does hits all of them.

    The order is turned by one from pass to pass, so that nobody always comes after the same one.
    """
    with quiet_memory():
        for p in range(passes):
            turn = p % max(len(entries), 1)
            for entry in entries[turn:] + entries[:turn]:
                start, end = entry.windows[mode]
                pacer = Pacer(clock, period, 0) if mode == "paced" else None
                warm = min(end, start + _WARM_UP[mode])
                if not drive(entry.lane, start, warm, clock=clock, pacer=pacer, stop=stop):
                    return False
                into = (entry.times[mode], p)
                if not drive(
                    entry.lane, start, end, clock=clock, pacer=pacer, into=into, stop=stop
                ):
                    return False
                told()
    return True


def _row(entry: Entry, mode: Mode, stream: Stream, horizon: int, standard: Standard) -> Row:
    lane, times, verdict = entry.lane, entry.times[mode].of, entry.verdicts[mode]
    start, end = entry.windows[mode]
    period = round(1e9 * stream.scenario.cell.period)
    over = times["response" if mode == "paced" else "step"] > period
    told = {stage: percentiles(times[stage]) for stage in ("prepare", "step")}
    for stage in ("update", "build", "solve"):
        told[stage] = percentiles(times[stage]) if lane.tells else Percentiles()
    for stage in ("response", "lateness"):
        told[stage] = percentiles(times[stage]) if mode == "paced" else Percentiles()
    return Row(
        backend=lane.backend,
        path=lane.path,
        horizon=horizon,
        axes=stream.axes,
        mode=mode,
        passes=len(times["step"]),
        instances=end - start,
        recorded=stream.cycles,
        cut=entry.cuts[mode],
        **{f"{stage}_us": figures for stage, figures in told.items()},
        pass_p50_us=[float(np.median(one)) / 1e3 for one in times["step"]],
        error=verdict.error,
        without_reference=verdict.without_reference,
        violation=verdict.violation,
        active_share=standard.share(slice(start, end)),
        ratio_to_analytic=None,
        misses=int(over.sum()),
        missed_in_every_pass=int(over.all(axis=0).sum()),
        status=verdict.status,
        source=verdict.source,
    )


def _with_ratios(rows: list[Row]) -> list[Row]:
    """Tell each median in multiples of the closed form's on the same path, in the same mode."""
    yardstick = {(row.path, row.mode): row.step_us.p50 for row in rows if row.backend == YARDSTICK}

    def ratio(row: Row) -> float | None:
        unit = yardstick.get((row.path, row.mode))
        return row.step_us.p50 / unit if unit and row.step_us.p50 is not None else None

    return [replace(row, ratio_to_analytic=ratio(row)) for row in rows]
