"""The estimator on hearts of which everything is known: it converges, follows, and gives way."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qpmpc.arrays import Array
from qpmpc.rhythm.estimator import MotionEstimator

from .hearts import NOISE, PERIOD, foretell, motion, noise, pulses, rms

pytestmark = pytest.mark.slow

both = pytest.mark.parametrize("synchronised", [True, False], ids=["beats", "tracked"])


def estimator(synchronised: bool, axes: int = 3, **change: float) -> MotionEstimator:
    return MotionEstimator(axes, PERIOD, motion(synchronised, **change), synchronised=synchronised)


def plain() -> MotionEstimator:
    """Never told of a beat: it stays with what is smooth."""
    return estimator(True)


def beats_of(intervals: Array, first: float = 0.4) -> list[float]:
    return (first + np.concatenate([[0.0], np.cumsum(intervals)])).tolist()


STEADY = beats_of(np.full(18, 0.83))


@pytest.fixture(scope="module")
def steady() -> dict[str, Array]:
    """What is expected 4 ms ahead of a steady heart: errors of the last three seconds."""
    force = pulses(STEADY, 9_000)
    samples = force + noise(9_000)
    return {
        name: (foretell(how, samples, told) - force)[6_000:]
        for name, how, told in (
            ("plain", plain(), []),
            ("beats", estimator(True), STEADY),
            ("tracked", estimator(False), []),
        )
    }


def test_a_steady_heart_is_foretold_better_than_a_smooth_motion(steady: dict[str, Array]) -> None:
    smooth = rms(steady["plain"])
    assert (rms(steady["beats"]) < 0.65 * smooth).all()
    assert (rms(steady["tracked"]) < 0.75 * smooth).all()
    assert (rms(steady["beats"]) < 0.6 * NOISE).all()


def test_the_rate_is_found_and_followed_as_it_drifts() -> None:
    intervals = np.linspace(0.9, 0.65, 16)
    beats = beats_of(intervals)
    force = pulses(beats, 11_000)
    how, found = estimator(False), []
    foretell(how, force + noise(11_000), note=lambda _: found.append(how.interval))
    assert how.following
    for second in (6, 8, 10):
        true = np.diff(beats)[np.searchsorted(beats, second) - 1]
        assert found[1000 * second] == pytest.approx(true, rel=0.06)


@both
def test_when_the_rhythm_breaks_it_is_no_worse_than_without_and_takes_no_jump(
    synchronised: bool,
) -> None:
    """Six steady beats, then fibrillation: intervals of any length, beats of any size."""
    rng = np.random.default_rng(7)
    beats = beats_of(np.concatenate([np.full(6, 0.83), rng.uniform(0.35, 1.2, 10)]))
    sizes = np.concatenate([np.ones(7), rng.uniform(0.4, 1.3, 10)])
    force = pulses(beats, 10_000, sizes)
    samples = force + noise(10_000)
    told = beats if synchronised else []
    how, now = estimator(synchronised), np.zeros_like(force)
    error = foretell(how, samples, told, note=lambda k: how.preview(now[k : k + 1])) - force
    smooth = foretell(plain(), samples) - force
    assert (rms(error[5500:]) < 1.25 * rms(smooth[5500:])).all()
    assert np.abs(error[5500:]).max() < 2.0 * np.abs(smooth[5500:]).max()
    steps = np.abs(np.diff(now[3000:], axis=0)).max(axis=0)
    true_steps = np.abs(np.diff(force, axis=0)).max(axis=0)
    assert (steps < true_steps + NOISE).all()


@both
def test_after_the_heart_stops_what_was_learned_is_given_up(synchronised: bool) -> None:
    beats = beats_of(np.full(7, 0.8))
    force = pulses(beats, 12_000)
    told = beats_of(np.full(13, 0.8)) if synchronised else []  # an ECG without a pulse
    how = estimator(synchronised)
    error = foretell(how, force + noise(12_000), told) - force
    assert how.waveform.beats < 7
    assert (rms(error[11_000:]) < NOISE).all()


def test_an_early_beat_does_no_harm() -> None:
    intervals = np.full(18, 0.83)
    intervals[9], intervals[10] = 0.55, 1.11
    beats = beats_of(intervals)
    sizes = np.ones(19)
    sizes[10], sizes[11] = 0.75, 1.2
    force = pulses(beats, 9_500, sizes)
    samples = force + noise(9_500)
    error = foretell(estimator(True), samples, beats) - force
    smooth = foretell(plain(), samples) - force
    for beat in (beats[10],):
        part = slice(round(1000 * beat), round(1000 * beat) + 500)
        assert (rms(error[part]) < 1.1 * rms(smooth[part])).all()


def test_double_peaks_and_peaks_before_the_first_sample_are_none() -> None:
    how = estimator(True)
    how.beat()
    how.advance()
    assert not how.following
    how.correct(np.zeros(3))
    how.beat()
    how.advance()
    assert how.following
    for k in range(300):
        how.correct(np.zeros(3))
        if k in (50, 120):
            how.beat()
        how.advance()
    assert np.isnan(how.interval)
    how.beat()
    how.advance()
    assert how.interval == pytest.approx(0.301, abs=2e-3)


@both
def test_missing_samples_are_bridged(synchronised: bool) -> None:
    force = pulses(STEADY, 8_000)
    samples = force + noise(8_000)
    rng = np.random.default_rng(8)
    samples[rng.random(8_000) < 0.2] = np.nan
    samples[7_000:7_010, 1] = np.inf
    error = foretell(estimator(synchronised), samples, STEADY if synchronised else []) - force
    assert np.isfinite(error[10:]).all()
    assert (rms(error[5000:]) < 1.5 * NOISE).all()


def test_a_filter_that_broke_down_begins_anew() -> None:
    how = estimator(True)
    for _ in range(5):
        how.correct(np.ones(3))
        how.advance()
    how.filter.state[:] = np.nan
    how.correct(np.ones(3))
    out = np.empty((3, 3))
    for _ in range(3):
        how.correct(np.full(3, 2.0))
        how.advance()
    np.testing.assert_allclose(how.preview(out), 2.0)


@settings(max_examples=15, deadline=None)
@given(
    st.lists(
        st.sampled_from([0.0, -5.0, 1e3, -1e6, 1e12, np.nan, np.inf]), min_size=5, max_size=60
    ),
    st.booleans(),
    st.integers(1, 3),
)
def test_nothing_that_is_measured_breaks_it(
    values: list[float], synchronised: bool, axes: int
) -> None:
    how, out = estimator(synchronised, axes), np.empty((9, axes))
    for k, value in enumerate(values):
        if k % 3 == 0:
            how.beat()
        for _ in range(40):
            how.correct(np.full(axes, value))
            assert np.isfinite(how.preview(out)).all()
            how.advance()


@both
def test_memory_does_not_grow(synchronised: bool) -> None:
    """Every array is the one of the start, after any number of beats."""
    how = estimator(synchronised)
    samples = pulses(STEADY, 3500)
    foretell(how, samples, STEADY)
    arrays = {k: (id(v), v.shape) for k, v in vars(how).items() if isinstance(v, np.ndarray)}
    foretell(how, samples, STEADY)
    after = {k: (id(v), v.shape) for k, v in vars(how).items() if isinstance(v, np.ndarray)}
    assert after.keys() == arrays.keys()
    assert {k: s for k, (_, s) in after.items() if k != "_taylor"} == {
        k: s for k, (_, s) in arrays.items() if k != "_taylor"
    }
    assert how.waveform.kept[0].size <= 400


def test_a_reset_is_a_new_start() -> None:
    how = estimator(False)
    samples = pulses(STEADY, 4000) + noise(4000)
    first = foretell(how, samples)
    how.reset()
    np.testing.assert_array_equal(foretell(how, samples), first)
