"""What verbs that run an experiment have in common."""

import sys
from datetime import datetime
from pathlib import Path
from typing import Protocol

from bench.report import write_report
from qpmpc.controller import Compiled
from qpmpc.kinds import controller_kind
from scenarios import Scenario, ScenarioError, load_scenario

FAILED = 1


class Options(Protocol):
    """The options that change a scenario."""

    @property
    def motion(self) -> Path | None: ...
    @property
    def beats(self) -> Path | None: ...
    @property
    def setpoint(self) -> Path | None: ...
    @property
    def duration(self) -> float | None: ...
    @property
    def seed(self) -> int | None: ...
    @property
    def set(self) -> tuple[str, ...]: ...


class Asked(Options, Protocol):
    """The options that say which experiment is meant."""

    @property
    def scenario(self) -> str: ...


def load(
    asked: Asked,
    *,
    compiled: Compiled | None = None,
    controller: str | None = None,
    **top: str | None,
) -> Scenario:
    return load_named(asked, asked.scenario, compiled=compiled, controller=controller, **top)


def load_named(
    asked: Options,
    name: str,
    *,
    compiled: Compiled | None = None,
    controller: str | None = None,
    **top: str | None,
) -> Scenario:
    if controller is not None:
        controller_kind(controller)  # an unknown one is told before anything is done
    keys = {"duration": asked.duration, "seed": asked.seed, **top}
    asked_for = {"controller.solver.compiled": compiled, "controller.kind": controller}
    chosen = (f"{key}={value}" for key, value in asked_for.items() if value is not None)
    return load_scenario(
        name,
        top={key: value for key, value in keys.items() if value is not None},
        motion=asked.motion,
        beats=asked.beats,
        setpoint=asked.setpoint,
        settings=(*asked.set, *chosen),
    )


def report(folder: Path) -> None:
    """Write the report of results into their folder; they are worth more than it."""
    try:
        write_report([folder], folder / "report.html")
    except ScenarioError as error:
        print(f"pulsempc: no report: {error}", file=sys.stderr)


def now() -> str:
    return f"{datetime.now():%Y%m%d-%H%M%S}"
