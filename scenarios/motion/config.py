"""What can be set on the motion: one frozen record, SI units, defaults of the paper's heart."""

from dataclasses import dataclass
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, MinLen

Axis = Literal["x", "y", "z"]
AXES: tuple[Axis, ...] = ("x", "y", "z")
"""Names of the axes in the order of every array."""
Positive = Annotated[float, Gt(0)]


@dataclass(frozen=True)
class RateStep:
    """A change of the heart's rate."""

    time: Annotated[float, Gt(0)]
    """When it happens [s]: from the first beat after it on."""
    rate: Annotated[float, Ge(0.5), Le(3.0)]
    """New mean rate [Hz]."""


@dataclass(frozen=True)
class MotionConfig:
    """Motion of the tissue: generated from a seed, timed by real beats, or recorded.

    With ``beats`` the keys of the generated beat series, and with ``file`` all keys but ``axes``,
    have no effect; setting them then is an error.
    """

    heart_rate: Annotated[float, Ge(0.5), Le(3.0)] = 1.2
    """Mean rate of the heart [Hz]."""
    rate_steps: tuple[RateStep, ...] = ()
    """Changes of that rate, in the order of their times."""
    rate_irregularity: Annotated[float, Ge(0), Le(0.5)] = 0.0
    """Relative spread of each interval by itself, uniform to either side [-]: fibrillation."""
    rate_variability_lf: Annotated[float, Ge(0), Le(0.2)] = 0.03
    """Amplitude of the slow wave (0.1 Hz) of the heart rate, relative to its mean [-]."""
    rate_variability_hf: Annotated[float, Ge(0), Le(0.2)] = 0.03
    """Amplitude of the heart rate's swing with the breath, relative to its mean [-]."""
    early_beat_probability: Annotated[float, Ge(0), Le(1)] = 0.0
    """Probability that a beat comes early and is followed by a compensatory pause [-]."""
    respiration_rate: Annotated[float, Ge(0.1), Le(1.0)] = 0.25
    """Mean rate of the breath [Hz]."""
    respiration_variability: Annotated[float, Ge(0), Le(0.2)] = 0.03
    """Relative spread of the length of a breath, uniform to either side [-]."""
    respiration_excursion: Annotated[float, Ge(0), Le(2)] = 0.4
    """Excursion of the breath as a share of the first lobe of a beat, on axis z [-]."""
    breath_modulation: Annotated[float, Ge(0), Le(0.8)] = 0.2
    """Relative swing of the beats' amplitude with the breath, on axis z [-]."""
    force_rms: tuple[Positive, Positive, Positive] = (1.0, 1.6, 3.5)
    """RMS about the mean of the uncompensated force on x, y, z, over the first 15 s [N]."""
    force_peak_to_peak: tuple[Positive, Positive, Positive] = (7.0, 10.0, 20.0)
    """Peak to peak of the uncompensated force on x, y, z, over the first 15 s [N]."""
    reference_stiffness: Positive = 2500.0
    """Stiffness at which the motion causes that force in a tool held still [N/m]."""
    axes: Annotated[tuple[Axis, ...], MinLen(1)] = AXES
    """Axes that move; the others stay at rest."""
    beats: str | None = None
    """CSV file of R-peak times that drives the generated pulses."""
    file: str | None = None
    """CSV file of a recorded motion, played as it is."""
