"""One experiment: the run under control, and the same motion on a tool that is held still."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from plant.cell import Cell, heart_programme
from plant.errors import UnstableSimulationError
from qpmpc.force_control import ForceController
from scenarios.config import Scenario
from scenarios.log import Log
from scenarios.loop import Stop, control_loop, watch_loop
from scenarios.motion import load_motion
from scenarios.setpoint import Setpoint

Report = Callable[[str, int, int], None]
"""Called now and then with the stage, cycles done and cycles in all."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """What an experiment left behind."""

    scenario: Scenario
    log: Log
    stopped: str | None
    """Why it ended before both runs were through: "interrupted", or what failed; None if it did
    not."""
    wall_time: dict[str, float]
    """Seconds that each stage took: ``setup``, ``compensated``, ``uncompensated``."""


def run_experiment(scenario: Scenario, *, report: Report, stop: Stop) -> Experiment:
    """Run a scenario: controlled first, then with the brakes closed.

    The tool is held where the force would be the setpoint if the tissue stood in the middle of
    its motion: no other place gives less force error.

    Raises:
        ScenarioError, QpmpcError, PlantError: what the scenario asks for cannot be had; nothing
        has been simulated then.
    """
    started = perf_counter()
    period, cycles = scenario.cell.period, scenario.cycles
    controller = ForceController(scenario.controller, scenario.axes, period, scenario.backend)
    motion = load_motion(scenario.motion, scenario.duration, period, scenario.seed)
    report("setup", 0, 1)
    heart = heart_programme(scenario.cell, motion)
    wished = np.array([scenario.setpoint.x, scenario.setpoint.y, scenario.setpoint.z])
    cell, held = (
        Cell(
            scenario.cell, motion, force=wished, seed=scenario.seed, axes=scenario.axes, heart=heart
        )
        for _ in range(2)
    )
    held.move_tool(wished / scenario.cell.contact.stiffness)
    held.close_brakes()
    setpoint = Setpoint(
        scenario.setpoint, scenario.axes, cycles, scenario.controller.horizon, period
    )
    controller.reset(setpoint.force[0])
    log = Log(cycles, scenario.axes, tuple(controller.general.problem.rows))
    ready = perf_counter()
    controlled, stopped = None, None
    try:
        complete = control_loop(
            cell,
            controller,
            setpoint,
            log,
            cycles,
            limits=scenario.controller.bounds.command,
            progress=lambda done, total: report("compensated", done, total),
            stop=stop,
        )
        controlled = perf_counter()
        complete = complete and watch_loop(
            held,
            log.force_uncompensated,
            cycles,
            progress=lambda done, total: report("uncompensated", done, total),
            stop=stop,
        )
        stopped = None if complete else "interrupted"
    except UnstableSimulationError as error:
        stopped = str(error)
    ended = perf_counter()
    if controlled is None:
        controlled = ended
    return Experiment(
        scenario,
        log,
        stopped,
        {
            "setup": ready - started,
            "compensated": controlled - ready,
            "uncompensated": ended - controlled,
        },
    )
