"""Cost against the horizon, condensed and structured, on instances of a closed loop on the cell.

``python -m bench.horizons`` prints one table: for every horizon the same instances, recorded from a
run, solved hot in either form, and the least time of some passes for each instance.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from plant.errors import PlantError
from qpmpc import Controller, ForceController, Problem, Step
from qpmpc.backends import Limits
from qpmpc.errors import QpmpcError
from qpmpc.structured.problem import StructuredProblem
from scenarios import Scenario, ScenarioError, load_scenario, run_experiment
from scenarios.loop import Watch, quiet_memory

Array = NDArray[np.float64]

SCENARIO = "paper"
SETTINGS = (
    "controller.observer.disturbance=constant",
    "controller.bounds.command=[-10.0, 10.0]",
    "setpoint.steps=[{time=0.6, z=-16.0}, {time=1.2, z=-6.0}, {time=1.8, z=-14.0}]",
)
"""The paper's run with a disturbance that stays, half the acceleration, and a setpoint that jumps,
so rarely that the longest horizon sees one jump, as the shortest does."""
HORIZONS = (8, 16, 32, 64, 128, 256, 512)
CONDENSED_UP_TO = 128
"""Horizon up to which the condensed form is timed; its set-up alone takes long above."""
FITTED = 64
"""Horizon from which the exponent is fitted."""


@dataclass(frozen=True, eq=False)
class Instances:
    """What a controller was asked in the cycles of a run."""

    states: Array
    """``(cycles, n)``."""
    previous: Array
    """u(k-1), ``(cycles, n_inputs)``."""
    references: Array
    """``(cycles, N, n_outputs)``."""


@dataclass(frozen=True, eq=False)
class Timing:
    """Least times of each instance in one form [s], and what came out."""

    form: str
    update: Array
    solve: Array
    whole: Array
    """Update, solve, scaling and check."""
    decisions: Array
    """``(cycles, n_z)``, NaN where there is none."""
    active: Array
    """Rows with a multiplier, ``(cycles,)``."""
    iterations: Array

    def when_active(self, name: str) -> float:
        """Return the median of one of the times over the cycles with an active row [s]."""
        times = getattr(self, name)[self.active > 0]
        return float(np.median(times)) if times.size else float("nan")


class Recorder:
    """Stands before a controller's reference and is shown its steps."""

    def __init__(self, controller: Controller) -> None:
        self._controller, self._asked = controller, controller.reference
        self._last = np.zeros(controller.problem.model.n_inputs)
        self.states: list[Array] = []
        self.previous: list[Array] = []
        self.references: list[Array] = []
        controller.reference = self._reference

    def _reference(self, preview: Array, output: Array) -> Array:
        wanted = self._asked(preview, output)
        self.references.append(wanted.copy())
        return wanted

    def __call__(self, step: Step) -> None:
        """Keep what this cycle decided on."""
        self.states.append(self._controller.observer.state.copy())
        self.previous.append(self._last.copy())
        self._last[:] = step.command


def record(scenario: Scenario) -> tuple[Instances, Controller]:
    """Run a scenario; return what its controller was asked, and the controller."""
    found: list[tuple[Recorder, Controller]] = []

    def shadow(controller: ForceController) -> Watch:
        found.append((Recorder(controller.general), controller.general))
        return found[0][0]

    run_experiment(
        scenario,
        report=lambda *_: None,
        stop=lambda: False,
        held=np.zeros((scenario.cycles, 3)),
        shadow=shadow,
    )
    recorder, controller = found[0]
    return (
        Instances(
            *(np.array(v) for v in (recorder.states, recorder.previous, recorder.references))
        ),
        controller,
    )


def measure(problem: Problem, asked: Instances, passes: int) -> Timing:
    """Time one form on all instances, in their order."""
    solver = problem.solver("daqp", Limits(), None)
    cycles, n = len(asked.states), problem.q.size
    update, solve, whole = np.full((3, cycles), np.inf)
    decisions, active, iterations = np.full((cycles, n), np.nan), np.zeros(cycles), np.zeros(cycles)
    with quiet_memory():
        for _ in range(passes):
            solver.forget()
            for k in range(cycles):
                begin = perf_counter()
                problem.update(asked.states[k], asked.previous[k], asked.references[k])
                updated = perf_counter()
                solution = solver.solve(problem.q, problem.l, problem.u)
                done = perf_counter()
                update[k] = min(update[k], updated - begin)
                solve[k] = min(solve[k], solution.solve_time)
                whole[k] = min(whole[k], done - begin)
                decisions[k] = solution.x
                active[k] = np.count_nonzero(solution.y)
                iterations[k] = solution.iterations
    form = "structured" if isinstance(problem, StructuredProblem) else "condensed"
    return Timing(form, update, solve, whole, decisions, active, iterations)


def study(
    horizons: Sequence[int], *, duration: float, passes: int, condensed_up_to: int
) -> list[tuple[int, Timing]]:
    """Measure both forms at every horizon, and print a line for each."""
    print(
        "  N form         update  solve p50 active   p99  p99.9  whole p50 active    p99"
        "  active  steps   error"
    )
    found = []
    for horizon in horizons:
        forms = ["structured", *(["condensed"] if horizon <= condensed_up_to else [])]
        timings: list[Timing] = []
        asked: Instances | None = None
        for form in forms:
            scenario = load_scenario(
                SCENARIO,
                top={"duration": duration if asked is None else 0.01},
                settings=[
                    *SETTINGS,
                    f"controller.horizon={horizon}",
                    f"controller.solver.form={form}",
                ],
            )
            instances, controller = record(scenario)
            asked = asked or instances
            timings.append(measure(controller.problem, asked, passes))
            error = np.abs(timings[-1].decisions - timings[0].decisions).max()
            print(_line(horizon, timings[-1], error), flush=True)
        found += [(horizon, timing) for timing in timings]
    return found


def _line(horizon: int, timing: Timing, error: float) -> str:
    solve = np.percentile(1e6 * timing.solve, [50, 99, 99.9])
    whole = np.percentile(1e6 * timing.whole, [50, 99])
    active = {name: 1e6 * timing.when_active(name) for name in ("solve", "whole")}
    return (
        f"{horizon:3d} {timing.form:10s} {np.median(1e6 * timing.update):8.1f} {solve[0]:10.1f}"
        f" {active['solve']:6.1f} {solve[1]:5.0f} {solve[2]:6.0f} {whole[0]:10.1f}"
        f" {active['whole']:6.1f} {whole[1]:6.0f} {np.mean(timing.active > 0):7.0%}"
        f" {timing.iterations.mean():6.2f} {error:7.0e}"
    )


def exponent(horizons: Sequence[int], times: Sequence[float]) -> float:
    """Return p of the least-squares fit ``times ~ horizons ** p``."""
    return float(np.polyfit(np.log(horizons), np.log(times), 1)[0])


def crossover(found: Sequence[tuple[int, Timing]]) -> int | None:
    """Return the least horizon from which the structured form is faster in the median, or None."""
    medians: dict[int, dict[str, float]] = {}
    for horizon, timing in found:
        medians.setdefault(horizon, {})[timing.form] = float(np.median(timing.whole))
    both = {h: m for h, m in sorted(medians.items()) if len(m) == 2}
    slower = [h for h, m in both.items() if m["structured"] >= m["condensed"]]
    return next((h for h in both if not slower or h > max(slower)), None)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study from the command line."""
    parser = argparse.ArgumentParser(prog="python -m bench.horizons", description=__doc__)
    parser.add_argument("--horizon", default=",".join(map(str, HORIZONS)), help="steps, by commas")
    parser.add_argument("--duration", type=float, default=2.2, help="of the run [s]")
    parser.add_argument("--passes", type=int, default=3, help="over all instances")
    parser.add_argument("--condensed-up-to", type=int, default=CONDENSED_UP_TO, metavar="N")
    given = parser.parse_args(arguments)
    try:
        horizons = [int(part) for part in given.horizon.split(",")]
        if given.passes < 1:
            raise ValueError("--passes must be at least 1")
        found = study(
            horizons,
            duration=given.duration,
            passes=given.passes,
            condensed_up_to=given.condensed_up_to,
        )
    except (ValueError, QpmpcError, PlantError, ScenarioError) as error:
        print(f"bench.horizons: {error}", file=sys.stderr)
        return 2
    print(f"three axes, times in microseconds; crossover (whole, median): N = {crossover(found)}")
    long = [(h, t) for h, t in found if t.form == "structured" and h >= FITTED]
    if len(long) > 1:
        steps = [h for h, _ in long]
        for name, times in (
            ("all cycles", [float(np.median(t.solve)) for _, t in long]),
            ("active cycles", [t.when_active("solve") for _, t in long]),
            ("active cycles, with update and check", [t.when_active("whole") for _, t in long]),
        ):
            power = exponent(steps, times)
            print(f"structured, {name}: the median grows as N^{power:.2f} from N = {steps[0]} on")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
