"""When the heart beats: drawn series, early beats, and the R peaks of a real ECG."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import scenarios
from scenarios import load_scenario
from scenarios.motion import (
    DataFileError,
    DataTooShortError,
    Motion,
    MotionConfig,
    RateStep,
    load_motion,
)
from scenarios.motion.beats import read_beats

PERIOD = 0.001
REAL_BEATS = Path(scenarios.__file__).parent / "data" / "beats_mitbih208.csv"
STEADY = {"rate_variability_lf": 0.0, "rate_variability_hf": 0.0}


def heart(duration: float, seed: int = 0, **keys: object) -> Motion:
    """One moving axis is enough here, and a third of the work."""
    return load_motion(replace(MotionConfig(axes=("z",)), **keys), duration, PERIOD, seed)


def write_beats(path: Path, times: np.ndarray) -> str:
    path.write_text("t\n" + "\n".join(f"{t:.4f}" for t in times) + "\n")
    return str(path)


def excursions(motion: Motion) -> np.ndarray:
    """Peak to peak on z in the 0.4 s after each beat but the last."""
    starts = np.round(motion.beats[:-1] / PERIOD).astype(int)
    return np.array([np.ptp(motion.position[k : k + 400, 2]) for k in starts])


@pytest.mark.parametrize("rate", [1.0, 1.2, 1.9])
def test_the_mean_rate_is_kept(rate: float) -> None:
    for seed in range(3):
        intervals = np.diff(heart(120.0, seed, heart_rate=rate).beats)
        assert 1.0 / intervals.mean() == pytest.approx(rate, rel=0.01)


def test_without_variability_the_beats_are_even() -> None:
    np.testing.assert_allclose(np.diff(heart(30.0, **STEADY).beats), 1.0 / 1.2, rtol=1e-12)


def test_the_slow_wave_swings_the_rate_at_a_tenth_hertz() -> None:
    motion = heart(200.0, **(STEADY | {"rate_variability_lf": 0.1}))
    rate = 1.0 / np.diff(motion.beats)
    assert (rate.max() - rate.min()) / 2.4 == pytest.approx(0.1, rel=0.05)
    time = motion.beats[:-1]
    waves = np.array([np.abs(np.exp(-2j * np.pi * f * time) @ (rate - 1.2)) for f in (0.1, 0.25)])
    assert waves[0] > 5.0 * waves[1]


def test_the_fast_wave_follows_the_breath() -> None:
    keys = STEADY | {"rate_variability_hf": 0.1, "respiration_variability": 0.0}
    motion = heart(200.0, **keys)
    rate = 1.0 / np.diff(motion.beats)
    assert (rate.max() - rate.min()) / 2.4 == pytest.approx(0.1, rel=0.05)
    time = motion.beats[:-1]
    waves = np.array([np.abs(np.exp(-2j * np.pi * f * time) @ (rate - 1.2)) for f in (0.1, 0.25)])
    assert waves[1] > 5.0 * waves[0]


def test_the_rate_steps_from_the_first_beat_after_the_time() -> None:
    steps = (RateStep(10.0, 2.0), RateStep(20.0, 0.8))
    beats = heart(30.0, rate_steps=steps, **STEADY).beats
    intervals = np.diff(beats)
    before = beats[:-1]
    np.testing.assert_allclose(intervals[before < 10.0], 1.0 / 1.2, rtol=1e-9)
    between = (before >= 10.0) & (before < 20.0)
    np.testing.assert_allclose(intervals[between], 0.5, rtol=1e-9)
    np.testing.assert_allclose(intervals[before >= 20.0], 1.25, rtol=1e-9)
    assert between.sum() > 15
    calm = heart(30.0, **STEADY).beats
    assert np.array_equal(beats[beats < 10.0], calm[calm < 10.0])


def test_irregular_intervals_spread_by_themselves() -> None:
    intervals = np.diff(heart(400.0, rate_irregularity=0.3, **STEADY).beats) * 1.2
    assert 0.7 <= intervals.min() < 0.72
    assert 1.28 < intervals.max() <= 1.3
    assert intervals.std() == pytest.approx(0.3 / np.sqrt(3.0), rel=0.05)
    assert abs(np.corrcoef(intervals[1:], intervals[:-1])[0, 1]) < 0.12  # no memory


def test_without_breath_only_the_beats_move_the_tissue() -> None:
    keys = STEADY | {"respiration_excursion": 0.0, "breath_modulation": 0.0}
    motion = heart(60.0, **keys)
    found = excursions(motion)[1:]
    np.testing.assert_allclose(found, found[0], rtol=1e-3)
    assert np.ptp(excursions(heart(60.0, **STEADY))) > 0.05 * found[0]


def test_early_beats_come_at_their_probability_with_a_compensatory_pause() -> None:
    motion = heart(600.0, early_beat_probability=0.1, **STEADY)
    intervals = np.diff(motion.beats) * 1.2
    early = np.flatnonzero(intervals < 0.9)
    assert early.size / intervals.size == pytest.approx(0.1 / 1.1, abs=0.03)
    assert intervals[early].min() >= 0.6
    assert intervals[early].max() <= 0.8
    early = early[early + 1 < intervals.size]
    np.testing.assert_allclose(intervals[early] + intervals[early + 1], 2.0, rtol=1e-9)
    others = np.setdiff1d(np.arange(intervals.size), np.concatenate((early, early + 1)))
    np.testing.assert_allclose(intervals[others[:-1]], 1.0, rtol=1e-9)
    assert not (np.diff(heart(600.0, **STEADY).beats) * 1.2 < 0.9).any()


def test_an_early_beat_is_smaller_and_the_one_after_the_pause_larger() -> None:
    keys = STEADY | {"breath_modulation": 0.0, "respiration_excursion": 0.0}
    motion = heart(120.0, early_beat_probability=0.1, **keys)
    intervals = np.diff(motion.beats) * 1.2
    sizes = excursions(motion)[1:]
    before = intervals[: sizes.size]
    usual = np.median(sizes[np.abs(before - 1.0) < 1e-9])
    assert (sizes[before < 0.9] < 0.9 * usual).all()
    assert (sizes[before > 1.1] > 1.1 * usual).all()


def test_real_beats_drive_the_pulses(tmp_path: Path) -> None:
    times = np.loadtxt(REAL_BEATS, comments="#", skiprows=3)
    motion = heart(41.0, beats=str(REAL_BEATS))
    np.testing.assert_allclose(
        np.diff(motion.beats), np.diff(times)[: motion.beats.size - 1], atol=1e-12
    )
    assert motion.beats[0] == pytest.approx(0.35)
    # the twitch follows its R peak: the steepest descent of z comes at the same time in each beat
    starts = np.round(motion.beats[:-1] / PERIOD).astype(int)
    delay = np.array([np.argmin(motion.velocity[k : k + 350, 2]) for k in starts])
    assert np.ptp(delay) < 40
    moved = heart(41.0, beats=write_beats(tmp_path / "later.csv", times + 1000.0))
    np.testing.assert_allclose(moved.position, motion.position, atol=1e-9)


def test_systole_shortens_less_than_the_interval(tmp_path: Path) -> None:
    def systole(interval: float) -> float:
        """Samples from the R peak to the lowest point of z, the end of the twitch."""
        path = write_beats(tmp_path / "beats.csv", interval * np.arange(60))
        motion = heart(20.0, beats=path, respiration_excursion=0.0, breath_modulation=0.0)
        k = round(motion.beats[5] / PERIOD)
        beat = motion.position[k : k + round(interval / PERIOD), 2]
        return float(np.argmin(beat))

    slow, fast = systole(1.0), systole(0.5)
    assert 0.5 * slow < fast < 0.85 * slow


def test_real_beats_too_short_for_the_run() -> None:
    with pytest.raises(DataTooShortError, match=r"41\.77 s.*60 s") as caught:
        heart(60.0, beats=str(REAL_BEATS))
    assert caught.value.requested == 60.0
    assert caught.value.available == pytest.approx(41.775, abs=1e-3)
    assert caught.value.path == REAL_BEATS


def test_a_series_shorter_than_the_calibration_still_hits_the_targets(tmp_path: Path) -> None:
    path = write_beats(tmp_path / "short.csv", 0.85 * np.arange(12))
    force = 2500.0 * heart(9.7, beats=path, axes=("x", "y", "z")).position
    np.testing.assert_allclose(force.std(axis=0), (1.0, 1.6, 3.5), rtol=0.01)
    np.testing.assert_allclose(np.ptp(force, axis=0), (7.0, 10.0, 20.0), rtol=0.01)


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("t\n0.0\n0.8\n0.9\n1.8\n", 4, "0.2 to 3 s"),
        ("# ms\nt\n0\n800\n1600\n2400\n", 4, "seconds"),
        ("t\n0.0\n0.8\n0.8\n1.6\n", 4, "increase"),
        ("t\n0.0\n0.8\n1.6\n", None, "at least 4"),
        ("time\n0.0\n0.8\n1.6\n", 1, "expected t"),
        ("t\n0.0\n0.8\nx\n", 4, "finite number"),
    ],
)
def test_bad_beat_files(tmp_path: Path, text: str, line: int | None, words: str) -> None:
    path = tmp_path / "beats.csv"
    path.write_text(text)
    with pytest.raises(DataFileError, match=words) as caught:
        heart(1.0, beats=str(path))
    assert caught.value.line == line
    assert caught.value.path == path


def test_the_early_beat_of_constrained_falls_into_its_cap_on_force() -> None:
    """At 0.65 of the interval; the pause after it is compensatory, all others are regular."""
    scenario = load_scenario("constrained")
    beats = read_beats(Path(scenario.motion.beats))
    intervals = np.diff(beats.times)
    usual = beats.usual_interval
    (early,) = np.flatnonzero(intervals < 0.9 * usual)
    assert intervals[early] == pytest.approx(0.65 * usual, rel=1e-3)
    assert intervals[early] + intervals[early + 1] == pytest.approx(2 * usual, rel=1e-3)
    others = np.delete(intervals, [early, early + 1])
    np.testing.assert_allclose(others, usual, atol=1.1e-4)
    capped, freed = (step.time for step in scenario.bounds_steps)
    assert capped < beats.times[early + 1] < beats.times[early + 1] + 0.3 < freed
    assert beats.times[-1] > scenario.duration
