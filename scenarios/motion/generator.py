"""The generated heart: beats, breath and pulses, calibrated to the uncompensated force."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
from scipy.optimize import brentq

from scenarios.errors import DataTooShortError
from scenarios.motion.beats import BeatSeries, draw_beats, read_beats
from scenarios.motion.breath import breath_wave, draw_breath
from scenarios.motion.config import AXES, Axis, MotionConfig
from scenarios.motion.contraction import contraction
from scenarios.motion.errors import UnreachableForceError
from scenarios.motion.pulses import SHAPES, Train, lay_lobes, sum_lobes
from scenarios.motion.record import Array, Motion, control_instants

CALIBRATION_TIME = 15.0
"""Length of the paper's run [s]: the force targets hold over it, whatever the duration."""
_CALIBRATION_PERIOD = 0.001
"""Grid of the calibration [s], fixed: the control period samples the motion, no more."""
_BREADTHS = np.geomspace(3.0, 0.35, 12)
"""Stretch of the twitch that the calibration may use, smoothest first [-]."""
_WEIGHT_SPREAD = 0.15
"""Spread of the lobes' heights from seed to seed, uniform to either side [-]."""
_LOOK_AHEAD = 3.0
"""Beats and breaths drawn beyond the end of the run [s]: a lobe starts before its R peak."""


def generate(config: MotionConfig, duration: float, period: float, seed: int) -> Motion:
    """Heart motion for ``seed`` [m], its beats drawn or those of ``config.beats``.

    A longer run begins with the samples of a shorter one. Errors: ``UnreachableForceError``; with
    ``config.beats`` also ``DataFileError`` and ``DataTooShortError``.
    """
    # one stream a purpose: a change of one key leaves what the others draw as it was
    streams = [np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(5)]
    covered = max(duration, CALIBRATION_TIME) + _LOOK_AHEAD
    breath = draw_breath(
        streams[0], config.respiration_rate, config.respiration_variability, covered
    )
    calibration_time = CALIBRATION_TIME
    if config.beats is None:
        beats = draw_beats(
            config,
            breath,
            covered,
            phase_rng=streams[1],
            early_rng=streams[2],
            spread_rng=streams[4],
        )
    else:
        beats = _real_beats(Path(config.beats), duration)
        calibration_time = min(CALIBRATION_TIME, float(beats.times[-1]))
    weights = 1.0 + _WEIGHT_SPREAD * streams[3].uniform(-1.0, 1.0, size=(3, 4))

    time = control_instants(duration, period)
    grid = control_instants(calibration_time, _CALIBRATION_PERIOD)
    grid_wave = breath_wave(breath, grid)[0]
    waves = np.array(breath_wave(breath, time))
    beat_wave = breath_wave(breath, beats.times)[0]
    samples = np.zeros((3, time.size, 3))
    for i, axis in enumerate(AXES):
        if axis not in config.axes:
            continue
        shape = SHAPES[i]
        excursion = shape.breath * config.respiration_excursion
        swing = 1.0 + shape.modulation * config.breath_modulation * (2.0 * beat_wave - 1.0)
        lay = partial(lay_lobes, shape, weights[i], beats=beats, modulation=swing)
        ratio = config.force_peak_to_peak[i] / config.force_rms[i]
        breadth, curve = _calibrate(axis, lay, excursion * grid_wave, ratio)
        scale = config.force_rms[i] / config.reference_stiffness / float(np.std(curve))
        samples[:, :, i] = excursion * waves + sum_lobes(lay(breadth), period, time.size, True)
        samples[0, :, i] -= np.mean(curve)
        samples[:, :, i] *= scale
    position, velocity, acceleration = samples
    return Motion(
        period,
        time,
        position,
        velocity,
        acceleration,
        beats.times[beats.times < duration],
        contraction(beats, time),
    )


def _real_beats(path: Path, duration: float) -> BeatSeries:
    beats = read_beats(path)
    available = float(beats.times[-1])
    if duration > available:
        longest = np.floor(available * 100.0) / 100.0
        reason = f"the beats last {longest:.2f} s, the run {duration:g} s; shorten the run"
        raise DataTooShortError(path, available, duration, reason)
    return beats


def _calibrate(
    axis: Axis, lay: Callable[[float], Train], breathing: Array, ratio: float
) -> tuple[float, Array]:
    """Breadth of the twitch that gives ``ratio`` of peak to peak to RMS, and the curve it gives.

    ``lay`` makes the lobes for a breadth, ``breathing`` (n,) is what the breath adds to them on the
    calibration grid. Of several answers the smoothest is taken.
    """

    def curve(breadth: float) -> Array:
        pulses = sum_lobes(lay(breadth), _CALIBRATION_PERIOD, breathing.size, False)[0]
        return np.asarray(breathing + pulses)

    def excess(breadth: float) -> float:
        q = curve(breadth)
        return float(np.ptp(q) / np.std(q)) - ratio

    tried: list[float] = []
    for i, breadth in enumerate(_BREADTHS):
        tried.append(excess(breadth))
        if i and tried[-2] * tried[-1] <= 0.0:
            solved = float(brentq(excess, breadth, _BREADTHS[i - 1], xtol=1e-3))
            return solved, curve(solved)
    raise UnreachableForceError(axis, ratio, ratio + min(tried), ratio + max(tried))
