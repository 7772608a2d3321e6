"""A whole measurement: one recording a set of axes, one group of rows a horizon, all files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.instances import instances
from bench.latency.figure import draw_latency
from bench.latency.measure import Group, Settings, measure
from bench.latency.result import LeftOut, Result, Timer
from bench.latency.statistics import timer_cost
from bench.machine import machine
from bench.realtime import SystemClock
from bench.stream import Stream, record
from scenarios import Scenario
from scenarios.experiment import Report
from scenarios.loop import Stop, quiet_memory
from scenarios.results import write_config


def run_session(
    scenarios: Sequence[Scenario],
    horizons: Sequence[int],
    settings: Settings,
    left_out: Sequence[LeftOut],
    *,
    clock: SystemClock,
    report: Report,
    stop: Stop,
    folder: Path,
) -> Result:
    """Record and measure; write what belongs to each group into ``folder`` as it is through.

    Args:
        scenarios: the same one with each set of axes.
        horizons: N of each group; the recording keeps the scenario's own.
        settings: see there.
        left_out: what is known from the start to have no row.
        clock, report, stop: as elsewhere; after a stop the result holds the groups that are whole.
        folder: gets ``config.toml`` and what it names, ``instances-*.npz``, ``times-*.npz`` and
            ``latency-*.png``.

    Raises:
        ScenarioError, QpmpcError, PlantError: what is asked for cannot be had.
    """
    with quiet_memory():  # as it is in every pass
        facts = machine()
    least, usual = timer_cost(clock.now)
    timer = Timer("monotonic_ns", least, usual, clock.sleeps_by)
    groups: list[Group] = []
    for scenario in scenarios:
        stream = record(scenario, report=report, stop=stop)
        if stream is None:
            break
        if not groups:
            write_config(scenarios[0], folder)
        for horizon in horizons:
            group = measure(stream, horizon, settings, clock=clock, report=report, stop=stop)
            if group is None:
                break
            groups.append(group)
            _write(group, stream, folder)
    return Result(
        scenario=scenarios[0].name,
        seed=scenarios[0].seed,
        period_us=1e6 * scenarios[0].cell.period,
        complete=len(groups) == len(scenarios) * len(horizons),
        rows=[row for group in groups for row in group.rows],
        left_out=[*left_out, *(left for group in groups for left in group.left_out)],
        streams=[group.facts for group in groups],
        timer=timer,
        machine=facts | {"load_average_end": [round(load, 2) for load in os.getloadavg()]},
    )


def _write(group: Group, stream: Stream, folder: Path) -> None:
    """Write samples, picture and, where rows are constant, the instances of a group."""
    facts = group.facts
    name = f"{stream.axes.replace(',', '')}-N{facts.horizon}"
    samples: dict[str, Any] = {
        "/".join((*key, stage)): values
        for key, times in group.times.items()
        for stage, values in times.of.items()
    }
    np.savez_compressed(folder / f"times-{name}.npz", **samples)
    if not stream.bounds_joints:
        instances(stream, facts.horizon).save(folder / f"instances-{name}.npz")
    curves = {
        mode: {
            (backend if path == "interpreted" else f"{backend} ({path})"): times.of[what]
            for (backend, path, its), times in group.times.items()
            if its == mode
        }
        for mode, what in (("hot", "step"), ("paced", "response"))
    }
    share = "" if facts.active_share is None else f", bounds act in {facts.active_share:.0%}"
    title = f"{stream.scenario.name}, axes {stream.axes}, N = {facts.horizon}{share}"
    draw_latency(curves, title, 1e6 * stream.scenario.cell.period, folder / f"latency-{name}.png")
