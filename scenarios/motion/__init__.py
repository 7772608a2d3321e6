"""Motion of the tissue: a generated heart, a heart timed by real beats, or a recording.

The generated motion is calibrated so that a tool held still on tissue of ``reference_stiffness``
feels the uncompensated force of Dominici et al., IROS 2009, for every seed: RMS 1 / 1.6 / 3.5 N and
peak to peak 7 / 10 / 20 N on x / y / z.
"""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from scenarios.errors import DataFileError, DataTooShortError
from scenarios.motion.config import AXES, Axis, MotionConfig, RateStep
from scenarios.motion.errors import MotionKeyError, UnreachableForceError
from scenarios.motion.generator import CALIBRATION_TIME, generate
from scenarios.motion.record import Motion
from scenarios.motion.recording import read_recording

__all__ = [
    "CALIBRATION_TIME",
    "Axis",
    "DataFileError",
    "DataTooShortError",
    "Motion",
    "MotionConfig",
    "MotionKeyError",
    "RateStep",
    "UnreachableForceError",
    "load_motion",
]

_KEYS_OF_DRAWN_BEATS = (
    "heart_rate",
    "rate_steps",
    "rate_irregularity",
    "rate_variability_lf",
    "rate_variability_hf",
    "early_beat_probability",
)


def load_motion(config: MotionConfig, duration: float, period: float, seed: int) -> Motion:
    """Motion for a run of ``duration`` [s] at control instants ``period`` [s] apart.

    There are round(duration / period) samples, at least one. The same ``config``, ``period`` and
    ``seed`` (>= 0) give the same samples, and a longer run begins with those of a shorter one. A
    recording does not depend on the seed. Relative paths count from the working directory.

    Errors, all ``ScenarioError``: ``MotionKeyError`` for keys that ``file`` or ``beats`` leaves
    without effect, ``DataFileError`` for an unusable file, ``DataTooShortError`` if it ends
    before the run, ``UnreachableForceError`` for force targets that the pulses cannot give.
    """
    if config.file is not None:
        others = tuple(f.name for f in fields(config) if f.name not in ("file", "axes"))
        _require_defaults(config, others, "file")
        motion = read_recording(Path(config.file), duration, period)
        moving = np.isin(AXES, config.axes)
        return replace(
            motion,
            position=motion.position * moving,
            velocity=motion.velocity * moving,
            acceleration=motion.acceleration * moving,
        )
    if config.beats is not None:
        _require_defaults(config, _KEYS_OF_DRAWN_BEATS, "beats")
    return generate(config, duration, period, seed)


def _require_defaults(config: MotionConfig, keys: tuple[str, ...], source: str) -> None:
    default = MotionConfig()
    changed = tuple(key for key in keys if getattr(config, key) != getattr(default, key))
    if changed:
        raise MotionKeyError(changed, source)
