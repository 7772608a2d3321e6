# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""What is applied where a solve gives nothing: the plan, the clipped closed form, the command."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    CommandBound,
    Controller,
    ExponentialReference,
    KalmanObserver,
    LinearModel,
    OutputBound,
    Problem,
    RateBound,
    RawSolution,
    Source,
    Status,
    Step,
    constant,
    contact_model,
    stack,
    with_delay,
    with_disturbance,
)
from qpmpc.backends.daqp import DaqpBackend
from qpmpc.fallback import Fallback

PERIOD, N, DELAY = 1e-3, 8, 1
COMMAND, RATE = 20.0, 4.0
decisions = pytest.mark.parametrize("decision", ["increment", "absolute"])
moves = pytest.mark.parametrize("N_u", [1, 3, N])
INF = np.inf


class Flaky(DaqpBackend):
    """DAQP, until it is told to end otherwise."""

    status: Status | None = None

    def solve(self, q: np.ndarray, l: np.ndarray, u: np.ndarray) -> RawSolution:
        raw = super().solve(q, l, u)
        if type(self).status is not None:
            raw.status, raw.x = type(self).status, np.full(q.size, 1e3)
        return raw


@dataclass(eq=False)
class Loop:
    """A controller on its own model's plant; the backend fails on demand."""

    controller: Controller
    kind: type[Flaky]
    model: LinearModel
    x: np.ndarray
    goal: float = 3.0

    def cycle(self, *, fail: Status | None = None, lost: bool = False) -> Step:
        """One cycle; ``lost``: the force is NaN."""
        self.kind.status = fail
        measured = self.x.reshape(self.model.n_inputs, -1)[:, :2].ravel().copy()
        if lost:
            measured[0] = np.nan
        step = self.controller.step(measured, np.full((N + 1, self.model.n_outputs), self.goal))
        self.x = self.model.A @ self.x + self.model.B @ step.command
        self.controller.prepare()
        return step

    def closed_form(self, previous: np.ndarray) -> np.ndarray:
        problem = self.controller.problem
        decision = np.linalg.solve(problem.qp.P, -problem.q)
        return problem.command(decision, previous)


@pytest.fixture
def loop() -> Callable[..., Loop]:
    def make(
        *,
        decision: Any = "increment",
        N_u: int = N,
        axes: int = 1,
        start: float = 2.0,
        **bounds: Any,
    ) -> Loop:
        contact = contact_model(1000.0, 20.0, PERIOD)
        one = with_disturbance(with_delay(contact.model, DELAY), contact.load, constant())
        model = stack([one] * axes)
        command = bounds.get("command", (-COMMAND, COMMAND))
        rate = bounds.get("rate", (-INF, INF))
        problem = Problem(
            model,
            N,
            output_weight=1.0,
            increment_weight=0.003,
            control_horizon=N_u,
            decision=decision,
            bounds=[
                CommandBound(*command, moving=True),
                RateBound(*rate, moving=True),
                OutputBound("force", model.C, *bounds.get("force", (-50.0, 50.0)), 100.0),
            ],
        )
        rows = np.kron(np.eye(axes), np.eye(one.n_states)[:2])
        noise = np.diag(np.tile([1e-6, 1e-6, 0.0, 0.5], axes)) ** 2
        observer = KalmanObserver(model, rows, noise, np.diag(np.tile([3e-3, 1e-4], axes)) ** 2)
        kind = type("Flaky", (Flaky,), {})
        reference = ExponentialReference(N, axes, PERIOD, 0.01)
        controller = Controller(problem, observer, reference, kind)
        x = np.zeros((axes, one.n_states))
        x[:, 0] = start + 0.3 * np.arange(axes)
        controller.reset(x.ravel())
        return Loop(controller, kind, model, x.ravel())

    return make


def plan_of(step: Step, previous: np.ndarray, decision: str) -> np.ndarray:
    """Commands u(k) ... u(k+N_u-1) that a step decided."""
    if decision == "absolute":
        return step.decision
    return previous + np.cumsum(step.decision, axis=0)


FAILURES = [Status.FAILED, Status.INFEASIBLE, Status.UNBOUNDED, Status.ITERATION_LIMIT]


# ---- the chain


@decisions
@moves
@pytest.mark.parametrize("axes", [1, 3])
@pytest.mark.parametrize("status", FAILURES)
def test_plan_goes_on_then_the_closed_form(
    loop: Any, decision: str, N_u: int, axes: int, status: Status
) -> None:
    run = loop(decision=decision, N_u=N_u, axes=axes)
    run.cycle()
    previous = run.controller.command.copy()
    good = run.cycle()
    plan = plan_of(good, previous, decision)
    assert good.source is Source.SOLUTION
    np.testing.assert_allclose(good.command, plan[0], rtol=1e-12)
    for planned in plan[1:]:
        step = run.cycle(fail=status)
        assert (step.status, step.source) == (status, Source.PLAN)
        np.testing.assert_allclose(step.command, planned, rtol=1e-12)
    for _ in range(3):
        previous = run.controller.command.copy()
        step = run.cycle(fail=status)
        assert (step.status, step.source) == (status, Source.ANALYTIC)
        np.testing.assert_allclose(step.command, run.closed_form(previous), rtol=1e-9)
    assert run.cycle().source is Source.SOLUTION


@decisions
def test_without_measurements_the_plan_goes_on_then_the_command_is_held(
    loop: Any, decision: str
) -> None:
    run = loop(decision=decision, N_u=4)
    run.cycle()
    previous = run.controller.command.copy()
    plan = plan_of(run.cycle(), previous, decision)
    for planned in plan[1:]:
        step = run.cycle(lost=True)
        assert (step.status, step.source) == (Status.FAILED, Source.PLAN)
        np.testing.assert_allclose(step.command, planned, rtol=1e-12)
    for _ in range(4):
        step = run.cycle(lost=True)
        assert (step.status, step.source) == (Status.FAILED, Source.HOLD)
        np.testing.assert_allclose(step.command, plan[-1], rtol=1e-12)
    measured = run.cycle(fail=Status.FAILED)  # seen again, but not solved
    assert measured.source is Source.ANALYTIC


def test_first_cycle_has_no_plan(loop: Any) -> None:
    assert loop().cycle(fail=Status.FAILED).source is Source.ANALYTIC
    lost = loop().cycle(lost=True)
    assert lost.source is Source.HOLD
    np.testing.assert_array_equal(lost.command, [0.0])


def test_a_setpoint_that_is_lost_leaves_plan_or_command(loop: Any) -> None:
    run = loop(N_u=2)
    good = run.cycle()
    run.goal = np.nan
    steps = [run.cycle() for _ in range(3)]
    assert [s.source for s in steps] == [Source.PLAN, Source.HOLD, Source.HOLD]
    assert all(s.status is Status.FAILED for s in steps)
    np.testing.assert_allclose(steps[-1].command, good.decision.sum(axis=0), rtol=1e-12)
    run.goal = 3.0
    assert run.cycle().source is Source.SOLUTION


@decisions
def test_recovers_at_once_and_makes_a_new_plan(loop: Any, decision: str) -> None:
    run = loop(decision=decision, N_u=4)
    run.cycle()
    run.cycle(fail=Status.FAILED)
    run.cycle(fail=Status.FAILED)
    run.goal = 4.0
    previous = run.controller.command.copy()
    good = run.cycle()
    plan = plan_of(good, previous, decision)
    assert (good.status, good.source) == (Status.SOLVED, Source.SOLUTION)
    step = run.cycle(fail=Status.INFEASIBLE)
    assert step.source is Source.PLAN
    np.testing.assert_allclose(step.command, plan[1], rtol=1e-12)


def test_reset_forgets_the_plan(loop: Any) -> None:
    run = loop()
    run.cycle()
    run.controller.reset(run.x)
    assert run.cycle(fail=Status.FAILED).source is Source.ANALYTIC
    run.cycle()
    run.controller.reset(run.x, 1.5)
    step = run.cycle(lost=True)
    assert step.source is Source.HOLD
    np.testing.assert_array_equal(step.command, [1.5])


@decisions
def test_single_failures_hardly_matter(loop: Any, decision: str) -> None:
    """The plan is what the next solve would have decided, but for the end of its horizon."""
    good, flawed = loop(decision=decision), loop(decision=decision)
    for k in range(40):
        ours, theirs = flawed.cycle(fail=Status.FAILED if k % 8 == 7 else None), good.cycle()
        assert abs(ours.command - theirs.command)[0] < 2.0
    np.testing.assert_allclose(flawed.x[:2], good.x[:2], atol=0.01)


def test_an_answer_that_is_nearly_right_is_used_and_planned_on(loop: Any) -> None:
    run = loop()

    class Nearly(run.kind):  # type: ignore[misc]
        error = 1e-4

        def solve(self, q: np.ndarray, l: np.ndarray, u: np.ndarray) -> RawSolution:
            raw = DaqpBackend.solve(self, q, l, u)
            raw.x = raw.x + self.error
            return raw

    controller = Controller(
        run.controller.problem, run.controller.observer, run.controller.reference, Nearly
    )
    controller.reset(run.x)
    run.controller = controller
    step = run.cycle()
    assert (step.status, step.source) == (Status.INACCURATE, Source.SOLUTION)
    Nearly.error = 1.0  # no longer
    step = run.cycle()
    assert (step.status, step.source) == (Status.INACCURATE, Source.PLAN)


# ---- bounds on the command


@decisions
@pytest.mark.parametrize("seed", range(3))
def test_command_never_leaves_its_bounds_and_is_never_nan(
    loop: Any, decision: str, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    run = loop(decision=decision, N_u=5, axes=2, rate=(-RATE, RATE), force=(1.0, 4.0))
    previous, sources = np.zeros(2), set()
    for _ in range(150):
        run.goal = 10.0 * rng.standard_normal() if rng.random() < 0.1 else run.goal
        run.x[[0, 4]] += rng.standard_normal(2) * (rng.random() < 0.1)
        step = run.cycle(
            fail=rng.choice(FAILURES) if rng.random() < 0.8 else None, lost=rng.random() < 0.3
        )
        sources.add(step.source)
        assert np.isfinite(step.command).all()
        assert np.isfinite(step.decision).all()
        assert np.isfinite(step.predicted).all()
        assert np.abs(step.command).max() <= COMMAND
        assert np.abs(step.command - previous).max() <= RATE + 1e-12
        previous = step.command
    assert sources == set(Source)


def test_closed_form_is_clipped(loop: Any) -> None:
    run = loop(command=(-0.5, 0.25), start=2.0)
    run.goal = 30.0
    step = run.cycle(fail=Status.FAILED)
    assert step.source is Source.ANALYTIC
    np.testing.assert_array_equal(step.command, [0.25])
    run = loop(rate=(-0.125, 0.125))
    run.goal = -30.0
    np.testing.assert_array_equal(run.cycle(fail=Status.FAILED).command, [-0.125])


@decisions
def test_plan_and_command_held_follow_bounds_that_move(loop: Any, decision: str) -> None:
    run = loop(decision=decision, N_u=3)
    run.goal = 30.0
    good = run.cycle()
    assert good.command[0] > 2.0
    run.controller.problem.move("command", -1.0, 1.0)
    step = run.cycle(fail=Status.FAILED)
    assert step.source is Source.PLAN
    np.testing.assert_array_equal(step.command, [1.0])
    run.cycle(fail=Status.FAILED)
    run.controller.problem.move("command", -0.5, 0.5)
    step = run.cycle(lost=True)
    assert step.source is Source.HOLD
    np.testing.assert_array_equal(step.command, [0.5])
    run.controller.problem.move("command", -9.0, 9.0)
    run.controller.problem.move("rate", -0.25, 0.25)
    assert run.cycle(fail=Status.FAILED).command[0] == pytest.approx(0.75)


# ---- what the step tells


@decisions
@pytest.mark.parametrize("sort", ["plan", "analytic", "hold"])
def test_decision_and_prediction_are_those_of_the_command(
    loop: Any, decision: str, sort: str
) -> None:
    """The decision told begins with the command, and the model goes where it is predicted."""
    run = loop(decision=decision, N_u=4)
    if sort == "plan":
        run.cycle()
    step = run.cycle(fail=Status.FAILED, lost=sort == "hold")
    x = run.controller.observer.state.copy()  # after `prepare`: one cycle on
    assert step.source == sort
    previous = np.zeros(1) if sort != "plan" else None
    if decision == "absolute":
        np.testing.assert_allclose(step.decision[0], step.command, rtol=1e-12)
        commands = step.decision
    else:
        start = step.command - step.decision[0] if previous is None else previous
        commands = start + np.cumsum(step.decision, axis=0)
    np.testing.assert_allclose(commands[0], step.command, rtol=1e-9, atol=1e-12)
    held = np.vstack([commands, np.tile(commands[-1], (N - len(commands), 1))])
    expected = [float((run.model.C @ x)[0])]
    for u in held[1:]:
        x = run.model.A @ x + run.model.B @ u
        expected.append(float((run.model.C @ x)[0]))
    np.testing.assert_allclose(step.predicted[:, 0], expected, rtol=1e-9, atol=1e-9)


def test_a_plan_is_kept_as_it_was_made(loop: Any) -> None:
    """Neither the array that it came in nor the command that went out is the plan."""
    problem = loop(N_u=3).controller.problem
    fallback, decision = Fallback(problem), np.array([1.0, 2.0, 3.0])
    fallback.remember(decision, np.zeros(1))
    decision[:] = 9.0
    source, command, told = fallback.decide(np.array([1.0]), measured=True)
    assert source is Source.PLAN
    np.testing.assert_array_equal(command, [3.0])
    np.testing.assert_array_equal(told, [2.0, 3.0, 0.0])  # and stays there
    command[:] = 7.0
    np.testing.assert_array_equal(fallback.decide(np.array([3.0]), measured=True)[1], [6.0])
    fallback.forget()
    assert fallback.decide(np.array([3.0]), measured=False)[0] is Source.HOLD
