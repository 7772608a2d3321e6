"""The breath: a smooth wave from end of expiration to full inspiration and back."""

from dataclasses import dataclass

import numpy as np

from scenarios.motion.record import Array

# One breath: inspiration, expiration, rest at the end of expiration. The smooth steps leave their
# ends so gently that with an exact rest of 10.5 % the wave is below 2 % of its excursion for 26 %
# of the breath, the share of end expiration in anaesthetised breathing (estimated).
_INSPIRATION = 0.36
_EXPIRATION = 0.535
_REST = 1.0 - _INSPIRATION - _EXPIRATION
MEAN = 0.5 * (1.0 - _REST)
"""Mean of the wave over a breath [-]."""


@dataclass(frozen=True)
class Breath:
    """A series of breaths; before the first the wave is at rest."""

    starts: Array
    """Onsets of inspiration [s], (m,)."""
    lengths: Array
    """Lengths of the breaths [s], (m,)."""


def draw_breath(
    rng: np.random.Generator, rate: float, variability: float, duration: float
) -> Breath:
    """Breaths of mean ``rate`` [Hz] that cover ``duration`` [s].

    The run starts at the end of an expiration: the first inspiration follows within the rest.
    """
    count = int(duration * rate / (1.0 - variability)) + 2
    first = rng.uniform(0.2, 1.0) * _REST / rate
    lengths = (1.0 + variability * rng.uniform(-1.0, 1.0, size=count)) / rate
    # a plain running sum: the onsets of a longer run begin with those of a shorter one
    return Breath(starts=first + np.concatenate(([0.0], np.cumsum(lengths)[:-1])), lengths=lengths)


def breath_wave(breath: Breath, time: Array) -> tuple[Array, Array, Array]:
    """Wave in 0 (end of expiration) .. 1 (full inspiration), first and second derivative.

    ``time`` (n,) [s]; returns three (n,) arrays in 1, 1/s, 1/s^2. Three times differentiable.
    """
    index = np.maximum(np.searchsorted(breath.starts, time, side="right") - 1, 0)
    length = breath.lengths[index]
    phase = (time - breath.starts[index]) / length
    rising = phase < _INSPIRATION
    share = np.where(rising, _INSPIRATION, -_EXPIRATION)
    progress = np.where(rising, phase, phase - _INSPIRATION - _EXPIRATION) / share
    wave, slope, curvature = _smooth_step(np.clip(progress, 0.0, 1.0))
    rate = 1.0 / (share * length)
    return wave, slope * rate, curvature * rate**2


def _smooth_step(s: Array) -> tuple[Array, Array, Array]:
    """Polynomial step of degree 7, three derivatives zero at 0 and 1, and two derivatives."""
    r = 1.0 - s
    step = s**4 * (35.0 - 84.0 * s + 70.0 * s**2 - 20.0 * s**3)
    return step, 140.0 * (s * r) ** 3, 420.0 * (s * r) ** 2 * (r - s)
