"""The generated heart: the paper's uncompensated force for every seed, physiological curves."""

from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import scenarios
from scenarios.errors import ScenarioError
from scenarios.motion import (
    CALIBRATION_TIME,
    Motion,
    MotionConfig,
    MotionKeyError,
    UnreachableForceError,
    load_motion,
)

PERIOD = 0.001
REAL_BEATS = str(Path(scenarios.__file__).parent / "data" / "beats_mitbih208.csv")
RMS = np.array([1.0, 1.6, 3.5])
PEAK_TO_PEAK = np.array([7.0, 10.0, 20.0])
STIFFNESS = 2500.0


@cache
def heart(duration: float = CALIBRATION_TIME, seed: int = 0, **keys: object) -> Motion:
    return load_motion(replace(MotionConfig(), **keys), duration, PERIOD, seed)


def figures(motion: Motion) -> tuple[np.ndarray, np.ndarray]:
    force = STIFFNESS * motion.position
    return force.std(axis=0), np.ptp(force, axis=0)


@pytest.mark.parametrize(
    ("keys", "seeds"),
    [
        ({}, 25),
        ({"early_beat_probability": 0.15}, 25),
        ({"beats": REAL_BEATS}, 20),
        ({"heart_rate": 2.0}, 10),
        ({"heart_rate": 1.0}, 10),
    ],
    ids=["regular", "early", "real", "fast", "slow"],
)
def test_every_seed_gives_the_force_of_the_paper(keys: dict[str, object], seeds: int) -> None:
    for seed in range(seeds):
        rms, peak_to_peak = figures(heart(seed=seed, **keys))
        np.testing.assert_allclose(rms, RMS, rtol=0.01, err_msg=f"seed {seed}")
        np.testing.assert_allclose(peak_to_peak, PEAK_TO_PEAK, rtol=0.01, err_msg=f"seed {seed}")


@pytest.mark.parametrize("duration", [8.0, 60.0])
def test_other_durations_stay_near_the_targets(duration: float) -> None:
    for seed in range(5):
        rms, peak_to_peak = figures(heart(duration, seed))
        np.testing.assert_allclose(rms, RMS, rtol=0.07)
        np.testing.assert_allclose(peak_to_peak, PEAK_TO_PEAK, rtol=0.07)


def test_a_tool_held_at_the_mean_feels_the_rms() -> None:
    force = STIFFNESS * heart().position
    np.testing.assert_allclose(np.sqrt((force**2).mean(axis=0)), RMS, rtol=1e-3)


@pytest.mark.parametrize("keys", [{}, {"early_beat_probability": 0.15}, {"beats": REAL_BEATS}])
def test_a_longer_run_begins_with_the_shorter(keys: dict[str, object]) -> None:
    short, long = heart(7.3, 4, **keys), heart(33.0, 4, **keys)
    n = short.time.size
    for name in ("time", "position", "velocity", "acceleration"):
        assert getattr(short, name).tobytes() == getattr(long, name)[:n].tobytes(), name
    np.testing.assert_array_equal(short.beats, long.beats[: short.beats.size])


def test_the_seed_decides_and_nothing_else() -> None:
    first, other = heart(seed=1), heart(seed=2)
    again = load_motion(MotionConfig(), CALIBRATION_TIME, PERIOD, 1)
    assert first.position.tobytes() == again.position.tobytes()
    assert np.abs(first.position - other.position).max(axis=0).min() > 1e-3
    assert not np.array_equal(first.beats, other.beats)


def test_the_control_period_only_samples_the_motion() -> None:
    fine = heart()
    coarse = load_motion(MotionConfig(), CALIBRATION_TIME, 4 * PERIOD, 0)
    assert coarse.period == 4 * PERIOD
    np.testing.assert_allclose(coarse.position, fine.position[::4], atol=1e-12)


def test_samples_are_at_the_control_instants() -> None:
    motion = heart(2.0)
    np.testing.assert_array_equal(motion.time, PERIOD * np.arange(2000))
    for name in ("position", "velocity", "acceleration"):
        assert getattr(motion, name).shape == (2000, 3)
    assert motion.beats.max() < 2.0
    assert heart(1e-5).time.size == 1


@pytest.mark.parametrize("keys", [{}, {"beats": REAL_BEATS}])
def test_derivatives_agree_with_differences(keys: dict[str, object]) -> None:
    motion = heart(**keys)
    velocity = (motion.position[2:] - motion.position[:-2]) / (2 * PERIOD)
    acceleration = (motion.velocity[2:] - motion.velocity[:-2]) / (2 * PERIOD)
    # a central difference errs by period^2 / 6 times the third derivative
    np.testing.assert_allclose(motion.velocity[1:-1], velocity, atol=2e-4)
    np.testing.assert_allclose(motion.acceleration[1:-1], acceleration, atol=2e-2)


def test_the_spectrum_ends_at_20_hz() -> None:
    frequency = np.fft.rfftfreq(15000, PERIOD)
    for seed in range(10):
        for keys in ({}, {"beats": REAL_BEATS}, {"heart_rate": 2.0}):
            motion = heart(seed=seed, **keys)
            energy = np.abs(np.fft.rfft(motion.position * np.hanning(15000)[:, None], axis=0)) ** 2
            assert (energy[frequency > 20.0].sum(axis=0) < 0.01 * energy.sum(axis=0)).all()
            # no broadband noise: nothing but rounding is left at 100 Hz
            assert (energy[frequency > 100.0].sum(axis=0) < 1e-15 * energy.sum(axis=0)).all()


@pytest.mark.parametrize("keys", [{}, {"early_beat_probability": 0.15}, {"beats": REAL_BEATS}])
def test_the_motion_is_steep_but_physiological(keys: dict[str, object]) -> None:
    for seed in range(10):
        motion = heart(seed=seed, **keys)
        assert (np.abs(motion.acceleration).max(axis=0) < 10.0).all()
        assert (np.abs(motion.velocity).max(axis=0) < 0.25).all()
        disturbance = np.abs(motion.acceleration + 20.0 * motion.velocity).max(axis=0)
        assert (disturbance < 12.0).all()  # leaves room below the command bound of 20 m/s^2


def test_it_starts_at_rest() -> None:
    for seed in range(20):
        motion = heart(seed=seed)
        assert np.abs(motion.velocity[:50]).max() < 1e-3
        assert motion.beats[0] >= 0.35


def test_there_is_rest_between_the_beats() -> None:
    z = heart().velocity[:, 2]
    assert np.mean(np.abs(z) < 0.1 * np.abs(z).max()) > 0.5


def test_targets_and_stiffness_scale_the_motion() -> None:
    reference = heart()
    soft = heart(reference_stiffness=500.0)
    np.testing.assert_allclose(soft.position, 5.0 * reference.position, rtol=1e-9)
    other = heart(force_rms=(2.0, 1.6, 3.0), force_peak_to_peak=(13.0, 10.0, 17.5))
    rms, peak_to_peak = figures(other)
    np.testing.assert_allclose(rms, (2.0, 1.6, 3.0), rtol=1e-3)
    np.testing.assert_allclose(peak_to_peak, (13.0, 10.0, 17.5), rtol=1e-3)


def test_axes_that_do_not_move_are_at_rest() -> None:
    motion, full = heart(axes=("z",)), heart()
    assert not motion.position[:, :2].any()
    assert not motion.velocity[:, :2].any()
    assert not motion.acceleration[:, :2].any()
    np.testing.assert_array_equal(motion.position[:, 2], full.position[:, 2])


def peaks_with(axis: str, ratio: float) -> tuple[float, ...]:
    """Targets of the paper, but for ``axis`` peak to peak of ``ratio`` times the RMS."""
    peaks = PEAK_TO_PEAK.copy()
    peaks["xyz".index(axis)] = ratio * RMS["xyz".index(axis)]
    return tuple(peaks)


@pytest.mark.parametrize(("ratio", "axis"), [(2.5, "x"), (14.0, "z")])
def test_an_unreachable_ratio_names_the_range(ratio: float, axis: str) -> None:
    with pytest.raises(UnreachableForceError) as caught:
        heart(force_peak_to_peak=peaks_with(axis, ratio))
    error = caught.value
    assert isinstance(error, ScenarioError)
    assert error.axis == axis
    assert error.ratio == pytest.approx(ratio)
    assert not error.lowest <= ratio <= error.highest
    assert f"{error.lowest:.2f} to {error.highest:.2f}" in str(error)
    # what the error calls reachable is reached
    for reachable in (error.lowest * 1.001, error.highest * 0.999):
        heart(force_peak_to_peak=peaks_with(axis, reachable))


def test_the_unreachable_target_of_a_resting_axis_does_not_matter() -> None:
    heart(axes=("x",), force_peak_to_peak=(7.0, 10.0, 500.0))


def test_keys_without_effect_are_refused() -> None:
    with pytest.raises(MotionKeyError, match=r"motion\.heart_rate.*motion\.beats") as caught:
        heart(beats=REAL_BEATS, heart_rate=1.3)
    assert caught.value.keys == ("heart_rate",)
    with pytest.raises(MotionKeyError) as caught:
        heart(file="recording.csv", beats=REAL_BEATS, force_rms=(1.0, 1.0, 1.0))
    assert set(caught.value.keys) == {"beats", "force_rms"}
    assert caught.value.source == "file"


@pytest.mark.parametrize(
    "keys",
    [
        {"respiration_rate": 0.35},
        {"respiration_variability": 0.1},
        {"respiration_excursion": 0.8},
        {"breath_modulation": 0.4},
    ],
    ids=lambda keys: next(iter(keys)),
)
@pytest.mark.parametrize("beats", [None, REAL_BEATS], ids=["drawn", "real"])
def test_each_key_of_the_breath_changes_the_motion(
    keys: dict[str, object], beats: str | None
) -> None:
    change = heart(beats=beats, **keys).position - heart(beats=beats).position
    assert (np.abs(change).max(axis=0) > 5e-5).all()


def band(motion: Motion, low: float, high: float) -> np.ndarray:
    frequency = np.fft.rfftfreq(motion.time.size, motion.period)
    energy = np.abs(np.fft.rfft(motion.position - motion.position.mean(axis=0), axis=0)) ** 2
    return energy[(frequency >= low) & (frequency <= high)].sum(axis=0) / energy.sum(axis=0)


def test_the_breath_shows_at_its_rate() -> None:
    steady = {"respiration_variability": 0.0, "rate_variability_hf": 0.0}
    at_rate = band(heart(60.0, respiration_rate=0.35, **steady), 0.33, 0.37)
    elsewhere = band(heart(60.0, respiration_rate=0.25, **steady), 0.33, 0.37)
    assert (at_rate > 10.0 * elsewhere).all()


def test_a_deeper_breath_moves_the_tissue_more_and_modulates_the_beats() -> None:
    quiet = {"rate_variability_lf": 0.0, "rate_variability_hf": 0.0}
    shallow = heart(60.0, respiration_excursion=0.1, **quiet)
    deep = heart(60.0, respiration_excursion=0.6, **quiet)
    assert (band(deep, 0.2, 0.3) > 5.0 * band(shallow, 0.2, 0.3)).all()

    def spread_of_peaks(depth: float) -> float:
        motion = heart(60.0, breath_modulation=depth, respiration_excursion=0.0, **quiet)
        starts = np.round(motion.beats[:-1] / PERIOD).astype(int)
        peaks = np.array([motion.position[k : k + 400, 2].max() for k in starts])
        return float(np.ptp(peaks) / peaks.mean())

    assert spread_of_peaks(0.0) < 0.01
    assert spread_of_peaks(0.15) > 0.2


def test_every_key_is_covered_by_these_tests() -> None:
    known = {
        *("heart_rate", "rate_variability_lf", "rate_variability_hf", "early_beat_probability"),
        *("respiration_rate", "respiration_variability", "respiration_excursion"),
        *("breath_modulation", "force_rms", "force_peak_to_peak", "reference_stiffness", "axes"),
        *("beats", "file", "rate_steps", "rate_irregularity"),
    }
    assert {field.name for field in fields(MotionConfig)} == known
