"""The same experiment under several backends, and one table of what came of it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.reference import CommandError
from qpmpc import ForceController
from qpmpc.config import FREE, BoundsConfig
from qpmpc.errors import BackendSetupError
from qpmpc.kinds import controller_kind
from qpmpc.native import CompiledStepError
from scenarios import Experiment, Scenario, Summary, run_experiment, summarise
from scenarios.experiment import Report
from scenarios.loop import Stop
from scenarios.metrics import versions, violations
from scenarios.schedule import Schedule

Row = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Comparison:
    """What came of a comparison, one entry a backend in each list."""

    scenario: Scenario
    """As it was asked for, with its bounds."""
    bounded: bool
    rows: list[Row] = field(default_factory=list)
    experiments: list[Experiment | None] = field(default_factory=list)
    """None where a backend refused the problem."""

    @property
    def whole(self) -> bool:
        """Whether every backend ran to the end."""
        return all(e is not None and e.stopped is None for e in self.experiments)

    def summary(self) -> Summary:
        """Return everything that goes into ``compare.json``, with stable keys."""
        scenario = self.scenario
        return {
            "scenario": scenario.name,
            "seed": scenario.seed,
            "cycles": scenario.cycles,
            "bounds": "on" if self.bounded else "off",
            "rows": self.rows,
            "versions": versions(),
        }


def compare(
    scenario: Scenario,
    backends: Sequence[str],
    *,
    bounded: bool,
    report: Report,
    stop: Stop,
    keep: Callable[[str, Experiment], None],
) -> Comparison:
    """Run a scenario under each backend: same motion, same noise, same setpoint.

    Args:
        scenario: see there.
        backends: names; installed, no two the same.
        bounded: whether the controller knows the bounds; violations are counted against them in
            either case.
        report, stop: as for `run_experiment`.
        keep: shown each experiment as soon as it is through.
    """
    schedule = Schedule(scenario)
    comparison = Comparison(scenario, bounded)
    held: NDArray[np.float64] | None = None
    for backend in backends:
        if stop():
            break
        errors: list[CommandError] = []

        def shadow(controller: ForceController, found: list[CommandError] = errors) -> CommandError:
            found.append(CommandError(controller, scenario.cycles))
            return found[0]

        asked = replace(scenario, backend=backend)
        if not bounded:
            asked = _unbounded(asked)
        try:
            experiment = run_experiment(
                asked, report=_named(report, backend), stop=stop, held=held, shadow=shadow
            )
        except (BackendSetupError, CompiledStepError) as error:
            comparison.rows.append(_refused(asked, str(error)))
            comparison.experiments.append(None)
            continue
        comparison.rows.append(row(experiment, schedule, errors[0].errors))
        comparison.experiments.append(experiment)
        keep(backend, experiment)
        if experiment.stopped is None:
            held = experiment.log.force_uncompensated
    return comparison


def _named(report: Report, backend: str) -> Report:
    def told(stage: str, done: int, total: int) -> None:
        name = {"compensated": backend, "uncompensated": "held still"}.get(stage, stage)
        report(name, done, total)

    return told


def _unbounded(scenario: Scenario) -> Scenario:
    controller = replace(scenario.controller, bounds=BoundsConfig(command=FREE))
    return replace(scenario, controller=controller, bounds_steps=())


def row(experiment: Experiment, schedule: Schedule, errors: NDArray[np.float64]) -> Row:
    """Return what is told of a run, with stable keys.

    Args:
        experiment: see there.
        schedule: of the bounds that violations are counted against.
        errors: of the command, see `CommandError`; no row where the controller solves no QP.
    """
    scenario, summary = experiment.scenario, summarise(experiment)
    known = errors[~np.isnan(errors).any(axis=1)]
    return _head(scenario) | {
        "complete": summary["complete"],
        "error": experiment.stopped,
        "trip": summary["trip"],
        "axes": {
            axis: {
                "rms": figures["compensated"]["rms"],
                "max": figures["compensated"]["max"],
                "p99": figures["compensated"]["p99"],
                "peak_to_peak": figures["compensated"]["peak_to_peak"],
                "reduction_rms": figures["reduction"]["rms"],
                "reduction_max": figures["reduction"]["max"],
            }
            for axis, figures in summary["axes"].items()
        },
        "violations": violations(experiment.log, schedule, scenario.cell.period),
        "saturation": summary["saturation"],
        "increment_rms": summary["increment_rms"],
        "torque_increment_rms": summary["torque_increment_rms"],
        "status": summary["status"],
        "source": summary["source"],
        "compiled": summary["compiled"],
        "build_us": summary["timing"]["build_us"],
        "solve_us": summary["timing"]["solve_us"],
        "command_error": float(known.max()) if known.size else None,
        "command_error_rms": float(np.sqrt(np.mean(known**2))) if known.size else None,
        "without_reference": int(len(errors) - len(known)),
    }


def _refused(scenario: Scenario, reason: str) -> Row:
    return _head(scenario) | {"complete": False, "error": reason}


def _head(scenario: Scenario) -> Row:
    kind = controller_kind(scenario.controller.kind)
    return {
        "backend": scenario.backend if kind.takes_backend else None,
        "controller": kind.name,
        "scenario": scenario.name,
        "seed": scenario.seed,
    }
