"""Measurements of which parts are missing or wrong: against the textbook, and by effect."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qpmpc import (
    KalmanObserver,
    LinearModel,
    ModelConfig,
    ObserverConfig,
    ObserverError,
    axis_model,
    stack,
)
from qpmpc import intermittent as module
from qpmpc.arrays import Array
from qpmpc.kalman import subsystems

PERIOD = 1e-3
AXIS = axis_model(ModelConfig(), ObserverConfig(), PERIOD)
N = AXIS.model.n_states
NOTHING = np.full(2, np.nan)


def observer(count: int = 1, **arguments: Any) -> KalmanObserver:
    """The observer of some axes of the force controller."""
    eye = np.eye(count)
    made = KalmanObserver(
        stack([AXIS.model] * count),
        np.kron(eye, AXIS.measured),
        np.kron(eye, AXIS.process_noise),
        np.kron(eye, AXIS.measurement_noise),
        **arguments,
    )
    made.reset()
    return made


class Textbook:
    """The time-varying filter, one row after the other, in the states' own units."""

    def __init__(self, model: tuple[Array, Array, Array], W: Array, V: Array, P: Array) -> None:
        (self.A, self.B, self.C), self.W, self.V, self.P = model, W, V, P
        self.x = np.zeros(len(W))

    def correct(self, y: Array) -> Array:
        """V is diagonal, so rows may come one by one."""
        P = self.A @ self.P @ self.A.T + self.W
        for c, v, value in zip(self.C, np.diag(self.V), y, strict=True):
            if np.isfinite(value):
                gain = P @ c / (c @ P @ c + v)
                self.x = self.x + gain * (value - c @ self.x)
                rest = np.eye(len(self.x)) - np.outer(gain, c)
                P = rest @ P @ rest.T + v * np.outer(gain, gain)
        self.P = P
        return self.x

    def predict(self, u: Array) -> None:
        self.x = self.A @ self.x + self.B @ u


@given(
    n=st.integers(1, 5), m=st.integers(1, 3), seed=st.integers(0, 10**6),
    present=st.floats(0.0, 1.0),
)  # fmt: skip
@settings(max_examples=40, deadline=None)
def test_it_is_the_filter_of_the_textbook(n: int, m: int, seed: int, present: float) -> None:
    rng = np.random.default_rng(seed)
    A, B, C = rng.standard_normal((n, n)), rng.standard_normal((n, 1)), rng.standard_normal((m, n))
    A *= 1.02 / max(np.abs(np.linalg.eigvals(A)))
    root = rng.standard_normal((n, n))
    W, V = root @ root.T + 0.01 * np.eye(n), np.diag(rng.uniform(0.01, 3.0, m))
    (part,) = subsystems(A, C, W, V)
    scale = np.outer(part.state_scale, part.state_scale)
    theirs = Textbook((A, B, C), W, V, part.P / scale)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_SETTLED", 0.0)
        mine = KalmanObserver(LinearModel(A, B, np.eye(1, n), 1.0), C, W, V)
        for k in range(40):
            y, u = rng.standard_normal(m), rng.standard_normal(1)
            y[(rng.random(m) > present) | (k == 0)] = np.nan
            np.testing.assert_allclose(mine.correct(y), theirs.correct(y), rtol=1e-7, atol=1e-9)
            mine.predict(u)
            theirs.predict(u)


def test_a_complete_stretch_brings_the_steady_state_back() -> None:
    filter_ = observer()
    for k in range(300):
        filter_.correct(NOTHING if 50 <= k < 70 else np.zeros(2))
        filter_.predict(np.zeros(1))
        if k in (0, 49):
            assert filter_.settled[0]
        if 50 <= k < 75:
            assert not filter_.settled[0]
    assert filter_.settled[0]
    assert (filter_.missing == 0).all()


def world(rng: np.random.Generator, cycles: int) -> tuple[Array, Array]:
    """States and measurements of a world that is as the observer is told."""
    noise = np.sqrt(np.diag(AXIS.process_noise)), np.sqrt(np.diag(AXIS.measurement_noise))
    x, states, seen = np.zeros(N), [], []
    for _ in range(cycles):
        x = AXIS.model.A @ x + noise[0] * rng.standard_normal(N)
        states.append(x)
        seen.append(AXIS.measured @ x + noise[1] * rng.standard_normal(2))
    return np.array(states), np.array(seen)


def errors(filter_: KalmanObserver, states: Array, seen: Array) -> Array:
    found = []
    for x, y in zip(states, seen, strict=True):
        found.append(filter_.correct(y) - x)
        filter_.predict(np.zeros(1))
    return np.array(found)


class Careless(KalmanObserver):
    """The gain of the steady state for what is there, and again as soon as all is there."""

    def correct(self, measurement: Array) -> Array:
        innovation = measurement - self.measured @ self.state
        there = np.isfinite(innovation)
        self.state += self.gain[:, there] @ innovation[there]
        return self.state


def test_covariance_says_what_the_errors_are_and_careless_gains_are_worse() -> None:
    """100 worlds, in each of which the force is away for 15 ms."""
    rng, lost, cycles = np.random.default_rng(8), slice(150, 165), 200
    mine, careless, claimed = [], [], None
    for _ in range(100):
        states, seen = world(rng, cycles)
        seen[lost, 0] = np.nan
        filter_ = observer()
        variances = []
        filter_.correct(seen[0])
        for x, y in zip(states, seen, strict=True):
            mine.append((filter_.correct(y) - x)[0])
            (part,) = filter_._parts
            variances.append(part.P[0, 0, 0] / part.state_scale[0, 0] ** 2)
            filter_.predict(np.zeros(1))
        claimed = np.sqrt(variances)
        plain = Careless(AXIS.model, AXIS.measured, AXIS.process_noise, AXIS.measurement_noise)
        careless.append(errors(plain, states, seen)[:, 0])
    deviation = np.sqrt(np.mean(np.reshape(mine, (100, cycles)) ** 2, axis=0))
    for k in (140, 155, 164, 165, 166, 170, 190):
        assert deviation[k] == pytest.approx(claimed[k], rel=0.3)
    assert claimed[164] > 50 * claimed[140]
    after = slice(165, 185)
    worse = np.sqrt(np.mean(np.square(careless)[:, after]))
    assert worse > 5 * np.sqrt(np.mean(deviation[after] ** 2))


def test_there_is_no_steady_gain_for_the_velocity_alone() -> None:
    """Why it has to vary in time: without the force nothing determines force and tissue."""
    with pytest.raises(ObserverError):
        subsystems(AXIS.model.A, AXIS.measured[1:], AXIS.process_noise, np.eye(1))


def test_an_axis_without_a_force_leaves_the_others_alone() -> None:
    rng, both, alone = np.random.default_rng(1), observer(2), observer(2)
    for k in range(60):
        y = rng.standard_normal(4) * [0.01, 1e-5, 0.01, 1e-5]
        alone.correct(y)
        y[0] = np.nan if 20 <= k < 30 else y[0]
        both.correct(y)
        for each in (both, alone):
            each.predict(np.zeros(2))
    assert np.abs(both.state[:N] - alone.state[:N]).max() > 1e-6
    np.testing.assert_allclose(both.state[N:], alone.state[N:], rtol=1e-9, atol=1e-12)


# ---- the gate


def settled(**arguments: Any) -> KalmanObserver:
    filter_ = observer(**arguments)
    for _ in range(5):
        filter_.correct(np.zeros(2))
        filter_.predict(np.zeros(1))
    return filter_


def test_what_the_gate_refuses_counts_as_missing() -> None:
    wrong, missing, open_ = (settled(gate=[g, np.inf]) for g in (2.0, 2.0, 10.0))
    wrong.correct(np.array([5.0, 1e-5]))
    missing.correct(np.array([np.nan, 1e-5]))
    open_.correct(np.array([5.0, 1e-5]))
    np.testing.assert_array_equal(wrong.state, missing.state)
    assert abs(wrong.state[0]) < 1e-3
    assert abs(open_.state[0]) > 1.0
    assert wrong.missing.tolist() == [1, 0]


@pytest.mark.parametrize("step", [0.5, 5.0, -50.0])
def test_a_step_that_stays_passes_on_the_fourth_cycle_at_the_latest(step: float) -> None:
    filter_, estimates = settled(gate=[2.0, np.inf]), []
    for _ in range(12):
        estimates.append(filter_.correct(np.array([step, 0.0]))[0])
        filter_.predict(np.zeros(1))
    passed = int(np.argmax(np.abs(estimates) > 1e-6))
    assert passed == {0.5: 0, 5.0: 2, -50.0: module.MOST_REFUSED}[step]  # the gate widens
    assert estimates[passed] == pytest.approx(step, rel=0.3)


def test_the_gate_is_as_wide_as_little_is_known() -> None:
    """After 20 cycles in the dark a force 3 N off is no surprise."""
    filter_ = settled(gate=[2.0, np.inf])
    for _ in range(2):  # fewer than it takes to pass anyway
        filter_.correct(np.array([np.nan, 0.0]))
        filter_.predict(np.zeros(1))
    assert (filter_.missing < module.MOST_REFUSED).all()
    filter_.correct(np.array([2.5, 0.0]))
    assert filter_.missing.tolist() == [0, 0]
    assert filter_.state[0] > 1.0


# ---- patience


def test_informed_is_who_has_seen_every_row_not_long_ago() -> None:
    filter_ = observer(patience=3)
    assert not filter_.informed
    filter_.correct(np.array([np.nan, 0.0]))
    assert not filter_.informed
    filter_.correct(np.zeros(2))
    told = []
    for row in (0, 1, 0, 0, 0, None):
        y = np.zeros(2)
        if row is not None:
            y[row] = np.nan
        filter_.correct(y)
        told.append(filter_.informed)
    assert told == [True] * 6
    for _ in range(4):
        told.append(filter_.informed)
        filter_.correct(NOTHING)
    assert not filter_.informed
    assert told[6:] == [True] * 4
    filter_.correct(np.zeros(2))
    assert filter_.informed
    filter_.reset()
    assert not filter_.informed


def test_long_silence_ends_in_an_estimate_of_what_is_there() -> None:
    filter_ = settled()
    for _ in range(20_000):
        filter_.correct(NOTHING)
        filter_.predict(np.zeros(1))
    (part,) = filter_._parts
    assert np.isfinite(part.P).all()
    for _ in range(200):
        filter_.correct(np.array([3.0, 0.01]))
        filter_.predict(np.array([0.2]))
    assert filter_.settled[0]
    assert filter_.state[:2] == pytest.approx([3.0, 0.01], rel=1e-3)


# ---- what is known beforehand


def test_what_is_known_beforehand_is_taken_into_account_once() -> None:
    known = np.full(N, np.inf)
    known[6] = 60.0  # the tissue's jerk
    with_, without = observer(prior=known), observer()
    rng = np.random.default_rng(3)
    for _ in range(50):
        y = rng.standard_normal(2) * [0.003, 1e-5]
        for each in (with_, without):
            each.correct(y)
            each.predict(np.zeros(1))
    np.testing.assert_array_equal(with_.state, without.state)
    before = without.state.copy()
    (part,) = without._parts
    scale = part.state_scale[0]
    P = part.P[0] / np.outer(scale, scale)
    P = AXIS.model.A @ P @ AXIS.model.A.T + AXIS.process_noise
    gain = P[:, 6] / (P[6, 6] + 60.0**2)
    with_.correct(NOTHING)
    np.testing.assert_allclose(with_.state, before - gain * before[6], rtol=1e-6, atol=1e-12)
    later = with_.predict(np.zeros(1)).copy()
    np.testing.assert_array_equal(with_.correct(NOTHING), later)


def test_what_is_known_beforehand_comes_before_what_is_still_measured() -> None:
    """A prior on a state that both rows show: a measurement of 0, then that of the other row."""
    A, C = np.array([[1.0, 0.3], [0.0, 0.9]]), np.array([[1.0, 0.0], [1.0, 1.0]])
    W, V = np.diag([0.2, 1.0]), np.diag([0.1, 0.5])
    (part,) = subsystems(A, C, W, V)
    model = LinearModel(A, np.ones((2, 1)), np.eye(1, 2), 1.0)
    mine = KalmanObserver(model, C, W, V, prior=[np.inf, 0.4])
    mine.reset([1.0, -2.0])
    P = A @ (part.P / np.outer(part.state_scale, part.state_scale)) @ A.T + W
    x = np.array([1.0, -2.0])
    for row, variance, value in (([0.0, 1.0], 0.4**2, 0.0), (C[1], V[1, 1], 3.0)):
        gain = P @ row / (row @ P @ row + variance)
        x = x + gain * (value - np.dot(row, x))
        P = P - np.outer(gain, row @ P)
    np.testing.assert_allclose(mine.correct(np.array([np.nan, 3.0])), x, rtol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"patience": -1}, "patience must not be negative, got -1 cycles"),
        ({"gate": 0.0}, "gate must be positive, got 0"),
        ({"gate": [1.0, np.nan]}, "gate holds NaN"),
        ({"gate": np.ones(3)}, "gate must have shape"),
        ({"prior": -1.0}, "prior must be positive, got -1"),
        ({"prior": np.ones(3)}, "prior must have shape"),
    ],
)
def test_arguments_that_cannot_be(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(Exception, match=message):
        observer(**arguments)


def test_a_subsystem_that_nothing_measures_is_predicted(rng: np.random.Generator) -> None:
    model = LinearModel(np.diag([0.9, 0.5]), np.ones((2, 1)), np.eye(2), 1.0)
    filter_ = KalmanObserver(model, [[1.0, 0.0]], np.eye(2), [[1.0]], patience=5)
    filter_.reset([1.0, 1.0])
    filter_.correct(np.array([np.nan]))
    np.testing.assert_array_equal(filter_.state, [1.0, 1.0])
    np.testing.assert_allclose(filter_.predict(np.zeros(1)), [0.9, 0.5])
