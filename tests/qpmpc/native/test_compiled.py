"""A compiled step decides what the interpreted one decides, to 1e-9, whatever comes."""

from __future__ import annotations

import tracemalloc
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from qpmpc import (
    BoundsConfig,
    CommandBound,
    CompiledStepError,
    Controller,
    ControllerConfig,
    ExponentialReference,
    ForceController,
    KalmanObserver,
    Limits,
    LinearModel,
    ModelConfig,
    ObserverConfig,
    OutputBound,
    PerAxis,
    Problem,
    RateBound,
    SolverConfig,
    Source,
    Status,
    Step,
    TangentialConfig,
    UnknownNameError,
    stack,
)
from qpmpc.backends.daqp import DaqpBackend
from qpmpc.native import daqp_form
from qpmpc.native.compiled import Code
from qpmpc.native.forms import c_text

EXACT = 1e-9
PERIOD, STIFFNESS = 1e-3, 2500.0
WISH = {"x": 0.5, "y": 1.0, "z": -10.0}
TIGHT = BoundsConfig(command=(-8.0, 8.0), force=PerAxis(z=(-13.0, 0.0)), velocity=(-0.1, 0.1))
CYCLES = 400
LOST = (0, 130, 131, 132, *range(200, 212))

Change = Callable[[ForceController, int], None]


@dataclass(frozen=True)
class Case:
    """A force controller and what happens to it."""

    config: ControllerConfig = field(default_factory=lambda: ControllerConfig(bounds=TIGHT))
    axes: tuple[str, ...] = ("x", "y", "z")
    moving: tuple[str, ...] = ()
    change: Change | None = None
    lost: tuple[int, ...] = ()
    """Cycles in which a force is not measured."""
    spikes: tuple[int, ...] = ()
    """Cycles in which one is wrong by 5 N."""
    interpreted: tuple[int, int] = (0, 0)
    """How many cycles the compiled step may hand over, besides those."""
    bounded: bool = True
    """Whether bounds must be active somewhere."""
    backends: tuple[str, ...] = field(default=("daqp", "analytic"))


def closing(controller: ForceController, k: int) -> None:
    """A cap on the force of z that comes down within the horizon, and goes away again."""
    if k % 2 == 0:
        horizon = controller.general.problem.horizon
        low = np.full((horizon, 3), -np.inf)
        low[:, 2] = np.where((k + np.arange(horizon)) % 200 < 120, -9.0, -np.inf)
        controller.move("force", low, np.full((horizon, 3), np.inf))


def narrowing(controller: ForceController, k: int) -> None:
    """Command and rate bounds that breathe."""
    width = 3.0 + 2.0 * np.sin(k / 20)
    controller.move("command", -width, width)
    controller.move("rate", -0.4 * width, 0.5 * width)


def config(**changes: Any) -> ControllerConfig:
    return ControllerConfig(**({"bounds": TIGHT} | changes))


CASES = {
    "three axes": Case(),
    "one axis": Case(axes=("z",)),
    "two axes, other order": Case(axes=("z", "x")),
    "one step": Case(config(horizon=1), bounded=False),
    "one step, one axis": Case(config(horizon=1), axes=("y",), bounded=False),
    "far": Case(config(horizon=32, solver=SolverConfig(form="condensed"))),
    "few moves": Case(config(horizon=16, control_horizon=3)),
    "one move": Case(config(control_horizon=1)),
    "absolute": Case(config(decision="absolute", increment_weight=1e-4)),
    "absolute, rate": Case(
        config(decision="absolute", bounds=replace(TIGHT, rate=(-1.5, 1.0)))
    ),
    "rate": Case(config(bounds=replace(TIGHT, rate=PerAxis(x=(-0.5, 0.5), z=(-2.0, 2.5))))),
    "cone": Case(
        config(bounds=replace(TIGHT, tangential=TangentialConfig(0.3, 0.05, 6)), horizon=5)
    ),
    "no bounds": Case(
        config(bounds=BoundsConfig(command=(-np.inf, np.inf))), bounded=False
    ),
    "different bounds": Case(
        config(bounds=BoundsConfig(
            command=PerAxis(x=(-3.0, np.inf), y=(-1.0, 2.0)), force=PerAxis(z=(-np.inf, -9.5))
        )),
    ),
    "gives way": Case(
        config(bounds=replace(TIGHT, force=PerAxis(x=(0.45, 0.55), z=(-10.1, -9.9)))),
    ),
    "moving cap": Case(moving=("force",), change=closing),
    "moving command": Case(
        config(bounds=replace(TIGHT, rate=(-1.0, 1.0))),
        moving=("command", "rate"),
        change=narrowing,
    ),
    "delay": Case(config(model=ModelConfig(delay=3, lag=0.0))),
    "no delay": Case(config(model=ModelConfig(delay=0))),
    "none": Case(config(observer=ObserverConfig(disturbance="none"))),
    "constant": Case(config(observer=ObserverConfig(disturbance="constant"))),
    "ramp": Case(config(observer=ObserverConfig(disturbance="ramp"))),
    "lost": Case(lost=LOST, interpreted=(30, 120)),
    "lost, no patience": Case(
        config(observer=ObserverConfig(patience=0.0)), lost=LOST, interpreted=(30, 120)
    ),
    "lost for long": Case(
        config(observer=ObserverConfig(patience=0.01)),
        lost=tuple(range(100, 150)),
        interpreted=(10, 80),
    ),
    "lost, no disturbance": Case(
        config(observer=ObserverConfig(disturbance="none")), lost=LOST, interpreted=(1, 60)
    ),
    "lost, force alone": Case(
        config(
            observer=ObserverConfig(disturbance="ramp"),
            bounds=replace(TIGHT, velocity=(-np.inf, np.inf)),
        ),
        lost=LOST,
        interpreted=(30, 200),
    ),
    "spikes": Case(spikes=(50, 51, 90, *range(130, 140)), interpreted=(30, 150)),
}  # fmt: skip


def controllers(case: Case, backend: str) -> tuple[ForceController, ForceController]:
    """The same controller, compiled and interpreted."""
    made = []
    for compiled in ("on", "off"):
        solver = replace(case.config.solver, compiled=compiled)
        made.append(
            ForceController(
                replace(case.config, solver=solver), case.axes, PERIOD, backend, moving=case.moving
            )
        )
    return made[0], made[1]


@dataclass
class Heard:
    """What a controller was told, to tell it to another one."""

    moments: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)


def closed_loop(
    controller: ForceController,
    case: Case,
    cycles: int = CYCLES,
    *,
    amplitude: float = 4e-3,
    heard: Heard | None = None,
) -> list[Step]:
    """Press on moving tissue: a tool with one cycle of delay against springs, noise, a step."""
    n, rng = len(case.axes), np.random.default_rng(5)
    t = PERIOD * np.arange(cycles)[:, None]
    tissue = amplitude * np.sin(2 * np.pi * 4.0 * t + np.arange(n)) ** 3
    noise = rng.normal(size=(2, cycles, n)) * [[[3e-3]], [[1e-5]]]
    wish = np.array([WISH[axis] for axis in case.axes])
    horizon = controller.general.problem.horizon
    preview = np.tile(wish, (cycles + horizon + 1, 1))
    preview[cycles // 2 :] *= 1.3
    place, velocity, under_way = wish / STIFFNESS + tissue[0], np.zeros(n), np.zeros(n)
    controller.reset(wish)
    steps = []
    for k in range(cycles):
        if case.change is not None:
            case.change(controller, k)
        force = STIFFNESS * (place - tissue[k]) + noise[0, k]
        if k in case.lost:
            force[k % n] = (np.nan, np.inf, -np.inf)[k % 3]
        if k in case.spikes:
            force[k % n] += (5.0, -5.0)[k % 2]
        told = force, velocity + noise[1, k], preview[k : k + horizon + 1]
        if heard is not None:
            heard.moments.append(told)
        step = controller.step(*told)
        steps.append(step)
        acceleration = under_way - 20.0 * velocity
        place = place + PERIOD * velocity + PERIOD**2 / 2 * acceleration
        velocity = velocity + PERIOD * acceleration
        under_way = step.command.copy()
        controller.prepare()
    return steps


def told(controller: ForceController, case: Case, heard: Heard) -> list[Step]:
    """Tell a controller what another one heard.

    Where bounds keep a loop from holding its setpoint, it is a limit cycle, in which rounding
    grows from cycle to cycle whoever rounds. What each cycle decides is compared without that.
    """
    controller.reset(np.array([WISH[axis] for axis in case.axes]))
    steps = []
    for k, moment in enumerate(heard.moments):
        if case.change is not None:
            case.change(controller, k)
        steps.append(controller.step(*moment))
        controller.prepare()
    return steps


def both(
    compiled: ForceController, interpreted: ForceController, case: Case
) -> tuple[list[Step], list[Step]]:
    """Close the loop by the interpreted path and tell the compiled one what that heard."""
    heard = Heard()
    second = closed_loop(interpreted, case, heard=heard)
    return told(compiled, case, heard), second


def assert_same(first: list[Step], second: list[Step]) -> None:
    assert [(s.status, s.source) for s in first] == [(s.status, s.source) for s in second]
    for name in ("command", "decision", "predicted", "violation"):
        a, b = (np.array([getattr(s, name) for s in steps]) for steps in (first, second))
        assert a.shape == b.shape
        assert np.abs(a - b).max(initial=0.0) <= EXACT, name
    for name in ("primal", "dual", "gap", "scaled"):
        a, b = (np.array([getattr(s.residuals, name) for s in steps]) for steps in (first, second))
        assert np.allclose(a, b, rtol=1e-9, atol=1e-7, equal_nan=True), name  # near 0: rounding
    assert all(
        a.rows == b.rows and a.slack.keys() == b.slack.keys()
        for a, b in zip(first, second, strict=True)
    )


def active(steps: list[Step], interpreted: ForceController) -> int:
    problem = interpreted.general.problem
    low, high = problem.limits(np.zeros(problem.model.n_inputs))
    return sum(
        bool(((s.command <= low) | (s.command >= high)).any() or s.violation.max(initial=0) > 1e-6)
        for s in steps
    )


@pytest.mark.parametrize("backend", ["daqp", "analytic"])
@pytest.mark.parametrize("name", CASES)
def test_every_cycle_of_a_closed_loop_is_the_same(name, backend):
    case = CASES[name]
    compiled, interpreted = controllers(case, backend)
    first, second = both(compiled, interpreted, case)
    assert_same(first, second)
    assert compiled.general.compilation.used
    assert not interpreted.general.compilation.used
    handed = compiled.general.compilation.interpreted_cycles - len({*case.lost, *case.spikes})
    assert case.interpreted[0] <= handed <= case.interpreted[1]
    for mine, theirs in zip(
        (compiled.general.observer.state, *vectors(compiled.general)),
        (interpreted.general.observer.state, *vectors(interpreted.general)),
        strict=True,
    ):
        finite = np.isfinite(theirs)
        assert np.array_equal(mine[~finite], theirs[~finite])
        assert np.allclose(mine[finite], theirs[finite], rtol=1e-9, atol=1e-9)
    if case.bounded and backend == "daqp":
        assert active(second, interpreted) > CYCLES // 20


@pytest.mark.parametrize("backend", ["daqp", "analytic"])
@pytest.mark.parametrize(
    "name", ["three axes", "one axis", "one move", "constant", "ramp", "different bounds"]
)
def test_closed_loops_of_their_own_stay_together(name, backend):
    case = CASES[name]
    compiled, interpreted = controllers(case, backend)
    first = closed_loop(compiled, case, amplitude=1e-3)
    assert_same(first, closed_loop(interpreted, case, amplitude=1e-3))


def vectors(controller: Controller) -> tuple[np.ndarray, ...]:
    problem = controller.problem
    return problem.free, problem.q, problem.l, problem.u, controller.command


def test_the_loops_see_what_they_are_there_for():
    """Clipped commands, bounds that give way, and every source of a command."""
    seen: Counter[tuple[Status, Source]] = Counter()
    for name, backend in (("lost, no patience", "daqp"), ("three axes", "analytic")):
        _, interpreted = controllers(CASES[name], backend)
        seen += Counter((s.status, s.source) for s in closed_loop(interpreted, CASES[name]))
    assert seen[Status.CLIPPED, Source.SOLUTION] > 5
    assert seen[Status.FAILED, Source.PLAN] > 5
    assert seen[Status.FAILED, Source.HOLD] > 2
    _, interpreted = controllers(CASES["gives way"], "daqp")
    steps = closed_loop(interpreted, CASES["gives way"])
    assert sum(step.slack["force"].max() > 1e-3 for step in steps) > 20


def test_axes_that_nothing_couples_are_groups_and_a_cone_couples_them():
    assert controllers(CASES["three axes"], "daqp")[0].general.compiled.groups == 3
    assert controllers(CASES["cone"], "daqp")[0].general.compiled.groups == 1


def test_both_paths_take_turns_without_a_seam():
    case = CASES["gives way"]
    mixed, interpreted = controllers(case, "daqp")
    compiled = mixed.general.compiled
    turns = np.random.default_rng(2).integers(0, 2, CYCLES)

    def change(controller: ForceController, k: int) -> None:
        controller.general.compiled = compiled if turns[k] else None

    heard = Heard()
    second = closed_loop(interpreted, case, heard=heard)
    assert_same(told(mixed, replace(case, change=change), heard), second)


def test_the_raw_call_leaves_the_command_behind():
    case = CASES["lost"]
    raw, interpreted = controllers(case, "daqp")
    compiled, codes = raw.general.compiled, []

    @dataclass
    class Raw:
        general: Controller = raw.general
        reset = staticmethod(raw.reset)

        def step(self, force, velocity, preview):
            codes.append(compiled.step(raw.measured(force, velocity), preview))
            return replace(BLANK, command=raw.general.command.copy())

        def prepare(self):
            compiled.prepare()
            compiled.prepare()  # the second finds nothing to do

    first, second = both(Raw(), interpreted, case)
    assert all(
        np.allclose(a.command, b.command, atol=EXACT) for a, b in zip(first, second, strict=True)
    )
    counted = Counter(codes)
    assert counted.keys() == {Code.DECIDED, Code.NOT_MEASURED, Code.NOT_STEADY}
    assert counted[Code.NOT_MEASURED] == len(case.lost)
    assert raw.general.compilation.interpreted_cycles == CYCLES - counted[Code.DECIDED]


BLANK = Step(*[None] * 10)


def test_who_leaves_prepare_out_gets_it_done():
    case = CASES["three axes"]
    lazy, interpreted = controllers(case, "daqp")
    lazy.prepare = lambda: None
    assert_same(*both(lazy, interpreted, case))


def test_a_state_that_someone_sets_is_taken():
    case = CASES["three axes"]
    compiled, interpreted = controllers(case, "daqp")

    def shove(controller: ForceController, k: int) -> None:
        if k % 50 == 49:
            controller.general.observer.state[0] += 0.5
        if k % 70 == 69:
            controller.general.command[1] = 3.0

    assert_same(*both(compiled, interpreted, replace(case, change=shove)))


def test_a_step_keeps_its_numbers():
    case = CASES["three axes"]
    compiled, _ = controllers(case, "daqp")
    steps = closed_loop(compiled, case, 20)
    kept = [steps[3].command.copy(), steps[3].decision.copy(), steps[3].residuals]
    closed_loop(compiled, case, 20)
    assert np.array_equal(kept[0], steps[3].command)
    assert np.array_equal(kept[1], steps[3].decision)
    assert kept[2] == steps[3].residuals
    assert steps[3].times.step > steps[3].times.solve > 0
    assert steps[3].times.update > 0
    assert steps[3].iterations >= 3
    assert "solved" in repr(steps[3])


def test_shapes_are_checked():
    compiled, _ = controllers(CASES["three axes"], "daqp")
    general = compiled.general
    with pytest.raises(ValueError, match="broadcast"):
        general.compiled.step(np.zeros(5), np.zeros((9, 3)))
    for measurement, preview in (
        (np.zeros(5), (9, 3)),
        (np.zeros(6), (8, 3)),
        (np.zeros(6), (9, 1)),
    ):
        with pytest.raises(Exception, match="must have shape"):
            general.step(measurement, np.zeros(preview))


def test_measurements_of_any_layout_are_taken():
    compiled, interpreted = controllers(CASES["three axes"], "daqp")
    preview = np.asfortranarray(np.tile([0.5, 1.0, -10.0], (9, 1)))
    wide = np.zeros(12)
    wide[::2] = [0.4, 0.01, 1.2, 0.0, -9.0, -0.02]
    for controller in (compiled, interpreted):
        controller.reset(np.array([0.5, 1.0, -10.0]))
    a = compiled.general.step(wide[::2], preview)
    b = interpreted.general.step(wide[::2].copy(), np.ascontiguousarray(preview))
    assert np.allclose(a.command, b.command, atol=EXACT)


def test_a_preview_that_is_not_finite_is_handed_over():
    compiled, interpreted = controllers(CASES["three axes"], "daqp")
    preview = np.tile([0.5, 1.0, -10.0], (9, 1))
    preview[4, 1] = np.nan
    steps = []
    for controller in (compiled, interpreted):
        controller.reset(preview[0])
        steps.append([controller.step(preview[0], np.zeros(3), preview) for _ in range(3)])
    assert_same(*steps)
    assert compiled.general.compilation.interpreted_cycles == 3


# ---- limits and deadlines


def test_a_limit_of_iterations_is_kept_by_each_group():
    case = Case(config(solver=SolverConfig(max_iterations=2)))
    compiled, _ = controllers(case, "daqp")
    steps = closed_loop(compiled, case)
    handed = compiled.general.compilation.interpreted_cycles
    assert 20 < handed < CYCLES
    assert Status.ITERATION_LIMIT in {step.status for step in steps}


def test_no_time_left_is_late():
    compiled, interpreted = controllers(CASES["three axes"], "daqp")
    goal = np.tile([0.5, 1.0, -10.0], (9, 1))
    outcomes = []
    for controller in (compiled, interpreted):
        controller.reset(goal[0])
        steps = [controller.step(goal[0], np.zeros(3), goal)]
        steps += [controller.step(goal[0], np.zeros(3), goal, deadline=d) for d in (0.0, -1.0)]
        steps.append(controller.step(goal[0], np.zeros(3), goal, deadline=10.0))
        outcomes.append(steps)
    assert_same(*outcomes)
    assert [s.status for s in outcomes[0]] == [
        Status.SOLVED, Status.LATE, Status.LATE, Status.SOLVED,
    ]  # fmt: skip
    compiled.general.compiled.step(compiled.measured(goal[0], np.zeros(3)), goal, 1e-9)
    assert compiled.general.compilation.interpreted_cycles == 3


# ---- any linear model


def generic(
    seed: int, shape: tuple[int, int, int, int, int], *, hard: bool, coupled: bool, compiled: str
) -> Controller:
    """A stable random model with a hard or soft output bound, command and rate bounds."""
    n, n_u, n_y, horizon, moves = shape
    rng = np.random.default_rng(seed)

    def model() -> LinearModel:
        A = rng.normal(size=(n, n))
        A *= rng.uniform(0.5, 0.99) / np.abs(np.linalg.eigvals(A)).max()
        return LinearModel(A, rng.normal(size=(n, n_u)), rng.normal(size=(n_y, n)), 0.1)

    whole = model() if coupled else stack([model(), model()])
    n, n_u, n_y = whole.n_states, whole.n_inputs, whole.n_outputs
    read = rng.normal(size=(n_y, n)) * (whole.C != 0)
    problem = Problem(
        whole,
        horizon,
        control_horizon=moves,
        output_weight=rng.uniform(0.1, 2.0, n_y),
        increment_weight=rng.uniform(0.01, 0.5, n_u),
        bounds=[
            CommandBound(-rng.uniform(0.3, 2, n_u), rng.uniform(0.3, 2, n_u)),
            RateBound(-rng.uniform(0.1, 1, n_u), np.inf),
            OutputBound(
                "soft", read, -0.5, rng.uniform(0.2, 1.0, n_y), 3.0, rng.choice([0.0, 2.0])
            ),
            OutputBound(
                "hard", whole.C, -0.8 if hard else -np.inf, 9.0 if hard else np.inf, np.inf
            ),
        ],
    )
    observer = KalmanObserver(whole, whole.C, np.eye(n), 0.1 * np.eye(n_y))
    reference = ExponentialReference(horizon, n_y, 0.1, rng.choice([0.0, 0.3]))
    return Controller(problem, observer, reference, compiled=compiled)


SHAPES = [(3, 2, 2, 5, 5), (4, 1, 2, 7, 3), (2, 3, 1, 3, 2)]


@settings(max_examples=25, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    seed=st.integers(0, 2**32 - 1),
    shape=st.sampled_from(SHAPES),
    hard=st.booleans(),
    coupled=st.booleans(),
)
def test_any_model_is_controlled_alike(seed, shape, hard, coupled):
    both = [generic(seed, shape, hard=hard, coupled=coupled, compiled=c) for c in ("on", "off")]
    runs = []
    for controller in both:
        rng, model = np.random.default_rng(seed), controller.problem.model
        x, steps = rng.normal(size=model.n_states), []
        horizon = controller.problem.horizon
        for k in range(25):
            goal = np.full((horizon + 1, model.n_outputs), np.sin(k / 3))
            step = controller.step(model.C @ x + 0.01 * rng.normal(size=model.n_outputs), goal)
            steps.append(step)
            x = model.A @ x + model.B @ step.command + 0.3 * rng.normal(size=model.n_states)
            controller.prepare()
        runs.append(steps)
    assert_same(*runs)


def test_hard_bounds_that_cannot_hold_go_to_the_fallback():
    both = [generic(3, SHAPES[0], hard=True, coupled=True, compiled=c) for c in ("on", "off")]
    runs = []
    for controller in both:
        steps = []
        for k in range(40):
            far = np.full(2, 80.0 if 10 < k < 25 else 0.1)
            steps.append(controller.step(-far, np.zeros((6, 2))))
            controller.prepare()
        runs.append(steps)
    assert_same(*runs)
    assert Status.INFEASIBLE in {step.status for step in runs[0]}
    assert both[0].compilation.interpreted_cycles == sum(
        step.status is Status.INFEASIBLE for step in runs[0]
    )


# ---- where there is none


class Slower(DaqpBackend):
    """A backend of someone's own, made from one that has a compiled form."""

    name = "slower"

    def solve(self, q, low, high):
        return super().solve(q, low, high)


class Ramp(ExponentialReference):
    """A reference of someone's own."""


class Watched(KalmanObserver):
    """An observer of someone's own."""


def small(backend="daqp", *, reference=ExponentialReference, observer=KalmanObserver, **choice):
    model = LinearModel([[1, 0.1], [0, 1]], [[0], [0.1]], [[1, 0]], 0.1)
    problem = Problem(model, 3, output_weight=1.0, increment_weight=0.1)
    return Controller(
        problem,
        observer(model, np.eye(2), np.eye(2), np.eye(2)),
        reference(3, 1, 0.1, 0.0),
        backend,
        **choice,
    )


@pytest.mark.parametrize(
    ("choice", "reason"),
    [
        ({"backend": "piqp"}, "the backend has no compiled form"),
        ({"backend": Slower}, "the backend has no compiled form"),
        ({"reference": Ramp}, "the reference is a Ramp"),
        ({"observer": Watched}, "the observer is a Watched"),
        ({"limits": Limits(time=1e-3)}, "a limit of time is kept by the interpreted path"),
    ],
)
def test_what_cannot_be_compiled_is_interpreted_and_says_why(choice, reason):
    controller = small(**choice)
    assert controller.compiled is None
    assert (controller.compilation.used, controller.compilation.reason) == (False, reason)
    assert controller.step(np.zeros(2), np.ones((4, 1))).status is Status.SOLVED
    with pytest.raises(CompiledStepError, match=reason) as caught:
        small(**choice, compiled="on")
    assert caught.value.reason == reason


def test_off_is_off_and_other_words_are_errors():
    assert small(compiled="off").compilation.reason == "switched off"
    with pytest.raises(UnknownNameError, match="did you mean 'auto'"):
        small(compiled="auto ")


def test_without_a_compiler_it_is_interpreted_and_says_so(monkeypatch):
    monkeypatch.setenv("CC", "/nonexistent")
    controller = small()
    assert controller.compiled is None
    assert "no C compiler: looked for /nonexistent" in controller.compilation.reason
    with pytest.raises(CompiledStepError, match="no C compiler"):
        small(compiled="on")


def test_a_cache_that_must_not_be_used_is_not(monkeypatch, tmp_path):
    tmp_path.chmod(0o777)
    monkeypatch.setenv("PULSEMPC_CACHE", str(tmp_path))
    assert "others may write to it" in small().compilation.reason


def test_other_numbers_of_one_shape_need_no_compiler(monkeypatch, tmp_path):
    monkeypatch.setenv("PULSEMPC_CACHE", str(tmp_path / "own"))
    assert small().compiled.binary.compiled
    assert not small().compiled.binary.compiled
    model = LinearModel([[0.9, 0.2], [0, 0.5]], [[0.3], [0.1]], [[1, 1]], 0.1)
    other = Controller(
        Problem(model, 3, output_weight=7.0, increment_weight=0.4),
        KalmanObserver(model, np.eye(2), np.eye(2), np.eye(2)),
        ExponentialReference(3, 1, 0.1, 0.2),
    )
    assert not other.compiled.binary.compiled


def test_two_controllers_of_one_shape_do_not_share_memory():
    first, second = small(), small()
    goal = np.ones((4, 1))
    a = [first.step(np.zeros(2), goal).command[0] for _ in range(3)]
    b = [second.step(np.zeros(2), goal).command[0] for _ in range(3)]
    assert a == b


@pytest.mark.parametrize(
    ("known", "other"),
    [
        ("double *x, *xold, *lam,", "double *xold, *x, *lam,"),
        ("int n_active, iterations, sing_ind;", "int iterations, n_active, sing_ind;"),
        ("int cycle_tol, iter_limit;", "int iter_limit, cycle_tol;"),
        ("double *rho_ls, *rho_us,", "double *rho_us, *rho_ls,"),
        ("int *prox_mask;", "void *more; int *prox_mask;"),
    ],
)
def test_a_daqp_that_lays_out_its_memory_otherwise_is_not_called(known, other, monkeypatch):
    def text(name: str) -> str:
        found = c_text(name)
        assert name != "daqp_abi.h" or known in found
        return found.replace(known, other)

    monkeypatch.setattr(daqp_form, "c_text", text)
    controller = small()
    assert controller.compiled is None
    assert "lays out its memory in another way" in controller.compilation.reason


# ---- memory


def test_nothing_is_allocated():
    compiled, _ = controllers(CASES["three axes"], "daqp")
    general = compiled.general
    step, prepare = general.compiled.step, general.compiled.prepare
    measurement, preview = np.array([0.5, 0, 1, 0, -10, 0.0]), np.tile([0.5, 1, -10.0], (9, 1))
    for _ in range(100):
        step(measurement, preview)
        prepare()
    tracemalloc.start()
    before = tracemalloc.take_snapshot()
    for _ in range(20_000):
        step(measurement, preview)
        prepare()
    after = tracemalloc.take_snapshot()
    tracemalloc.stop()
    grown = [d for d in after.compare_to(before, "filename") if "tracemalloc" not in str(d)]
    assert sum(d.size_diff for d in grown) < 2000
