"""Controllers against each other: the same motions, noise and setpoint, one row for each run."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.compare import Row, row
from scenarios import Experiment, Scenario, Summary, run_experiment
from scenarios.experiment import Report
from scenarios.loop import Stop
from scenarios.metrics import versions
from scenarios.schedule import Schedule

MOTIONS = ("regular", "paper", "early-beats", "rate-step", "breath-held", "ecg", "recorded")
"""Shipped scenarios that are compared where none is named: every motion of the heart once."""


@dataclass(frozen=True, eq=False)
class Contest:
    """What came of it, scenario by scenario, in the order in which controllers were named."""

    scenarios: Sequence[Scenario]
    controllers: Sequence[str]
    rows: list[Row] = field(default_factory=list)

    @property
    def whole(self) -> bool:
        """Whether every run came to its end; a trip of the protection is one."""
        expected = len(self.scenarios) * len(self.controllers)
        return len(self.rows) == expected and all(row["complete"] for row in self.rows)

    def summary(self) -> Summary:
        """Return everything that goes into ``compare.json``, with stable keys."""
        return {
            "scenarios": [
                {"scenario": s.name, "seed": s.seed, "cycles": s.cycles} for s in self.scenarios
            ],
            "controllers": list(self.controllers),
            "rows": self.rows,
            "versions": versions(),
        }


def contest(
    scenarios: Sequence[Scenario],
    controllers: Sequence[str],
    *,
    report: Report,
    stop: Stop,
    keep: Callable[[Experiment], None],
) -> Contest:
    """Run each scenario under each controller.

    Args:
        scenarios: no two of the same name.
        controllers: names, no two the same.
        report, stop: as for `run_experiment`.
        keep: shown each experiment as soon as it is through.

    Raises:
        ScenarioError, QpmpcError, PlantError: what a scenario asks for cannot be had.
    """
    found = Contest(scenarios, controllers)
    nothing = np.zeros((0, 3))
    for scenario in scenarios:
        schedule = Schedule(scenario)
        held: NDArray[np.float64] | None = None
        for name in controllers:
            if stop():
                return found
            asked = replace(scenario, controller=replace(scenario.controller, kind=name))
            experiment = run_experiment(
                asked, report=_named(report, f"{scenario.name}, {name}"), stop=stop, held=held
            )
            found.rows.append(row(experiment, schedule, nothing))
            keep(experiment)
            if experiment.stopped is None:
                held = experiment.log.force_uncompensated
    return found


def ahead(rows: Sequence[Row], name: str, key: str) -> dict[str, list[str]]:
    """Return for each scenario and axis ("paper z") who is better than ``name`` by a figure.

    A run that tripped is no better, whatever it shows until then; where ``name`` tripped, all that
    did not are.

    Args:
        rows: of a contest.
        name: of the controller that is asked about.
        key: of the axes' figures, the smaller the better: "rms", "max", ...
    """
    result: dict[str, list[str]] = {}
    for own in rows:
        if own["controller"] != name:
            continue
        for axis, figures in own["axes"].items():
            others = [
                other
                for other in rows
                if other["scenario"] == own["scenario"]
                and other["controller"] != name
                and other["trip"] is None
            ]
            better = [
                str(other["controller"])
                for other in others
                if own["trip"] is not None or _value(other, axis, key) < figures[key]
            ]
            result[f"{own['scenario']} {axis}"] = better
    return result


def _value(row: Row, axis: str, key: str) -> Any:
    return row["axes"][axis][key]


def _named(report: Report, name: str) -> Report:
    def told(stage: str, done: int, total: int) -> None:
        shown = {"compensated": name, "uncompensated": "held still"}.get(stage, stage)
        report(shown, done, total)

    return told
