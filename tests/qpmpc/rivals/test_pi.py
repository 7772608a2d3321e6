"""PI with feed-forward against what is known of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from qpmpc import ControllerConfig
from qpmpc.rivals.config import PiConfig
from qpmpc.rivals.pi import PiLaw

CONFIG = ControllerConfig(pi=PiConfig(50.0, 300.0, 150.0, 1.0, 0.002))
KNOWN = np.ones(1, dtype=np.bool_)


def having(**gains) -> ControllerConfig:
    return replace(CONFIG, pi=replace(CONFIG.pi, **gains))


def test_a_step_and_a_constant_load_leave_no_error(make, loop):
    run = loop(
        make("pi", CONFIG), CONFIG, 3000, setpoint=lambda k: 2.0 if k > 50 else 0.0,
        load=lambda k: 1.5 if k > 1500 else 0.0,
    )  # fmt: skip
    assert abs(run.force[1400, 0] - 2.0) < 1e-3
    assert abs(run.force[-1, 0] - 2.0) < 1e-3
    assert run.command[-1, 0] == pytest.approx(-1.5, abs=1e-2)  # so that u + d is nothing


def test_without_the_integral_a_load_leaves_the_error_of_the_formula(make, loop):
    """At rest u = -d and v = 0, so that u = velocity proportional e / K_s."""
    config = having(integral=0.0)
    run = loop(make("pi", config), config, 2000, load=lambda k: 1.5)
    expected = 1.5 * config.model.stiffness / (150.0 * 50.0)
    assert run.force[-1, 0] == pytest.approx(expected, rel=1e-6)


def test_tissue_of_constant_velocity_leaves_no_error_with_all_of_it_fed_forward(make, loop):
    """Without integral and feed-forward the error is v_e K_s / proportional."""
    moving = {"tissue": lambda k: 0.02}
    for share in (0.0, 0.5, 1.0):
        config = having(integral=0.0, feedforward=share)
        run = loop(make("pi", config), config, 2000, **moving)
        missing = (1.0 - share) * 0.02 * 2500 / 50.0
        assert -run.force[-1, 0] == pytest.approx(-missing * -1.0, abs=1e-6)


def test_feed_forward_makes_a_moving_tissue_less(make, loop):
    def error(share):
        config = having(feedforward=share)
        beat = {"tissue": lambda k: 0.05 * np.sin(2 * np.pi * 1.2 * k * 1e-3)}
        return float(np.std(loop(make("pi", config), config, 3000, **beat).force[1000:]))

    assert error(1.0) < 0.5 * error(0.5) < 0.5 * error(0.0)


def test_the_filter_time_is_that_of_the_estimate():
    law = PiLaw(having(filter_time=0.01, integral=0.0, proportional=0.0), 1, 1e-3)
    law.reset(np.zeros(1))
    velocity = np.array([0.1])
    wished = [float(law.decide(np.zeros(1), velocity, np.zeros(1), KNOWN)[0]) for _ in range(10)]
    # u = (K2 - velocity) v + velocity v_e, v_e = v (1 - e^(-t/T))
    estimate = (np.array(wished) - (20.0 - 150.0) * 0.1) / 150.0
    assert estimate == pytest.approx(0.1 * (1 - np.exp(-np.arange(1, 11) / 10)), rel=1e-9)


def test_the_end_of_a_gap_is_no_jump_of_the_force():
    law = PiLaw(having(filter_time=0.0, proportional=0.0, integral=0.0), 1, 1e-3)
    law.reset(np.zeros(1))
    zero, gap = np.zeros(1), np.zeros(1, dtype=np.bool_)
    assert law.decide(zero, np.array([0.1]), zero, gap)[0] == pytest.approx((20.0 - 150.0) * 0.1)
    assert law.decide(np.array([5.0]), zero, zero, KNOWN)[0] == 0.0
    slope = law.decide(np.array([5.1]), zero, zero, KNOWN)[0]
    assert slope == pytest.approx(-150.0 * 0.1 / (2500 * 1e-3))


def test_the_integral_waits_while_the_command_is_clipped():
    law = PiLaw(having(proportional=0.0, feedforward=0.0), 1, 1e-3)
    law.reset(np.zeros(1))
    zero, one = np.zeros(1), np.ones(1)
    for _ in range(5):
        law.decide(zero, zero, one, KNOWN)
        law.settle(zero)  # clipped to nothing
    free = law.decide(zero, zero, one, KNOWN)[0]
    assert free == pytest.approx(150.0 * 300.0 / 2500 * 1e-3)
    law.settle(np.array([free]))
    assert law.decide(zero, zero, one, KNOWN)[0] == pytest.approx(2 * free)
    law.settle(zero)
    back = law.decide(zero, zero, -one, KNOWN)[0]  # the way out is never stopped
    law.settle(np.array([back + 1e-6]))
    assert back == pytest.approx(0.0, abs=1e-12)
