"""What can be set on the rivals: frozen records, SI units, tuned defaults.

The defaults are what ``python -m bench.tune_rivals`` found, see ``docs/rivals.md``. Stiffness, K2,
delay and lag are those of ``controller.model``, the noise that of ``controller.observer``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Gt, Le, Lt


@dataclass(frozen=True)
class PiConfig:
    """PI control of the force around a velocity loop, with feed-forward of the tissue's velocity.

    Of ``pi``, and of ``pi-ilc`` underneath what it learns.
    """

    proportional: Annotated[float, Ge(0), Le(1e4)] = 110.0
    """Velocity asked for per depth of the force error, both in the tissue [1/s]."""
    integral: Annotated[float, Ge(0), Le(1e6)] = 9380.0
    """The same for the error's integral [1/s^2]."""
    velocity: Annotated[float, Gt(0), Le(1e4)] = 411.0
    """Acceleration commanded per velocity that is missing [1/s]."""
    feedforward: Annotated[float, Ge(0), Le(1)] = 0.905
    """Share of the tissue's estimated velocity that is added to the velocity asked for [-]."""
    filter_time: Annotated[float, Ge(0), Le(1)] = 0.000847
    """Time constant of the low-pass filter on that estimate [s]; 0: none."""


@dataclass(frozen=True)
class LearningConfig:
    """Iterative learning over known periods, on top of ``controller.pi``: ``pi-ilc``."""

    heart_period: Annotated[float, Gt(0), Le(60)] = 1 / 1.2
    """Period of the heart that the controller is told [s]; a scenario that does not give it gets
    that of ``motion.heart_rate``."""
    breath_period: Annotated[float, Gt(0), Le(60)] = 4.0
    """The same of the breath [s], of ``motion.respiration_rate``."""
    heart_gain: Annotated[float, Ge(0), Le(1)] = 0.5
    """Share of the command that would have prevented the error, learned each beat [-]."""
    breath_gain: Annotated[float, Ge(0), Le(1)] = 0.5
    """The same for each breath [-]."""
    cutoff: Annotated[float, Ge(1), Le(200)] = 15.0
    """Frequency at which the zero-phase filter Q halves the power of what is remembered [Hz]."""
    forgetting: Annotated[float, Ge(0), Lt(1)] = 0.02
    """Share of what was learned that is forgotten each period [-]."""


@dataclass(frozen=True)
class ActiveObserverConfig:
    """Two active observers, one for the force and one for the tissue's motion: ``aob``."""

    closed_loop_time: Annotated[float, Gt(0), Le(1)] = 0.00421
    """Time constant of both poles of the closed force loop [s]."""
    disturbance_drift: Annotated[float, Gt(0)] = 0.249
    """Force observer: change of the active state per cycle, standard deviation [m/s^2]."""
    jerk_drift: Annotated[float, Gt(0)] = 2.51
    """Motion observer: change of the tissue's jerk per cycle, standard deviation [m/s^3]."""


@dataclass(frozen=True)
class PaperLawConfig:
    """The paper's law, closed form without disturbance state, delay and lag: ``paper-law``."""

    increment_weight: Annotated[float, Gt(0)] = 0.00402
    """lambda, in place of ``controller.increment_weight``."""
    reference_time: Annotated[float, Ge(0)] = 0.00225
    """T_ref, in place of ``controller.reference_time`` [s]."""
