"""One experiment: the run under control, and the same motion on a tool that is held still."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from plant.cell import Cell, heart_programme
from plant.errors import UnstableSimulationError
from plant.own_arm import tool_arm
from qpmpc.backends import Fact, backend_class
from qpmpc.controller import Compilation
from qpmpc.force_control import ForceController
from qpmpc.kinds import controller_kind, controllers
from qpmpc.protocol import ForceControl
from scenarios.approach import recovery
from scenarios.config import Scenario
from scenarios.consistency import band
from scenarios.errors import ScenarioError
from scenarios.live import LiveSetpoint
from scenarios.log import Log
from scenarios.loop import Pace, Stop, Watch, control_loop, watch_loop
from scenarios.motion import Motion, load_motion
from scenarios.motion.config import AXES
from scenarios.physics import physics_loop
from scenarios.schedule import Schedule
from scenarios.setpoint import Setpoint

Array = NDArray[np.float64]
Report = Callable[[str, int, int], None]
"""Called now and then with the stage, cycles done and cycles in all."""
Shadow = Callable[[ForceController], Watch]
"""From the controller of a run, one that solves a QP, to what is shown its steps."""


@dataclass(frozen=True, eq=False)
class Assembly:
    """What a controlled run is made of, at its start."""

    cell: Cell
    setpoint: Setpoint | LiveSetpoint
    schedule: Schedule
    controller: ForceControl
    log: Log
    beats: NDArray[np.bool_]
    """In which cycles an ECG tells an R peak, ``(cycles,)``."""
    another_cell: Callable[[], Cell]
    """Makes a cell of the same motion, as `cell` was at the start."""


@dataclass(frozen=True, eq=False)
class Experiment:
    """What an experiment left behind."""

    scenario: Scenario
    log: Log
    schedule: Schedule
    stopped: str | None
    """Why it ended before both runs were through: "interrupted", or what failed; None if it did
    not."""
    wall_time: dict[str, float]
    """Seconds that each stage took: ``setup``, ``compensated``, ``uncompensated``; 0 if not run."""
    live: dict[str, int] | None = None
    """What came of a setpoint that was sent, see `scenarios.live.Counts`; None without one."""
    backend_facts: Sequence[Mapping[str, Fact]] = ()
    """What the backend told of itself, one entry for each problem that it solved a cycle."""
    compilation: Compilation = field(default_factory=lambda: Compilation(False, "not run", 0))
    """Whether the controller's step was compiled."""
    form: Mapping[str, str] = field(default_factory=dict)
    """Which form the controller's problem had, and why: ``name`` and ``reason``."""


def assemble(scenario: Scenario, report: Report) -> Assembly:
    """Make cell, setpoint, schedule of bounds, controller and log of a scenario.

    Args:
        scenario: see there.
        report: told once that it takes a while, when backend and motion are known to be there.

    Raises:
        ScenarioError, QpmpcError, PlantError: what the scenario asks for cannot be had.
    """
    period, cycles = scenario.cell.period, scenario.cycles
    controller_kind(scenario.controller.kind)  # what is not there is told before anything is done
    backend_class(scenario.backend)
    motion = load_motion(scenario.motion, scenario.duration, period, scenario.seed)
    tool = tool_arm(scenario.cell)
    setpoint = _setpoint(scenario)
    schedule = Schedule(scenario)
    report("setup", 0, 1)
    heart = heart_programme(scenario.cell, motion)
    library = physics_loop(tool.joints).binary

    def another_cell() -> Cell:
        return Cell(
            scenario.cell,
            motion,
            force=setpoint.start,
            seed=scenario.seed,
            axes=scenario.axes,
            heart=heart,
            library=library,
            tool=tool,
            contraction=motion.contraction,
        )

    cell = another_cell()
    controller = make_controller(scenario, cell, setpoint, schedule)
    log = Log(cycles, scenario.axes, tuple(controller.rows), cell.joints)
    return Assembly(
        cell, setpoint, schedule, controller, log, told_beats(motion, cycles), another_cell
    )


def told_beats(motion: Motion, cycles: int) -> NDArray[np.bool_]:
    """Return in which cycles an R peak is known that was not in the one before, ``(cycles,)``."""
    told = np.zeros(cycles, dtype=np.bool_)
    cycle = np.ceil(motion.beats / motion.period - 1e-9).astype(np.int64)
    told[cycle[cycle < cycles]] = True
    return told


def hold_still(cell: Cell, setpoint: Setpoint | LiveSetpoint) -> None:
    """Close the brakes where the force would be the setpoint at the start in the tissue's middle.

    The middle is that of its motion: no other place gives less force error, as long as the force
    is proportional to the way.
    """
    cell.move_tool(cell.rest(setpoint.start))
    cell.close_brakes()


def make_controller(
    scenario: Scenario, cell: Cell, setpoint: Setpoint | LiveSetpoint, schedule: Schedule
) -> ForceControl:
    """Make the controller of a scenario, for the start of a run.

    Args:
        scenario: see there.
        cell: at its start; what it tells of its joints is where bounds on them begin.
        setpoint, schedule: of the run.

    Raises:
        ScenarioError, QpmpcError: what the scenario asks for cannot be had.
    """
    controller = controller_kind(scenario.controller.kind).make(
        scenario.controller,
        scenario.axes,
        scenario.cell.period,
        backend_class(scenario.backend),
        joints=cell.joint_space(np.zeros(3), np.zeros(3)),
        moving=schedule.moving,
    )
    touching = scenario.cell.contact.gap == 0
    start = [setpoint.start[AXES.index(axis)] for axis in scenario.axes]
    controller.reset(np.array(start) * touching)
    return controller


def require_backend(scenario: Scenario, what: str) -> None:
    """Refuse a scenario whose controller takes no backend; ``what`` asks for one.

    Raises:
        ScenarioError: it takes none. UnknownNameError: there is no such controller.
    """
    kind = controller_kind(scenario.controller.kind)
    if not kind.takes_backend:
        able = ", ".join(other.name for other in controllers() if other.takes_backend)
        raise ScenarioError(
            f"{what}: no effect on controller.kind = {kind.name}, which takes no backend "
            f"(those that do: {able})"
        )


def run_experiment(
    scenario: Scenario,
    *,
    report: Report,
    stop: Stop,
    held: Array | None = None,
    shadow: Shadow | None = None,
    pace: Pace | None = None,
) -> Experiment:
    """Run a scenario: controlled first, then with the brakes closed.

    Args:
        scenario: see there.
        report, stop: see `Report`, `scenarios.loop.Stop`.
        held: force of the run with the brakes closed, ``(cycles, 3)`` [N], where an experiment of
            the same motion has it already.
        shadow: makes what is shown every step of the controller.
        pace: of the controlled run, see `Pace`; a setpoint that is sent live wants the clock's.

    Raises:
        ScenarioError, QpmpcError, PlantError: what the scenario asks for cannot be had; nothing
        has been simulated then.
    """
    started = perf_counter()
    cycles = scenario.cycles
    made = assemble(scenario, report)
    log = made.log
    watch: Watch | None = None
    if shadow is not None:
        if not isinstance(made.controller, ForceController):
            raise ScenarioError(
                f"controller.kind: {scenario.controller.kind} solves no QP to watch"
            )
        watch = shadow(made.controller)
    looking_after = recovery(scenario, made.schedule)
    if looking_after is not None:
        log.contact_events = looking_after.watch.events
    if held is None:
        still = made.another_cell()
        hold_still(still, made.setpoint)
    ready = perf_counter()
    controlled, stopped = None, None
    try:
        complete = control_loop(
            made.cell,
            made.controller,
            made.setpoint,
            log,
            cycles,
            schedule=made.schedule,
            recovery=looking_after,
            beats=made.beats,
            watch=watch,
            pace=pace,
            progress=lambda done, total: report("compensated", done, total),
            stop=stop,
        )
        controlled = perf_counter()
        if held is not None:
            log.force_uncompensated[:] = held
        elif complete:
            complete = watch_loop(
                still,
                log.force_uncompensated,
                cycles,
                progress=lambda done, total: report("uncompensated", done, total),
                stop=stop,
            )
        stopped = None if complete else "interrupted"
    except UnstableSimulationError as error:
        stopped = str(error)
    finally:
        if isinstance(made.setpoint, LiveSetpoint):
            made.setpoint.close()
            log.setpoint_source[:] = made.setpoint.source
    ended = perf_counter()
    about = made.controller.about()
    if controlled is None:
        controlled = ended
    return Experiment(
        scenario,
        log,
        made.schedule,
        stopped,
        {
            "setup": ready - started,
            "compensated": controlled - ready,
            "uncompensated": ended - controlled if held is None else 0.0,
        },
        made.setpoint.summary() if isinstance(made.setpoint, LiveSetpoint) else None,
        about.facts,
        compilation=about.compilation,
        form=about.form,
    )


def _setpoint(scenario: Scenario) -> Setpoint | LiveSetpoint:
    config, axes, period = scenario.setpoint, scenario.axes, scenario.cell.period
    cycles, horizon = scenario.cycles, scenario.controller.horizon
    bounds = np.array([band(scenario.controller.bounds.force, axis) for axis in axes]).T
    if config.live is not None:
        return LiveSetpoint(
            config.live, np.array([config.x, config.y, config.z]), (bounds[0], bounds[1]), axes,
            cycles=cycles, horizon=horizon, period=period,
        )  # fmt: skip
    setpoint = Setpoint(config, axes, cycles, horizon, period)
    if config.file is not None and not scenario.bounds_steps:
        _check_recorded(config.file, setpoint.force[:cycles], bounds, scenario)
    return setpoint


def _check_recorded(file: str, wished: Array, bounds: Array, scenario: Scenario) -> None:
    """Hold a recorded setpoint to the bounds on force, as one that is written out is held."""
    beyond = np.argwhere((wished < bounds[0]) | (wished > bounds[1]))
    if beyond.size:
        k, j = beyond[0]
        axis, when = scenario.axes[j], k * scenario.cell.period
        raise ScenarioError(
            f"{file}: {axis} is {wished[k, j]:g} N at {when:g} s, outside "
            f"controller.bounds.force.{axis} = [{bounds[0, j]:g}, {bounds[1, j]:g}] N"
        )
