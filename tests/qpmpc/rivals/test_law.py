"""What every rival owes to a run: bounds, gaps, deadlines, a start without a bump."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from qpmpc import BoundsConfig, ControllerConfig, PerAxis, SolverConfig
from qpmpc.errors import BoundsError, ShapeError, UnknownNameError
from qpmpc.fallback import Source
from qpmpc.kinds import (
    ControllerKind,
    by_law,
    controller_kind,
    controllers,
    register_controller,
)
from qpmpc.native import CompiledStepError
from qpmpc.rivals.config import LearningConfig
from qpmpc.rivals.law import LawController
from qpmpc.rivals.pi import PiLaw
from qpmpc.status import Status

KINDS = [kind.name for kind in controllers()]
LAWS = ["aob", "pi", "pi-ilc"]
CONFIG = ControllerConfig()
SHAKEN = lambda k: 0.03 * np.sin(2 * np.pi * 3 * k * 1e-3)  # noqa: E731


def bounded(**bounds) -> ControllerConfig:
    return ControllerConfig(bounds=BoundsConfig(**bounds))


# --- the registry --------------------------------------------------------------------------------


def test_the_rivals_of_the_issue_are_there():
    assert {"mpc", "paper-law", "aob", "pi", "pi-ilc"} <= set(KINDS)
    for kind in controllers():
        assert kind.summary
        assert kind.source
        assert controller_kind(kind.name) is kind
    assert [kind.name for kind in controllers() if kind.takes_backend] == ["mpc"]


def test_a_wrong_name_is_told_with_the_right_ones():
    with pytest.raises(UnknownNameError, match="did you mean 'pi-ilc'") as caught:
        controller_kind("pi-ilk")
    assert caught.value.valid == tuple(kind.name for kind in controllers())


def test_anybodys_controller_can_be_entered(monkeypatch, make, loop):
    monkeypatch.setattr("qpmpc.kinds._table", dict.fromkeys(()))

    class Still:
        def __init__(self, config, n_axes, period):
            self.wished = np.zeros(n_axes)

        def reset(self, force): ...

        def decide(self, force, velocity, setpoint, known):
            return self.wished

        def settle(self, command): ...

        def adopt(self, force): ...

    register_controller(ControllerKind("still", "does nothing", "here", "", by_law(Still)))
    assert [kind.name for kind in controllers()] == ["still"]
    assert not loop(make("still", CONFIG), CONFIG, 5, setpoint=lambda k: 1.0).force.any()


TABLES = {"pi": "pi", "ilc": "pi-ilc", "aob": "aob", "paper_law": "paper-law"}
SHORT = LearningConfig(0.11, 0.17, 0.5, 0.5, 15.0, 0.02)


@pytest.mark.parametrize(
    ("table", "key"),
    [(t, f.name) for t in TABLES for f in fields(getattr(ControllerConfig(), t))],
)
def test_every_key_has_an_effect(table, key, make, loop):
    def command(factor):
        config = replace(CONFIG, ilc=SHORT)
        own = getattr(config, table)
        own = replace(own, **{key: factor * getattr(own, key)})
        config = replace(config, **{table: own})
        asked = {"tissue": lambda k: 0.05 * np.sin(0.05 * k), "setpoint": lambda k: 1.0}
        return loop(make(TABLES[table], config), config, 400, **asked).command

    assert np.abs(command(1.0) - command(0.7)).max() > 1e-3


def test_every_table_is_named_where_controllers_are_listed():
    named = {table for kind in controllers() for table in kind.table.split(", ")}
    assert {f"controller.{table}" for table in TABLES} <= named


# --- start and bounds ----------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_at_rest_on_the_setpoint_nothing_is_commanded(kind, make, loop):
    run = loop(make(kind, CONFIG, "xyz"), CONFIG, 50, setpoint=lambda k: -10.0, start=-10.0)
    assert np.abs(run.command).max() < 1e-9
    assert np.abs(run.force + 10.0).max() < 1e-9


@pytest.mark.parametrize("kind", KINDS)
def test_a_step_of_the_setpoint_is_answered_and_settled(kind, make, loop):
    run = loop(make(kind, CONFIG, "xyz"), CONFIG, 1500, setpoint=lambda k: np.array([1, -2, 3.0]))
    assert np.abs(run.force[-1] - [1, -2, 3]).max() < 0.02
    assert run.force[:, 0].max() < 2.0


@pytest.mark.parametrize("kind", KINDS)
def test_reset_begins_anew(kind, make, loop):
    controller = make(kind, CONFIG, "xyz")
    asked = {"setpoint": lambda k: 1.0, "tissue": SHAKEN}
    first = loop(controller, CONFIG, 300, **asked)
    second = loop(controller, CONFIG, 300, **asked)
    assert np.array_equal(first.command, second.command)
    assert np.ptp(first.command) > 1.0


@pytest.mark.parametrize("kind", KINDS)
def test_the_bound_on_the_command_is_kept_and_told(kind, make, loop):
    config = bounded(command=PerAxis((-0.3, 0.5), (-0.2, 0.2), (-0.1, 0.4)))
    run = loop(make(kind, config, "xyz"), config, 400, setpoint=lambda k: 5.0 * (k // 100 % 2))
    assert run.command.max(axis=0).tolist() == [0.5, 0.2, 0.4]
    assert run.command.min(axis=0).tolist() == [-0.3, -0.2, -0.1]
    told = {step.status for step in run.steps}
    assert Status.CLIPPED in told | ({Status.CLIPPED} if kind == "mpc" else set())


@pytest.mark.parametrize("kind", KINDS)
def test_the_bound_on_the_rate_is_kept(kind, make, loop):
    config = bounded(rate=(-0.05, 0.02))
    run = loop(make(kind, config, "xyz"), config, 200, setpoint=lambda k: 5.0 * (k // 50 % 2))
    steps = np.diff(run.command, axis=0, prepend=0.0)
    assert steps.min() >= -0.05 - 1e-12
    assert steps.max() <= 0.02 + 1e-12
    assert np.isclose(steps, 0.02).any()


@pytest.mark.parametrize("kind", LAWS)
def test_a_bound_that_moves_is_kept_from_then_on(kind, make):
    controller = make(kind, CONFIG, "xz", ("command",))
    controller.reset(np.zeros(2))
    far = np.full((9, 2), 20.0)
    free = controller.step(np.zeros(2), np.zeros(2), far).command
    assert (free > 0.2).all()
    controller.move("command", np.full((8, 2), -0.1), np.tile([0.1, 0.2], (8, 1)))
    controller.prepare()
    assert controller.step(np.zeros(2), np.zeros(2), far).command.tolist() == [0.1, 0.2]
    controller.move("force", np.array(-1.0), np.array(1.0))  # not known to a law
    with pytest.raises(UnknownNameError, match="moving bound"):
        controller.move("forces", np.array(-1.0), np.array(1.0))
    with pytest.raises(BoundsError, match="must contain 0"):
        controller.move("rate", np.array(1.0), np.array(2.0))


@pytest.mark.parametrize("kind", KINDS)
def test_what_winds_up_unwinds(kind, make, loop):
    """For 0.3 s the tool is pushed away harder than the bound lets it push back.

    The end is before `pi-ilc` begins to repeat its answer.
    """
    config = bounded(command=(-2.0, 2.0))
    run = loop(
        make(kind, config), config, 620, start=1.0,
        setpoint=lambda k: 1.0, load=lambda k: -2.5 if k < 300 else 0.0,
    )  # fmt: skip
    assert (run.command[100:300] > 1.99).all()
    assert run.force[:300].min() < -5.0
    assert run.force.max() < 4.0
    assert np.abs(run.force[-1] - 1.0) < 0.6


# --- another force, another command --------------------------------------------------------------


@pytest.mark.parametrize("kind", LAWS)
def test_another_force_that_counts_from_now_on_is_no_jump(kind, make, loop):
    """At rest the setpoint goes along, so that nothing is to be done."""
    controller = make(kind, CONFIG, "xz")
    loop(controller, CONFIG, 100, setpoint=lambda k: 4.0, start=4.0)
    controller.adopt(force=np.zeros(2))
    controller.beat()
    still = np.zeros(2)
    for _ in range(20):
        step = controller.step(still, still, np.zeros((9, 2)))
        assert np.abs(step.command).max() < 1e-6
        controller.prepare()


@pytest.mark.parametrize("kind", LAWS)
def test_a_command_that_stood_in_is_the_one_that_was_applied(kind, make):
    config = bounded(rate=(-0.5, 0.5))
    controller = make(kind, config, "xz")
    controller.reset(np.zeros(2))
    still, far = np.zeros(2), np.full((9, 2), 5.0)
    controller.step(still, still, far)
    controller.adopt(command=np.array([3.0, -2.0]))
    controller.prepare()
    assert controller.step(still, still, far).command.tolist() == [3.5, -1.5]


# --- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_bad_arguments_are_told(kind, make):
    with pytest.raises(UnknownNameError, match="axis 'w'"):
        make(kind, CONFIG, "xw")
    with pytest.raises(UnknownNameError, match="moving bound"):
        make(kind, CONFIG, "x", ("tangential",))
    with pytest.raises(BoundsError, match="must contain 0"):
        make(kind, bounded(command=(1.0, 2.0)))
    with pytest.raises(BoundsError, match="lower must not exceed upper"):
        make(kind, bounded(rate=(2.0, 1.0)))


@pytest.mark.parametrize("kind", LAWS)
def test_a_compiled_step_that_is_required_is_not_to_be_had(kind, make):
    with pytest.raises(CompiledStepError, match="solves no QP"):
        make(kind, replace(CONFIG, solver=SolverConfig(compiled="on")))
    make(kind, replace(CONFIG, solver=SolverConfig(compiled="off")))


@pytest.mark.parametrize("kind", LAWS)
def test_a_wrong_shape_is_told(kind, make):
    controller = make(kind, CONFIG, "xy")
    good = [np.zeros(2), np.zeros(2), np.zeros((9, 2))]
    for i, bad in ((0, np.zeros(3)), (1, np.zeros(1)), (2, np.zeros(2)), (2, np.zeros((9, 3)))):
        arguments = [*good]
        arguments[i] = bad
        with pytest.raises(ShapeError):
            controller.step(*arguments)
    controller.step(*good)


# --- gaps and deadlines --------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [*LAWS, "mpc"])
def test_gaps_in_what_is_measured_are_survived(kind, make, loop):
    """Every 100 cycles 15 of silence, on one axis or on all."""

    def measured(k, force, velocity):
        if k % 100 < 15:
            force[:] = np.nan
        elif k % 100 < 30:
            force[1] = velocity[2] = np.nan
        return force, velocity

    asked = {"setpoint": lambda k: 1.0, "tissue": SHAKEN, "start": 1.0}
    whole = loop(make(kind, CONFIG, "xyz"), CONFIG, 1000, **asked)
    run = loop(make(kind, CONFIG, "xyz"), CONFIG, 1000, measured=measured, **asked)
    assert np.isfinite(run.command).all()
    assert np.abs(run.force - 1.0).max() < 12.0
    assert np.abs(whole.force - 1.0).max() < 6.0
    for k, step in enumerate(run.steps if kind in LAWS else []):
        assert (step.status is Status.FAILED) == (k % 100 < 30)
        assert (step.source is Source.SOLUTION) == (k % 100 >= 30)


@pytest.mark.parametrize("kind", LAWS)
def test_a_gap_on_one_axis_does_not_touch_the_others(kind, make, loop):
    def measured(k, force, velocity):
        if 100 < k < 150:
            force[1] = np.nan
        return force, velocity

    asked = {"setpoint": lambda k: 1.0, "tissue": SHAKEN}
    whole = loop(make(kind, CONFIG, "xyz"), CONFIG, 400, **asked)
    run = loop(make(kind, CONFIG, "xyz"), CONFIG, 400, measured=measured, **asked)
    assert np.array_equal(run.command[:, [0, 2]], whole.command[:, [0, 2]])
    assert not np.array_equal(run.command[:, 1], whole.command[:, 1])


def test_what_is_not_finite_is_not_sent(make):
    class Broken(PiLaw):
        def decide(self, force, velocity, setpoint, known):
            return np.full(2, np.nan if setpoint[0] else 0.5)

    controller = LawController(Broken(CONFIG, 2, 1e-3), ("x", "z"), CONFIG)
    zeros = np.zeros(2)
    assert controller.step(zeros, zeros, np.zeros((9, 2))).command.tolist() == [0.5, 0.5]
    step = controller.step(zeros, zeros, np.ones((9, 2)))
    assert step.command.tolist() == [0.5, 0.5]
    assert (step.status, step.source) == (Status.FAILED, Source.HOLD)


@pytest.mark.parametrize("own", [True, False])
@pytest.mark.parametrize("kind", LAWS)
def test_a_late_command_is_not_applied(kind, own, make):
    config = replace(CONFIG, solver=SolverConfig(deadline=1e-12)) if own else CONFIG
    controller = make(kind, config, "xz")
    controller.reset(np.zeros(2))
    arguments = np.zeros(2), np.zeros(2), np.ones((9, 2))
    step = controller.step(*arguments, deadline=None if own else 0.0)
    assert (step.status, step.source) == (Status.LATE, Source.HOLD)
    assert not step.command.any()
    controller.prepare()
    on_time = controller.step(*arguments, deadline=10.0)
    assert (on_time.status, on_time.source) == (Status.SOLVED, Source.SOLUTION)
    assert on_time.command.any()


@pytest.mark.parametrize("kind", LAWS)
def test_a_step_tells_what_it_did(kind, make, loop):
    run = loop(make(kind, CONFIG, "xz"), CONFIG, 20, setpoint=lambda k: 0.1)
    for k, step in enumerate(run.steps):
        before = run.command[k - 1] if k else np.zeros(2)
        assert step.decision.tolist() == [(run.command[k] - before).tolist()]
        assert step.predicted.shape == (1, 2)
        assert step.violation.shape == (0,)
        assert (step.rows, step.iterations) == ({}, 0)
        assert step.times.step > 0
    held = run.steps[0].command.copy()
    assert np.array_equal(held, run.command[0])  # nothing was overwritten since
    about = make(kind, CONFIG).about()
    assert (about.compilation.used, dict(about.form), list(about.facts)) == (False, {}, [])
