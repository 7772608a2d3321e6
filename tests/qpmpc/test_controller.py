from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    Backend,
    CommandBound,
    ContactModel,
    Controller,
    ExponentialReference,
    KalmanObserver,
    Limits,
    LinearModel,
    OutputBound,
    Problem,
    RateBound,
    RawSolution,
    ShapeError,
    Source,
    Status,
    Step,
    available,
    constant,
    contact_model,
    stack,
    with_delay,
    with_disturbance,
)
from qpmpc.backends import backend_class
from qpmpc.backends.daqp import DaqpBackend

PERIOD, N, DELAY = 1e-3, 8, 1
KINDS = [
    backend_class(info.name)
    for info in available()
    if info.version is not None and ":" not in info.name  # families: see test_backends.py
]
backends = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
heeding = pytest.mark.parametrize(
    "kind", [kind for kind in KINDS if kind.heeds_rows], ids=lambda kind: kind.name
)


@dataclass(frozen=True, eq=False)
class Axis:
    """Delayed contact with a matched disturbance, of which force and tool velocity are seen."""

    contact: ContactModel
    model: LinearModel
    rows: np.ndarray

    def bounds(self, **wanted: Any) -> list[Any]:
        made = {
            "command": CommandBound,
            "rate": RateBound,
            "force": lambda low, high: OutputBound("force", self.model.C, low, high, 100.0),
            "velocity": lambda low, high: OutputBound("velocity", self.rows[1:], low, high, 1e4),
        }
        return [made[name](*interval) for name, interval in wanted.items()]

    def controller(
        self, kind: type[Backend] | str = "analytic", *, decision: str = "increment", **bounds: Any
    ) -> Controller:
        problem = Problem(
            self.model,
            N,
            output_weight=1.0,
            increment_weight=0.003,
            bounds=self.bounds(**bounds),
            decision=decision,
        )
        noise = np.diag([1e-6, 1e-6, 0.0, 0.5]) ** 2
        observer = KalmanObserver(self.model, self.rows, noise, np.diag([0.003, 1e-4]) ** 2)
        return Controller(problem, observer, ExponentialReference(N, 1, PERIOD, 0.01), kind)


@pytest.fixture
def axis() -> Axis:
    contact = contact_model(1000.0, 20.0, PERIOD)
    model = with_disturbance(with_delay(contact.model, DELAY), contact.load, constant())
    return Axis(contact, model, np.eye(model.n_states)[:2])


@dataclass(frozen=True, eq=False)
class Run:
    steps: list[Step]
    force: np.ndarray
    velocity: np.ndarray

    @property
    def commands(self) -> np.ndarray:
        return np.array([s.command[0] for s in self.steps])


def preview(setpoint: float) -> np.ndarray:
    return np.full((N + 1, 1), setpoint)


def run(
    axis: Axis,
    controller: Controller,
    cycles: int,
    setpoint: float = 3.0,
    *,
    disturbance: Callable[[int], float] = lambda k: 0.0,
    start: float = 2.0,
    after: Callable[[Controller], None] = Controller.prepare,
) -> Run:
    """Close the loop on the model's own plant, begun at rest with the estimate right."""
    x = np.array([start, *np.zeros(axis.model.n_states - 1)])
    controller.reset(x)
    steps, force, velocity = [], [], []
    for k in range(cycles):
        x[-1] = disturbance(k)
        force.append(x[0])
        velocity.append(x[1])
        step = controller.step(x[:2].copy(), preview(setpoint))
        x = axis.model.A @ x + axis.model.B @ step.command
        after(controller)
        steps.append(step)
    return Run(steps, np.array(force), np.array(velocity))


def beat(k: int) -> float:
    return 12.0 * np.sin(2 * np.pi * 3 * k * PERIOD) + 6.0 * np.sin(2 * np.pi * 11 * k * PERIOD)


# ---- one step


@backends
@pytest.mark.parametrize("decision", ["increment", "absolute"])
def test_one_step_is_the_formula_of_the_paper(
    rng: np.random.Generator, axis: Axis, kind: type[Backend], decision: str
) -> None:
    controller = axis.controller(kind, decision=decision)
    estimate, previous = rng.standard_normal(4), rng.standard_normal(1)
    measured, s = rng.standard_normal(2), rng.standard_normal((N + 1, 1))
    controller.reset(estimate, previous)
    step = controller.step(measured, s)

    x = estimate + controller.observer.gain @ (measured - axis.rows @ estimate)
    alpha = np.exp(-PERIOD / 0.01) ** np.arange(1, N + 1)
    w = s[1:, 0] - alpha * (s[0, 0] - x[0])
    p = controller.problem.prediction
    free = p.Psi @ x + p.Upsilon @ previous
    z = np.linalg.solve(p.Theta.T @ p.Theta + 0.003 * np.eye(N), p.Theta.T @ (w - free))
    u = z[0] + (previous[0] if decision == "increment" else 0.0)
    np.testing.assert_allclose(step.decision[:, 0], z, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(step.command, [u], rtol=1e-6)
    np.testing.assert_allclose(step.predicted[:, 0], free + p.Theta @ z, rtol=1e-8)
    assert step.decision.shape == step.predicted.shape == (N, 1)
    assert step.status is Status.SOLVED
    np.testing.assert_array_equal(controller.command, step.command)


@backends
def test_prepare_may_be_left_out_or_called_twice(axis: Axis, kind: type[Backend]) -> None:
    def never(controller: Controller) -> None:
        """Leave it to the next step."""

    def twice(controller: Controller) -> None:
        controller.prepare()
        controller.prepare()

    commands = [
        run(axis, axis.controller(kind), 60, disturbance=beat, after=after).commands
        for after in (Controller.prepare, never, twice)
    ]
    np.testing.assert_array_equal(commands[0], commands[1])
    np.testing.assert_array_equal(commands[0], commands[2])


def test_limits_and_least_part_reach_the_solver(axis: Axis, liar: Any) -> None:
    given: list[Limits] = []
    kind = liar(lambda q, l, u: (-q, np.zeros(l.size)))  # noqa: E741
    kind.limits = frozenset(("iterations", "time"))

    class Seen(kind):  # type: ignore[misc, valid-type]
        def __init__(self, qp: Any, limits: Limits) -> None:
            super().__init__(qp, limits)
            given.append(limits)

    whole = axis.controller()
    parts = [whole.problem, whole.observer, whole.reference]
    Controller(*parts, Seen, Limits(7, 0.5))
    assert given == [Limits(7, 0.5)]
    problem = Problem(
        stack([axis.model] * 2),
        N,
        output_weight=1.0,
        increment_weight=0.003,
        bounds=[CommandBound(-1.0, 1.0)],  # or the increments that come too late stand alone
    )
    noise, rows = np.eye(8), np.kron(np.eye(2), axis.rows)
    observer = KalmanObserver(problem.model, rows, noise, np.eye(4))
    reference = ExponentialReference(N, 2, PERIOD, 0.01)
    for smallest, count in ((100, 1), (8, 2), (1, 2), (None, 2)):
        controller = Controller(problem, observer, reference, Seen, smallest_part=smallest)
        assert controller.solver.parts == count


def test_arrays_of_a_step_are_its_own(axis: Axis) -> None:
    controller = axis.controller(command=(-5.0, 5.0), force=(1.0, 2.5), velocity=(-0.01, 0.01))
    controller.reset([2.0, 0, 0, 0])
    step = controller.step(np.array([2.0, 0.05]), preview(9.0))
    arrays = [step.command, step.decision, step.predicted, *step.slack.values()]
    before = [a.copy() for a in arrays]
    for k in range(5):
        controller.step(np.array([1.0 + k, -0.05]), preview(-9.0))
    for a, b in zip(arrays, before, strict=True):
        np.testing.assert_array_equal(a, b)


def test_measurement_and_preview_are_left_as_they_are(axis: Axis) -> None:
    controller, measured, s = axis.controller(), np.array([2.0, 0.05]), preview(3.0)
    controller.step(measured, s)
    np.testing.assert_array_equal(measured, [2.0, 0.05])
    np.testing.assert_array_equal(s, preview(3.0))


@pytest.mark.parametrize(
    ("measured", "previewed", "argument"),
    [((1,), (N + 1, 1), "measurement"), ((2,), (2, 1), "preview"), ((2,), (N + 1,), "preview")],
)
def test_another_shape_is_refused_and_not_broadcast(
    axis: Axis, measured: tuple[int, ...], previewed: tuple[int, ...], argument: str
) -> None:
    with pytest.raises(ShapeError, match=argument):
        axis.controller().step(np.zeros(measured), np.zeros(previewed))


def test_reset_forgets_everything(axis: Axis) -> None:
    controller = axis.controller()
    first = run(axis, controller, 40, disturbance=beat).commands
    again = run(axis, controller, 40, disturbance=beat).commands
    np.testing.assert_array_equal(first, again)


def test_reset_takes_the_command_applied_so_far(axis: Axis) -> None:
    controller = axis.controller(rate=(-0.5, 0.5))
    controller.reset([2.0, 0, 7.0, 0], 7.0)
    step = controller.step(np.array([2.0, 0.0]), preview(-50.0))
    assert step.command[0] == pytest.approx(6.5)


def test_begins_from_the_state_of_the_observer(axis: Axis) -> None:
    controller = axis.controller()
    controller.observer.reset([2.0, 0.1, 0.0, 5.0])
    again = Controller(controller.problem, controller.observer, controller.reference, "analytic")
    np.testing.assert_array_equal(again.observer.state, [2.0, 0.1, 0.0, 5.0])


def test_times_are_ordered_and_cover_the_step(axis: Axis) -> None:
    times = run(axis, axis.controller(), 1).steps[0].times
    assert 0 < times.solve < times.step
    assert 0 < times.update < times.step
    assert times.update + times.solve <= times.step


def test_texts(axis: Axis) -> None:
    controller = axis.controller()
    assert "backend='analytic'" in repr(controller)
    assert "horizon=8" in repr(controller)
    assert repr(run(axis, controller, 1).steps[0]).startswith("Step(solved, command=[")


# ---- closed loop


@backends
def test_set_point_is_reached_without_offset(axis: Axis, kind: type[Backend]) -> None:
    result = run(axis, axis.controller(kind, command=(-20.0, 20.0)), 400, 3.0)
    assert result.force[-1] == pytest.approx(3.0, abs=1e-6)
    assert result.force.max() < 3.0 + 0.05
    assert all(s.status is Status.SOLVED for s in result.steps)


@backends
def test_disturbance_is_rejected(axis: Axis, kind: type[Backend]) -> None:
    still = run(axis, axis.controller(kind), 600, 2.0, disturbance=lambda k: 8.0)
    assert still.force[-1] == pytest.approx(2.0, abs=1e-5)
    assert still.commands[-1] == pytest.approx(-8.0, rel=1e-5)
    moving = run(axis, axis.controller(kind), 1000, 2.0, disturbance=beat)
    left_alone = axis.controller(command=(0.0, 0.0))
    alone = run(axis, left_alone, 1000, 2.0, disturbance=beat)
    assert not alone.commands.any()
    assert np.abs(moving.force[200:] - 2.0).max() < 0.01 * np.abs(alone.force[200:] - 2.0).max()


@backends
def test_backends_act_alike_where_no_bound_is_met(axis: Axis, kind: type[Backend]) -> None:
    wide = {"command": (-1e3, 1e3), "force": (-1e3, 1e3), "velocity": (-1e2, 1e2)}
    ours = run(axis, axis.controller(kind, **wide), 80, disturbance=beat).commands
    closed = run(axis, axis.controller("analytic"), 80, disturbance=beat).commands
    np.testing.assert_allclose(ours, closed, rtol=1e-6, atol=1e-6)


@backends
def test_command_and_rate_bounds_are_never_left(axis: Axis, kind: type[Backend]) -> None:
    bounds = {"command": (-6.0, 9.0), "rate": (-1.0, 2.0)}
    controller = axis.controller(kind, **bounds, force=(1.0, 3.0), velocity=(-0.05, 0.05))
    result = run(axis, controller, 300, 3.0, disturbance=beat)
    rates = np.diff(np.concatenate([[0.0], result.commands]))
    assert result.commands.min() >= -6.0
    assert result.commands.max() <= 9.0
    assert rates.min() >= -1.0 - 1e-14
    assert rates.max() <= 2.0 + 1e-14
    assert np.isclose(result.commands, -6.0).any()
    assert np.isclose(rates, -1.0).any()


@heeding
def test_force_bound_is_kept_where_it_can_be(axis: Axis, kind: type[Backend]) -> None:
    bounds = {"command": (-200.0, 200.0), "force": (0.5, 4.0)}  # strong enough to stop in time
    free = run(axis, axis.controller(kind, command=(-200.0, 200.0)), 300, 6.0)
    kept = run(axis, axis.controller(kind, **bounds), 300, 6.0)
    assert free.force.max() > 5.5
    assert kept.force.max() <= 4.0 + 1e-6
    assert kept.force[-1] == pytest.approx(4.0, abs=1e-3)
    assert all(s.status is Status.SOLVED for s in kept.steps)
    low = run(axis, axis.controller(kind, **bounds), 300, -3.0)
    assert low.force.min() >= 0.5 - 1e-6


@heeding
def test_velocity_bound_is_kept_where_it_can_be(axis: Axis, kind: type[Backend]) -> None:
    limit = 0.02
    free = run(axis, axis.controller(kind), 150, 6.0)
    kept = run(axis, axis.controller(kind, velocity=(-limit, limit)), 150, 6.0)
    assert np.abs(free.velocity).max() > 2 * limit
    assert np.abs(kept.velocity).max() <= limit + 1e-7
    assert np.isclose(kept.velocity, limit, atol=1e-5).sum() > 20


@heeding
def test_bound_that_cannot_be_kept_gives_way_and_the_step_says_by_how_much(
    axis: Axis, kind: type[Backend]
) -> None:
    controller = axis.controller(kind, command=(-20.0, 20.0), force=(0.5, 4.0))
    controller.reset([5.0, 0, 0, 0])
    step = controller.step(np.array([5.0, 0.0]), preview(3.0))
    assert step.status is Status.SOLVED
    assert step.slack["command"].max() < 1e-6
    beyond = np.maximum(step.predicted[DELAY:, 0] - 4.0, 0.0)
    np.testing.assert_allclose(step.slack["force"], beyond, atol=1e-6)
    assert beyond[0] > 0.5
    assert step.command[0] < -10


# ---- statuses


@pytest.mark.parametrize(("setpoint", "command"), [(50.0, 5.0), (-50.0, -4.0)])
def test_clipped_is_said(axis: Axis, setpoint: float, command: float) -> None:
    controller = axis.controller("analytic", command=(-4.0, 5.0))
    controller.reset([2.0, 0, 0, 0])
    step = controller.step(np.array([2.0, 0.0]), preview(setpoint))
    assert step.status is Status.CLIPPED
    assert step.command[0] == command
    assert step.slack["command"].max() > 0


def test_inaccurate_answer_is_clipped_but_stays_inaccurate(axis: Axis) -> None:
    class Nearly(DaqpBackend):
        def solve(self, q: Any, l: Any, u: Any) -> RawSolution:  # noqa: E741
            raw = super().solve(q, l, u)
            raw.x = raw.x + 1e-4
            return raw

    controller = axis.controller(Nearly, command=(-4.0, 5.0))
    controller.reset([2.0, 0, 0, 0])
    step = controller.step(np.array([2.0, 0.0]), preview(50.0))
    assert step.status is Status.INACCURATE
    assert step.source is Source.SOLUTION
    assert step.decision[0, 0] > 5.0
    assert step.command[0] == 5.0


@pytest.mark.parametrize(
    "status", [Status.FAILED, Status.ITERATION_LIMIT, Status.INFEASIBLE, Status.UNBOUNDED]
)
def test_a_solve_without_an_answer_is_told_and_stood_in_for(
    axis: Axis, liar: Any, status: Status
) -> None:
    kind = liar(lambda q, l, u: (np.ones(N), np.zeros(l.size)), status)  # noqa: E741
    controller = axis.controller(kind, command=(-20.0, 20.0))
    controller.reset([2.0, 0, 3.0, 0], 3.0)
    step = controller.step(np.array([2.0, 0.0]), preview(2.1))
    assert step.status is status
    assert step.source is Source.ANALYTIC
    closed = np.linalg.solve(controller.problem.qp.P, -controller.problem.q)
    np.testing.assert_allclose(step.command, 3.0 + closed[:1], rtol=1e-9)
    expected = controller.problem.free + controller.problem.prediction.Theta @ closed
    np.testing.assert_allclose(step.predicted[:, 0], expected, rtol=1e-9)
    assert controller.command[0] == step.command[0]


def test_a_wrong_answer_is_not_applied(axis: Axis, liar: Any) -> None:
    kind = liar(lambda q, l, u: (np.full(N, 1e3), np.zeros(l.size)))  # noqa: E741
    step = axis.controller(kind).step(np.array([2.0, 0.0]), preview(2.0))
    assert step.status is Status.INACCURATE
    assert step.source is Source.ANALYTIC
    assert abs(step.command[0]) < 100.0


@heeding
@pytest.mark.parametrize("decision", ["increment", "absolute"])
def test_contradicting_hard_bounds_are_said_and_the_command_bound_wins(
    axis: Axis, kind: type[Backend], decision: str
) -> None:
    controller = axis.controller(kind, decision=decision, command=(-5.0, 5.0), rate=(-1.0, 1.0))
    controller.reset([2.0, 0, 90.0, 0], 90.0)
    measured = np.array([2.0, 0.0])
    step = controller.step(measured, preview(2.0))
    assert step.status is Status.INFEASIBLE
    assert step.source is Source.ANALYTIC
    assert step.command[0] == 5.0
    assert step.violation.max() > 1.0  # of the rate, by what stands in
    step = controller.step(measured, preview(2.0))
    assert (step.status, step.source) == (Status.SOLVED, Source.SOLUTION)


@pytest.mark.parametrize("previous", [0.7, 3.0, -8.0])
def test_command_held_is_held_within_the_bounds(axis: Axis, previous: float) -> None:
    controller = axis.controller("daqp", command=(-1.0, 1.0))
    controller.reset([2.0, 0, 0, 0], previous)
    step = controller.step(np.array([np.nan, 0.0]), preview(9.0))
    assert step.source is Source.HOLD
    assert step.command[0] == np.clip(previous, -1.0, 1.0)


@backends
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("entry", [0, 1])
def test_lost_measurement_is_bridged_by_the_plan_and_forgotten(
    axis: Axis, kind: type[Backend], value: float, entry: int
) -> None:
    """The observer goes on by prediction, so one lost cycle leaves no trace on its own model."""
    controller, lost = axis.controller(kind), 7
    x, planned = np.array([2.0, 0.0, 0.0, 0.0]), 0.0
    controller.reset(x)
    for k in range(30):
        measured = x[:2].copy()
        if k == lost:
            measured[entry] = value
        step = controller.step(measured, preview(3.0))
        controller.prepare()
        x = axis.model.A @ x + axis.model.B @ step.command
        assert step.status is (Status.FAILED if k == lost else Status.SOLVED)
        assert step.source is (Source.PLAN if k == lost else Source.SOLUTION)
        if k == lost:
            assert step.command[0] == pytest.approx(planned, rel=1e-9)
        np.testing.assert_allclose(controller.observer.state, x, atol=1e-9)
        planned = step.command[0] + step.decision[1, 0]


@backends
def test_lost_set_point_holds_the_command(axis: Axis, kind: type[Backend]) -> None:
    controller = axis.controller(kind)
    controller.reset([2.0, 0, 3.0, 0], 3.0)
    broken = preview(2.0)
    broken[4] = np.nan
    step = controller.step(np.array([2.0, 0.0]), broken)
    assert step.status is Status.FAILED
    assert step.source is Source.HOLD
    assert step.command[0] == 3.0
    assert controller.step(np.array([2.0, 0.0]), preview(2.0)).status is Status.SOLVED


def test_any_class_with_the_members_will_do(axis: Axis) -> None:
    class Still(Backend):
        name, package, summary, heeds_rows = "still", "numpy", "moves nothing", False

        def __init__(self, qp: Any, limits: Any) -> None:
            self.n, self.m = qp.n, qp.m

        def solve(self, q: Any, l: Any, u: Any) -> RawSolution:  # noqa: E741
            return RawSolution(Status.SOLVED, np.zeros(self.n), np.zeros(self.m), 0)

    result = run(axis, axis.controller(Still, command=(-1.0, 1.0)), 5, 9.0)
    np.testing.assert_array_equal(result.commands, np.zeros(5))
