"""The mechanical pulse of each beat: Gaussian lobes, hung on the R peaks.

The shapes are our own estimate of what sonomicrometry of a beating heart's surface shows: a steep
twitch to and fro in systole, a slower and smaller wave as the ventricle fills, a kick of the atrium
before the next beat, and rest in between.
"""

from dataclasses import dataclass

import numpy as np

from scenarios.motion.beats import BeatSeries
from scenarios.motion.record import Array

_REFERENCE_INTERVAL = 60.0 / 72.0
"""Interval at which the times of ``Shape`` hold [s]."""
_AMPLITUDE_GAIN = 0.8
"""Change of a beat's amplitude per change of the interval before it (filling), estimated [-]."""
_AMPLITUDE_RANGE = (0.4, 1.6)
_REACH = 7.0
"""Standard deviations after which a lobe (then 2e-11 of its height) is cut."""


@dataclass(frozen=True)
class Lobe:
    """One Gaussian of the pulse at the reference interval."""

    amplitude: float
    """Height [-]."""
    centre: float
    """Time of its peak after the R peak [s]."""
    width: float
    """Standard deviation [s]."""


@dataclass(frozen=True)
class Shape:
    """Pulse and breath of one axis."""

    systole: tuple[Lobe, ...]
    """Lobes of the twitch; ``centre`` counts from ``systole_centre`` here."""
    systole_centre: float
    """Middle of the twitch after the R peak [s]."""
    diastole: tuple[Lobe, ...]
    """Filling wave and kick of the atrium (before the R peak)."""
    breath: float
    """Excursion of the breath relative to ``respiration_excursion`` [-]."""
    modulation: float
    """Change of amplitude at inspiration relative to ``breath_modulation`` [-]."""


SHAPES = (
    Shape(
        systole=(Lobe(-0.8, -0.030, 0.030), Lobe(1.0, 0.030, 0.034)),
        systole_centre=0.17,
        diastole=(Lobe(-0.10, 0.42, 0.050), Lobe(0.06, -0.07, 0.035)),
        breath=0.6,
        modulation=1.0,
    ),
    Shape(
        systole=(Lobe(1.0, -0.036, 0.034), Lobe(-0.75, 0.036, 0.040)),
        systole_centre=0.19,
        diastole=(Lobe(0.14, 0.45, 0.055), Lobe(-0.08, -0.06, 0.035)),
        breath=-0.8,
        modulation=-0.8,
    ),
    Shape(
        systole=(Lobe(1.0, -0.038, 0.036), Lobe(-0.9, 0.040, 0.042)),
        systole_centre=0.16,
        diastole=(Lobe(-0.18, 0.40, 0.055), Lobe(0.10, -0.08, 0.035)),
        breath=1.0,
        modulation=-1.0,
    ),
)
"""Shapes of the axes x, y, z."""


@dataclass(frozen=True)
class Train:
    """Lobes of all beats on one axis."""

    centres: Array
    """(m,) [s]."""
    widths: Array
    """Standard deviations [s], (m,)."""
    amplitudes: Array
    """(m,) [-]."""


def lay_lobes(
    shape: Shape, weights: Array, breadth: float, beats: BeatSeries, modulation: Array
) -> Train:
    """Lobes of ``beats`` for one axis, in the order of the beats.

    ``weights`` (lobes,) multiply the amplitudes of the shape, systole first; ``breadth`` stretches
    the twitch about its middle; ``modulation`` (beats,) multiplies the amplitude of each beat.

    The times of a beat go with the square root of the interval before it, as in Bazett's rule for
    the QT interval: systole shortens less than the interval, and the rest of diastole gives way. A
    beat after a short interval is smaller, after a pause larger, as the ventricle has filled.
    """
    lobes = [
        Lobe(lobe.amplitude, shape.systole_centre + breadth * lobe.centre, breadth * lobe.width)
        for lobe in shape.systole
    ]
    lobes.extend(shape.diastole)
    stretch = np.sqrt(beats.intervals / _REFERENCE_INTERVAL)[:, None]
    filling = 1.0 + _AMPLITUDE_GAIN * (beats.intervals / beats.usual_interval - 1.0)
    height = np.clip(filling, *_AMPLITUDE_RANGE) * modulation
    return Train(
        (beats.times[:, None] + stretch * np.array([lobe.centre for lobe in lobes])).ravel(),
        (stretch * np.array([lobe.width for lobe in lobes])).ravel(),
        (height[:, None] * (weights * np.array([lobe.amplitude for lobe in lobes]))).ravel(),
    )


def sum_lobes(train: Train, period: float, count: int, derivatives: bool) -> Array:
    """Sum of the lobes at k * ``period``, k < count, with its first two ``derivatives`` if asked.

    Returns (3, count), or (1, count) without derivatives. A sample is the same number for any
    ``count``: lobes are never cut at the end of the run but past it.
    """
    first = np.ceil((train.centres - _REACH * train.widths) / period).astype(int)
    last = np.floor((train.centres + _REACH * train.widths) / period).astype(int) + 1
    inside = np.flatnonzero((first < count) & (last > 0))
    margin = max(0, -int(first[inside].min(initial=0)))
    total = np.zeros(
        (3 if derivatives else 1, margin + max(count, int(last[inside].max(initial=0))))
    )
    for i in inside:
        width = train.widths[i]
        u = (np.arange(first[i], last[i]) * period - train.centres[i]) / width
        lobe = train.amplitudes[i] * np.exp(-0.5 * u * u)
        window = slice(margin + first[i], margin + last[i])
        total[0, window] += lobe
        if derivatives:
            total[1, window] -= u * lobe / width
            total[2, window] += (u * u - 1.0) * lobe / width**2
    return total[:, margin : margin + count]
