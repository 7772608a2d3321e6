"""Margins of loops whose margins are in every textbook; ranges; bounds; tuning."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    ControllerConfig,
    ModelConfig,
    ModelError,
    ObserverConfig,
    ObserverError,
    axis_model,
)
from qpmpc.arrays import Array
from qpmpc.margins import (
    Demand,
    Loop,
    TruePlant,
    force_law,
    margins,
    prediction_error,
    stable_range,
    tune,
)

FAST = 1e-5
"""A period that does not matter."""
PERIOD = 1e-3
PLANT = TruePlant(2500.0, 20.0, 1e-3, 1e-3)


def continuous(loop: Callable[[Any], Any]) -> Callable[[Array], Any]:
    return lambda omega: loop(1j * omega)


def test_an_integrator() -> None:
    found = margins(continuous(lambda s: 1 / s), FAST)
    assert found.phase == pytest.approx(np.pi / 2)
    assert found.delay == pytest.approx(np.pi / 2)
    assert (found.gain_up, found.gain_down) == (np.inf, 0.0)
    assert found.sensitivity == pytest.approx(1.0, abs=1e-6)
    assert found.crossovers == pytest.approx((1.0,))


def test_three_lags() -> None:
    """K / (s + 1)^3 is stable up to K = 8, and then oscillates with sqrt(3) rad/s."""
    found = margins(continuous(lambda s: 2 / (s + 1) ** 3), FAST)
    assert found.gain_up == pytest.approx(4.0)
    assert found.gain_down == 0.0
    w = np.sqrt(2 ** (2 / 3) - 1)  # |L| = 1
    assert found.crossovers == pytest.approx((w,))
    assert found.phase == pytest.approx(np.pi - 3 * np.arctan(w))
    assert found.delay == pytest.approx((np.pi - 3 * np.arctan(w)) / w)


def test_a_loop_that_is_stable_only_with_enough_gain() -> None:
    """K (s + 2)^2 / s^3: by Routh and Hurwitz stable for K > 1."""
    found = margins(continuous(lambda s: 2 * (s + 2) ** 2 / s**3), FAST)
    assert found.gain_down == pytest.approx(0.5)
    assert found.gain_up > 1e6  # where the grid ends


def test_an_integrator_with_delay() -> None:
    """K e^(-s tau) / s: gain margin pi / (2 K tau), phase margin pi/2 - K tau."""
    found = margins(continuous(lambda s: np.exp(-0.5 * s) / s), FAST)
    assert found.gain_up == pytest.approx(np.pi)
    assert found.phase == pytest.approx(np.pi / 2 - 0.5)
    assert found.delay == pytest.approx(np.pi / 2 - 0.5)


def test_a_discrete_integrator() -> None:
    """K / (z - 1), delayed by one: poles of z - 1 + K leave the circle at K = 2, at z = -1."""
    found = margins(lambda omega: 0.5 / (np.exp(1j * omega) - 1), 1.0)
    assert found.gain_up == pytest.approx(4.0)
    assert found.sensitivity == pytest.approx(4 / 3)  # 1 + L = 1 - K / 2 there
    assert found.peak == pytest.approx(np.pi)


def test_the_largest_sensitivity_of_a_second_order_loop() -> None:
    """L = wn^2 / (s (s + 2 zeta wn)); S by dense search of its formula."""
    zeta = 0.3
    omega = np.linspace(0.5, 2.5, 400_001)
    S = np.abs((1j * omega) * (1j * omega + 2 * zeta) / (1 - omega**2 + 2j * zeta * omega))
    found = margins(continuous(lambda s: 1 / (s * (s + 2 * zeta))), FAST)
    assert found.sensitivity == pytest.approx(S.max(), rel=1e-6)
    assert found.peak == pytest.approx(omega[S.argmax()], rel=1e-3)


# ---- ranges


@pytest.mark.parametrize(("low", "high"), [(0.3, 7.0), (1e-3, 50.0), (0.99, 1.01)])
def test_a_range_is_found_to_its_tolerance(low: float, high: float) -> None:
    found = stable_range(lambda v: low < v < high, 1.0, 1e-4, 1e3)
    assert found == pytest.approx((low, high), rel=2e-6)


def test_a_range_from_zero_and_one_without_end() -> None:
    assert stable_range(lambda v: v < 0.4, 0.0, 0.0, 3.0) == (0.0, pytest.approx(0.4, rel=1e-5))
    assert stable_range(lambda _: True, 1.0, 0.5, 2.0) == (0.5, 2.0)
    assert stable_range(lambda _: False, 1.0, 0.5, 2.0) is None


# ---- the lower bound


def test_a_random_walk_cannot_be_known_better() -> None:
    """x + w, y = x + v: the variance after the measurement solves P = (P + q) r / (P + q + r)."""
    one, q, r = np.eye(1), 0.3, 0.7
    P = (-q + np.sqrt(q**2 + 4 * q * r)) / 2
    for cycles in range(4):
        found = prediction_error(one, one, q * one, r * one, output=one, cycles=cycles)
        assert found[0] == pytest.approx(np.sqrt(P + cycles * q))


def test_what_is_not_measured_has_no_bound() -> None:
    with pytest.raises(ObserverError):
        prediction_error(np.eye(2), np.eye(1, 2), np.eye(2), np.eye(1), output=np.eye(2), cycles=1)


def test_no_loop_beats_it_in_the_world_it_is_for() -> None:
    """Tissue whose jerk is a random walk, a perfect robot; controllers told this or that."""
    true = axis_model(
        ControllerConfig().model,
        ObserverConfig(tissue_jerk_drift=30.0, input_drift=1e-9),
        PERIOD,
    )
    A, W = true.model.A, true.process_noise
    least = prediction_error(
        A, true.measured, W, true.measurement_noise, output=true.model.C, cycles=2
    )[0]
    omega = np.linspace(3.0, np.pi / PERIOD, 30_000)  # below, rounding is larger than what is left
    z = np.exp(1j * omega * PERIOD)
    S = np.array([[1, PERIOD, PERIOD**2 / 2], [0, 1, PERIOD], [0, 0, 1]])
    white = np.array([np.linalg.solve(each * np.eye(3) - S, [0, 0, 30.0])[0] for each in z])
    reached = []
    for drift in (10.0, 100.0, 1000.0):
        config = ControllerConfig(observer=ObserverConfig(tissue_jerk_drift=drift))
        loop = Loop(PLANT, force_law(config, PERIOD))
        from_tissue = loop.closed.part(slice(0, 1), slice(0, 1)).response(omega)[:, 0, 0]
        moved = np.trapezoid(np.abs(from_tissue * white) ** 2, omega) * PERIOD / np.pi
        reached.append(np.hypot(np.sqrt(moved), loop.noise(0.003, 1e-5)[0]))
    assert least < min(reached) < 5 * least


# ---- tuning


def demand(*stiffness: float, sensitivity: float = 1.9, **changes: Any) -> Demand:
    omega = 2 * np.pi * np.array([0.25, 1.2, 2.4, 4.8, 9.6])
    return Demand(
        [replace(PLANT, stiffness=k) for k in stiffness],
        sensitivity,
        omega,
        np.array([4e-4, 1e-3, 5e-4, 2e-4, 3e-5]),
        changes.pop("force_noise", 0.003),
        1e-5,
    )


def test_a_tuning_keeps_the_margin_and_is_the_same_each_time() -> None:
    config = ControllerConfig()
    asked = demand(2000.0, 3000.0)
    first, again = (tune(config, asked, PERIOD, model=True, evaluations=150) for _ in range(2))
    assert first.changed == again.changed
    assert first.met
    assert first.after.error < 0.2
    assert not first.before.sensitivity <= 1.9
    law = force_law(first.config, PERIOD)
    for plant in asked.plants:
        loop = Loop(plant, law)
        assert loop.stable
        assert margins(loop.transfer, PERIOD).sensitivity <= 1.9 * 1.001
    assert first.config.model.stiffness == first.changed["model.stiffness"]
    assert first.evaluations <= 200


def test_the_error_that_is_promised_is_the_one_of_the_loop() -> None:
    config, asked = ControllerConfig(), demand(2500.0)
    told = tune(config, asked, PERIOD, evaluations=1).before
    loop = Loop(PLANT, force_law(config, PERIOD))
    force = loop.rejection(asked.omega) * asked.motion * 2500.0
    noise = loop.noise(0.003, 1e-5)[0]
    still = 2500.0 * np.sqrt(np.sum(asked.motion**2))
    assert told.error == pytest.approx(np.sqrt(np.sum(force**2) + noise**2) / still, rel=0.02)
    assert told.sensitivity == pytest.approx(margins(loop.transfer, PERIOD).sensitivity, rel=0.01)
    assert told.radius == pytest.approx(loop.closed.radius)


def test_a_narrow_peak_between_the_points_is_seen() -> None:
    """A law with hardly a price on the command rings at 280 Hz, over some 10 rad/s."""
    config = ControllerConfig(
        model=ModelConfig(stiffness=11530.0),
        observer=ObserverConfig(
            force_noise=0.00313,
            input_drift=0.0602,
            tissue_jerk_drift=0.6562,
            velocity_noise=0.002126,
        ),
        reference_time=0.188,
        increment_weight=6.401e-6,
    )
    asked = replace(demand(2500.0), plants=[replace(PLANT, stiffness=1250.0, gain=1.2)])
    told = tune(config, asked, PERIOD, evaluations=1).before
    loop = Loop(asked.plants[0], force_law(config, PERIOD))
    assert told.sensitivity == pytest.approx(margins(loop.transfer, PERIOD).sensitivity, rel=0.02)
    assert told.sensitivity > 5


def test_what_is_not_modelled_is_not_turned() -> None:
    config = ControllerConfig(observer=ObserverConfig(disturbance="ramp"), reference_time=0.0)
    found = tune(config, demand(2500.0), PERIOD, evaluations=20)
    assert set(found.changed) == {"observer.input_slope_drift", "increment_weight"}


def test_a_margin_that_cannot_be_had_is_told() -> None:
    found = tune(ControllerConfig(), demand(2500.0, 1e5, sensitivity=1.01), PERIOD, evaluations=30)
    assert not found.met


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(((), 1.7), "at least one plant"), (((PLANT,), 1.0), "sensitivity must exceed 1, got 1")],
)
def test_demands_that_cannot_be(arguments: tuple[Any, ...], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        Demand(*arguments, np.ones(1), np.ones(1), 0.003, 1e-5)
