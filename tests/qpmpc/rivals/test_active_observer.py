"""The active observers against what is known of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qpmpc import ControllerConfig, ModelConfig, contact_model, with_delay
from qpmpc.errors import ModelError
from qpmpc.models import LinearModel
from qpmpc.rivals.active_observer import ActiveObserverLaw, compensation, place
from qpmpc.rivals.config import ActiveObserverConfig
from qpmpc.rivals.law import LawController

CONFIG = ControllerConfig()


def made(config: ControllerConfig) -> tuple[ActiveObserverLaw, LawController]:
    law = ActiveObserverLaw(config, 1, 1e-3)
    return law, LawController(law, ("z",), config)


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("lag", [0.0, 0.001, 0.004])
def test_a_constant_disturbance_is_estimated_exactly_and_leaves_no_error(delay, lag, loop):
    config = ControllerConfig(model=ModelConfig(delay=delay, lag=lag))
    law, controller = made(config)
    run = loop(controller, config, 1500, setpoint=lambda k: -3.0, load=lambda k: 1.75)
    assert law.disturbance[0] == pytest.approx(1.75, abs=1e-6)
    assert run.force[-1, 0] == pytest.approx(-3.0, abs=1e-6)
    assert run.command[-1, 0] == pytest.approx(-1.75, abs=1e-6)


def test_the_error_dies_as_the_poles_say(loop):
    """From a force that is known, without disturbance: two poles at exp(-T / closed_loop_time)."""
    for time in (0.01, 0.03):
        config = replace(CONFIG, aob=ActiveObserverConfig(closed_loop_time=time))
        _, controller = made(config)
        run = loop(controller, config, 600, start=1.0)
        k = np.arange(600)
        shape = np.linalg.lstsq(
            np.column_stack([np.exp(-k / time / 1e3), k * np.exp(-k / time / 1e3)])[10:],
            run.force[10:, 0],
            rcond=None,
        )
        assert np.sqrt(shape[1][0] / 590) < 1e-3  # all of it is of this form
        assert np.abs(run.force[10:, 0]).max() > 0.5


def test_the_motion_is_cancelled_before_the_force_tells_it(loop):
    """Tissue of constant acceleration: without its observer the force alone has to tell."""
    moving = {"tissue": lambda k: 0.3 * k * 1e-3}
    with_motion, without = (
        loop(
            made(replace(CONFIG, aob=ActiveObserverConfig(jerk_drift=drift)))[1],
            CONFIG,
            400,
            **moving,
        )
        for drift in (100.0, 1e-12)
    )
    assert np.abs(with_motion.force[100:]).max() < 0.2 * np.abs(without.force).max()
    assert np.abs(with_motion.force[-1]).max() < 1e-3


@pytest.mark.parametrize(("delay", "lag"), [(0, 0.0), (1, 0.001), (3, 0.004)])
def test_the_share_for_the_motion_comes_at_its_time(delay, lag, loop):
    """Half a cycle earlier or later, and the error is larger."""
    config = ControllerConfig(
        model=ModelConfig(delay=delay, lag=lag), aob=ActiveObserverConfig(disturbance_drift=1e-3)
    )
    right = delay * 1e-3 + lag + 0.5e-3
    error = {}
    for shift in (-0.5e-3, 0.0, 0.5e-3):
        law, controller = made(config)
        if shift:
            law._compensation = compensation(20.0, right + shift)
        run = loop(controller, config, 2000, tissue=lambda k: 0.1 * np.sin(0.004 * (k + 0.5)))
        error[shift] = float(np.std(run.force[500:]))
    assert error[0.0] < 0.7 * min(error[-0.5e-3], error[0.5e-3])


def test_the_compensation_extrapolates_a_motion_of_constant_jerk():
    t, later = 0.3, 0.004
    velocity, acceleration, jerk = 0.1 + 2 * t + 5 * t**2, 2 + 10 * t, 10.0
    ahead = t + later
    expected = (2 + 10 * ahead) + 20 * (0.1 + 2 * ahead + 5 * ahead**2)
    found = compensation(20.0, later) @ [7.0, velocity, acceleration, jerk]
    assert found[0] == pytest.approx(expected)


@settings(max_examples=15, deadline=None)
@given(
    stiffness=st.floats(200, 5000),
    damping=st.floats(0, 60),
    delay=st.integers(0, 4),
    lag=st.sampled_from([0.0, 0.0005, 0.003]),
    time=st.floats(0.004, 0.2),
)
def test_the_poles_are_where_they_are_asked_for(stiffness, damping, delay, lag, time):
    model = with_delay(contact_model(stiffness, damping, 1e-3, lag=lag).model, delay)
    poles = np.zeros(model.n_states)
    poles[:2] = np.exp(-1e-3 / time)
    if lag:
        poles[2] = np.exp(-1e-3 / lag)
    closed = model.A - model.B @ place(model, poles)
    # Double and multiple poles are as ill-conditioned as roots are: compare the polynomial.
    assert np.allclose(np.poly(closed), np.poly(poles), atol=1e-9)


def test_a_state_that_the_command_does_not_reach_is_told():
    model = LinearModel(np.diag([0.5, 0.7]), np.array([[1.0], [0.0]]), np.eye(1, 2), 1e-3)
    with pytest.raises(ModelError, match="does not reach"):
        place(model, np.zeros(2))
