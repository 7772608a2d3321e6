"""When the heart beats: a series drawn from a seed, or the R peaks of a real ECG."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenarios.errors import DataFileError
from scenarios.motion.breath import MEAN, Breath, breath_wave
from scenarios.motion.config import MotionConfig
from scenarios.motion.record import Array
from scenarios.table import read_table

FIRST_BEAT = 0.35
"""Earliest first R peak [s]: a run starts in the diastolic rest."""
_LF_RATE = 0.1
"""Rate of the slow (baroreflex) wave of the heart rate [Hz]."""
_EARLY_SHARE = (0.6, 0.8)
"""Interval before an early beat, as a share of the regular one."""
_INTERVAL_RANGE = (0.2, 3.0)
"""Intervals that a real series may have [s]; outside, peaks were missed or doubled."""


@dataclass(frozen=True)
class BeatSeries:
    """R peaks with what the shape of a beat depends on."""

    times: Array
    """R peaks [s], (m,)."""
    intervals: Array
    """Interval that precedes each beat [s], (m,)."""
    usual_interval: float
    """Interval of a beat of usual amplitude [s]."""


def draw_beats(
    config: MotionConfig,
    breath: Breath,
    duration: float,
    *,
    phase_rng: np.random.Generator,
    early_rng: np.random.Generator,
    spread_rng: np.random.Generator,
) -> BeatSeries:
    """Beats from the first, after the diastolic rest, to past ``duration`` [s].

    The rate swings with a slow wave and with the breath (faster in inspiration). An early beat
    comes after 0.6 to 0.8 of the interval, and the pause after it is compensatory: both intervals
    together are two regular ones. Where the rate steps, a beat of usual amplitude is one of the
    rate at the start: faster beats fill less.
    """
    low, high = config.rate_variability_lf, config.rate_variability_hf
    usual, steps = 1.0 / config.heart_rate, list(config.rate_steps)
    mean = usual
    lf_phase = phase_rng.uniform(0.0, 2.0 * np.pi)
    times = [max(FIRST_BEAT, phase_rng.uniform(0.4, 0.7) * usual)]
    intervals = [usual]
    pause = 0.0
    while times[-1] < duration:
        now = times[-1]
        while steps and steps[0].time <= now:
            mean = 1.0 / steps.pop(0).rate
        wave = float(breath_wave(breath, np.array([now]))[0][0])
        swing = low * np.sin(2.0 * np.pi * _LF_RATE * now + lf_phase) + 2.0 * high * (wave - MEAN)
        spread = config.rate_irregularity * spread_rng.uniform(-1.0, 1.0)
        regular = mean / (1.0 + swing) * (1.0 + spread)
        # drawn for every beat, so that the series does not depend on which beats are early
        chance, share = early_rng.random(), early_rng.uniform(*_EARLY_SHARE)
        interval = regular + pause
        if pause == 0.0 and chance < config.early_beat_probability:
            interval = share * regular
            pause = regular - interval
        else:
            pause = 0.0
        times.append(now + interval)
        intervals.append(interval)
    return BeatSeries(np.array(times), np.array(intervals), usual)


def read_beats(path: Path) -> BeatSeries:
    """Beats from a CSV file of R-peak times (column ``t`` [s]; other columns are ignored).

    The series is shifted in time so that its first beat comes ``FIRST_BEAT`` after the start of the
    run. Errors: ``DataFileError`` for an unusable file, fewer than 4 beats or an interval outside
    0.2 .. 3 s.
    """
    table = read_table(path, ("t",), min_rows=4)
    times = table.values[:, 0]
    intervals = np.diff(times)
    shortest, longest = _INTERVAL_RANGE
    wrong = np.flatnonzero((intervals < shortest) | (intervals > longest))
    if wrong.size:
        reason = (
            f"beat {intervals[wrong[0]]:.3g} s after the one before; "
            f"intervals must lie in {shortest:g} to {longest:g} s (is t in seconds?)"
        )
        raise DataFileError(path, int(table.lines[wrong[0] + 1]), reason)
    usual = float(np.median(intervals))
    return BeatSeries(
        times - times[0] + FIRST_BEAT, np.concatenate(([usual], intervals)), usual_interval=usual
    )
