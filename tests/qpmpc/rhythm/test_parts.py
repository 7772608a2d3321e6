"""Splines, the learned waveform, alignment, the filters and the period, each by itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import BSpline

from qpmpc.rhythm.alignment import align
from qpmpc.rhythm.filter import MotionFilter
from qpmpc.rhythm.period import Periodicity
from qpmpc.rhythm.plain import ORDER, PlainFilter, extrapolation, transition
from qpmpc.rhythm.spline import Spline
from qpmpc.rhythm.waveform import Waveform

from .hearts import PERIOD, pulses

SPLINE = Spline(1.2, 0.02)


# ---- splines


@given(st.floats(0.0, 1.2), st.integers(0, 2**31))
def test_a_spline_is_the_textbook_cubic(place: float, seed: int) -> None:
    c = np.random.default_rng(seed).standard_normal(SPLINE.count)
    knots = 0.02 * (np.arange(SPLINE.count + 4) - 3)
    reference = BSpline(knots, c, 3)
    numbers, weights, slopes = SPLINE.locate(np.array([place]))
    assert weights[0] @ c[numbers[0]] == pytest.approx(float(reference(place)), abs=1e-7)
    if 1e-6 < place < 1.2 - 1e-6:
        assert slopes[0] @ c[numbers[0]] == pytest.approx(float(reference(place, 1)), abs=1e-6)


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12))
def test_weights_are_shares_wherever_one_looks(place: float) -> None:
    numbers, weights, slopes = SPLINE.locate(np.array([place]))
    assert numbers.min() >= 0
    assert numbers.max() < SPLINE.count
    assert weights.sum() == pytest.approx(1.0)
    assert weights.min() >= -1e-12
    if not 0 <= place <= 1.2:
        assert not slopes.any()


def test_the_design_matrix_reads_the_spline() -> None:
    places = np.linspace(-0.1, 1.3, 57)
    c = np.random.default_rng(0).standard_normal(SPLINE.count)
    numbers, weights, _ = SPLINE.locate(places)
    np.testing.assert_allclose(SPLINE.design(places) @ c, (weights * c[numbers]).sum(axis=1))


# ---- the waveform


def wave(time: np.ndarray) -> np.ndarray:
    u = (time[:, None] - [0.2, 0.25]) / 0.04
    return np.asarray([3.0, -2.0] * np.exp(-0.5 * u * u))


def taught(beats: int, *, delay: float = 0.0, size: float = 1.0, noise: float = 0.0) -> Waveform:
    waveform = Waveform(2, SPLINE, capacity=300, noise=0.6, memory=8.0)
    rng = np.random.default_rng(1)
    time = 0.004 * np.arange(200)
    for _ in range(beats):
        slow = np.outer(1.0 + 2.0 * time - time**2, [1.0, -3.0]) * rng.standard_normal()
        values = size * wave(time - delay) + slow + noise * rng.standard_normal((200, 2))
        for t, value in zip(time, values, strict=True):
            waveform.note(t, value)
        waveform.learn(1.0, delay, np.full(2, size))
    return waveform


def shape_error(waveform: Waveform) -> float:
    """What is wrong apart from what is slow."""
    time = 0.004 * np.arange(180)  # a late beat does not show the end
    wrong = SPLINE.design(time) @ waveform.coefficients - wave(time)
    slow = np.vander(time, 3)
    return float(np.abs(wrong - slow @ np.linalg.lstsq(slow, wrong, rcond=None)[0]).max())


def test_beats_are_learned_whatever_is_slow_beneath_them() -> None:
    assert shape_error(taught(1)) < 1.0
    assert shape_error(taught(12)) < 0.05


def test_a_beat_is_learned_at_its_delay_and_size() -> None:
    assert shape_error(taught(12, delay=0.05, size=1.3)) < 0.05
    assert shape_error(taught(12, delay=0.05)) < 0.05


def test_noise_is_averaged_out() -> None:
    errors = [shape_error(taught(beats, noise=0.5)) for beats in (2, 20)]
    assert errors[1] < 0.7 * errors[0]


def test_what_is_beyond_its_room_is_not_learned_and_a_short_beat_not_at_all() -> None:
    waveform = Waveform(2, SPLINE, capacity=10, noise=0.6, memory=8.0)
    for k in range(50):
        waveform.note(0.004 * k, np.ones(2))
    assert waveform.kept[0].size == 10
    waveform.drop()
    waveform.note(0.0, np.ones(2))
    waveform.learn(1.0, 0.0, np.ones(2))
    assert waveform.beats == 0
    assert not waveform.coefficients.any()


def test_it_forgets() -> None:
    waveform = taught(5)
    waveform.forget()
    assert waveform.beats == 0
    assert not waveform.coefficients.any()


# ---- alignment


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.12, 0.12), st.floats(-3.0, 3.0))
def test_a_late_beat_is_found_to_half_a_sample(late: float, tilt: float) -> None:
    waveform = TAUGHT
    time = 0.004 * np.arange(200)
    for t, value in zip(time, wave(time - late) + tilt * time[:, None], strict=True):
        waveform.note(t, value)
    found = align(waveform, 1.0, 0.16)
    waveform.drop()
    assert found.delay == pytest.approx(late, abs=2e-3)
    assert found.explained > 0.95


TAUGHT = taught(12)


def test_what_is_no_beat_is_not_explained() -> None:
    rng = np.random.default_rng(2)
    for k in range(200):
        TAUGHT.note(0.004 * k, rng.standard_normal(2))
    assert align(TAUGHT, 1.0, 0.1).explained < 0.1
    TAUGHT.drop()
    assert align(TAUGHT, 1.0, 0.1).explained == 0.0


# ---- filters


def test_transition_and_extrapolation_are_the_taylor_series() -> None:
    A = transition(0.1)
    np.testing.assert_allclose(A, np.linalg.matrix_power(transition(0.05), 2))
    np.testing.assert_allclose(extrapolation(np.array([0.3]))[0], np.linalg.matrix_power(A, 3)[0])


def test_the_plain_filter_goes_on_along_a_parabola() -> None:
    plain = PlainFilter(2, PERIOD, 0.1, 1e4)
    time = PERIOD * np.arange(3000)
    path = np.stack([1 + 2 * time - 5 * time**2, np.sin(time)], axis=1)
    plain.begin(path[0])
    for value in path:
        plain.correct(value)
        plain.predict()
    ahead = extrapolation(np.array([0.01])) @ plain.state.T
    t = 3.0 + 0.01
    assert ahead[0, 0] == pytest.approx(1 + 2 * t - 5 * t**2, abs=1e-2)
    assert ahead[0, 1] == pytest.approx(np.sin(t), abs=1e-2)


def test_the_filter_without_a_waveform_is_the_plain_one_in_the_end() -> None:
    both = MotionFilter(1, PERIOD, 0.1), PlainFilter(1, PERIOD, 0.1, 1e4)
    both[0].begin(np.zeros(1), np.ones(ORDER))
    nothing, rng = np.zeros(1), np.random.default_rng(3)
    for k in range(2000):
        value = np.array([np.sin(0.01 * k) + 0.1 * rng.standard_normal()])
        both[0].correct(value, nothing, nothing, nothing)
        both[1].correct(value)
        both[0].predict(1e4)
        both[1].predict()
    np.testing.assert_allclose(both[0].rest, both[1].state, rtol=1e-3, atol=1e-3)
    assert both[0].surprise == pytest.approx(1.0, abs=0.6)


def test_size_and_delay_of_a_beat_are_told_from_a_pulse() -> None:
    """A pulse 1.2 times as large and 4 ms late, in noise, on a filter that knows its shape."""
    filt, rng = MotionFilter(1, PERIOD, 0.05), np.random.default_rng(4)
    filt.begin(np.zeros(1), np.array([0.01, 0.0, 0.0, 0.0]))
    filt.expect(0.0, 0.2, 0.005)

    def pulse(t: float) -> float:
        return float(5.0 * np.exp(-0.5 * ((t - 0.2) / 0.03) ** 2))

    for k in range(400):
        t = k * PERIOD - filt.delay
        lateness = -(pulse(t + 1e-6) - pulse(t - 1e-6)) / 2e-6
        value = 1.2 * pulse(k * PERIOD - 0.004) + 0.05 * rng.standard_normal()
        filt.correct(np.array([value]), np.array([pulse(t)]), np.array([lateness]), np.zeros(1))
        filt.predict(1.0)
    assert filt.change[0] == pytest.approx(0.2, abs=0.02)
    assert filt.delay == pytest.approx(0.004, abs=5e-4)
    assert filt.delay_deviation < 5e-4


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=3, max_size=40), st.integers(0, 2**31))
def test_covariance_stays_symmetric_and_positive(values: list[float], seed: int) -> None:
    rng = np.random.default_rng(seed)
    filt = MotionFilter(2, PERIOD, 0.01)
    filt.begin(np.zeros(2), np.array([0.01, 1.0, 1e2, 1e4]))
    for i, value in enumerate(values):
        if i % 7 == 3:
            filt.expect(0.7, 0.1, 0.01)
        filt.correct(np.full(2, value), *(10 * rng.standard_normal((2, 2))), rng.random(2))
        filt.predict(1e3)
    P = filt.covariance
    np.testing.assert_array_equal(P, P.T)
    size = np.sqrt(np.maximum(np.diagonal(P), 1e-12))
    assert np.linalg.eigvalsh(P / np.outer(size, size)).min() > -1e-6
    assert np.isfinite(filt.state).all()


# ---- the period


@settings(max_examples=25, deadline=None)
@given(st.floats(0.4, 1.6), st.integers(0, 2**31))
def test_the_period_of_a_rhythm_is_found(period: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    force = pulses(np.arange(0.1, 10.0, period).tolist(), 10_000)[::20]
    rate = np.diff(force, axis=0) / 0.02 + 3.0 * rng.standard_normal((499, 3))
    listener = Periodicity(3, 0.02)
    for value in rate:
        listener.note(value)
    found, correlation = listener.find()
    assert found == pytest.approx(period, rel=0.02)
    assert correlation > 0.5


def test_noise_has_no_period_and_a_rest_none_either() -> None:
    rng, listener = np.random.default_rng(6), Periodicity(3, 0.02)
    assert listener.find()[1] == 0.0
    for _ in range(1000):
        listener.note(rng.standard_normal(3))
    assert listener.find()[1] < 0.4
    still = Periodicity(1, 0.02)
    for _ in range(500):
        still.note(np.zeros(1))
    assert still.find()[1] == 0.0


def test_the_quiet_part_is_before_the_pulse() -> None:
    period = 0.8
    beats = np.arange(0.1, 6.0, period)
    force = pulses(beats.tolist(), 6000)[::20]
    listener = Periodicity(3, 0.02)
    for value in np.diff(force, axis=0) / 0.02:
        listener.note(value)
    quiet = (5.98 - listener.since_quiet(period) - 0.1) % period
    assert not 0.05 < quiet < 0.35  # the pulse
