"""What verbs that run an experiment have in common."""

import sys
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

import tyro

from bench.report import write_report
from qpmpc.controller import Compiled
from qpmpc.kinds import controller_kind
from scenarios import Scenario, ScenarioError, load_scenario

_arg = tyro.conf.arg
FAILED = 1


@dataclass(frozen=True, kw_only=True)
class Options:
    """The options that change a scenario; verbs inherit them."""

    motion: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """A recorded motion in place of the generated one: columns t, x, y, z [s, m]."""
    beats: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """Times of heart beats that drive the generated motion: column t [s]."""
    setpoint: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """A recorded wish in place of the scenario's: columns t, x, y, z [s, N]."""
    duration: Annotated[float | None, _arg(metavar="S")] = None
    """Simulated time [s]."""
    seed: Annotated[int | None, _arg(metavar="N")] = None
    """Seed of motion and sensor noise."""
    set: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], _arg(metavar="KEY.PATH=VALUE")] = ()
    """Change keys of the scenario; values in TOML's notation."""


@dataclass(frozen=True, kw_only=True)
class Asked(Options):
    """The options that say which experiment is meant."""

    scenario: Annotated[tyro.conf.Positional[str], _arg(metavar="SCENARIO")] = "paper"
    """Name of a shipped scenario (see `pulsempc scenarios`) or path of a TOML file."""


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
