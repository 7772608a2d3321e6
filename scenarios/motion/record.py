"""The motion of the tissue as every other part sees it: samples, and nothing about their source."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def control_instants(duration: float, period: float) -> Array:
    """Control instants k * period [s] of a run: round(duration / period) of them, at least one."""
    count = max(1, round(duration / period))
    return period * np.arange(count, dtype=np.float64)


@dataclass(frozen=True, eq=False)
class Motion:
    """Motion of the tissue surface at the control instants k = 0 .. n-1.

    Axes are x, y, z of the contact frame. Velocity and acceleration are exact derivatives of the
    curve behind the samples, not differences of samples.
    """

    period: float
    """Control period [s]."""
    time: Array
    """k * period [s], (n,)."""
    position: Array
    """Displacement from the mean position [m], (n, 3)."""
    velocity: Array
    """Its first derivative [m/s], (n, 3)."""
    acceleration: Array
    """Its second derivative [m/s^2], (n, 3)."""
    beats: Array
    """Times of the heart beats (R peaks) within the run [s], (m,); empty for a recording."""
    contraction: Array | None = None
    """How far the heart is contracted, from 0 (diastole) to 1 (height of systole), (n,); None for a
    recording, which tells no beats."""
