"""Folders of results, made without a simulation."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from plant.interface import Cause, Trip
from qpmpc.step import Source, Status
from scenarios import Experiment, Log, Schedule, load_scenario, summarise
from scenarios.results import write_run

BOUNDS = ("command", "velocity", "force")


def _experiment(
    change: Callable[[Log], None] | None = None,
    *,
    cycles: int = 400,
    rows: int | None = None,
    axes: tuple[str, ...] = ("x", "y", "z"),
    settings: tuple[str, ...] = (),
    stopped: str | None = None,
) -> Experiment:
    scenario = load_scenario(
        "paper",
        top={"duration": cycles * 1e-3},
        settings=[f"axes={json.dumps(axes)}", *settings],
    )
    log = Log(cycles, axes, BOUNDS)
    t = np.arange(cycles) * 1e-3
    index = ["xyz".index(axis) for axis in axes]
    wish = np.array([1.0, 2.0, -10.0])
    log.time[:] = t
    log.setpoint[:] = wish[index]
    log.force[:] = wish + 0.01 * np.sin(40 * t)[:, None]
    log.force_uncompensated[:] = wish + np.outer(np.sin(40 * t), [1, 2, 4])
    log.command[:] = np.sin(40 * t)[:, None]
    log.torque[:] = np.outer(np.cos(40 * t), np.arange(1, 7))
    log.touching[:] = True
    log.solve_time[:] = 1e-6 * (1 + np.arange(cycles) % 7)
    log.cycle_time[:] = 1e-5 * (1 + np.arange(cycles) % 11)
    log.plant_time[:] = 1e-4
    log.cycles = cycles if rows is None else rows
    if change is not None:
        change(log)
    wall = {"setup": 0.1, "compensated": 0.2, "uncompensated": 0.1}
    return Experiment(scenario, log, Schedule(scenario), stopped, wall)


def _trip(log: Log) -> None:
    log.tripped[300:] = True
    log.trip = Trip(Cause.FORCE, 0.2999, 31.0, 30.0)


def _troubled(log: Log) -> None:
    log.status[10] = tuple(Status).index(Status.LATE)
    log.source[10] = tuple(Source).index(Source.PLAN)
    log.cycle_time[20] = 2e-3
    log.touching[30:33] = False
    log.command_saturated[40:44] = True
    log.slack[50, 2] = 0.5
    log.force[60, 2] = -21.0


@pytest.fixture
def make(tmp_path) -> Callable[..., Path]:
    """Write the folder of a run; arguments are those of `_experiment`."""

    def write(name: str = "run", change: Callable[[Log], None] | None = None, **how: Any) -> Path:
        folder: Path = tmp_path / name
        folder.mkdir(parents=True)
        experiment = _experiment(change, **how)
        write_run(experiment, summarise(experiment), folder)
        return folder

    return write


@pytest.fixture
def changes() -> SimpleNamespace:
    """What may happen to a log."""
    return SimpleNamespace(trip=_trip, troubled=_troubled)


@pytest.fixture
def edit() -> Callable[..., None]:
    """Change the JSON of a file: ``edit(path, lambda found: ...)``."""

    def change(path: Path, how: Callable[[dict[str, Any]], Any]) -> None:
        found = json.loads(path.read_text())
        how(found)
        path.write_text(json.dumps(found))

    return change
