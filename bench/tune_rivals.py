"""Tune the rivals by one procedure and budget; write what was found as data.

Each is tuned on the cell, on the same training motions, whose seeds are not those of the
comparison, for the same cost. ``pi-ilc`` learns on top of ``controller.pi``, so ``pi`` is tuned
before it. Any other controller can be tuned by the same; ``mpc`` is compared as it is shipped.
"""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.tuning.cost import CHATTER, WORST, Cost, cost
from bench.tuning.search import descend, fill
from plant.cell import Cell
from plant.errors import PlantError, UnstableSimulationError
from qpmpc.errors import QpmpcError
from qpmpc.kinds import ControllerKind, controller_kind
from scenarios import Log, Scenario, ScenarioError, Schedule, Setpoint, load_scenario
from scenarios.experiment import assemble, make_controller
from scenarios.loop import control_loop
from scenarios.motion import load_motion

Array = NDArray[np.float64]

TRAINING = (("regular", 101), ("early-beats", 102))
"""Scenario and seed of each training motion."""
DURATION = 6.0
"""Of each [s]."""
STARTS, FILLED, DESCENDED = 3, 24, 40
"""Searches, of which the best counts; evaluations of each: points that fill the ranges, and those
of the simplex from the best of them."""
RIVALS = ("pi", "pi-ilc", "aob", "paper-law")
"""In this order: what is learned rests on what ``pi`` found."""
RESULTS = Path(__file__).parent / "tuned_rivals.json"
_DIGITS = 3


@dataclass(frozen=True, eq=False)
class Exercise:
    """A training motion, with cells to run it on."""

    scenario: Scenario
    held: Array
    """Force error of a tool held still, ``(cycles, 3)`` [N]."""
    cell: Callable[[], Cell]


def exercise(name: str, seed: int, duration: float) -> Exercise:
    """Lay a training motion out."""
    scenario = load_scenario(name, top={"seed": seed, "duration": duration})
    config = scenario.cell
    made = assemble(scenario, lambda *_: None)
    motion = load_motion(scenario.motion, duration, config.period, seed)
    held = -config.contact.stiffness * np.asarray(motion.position)
    return Exercise(scenario, held, made.another_cell)


def run(exercise: Exercise, settings: Mapping[str, float], kind: str) -> Cost:
    """Run one motion under a controller with the given keys below ``controller``.

    Raises:
        ScenarioError, QpmpcError, PlantError: there is no such controller, or no such run.
    """
    base = exercise.scenario
    scenario = load_scenario(
        base.name,
        top={"seed": base.seed, "duration": base.duration},
        settings=[
            f"controller.kind={kind}",
            *(f"controller.{key}={value!r}" for key, value in settings.items()),
        ],
    )
    cell = exercise.cell()
    setpoint, schedule = _setpoint(scenario), Schedule(scenario)
    controller = make_controller(scenario, cell, setpoint, schedule)
    log = Log(scenario.cycles, scenario.axes, tuple(controller.rows), cell.joints)
    control_loop(
        cell,
        controller,
        setpoint,
        log,
        scenario.cycles,
        schedule=schedule,
        progress=lambda *_: None,
        stop=lambda: log.trip is not None,
    )
    return cost(log, exercise.held, scenario.cycles)


def mean_cost(
    exercises: Sequence[Exercise], settings: Mapping[str, float], kind: str
) -> tuple[float, list[Cost]]:
    """Return the mean over the motions, and what it is made of."""
    try:
        costs = [run(each, settings, kind) for each in exercises]
    except (QpmpcError, UnstableSimulationError):
        return WORST, []
    return float(np.mean([each.total for each in costs])), costs


def tune(
    kind: ControllerKind, exercises: Sequence[Exercise], given: Mapping[str, float], seed: int
) -> tuple[dict[str, float], dict[str, Any]]:
    """Tune one controller.

    Args:
        kind: which.
        exercises: to tune it on.
        given: keys of others that were tuned before it.
        seed: of the points that fill the ranges in the first search; the next ones follow.

    Returns:
        Its keys with their values, and what there is to tell.
    """
    ranges = kind.tunables

    def named(values: Array) -> dict[str, float]:
        return {r.key: float(f"{v:.{_DIGITS}g}") for r, v in zip(ranges, values, strict=True)}

    def objective(values: Array) -> float:
        return mean_cost(exercises, {**given, **named(values)}, kind.name)[0]

    searches = []
    for start in range(seed, seed + STARTS):
        filled = fill(objective, ranges, FILLED, start)
        searches.append(descend(objective, ranges, filled.values, DESCENDED, 0.15))
    found = min(searches, key=lambda each: each.cost)
    values = named(found.values)
    _, costs = mean_cost(exercises, {**given, **values}, kind.name)
    return values, {
        "values": values,
        "cost": found.cost,
        "searches": [{"values": named(each.values), "cost": each.cost} for each in searches],
        "runs": [
            {"motion": each.scenario.name, "seed": each.scenario.seed, **asdict(cost)}
            for each, cost in zip(exercises, costs, strict=bool(costs))
        ],
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Tune from the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.tune_rivals", description=__doc__)
    parser.add_argument("--controllers", default=",".join(RIVALS), help="which, by commas")
    parser.add_argument("--seed", type=int, default=0, help="of the first search")
    parser.add_argument("--out", type=Path, default=RESULTS, help="JSON file; kept but for these")
    given = parser.parse_args(arguments)
    try:
        kinds = [controller_kind(name.strip()) for name in given.controllers.split(",")]
        exercises = [exercise(name, seed, DURATION) for name, seed in TRAINING]
        for kind in kinds:
            before = {
                key: value
                for other in _known(given.out).values()
                for key, value in other["values"].items()
                if key.split(".")[0] in _below(kind)
            }
            values, result = tune(kind, exercises, before, given.seed)
            print(kind.name, values, f"cost {result['cost']:.4f}", flush=True)
            found = _known(given.out) | {kind.name: result}
            told = {
                "command": "python -m bench.tune_rivals",
                "seed": given.seed,
                "motions": [{"motion": m, "seed": s, "duration": DURATION} for m, s in TRAINING],
                "evaluations": {"starts": STARTS, "fill": FILLED, "descend": DESCENDED},
                "free_chatter": CHATTER,
                "controllers": {name: found[name] for name in sorted(found)},
            }  # fmt: skip
            given.out.write_text(json.dumps(told, indent=2) + "\n", encoding="utf-8")
    except (ValueError, OSError, QpmpcError, PlantError, ScenarioError) as error:
        print(f"bench.tune_rivals: {error}", file=sys.stderr)
        return 2
    return 0


def _known(path: Path) -> dict[str, Any]:
    """Return what was found before, by controller."""
    if not path.exists():
        return {}
    found: dict[str, Any] = json.loads(path.read_text("utf-8"))["controllers"]
    return found


def _below(kind: ControllerKind) -> set[str]:
    """Tables that a controller reads and that are tuned with another one."""
    own = {tunable.key.split(".")[0] for tunable in kind.tunables}
    read = {table.removeprefix("controller.") for table in kind.table.split(", ")}
    return read - own


def _setpoint(scenario: Scenario) -> Setpoint:
    horizon = scenario.controller.horizon
    return Setpoint(
        scenario.setpoint, scenario.axes, scenario.cycles, horizon, scenario.cell.period
    )


if __name__ == "__main__":
    raise SystemExit(main())
