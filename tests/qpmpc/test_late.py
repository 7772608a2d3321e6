# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""A step whose answer is late: the earlier plan goes on, by a clock that the test holds."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qpmpc import (
    Controller,
    ControllerConfig,
    ForceController,
    QuadraticProgram,
    RawSolution,
    Source,
    Status,
    Step,
)
from qpmpc import controller as controller_module
from qpmpc.axis import axis_model
from qpmpc.backends.daqp import DaqpBackend
from qpmpc.errors import ModelError

PERIOD, N = 1e-3, 8
DEADLINE = 1e-3
QUICK, SLOW = 1e-4, 5e-3


class Clock:
    """Time stands still but where a solve lasts."""

    def __init__(self) -> None:
        self.now = 128.0

    def __call__(self) -> float:
        return self.now


class Timed(DaqpBackend):
    """DAQP whose solves last what they are told, by the test's clock."""

    name = "timed"
    clock: Clock
    lasts = QUICK
    calls = 0

    def solve(self, q: np.ndarray, l: np.ndarray, u: np.ndarray) -> RawSolution:
        raw = super().solve(q, l, u)
        cls = type(self)
        cls.calls += 1
        self.clock.now += cls.lasts
        return raw


class Loop:
    """One axis on its own model: the controller's next command, given how long solves last."""

    def __init__(self, kind: type[Timed], deadline: float | None = DEADLINE) -> None:
        base = ControllerConfig(horizon=N)
        force = ForceController(base, ("x",), PERIOD)
        self.rows = axis_model(base.model, base.observer, PERIOD).measured
        self.kind = kind
        self.controller = Controller(
            force.general.problem,
            force.general.observer,
            force.general.reference,
            kind,
            deadline=deadline,
        )
        self.model = self.controller.problem.model
        self.x = np.zeros(self.model.n_states)
        self.x[0] = 1.0
        self.controller.reset(self.x)
        self.goal = 3.0

    def cycle(self, lasts: float = QUICK, **given_: Any) -> Step:
        self.kind.lasts = lasts
        measured = self.rows @ self.x
        step = self.controller.step(measured, np.full((N + 1, 1), self.goal), **given_)
        self.x = self.model.A @ self.x + self.model.B @ step.command
        self.controller.prepare()
        return step


@pytest.fixture
def loop(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Loop]:
    clock = Clock()
    monkeypatch.setattr(controller_module, "perf_counter", clock)

    def make(**given_: Any) -> Loop:
        kind = type("Timed", (Timed,), {"clock": clock})
        made = Loop(kind, **given_)
        kind.calls = 0
        return made

    return make


def plan_of(step: Step, previous: np.ndarray) -> np.ndarray:
    return previous + np.cumsum(step.decision, axis=0)


def test_a_late_answer_is_not_applied_the_next_increment_of_the_plan_is(loop: Any) -> None:
    run = loop()
    run.cycle()
    previous = run.controller.command.copy()
    good = run.cycle()
    plan = plan_of(good, previous)
    assert (good.status, good.source) == (Status.SOLVED, Source.SOLUTION)
    run.goal = 9.0  # the answer that comes late is quite another
    for planned in plan[1:4]:
        step = run.cycle(SLOW)
        assert (step.status, step.source) == (Status.LATE, Source.PLAN)
        np.testing.assert_allclose(step.command, planned, rtol=1e-12)
        np.testing.assert_array_equal(run.controller.command, step.command)
        assert step.iterations > 0  # there was an answer, and what it took is told
        assert step.times.step == pytest.approx(SLOW)


def test_a_late_answer_makes_no_plan(loop: Any) -> None:
    """What goes on after it is the plan before it, to its end, then the closed form."""
    run = loop()
    previous = run.controller.command.copy()
    plan = plan_of(run.cycle(), previous)
    sources = []
    for k in range(1, N + 3):
        run.goal = 3.0 + k
        step = run.cycle(SLOW)
        sources.append(step.source)
        if k < N:
            np.testing.assert_allclose(step.command, plan[k], rtol=1e-12)
        else:
            problem = run.controller.problem
            decision = np.linalg.solve(problem.qp.P, -problem.q)
            assert step.decision.ravel() == pytest.approx(decision, rel=1e-9)
    assert sources == [Source.PLAN] * (N - 1) + [Source.ANALYTIC] * 3


def test_recovers_with_the_first_answer_in_time(loop: Any) -> None:
    """The observer was told what was applied: after it the loop is where it would have been."""
    run = loop()
    for _ in range(5):
        run.cycle()
    for _ in range(3):
        assert run.cycle(SLOW).status is Status.LATE
        np.testing.assert_allclose(run.controller.observer.state[:1], run.x[:1], atol=1e-9)
    after = run.cycle()
    assert (after.status, after.source) == (Status.SOLVED, Source.SOLUTION)
    for _ in range(400):
        after = run.cycle()
    assert after.source is Source.SOLUTION
    assert run.x[0] == pytest.approx(run.goal, abs=1e-3)


def test_a_first_cycle_that_is_late_has_the_closed_form(loop: Any) -> None:
    step = loop().cycle(SLOW)
    assert (step.status, step.source) == (Status.LATE, Source.ANALYTIC)


def test_the_deadline_itself_is_in_time_and_beyond_it_is_late(loop: Any) -> None:
    run = loop(deadline=0.5)  # numbers of base two: sums are exact
    assert run.cycle(0.5).status is Status.SOLVED
    assert run.cycle(0.500001).status is Status.LATE


def test_the_argument_takes_the_place_of_the_controllers_own(loop: Any) -> None:
    run = loop()
    assert run.cycle(SLOW, deadline=2 * SLOW).source is Source.SOLUTION
    assert run.cycle(QUICK, deadline=QUICK / 2).status is Status.LATE
    assert run.cycle(QUICK).source is Source.SOLUTION


@pytest.mark.parametrize("left", [-1e-9, -1.0, float("-inf")])
def test_with_nothing_left_no_solve_is_begun(loop: Any, left: float) -> None:
    run = loop()
    run.cycle()
    calls = run.kind.calls
    step = run.cycle(deadline=left)
    assert (step.status, step.source) == (Status.LATE, Source.PLAN)
    assert run.kind.calls == calls
    assert np.isnan(step.residuals.scaled)
    assert step.iterations == 0
    assert np.isfinite(step.command).all()
    assert np.isfinite(step.predicted).all()
    assert np.isfinite(step.violation).all()
    assert run.cycle().source is Source.SOLUTION


def test_without_a_deadline_no_clock_decides(loop: Any) -> None:
    run = loop(deadline=None)
    assert all(run.cycle(1e6).source is Source.SOLUTION for _ in range(3))


def test_without_a_measurement_the_status_tells_that_first(loop: Any) -> None:
    run = loop()
    run.cycle()
    run.controller.observer.patience = 0
    run.x[0] = np.nan
    step = run.cycle(SLOW)
    assert (step.status, step.source) == (Status.FAILED, Source.PLAN)


def test_an_answer_that_is_late_and_useless_counts_as_late(loop: Any) -> None:
    run = loop()
    run.cycle()
    run.goal = np.nan
    step = run.cycle(deadline=-1.0)
    assert (step.status, step.source) == (Status.LATE, Source.PLAN)


@settings(max_examples=60, deadline=None)
@given(late=st.lists(st.booleans(), min_size=1, max_size=40))
def test_whatever_is_late_is_late_alone_and_the_plan_counts_from_the_last_in_time(
    late: list[bool],
) -> None:
    clock = Clock()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(controller_module, "perf_counter", clock)
        run = Loop(type("Timed", (Timed,), {"clock": clock}))
        plan, used = np.empty((0, 1)), N
        for is_late in late:
            previous = run.controller.command.copy()
            step = run.cycle(SLOW if is_late else QUICK)
            assert (step.status is Status.LATE) == is_late
            if not is_late:
                assert step.source is Source.SOLUTION
                plan, used = plan_of(step, previous), 1
            elif used < N:
                assert step.source is Source.PLAN
                np.testing.assert_allclose(step.command, plan[used], rtol=1e-12)
                used += 1
            else:
                assert step.source is Source.ANALYTIC


def test_rows_that_changed_while_no_solve_was_begun_are_not_forgotten(loop: Any) -> None:
    """Joint maps replace rows: the next solve must see those of its own cycle."""
    run = loop()
    run.cycle()
    run.controller.problem.rows_changed = True
    run.cycle(deadline=-1.0)
    assert run.controller.problem.rows_changed
    run.cycle()
    assert not run.controller.problem.rows_changed


@pytest.mark.parametrize("deadline", [0.0, -1.0, float("nan")])
def test_a_deadline_that_is_none_is_refused(loop: Any, deadline: float) -> None:
    with pytest.raises(ModelError, match="deadline must be positive"):
        loop(deadline=deadline)


def test_no_answer_is_told_as_late() -> None:
    from qpmpc import Solver  # noqa: PLC0415

    qp = QuadraticProgram(np.eye(2), np.zeros(2), np.eye(2), -np.ones(2), np.ones(2))
    solution = Solver(qp).no_answer()
    assert solution.status is Status.LATE
    assert not solution.usable
    assert np.isnan(solution.x).all()
