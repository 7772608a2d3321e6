"""How the paper's printed equations are read, one test for each reading that concerns `qpmpc`."""

from typing import Any

import numpy as np
import pytest

from qpmpc import (
    BoundsConfig,
    ControllerConfig,
    ExponentialReference,
    ForceController,
    KalmanObserver,
    LinearModel,
    ModelConfig,
    ObserverConfig,
    Problem,
    absolute_prediction,
    axis_model,
    contact_model,
    prediction,
    zero_order_hold,
)

PERIOD = 1e-3
STIFFNESS, K2 = 1200.0, 20.0
MODEL = contact_model(STIFFNESS, K2, PERIOD).model


def problem(model: LinearModel = MODEL, **changed: Any) -> Problem:
    settings: dict[str, Any] = {"output_weight": 1.0, "increment_weight": 0.01} | changed
    return Problem(model, settings.pop("horizon", 8), **settings)


def test_reading_02_moving_tissue_is_a_matched_disturbance() -> None:
    """(6), (7) hold for tissue at rest; motion adds -K_s (a_e + K2 v_e) to y'' + K2 y'."""
    step, w = 1e-5, 2 * np.pi * 8.0
    contact = contact_model(STIFFNESS, K2, step)
    x, z, forces = np.zeros((2, 1)), np.zeros((2, 1)), []
    for k in range(6000):
        t = (k + 0.5) * step
        v_e, a_e = 0.05 * np.sin(w * t), 0.05 * w * np.cos(w * t)
        x = contact.model.A @ x + contact.tissue * v_e
        z = contact.model.A @ z - contact.load * (a_e + K2 * v_e)
        forces.append((x[0, 0], z[0, 0]))
    moved, matched = np.array(forces).T
    assert np.abs(moved).max() > 1.0
    np.testing.assert_allclose(matched, moved, atol=1e-5 * np.abs(moved).max())


def test_reading_03_y_is_a_force_and_u_an_acceleration() -> None:
    """Half a second at 2 m/s^2 without damping is 1 m/s and 0.25 m: K_s times 0.25 m of force."""
    model = contact_model(STIFFNESS, 0.0, PERIOD).model
    x = np.zeros((2, 1))
    for _ in range(500):
        x = model.A @ x + model.B * 2.0
    assert x[0, 0] == pytest.approx(STIFFNESS * 0.25)
    assert x[1, 0] == pytest.approx(1.0)


def test_reading_04_the_input_of_eq_8_multiplies_the_column() -> None:
    """In the states (y, dy/dt) of (8) the input column is [0; K_s], times u."""
    A, B = zero_order_hold([[0, 1], [0, -K2]], [[0], [STIFFNESS]], PERIOD)
    printed = LinearModel(A, B, np.array([[1.0, 0.0]]), PERIOD)
    np.testing.assert_allclose(
        prediction(printed, 20).Theta, prediction(MODEL, 20).Theta, rtol=1e-10
    )


def test_reading_05_theta_multiplies_increments_or_by_a_switch_commands(roll_out: Any) -> None:
    """(10): Theta's first column is the unit step response; the literal reading is a switch."""
    state, one = np.zeros(2), np.ones((8, 1))
    pulse = np.eye(8)[:, :1]
    step_response = roll_out(MODEL, state, one)[:, 0]
    increments, literal = prediction(MODEL, 8), absolute_prediction(MODEL, 8)
    np.testing.assert_allclose(increments.Theta[:, 0], step_response, rtol=1e-12)
    np.testing.assert_allclose(increments.Upsilon[:, 0], step_response, rtol=1e-12)
    np.testing.assert_allclose(literal.Theta[:, 0], roll_out(MODEL, state, pulse)[:, 0], rtol=1e-12)
    assert not literal.Upsilon.any()
    switched = problem(decision="absolute").prediction.Theta
    np.testing.assert_array_equal(switched, literal.Theta)


def test_reading_06_the_diagonal_of_theta_is_CB() -> None:  # noqa: N802
    """(11): the diagonal holds CB, an output, where the print has B, a state."""
    Theta = prediction(MODEL, 8).Theta
    assert Theta.shape == (8, 8)
    np.testing.assert_allclose(np.diag(Theta), (MODEL.C @ MODEL.B)[0, 0], rtol=1e-14)


def test_reading_07_the_cost_knows_the_last_command_and_weighs_increments() -> None:
    """(12) omits Upsilon u(k-1), which (13) has: a standing command costs nothing."""
    state, held = np.array([2.0, 5.0 / K2]), np.array([5.0])  # u cancels the damping: v stays
    p, literal = problem(), problem(decision="absolute")
    wish = (p.prediction.Psi @ state + p.prediction.Upsilon @ held).reshape(8, 1)
    p.update(state, held, wish)
    np.testing.assert_allclose(p.q, 0.0, atol=1e-10)
    p.update(state, np.zeros(1), wish)  # but without it the same wish asks for a change
    assert np.linalg.solve(p.qp.P, -p.q)[0] > 0.1
    literal.update(state, held, wish)  # and where commands are weighed, it is not kept
    assert np.linalg.solve(literal.qp.P, -literal.q)[0] < 4.9


def test_reading_08_the_state_is_an_estimate() -> None:
    """The paper names no observer; ``none`` takes force and velocity for what is measured."""
    config = ObserverConfig(disturbance="none")
    axis = axis_model(ModelConfig(delay=0, lag=0.0), config, PERIOD)
    observer = KalmanObserver(axis.model, axis.measured, axis.process_noise, axis.measurement_noise)
    observer.reset([9.0, -1.0])
    np.testing.assert_allclose(observer.correct(np.array([2.0, 0.03])), [2.0, 0.03], rtol=1e-6)


def test_reading_09_the_two_lambdas_are_two_parameters() -> None:
    """lambda, the effort weight, and alpha, the reference's decay, are set apart."""
    base = ForceController(ControllerConfig(), ("z",), PERIOD, "analytic").general
    effort = ForceController(ControllerConfig(increment_weight=1.0), ("z",), PERIOD, "analytic")
    decay = ForceController(ControllerConfig(reference_time=0.5), ("z",), PERIOD, "analytic")
    assert not np.allclose(effort.general.problem.qp.P, base.problem.qp.P)
    np.testing.assert_array_equal(decay.general.problem.qp.P, base.problem.qp.P)
    alphas = [c.reference.alpha for c in (base, effort.general, decay.general)]
    assert alphas == [np.exp(-PERIOD / 0.02), np.exp(-PERIOD / 0.02), np.exp(-PERIOD / 0.5)]


@pytest.mark.parametrize("period", [1e-3, 2e-3])
def test_reading_10_the_horizon_counts_samples_and_the_first_increment_is_applied(
    period: float,
) -> None:
    """ "N = 8*Ts" is 8 samples, at any period; the "first element" is Delta u(k)."""
    bounds = BoundsConfig(command=(-1e3, 1e3))
    controller = ForceController(
        ControllerConfig(horizon=8, bounds=bounds), ("z",), period, "analytic"
    )
    controller.reset(np.array([2.0]))
    previous = 0.0
    for _ in range(3):
        step = controller.step(np.array([2.0]), np.zeros(1), np.full((9, 1), 2.5))
        assert step.decision.shape == step.predicted.shape == (8, 1)
        assert step.command[0] == pytest.approx(previous + step.decision[0, 0], rel=1e-12)
        assert step.decision[0, 0] != 0
        previous = step.command[0]


@pytest.mark.parametrize(("time_constant", "close"), [(2.6e-3, True), (2.7e-3, False)])
def test_reading_11_the_decay_is_over_by_the_end_of_the_horizon(
    time_constant: float, close: bool
) -> None:
    """ "lambda^N close to 0": alpha^N < 0.05 at N = 8 means T_ref below 2.7 ms."""
    reference = ExponentialReference(8, 1, PERIOD, time_constant)
    w = reference(np.zeros((9, 1)), np.ones(1))
    assert w[-1, 0] == pytest.approx(reference.alpha**8)
    assert (w[-1, 0] < 0.05) == close


def test_reading_12_no_compensation_is_the_tool_held_still() -> None:
    """ "No compensation" is undefined in the paper: the tool stands, force is K_s times travel."""
    rng = np.random.default_rng(12)
    contact = contact_model(STIFFNESS, K2, PERIOD)
    speeds, x = 0.05 * rng.standard_normal(200), np.array([[2.0], [0.0]])
    for v_e in speeds:
        x = contact.model.A @ x + contact.tissue * v_e
        assert contact.velocity @ x == pytest.approx(0.0, abs=1e-14)
    assert x[0, 0] == pytest.approx(2.0 - STIFFNESS * PERIOD * speeds.sum(), rel=1e-10)
