"""A controller goes on from another command and another force than it expected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from qpmpc import ForceController
from qpmpc.config import BoundsConfig, ControllerConfig, SolverConfig
from qpmpc.fallback import Source

CONFIG = ControllerConfig(bounds=BoundsConfig(velocity=(-0.3, 0.3), force=(-20.0, 20.0)))
AXES = ("x", "y", "z")
WISH = np.tile([1.0, 2.0, -10.0], (9, 1))


def made(compiled="off", backend="daqp", patience=0.04, **model) -> ForceController:
    config = replace(
        CONFIG,
        solver=SolverConfig(compiled=compiled),
        model=replace(CONFIG.model, **model),
        observer=replace(CONFIG.observer, patience=patience),
    )
    return ForceController(config, AXES, 1e-3, backend)


def run(controller, adopt: bool, cycles=40):
    rng = np.random.default_rng(1)
    commands = []
    for k in range(cycles):
        if adopt and k in (9, 23):
            controller.adopt(force=np.array([0.1, 0.2, -0.3 * k]))
        force, velocity = rng.normal(0, 0.1, 3), rng.normal(0, 1e-3, 3)
        commands.append(controller.step(force, velocity, WISH).command.copy())
        if adopt and k % 5 == 0:
            controller.adopt(command=np.full(3, 0.5 * (k % 3)), force=np.zeros(3))
        controller.prepare()
    return np.array(commands)


@pytest.mark.parametrize("backend", ["daqp", "analytic"])
def test_both_paths_go_on_alike(backend):
    compiled = made("auto", backend)
    if compiled.general.compiled is None:
        pytest.skip(compiled.general.compilation.reason or "")
    found = run(compiled, adopt=True)
    np.testing.assert_allclose(found, run(made("off", backend), adopt=True), atol=1e-8)
    assert np.abs(found - run(made("off", backend), adopt=False)).max() > 0.1


def test_the_observer_goes_on_under_the_command_that_was_applied():
    one, other = made(), made()
    for controller in (one, other):
        controller.step(np.zeros(3), np.zeros(3), WISH)
    other.general.command[:] = [1.0, -2.0, 3.0]
    one.adopt(command=np.array([1.0, -2.0, 3.0]))
    for controller in (one, other):
        controller.prepare()
    assert np.array_equal(one.general.observer.state, other.general.observer.state)
    assert one.general.observer.state.any()


def test_a_force_that_is_adopted_changes_nothing_else_in_the_estimate():
    controller = made()
    run(controller, adopt=False)
    before = controller.general.observer.state.reshape(3, -1).copy()
    controller.adopt(force=np.array([7.0, 8.0, 9.0]))
    after = controller.general.observer.state.reshape(3, -1)
    assert after[:, 0].tolist() == [7.0, 8.0, 9.0]
    assert np.array_equal(after[:, 1:], before[:, 1:])


def test_a_plan_that_began_otherwise_does_not_go_on():
    controller = made(patience=0.0)
    for _ in range(2):
        controller.step(np.zeros(3), np.zeros(3), WISH)
        controller.prepare()
    step = controller.step(np.full(3, np.nan), np.zeros(3), WISH)
    assert step.source is Source.PLAN
    controller.prepare()
    controller.step(np.zeros(3), np.zeros(3), WISH)
    controller.adopt(command=np.array([0.5, 0.5, 0.5]))
    controller.prepare()
    step = controller.step(np.full(3, np.nan), np.zeros(3), WISH)
    assert step.source is Source.HOLD
    assert step.command.tolist() == [0.5, 0.5, 0.5]
