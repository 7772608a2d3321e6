"""How far the heart is contracted over its beats; the stiffness of the tissue follows it."""

import numpy as np

from scenarios.motion.beats import BeatSeries
from scenarios.motion.record import Array

_SYSTOLE = 0.3
"""Time from R peak to the height of systole at an interval of one second [s]."""
_RELAXATION = 0.5
"""Time from there to rest, relative to it [-]."""


def contraction(beats: BeatSeries, time: Array) -> Array:
    """Contraction at ``time`` (n,) [s]: 0 in diastole, 1 at the height of systole, (n,).

    The activation by which time-varying elastance models describe a ventricle, in the form that
    Heldt, Shim, Kamm and Mark (J. Appl. Physiol. 92, 2002) give it: half a cosine up within 0.3 s
    times the square root of the interval before the beat [s], half a cosine down in half of that
    time. As with the pulses of the motion, an early beat is an early, and a shorter, systole. Where
    one begins before the last has ended, the larger of the two counts.
    """
    level = np.zeros(time.size)
    rise = _SYSTOLE * np.sqrt(beats.intervals)
    for start, length in zip(beats.times.tolist(), rise.tolist(), strict=True):
        first, last = np.searchsorted(time, (start, start + (1.0 + _RELAXATION) * length))
        phase = (time[first:last] - start) / length
        phase = np.where(phase < 1.0, phase, 1.0 + (phase - 1.0) / _RELAXATION)
        beat = 0.5 * (1.0 - np.cos(np.pi * phase))
        np.maximum(level[first:last], beat, out=level[first:last])
    return level
