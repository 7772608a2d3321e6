"""Hearts of which everything is known: pulses at given times, on top of a slow breath."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from qpmpc.arrays import Array
from qpmpc.rhythm.estimator import Motion, MotionEstimator

PERIOD = 1e-3
NOISE = 0.2


def motion(synchronised: bool, **change: float) -> Motion:
    """What the configuration assumes by default of a Mini-45 on 2500 N/m."""
    values = {
        "noise": NOISE,
        "drift": 5e4,
        "residual_drift": 2e3,
        "memory": 8.0,
        "amplitude_spread": 0.15,
        "amplitude_memory": 0.7,
        "delay_spread": 0.002 if synchronised else 0.04,
    }
    return Motion(**(values | change))


def pulses(beats: Sequence[float], cycles: int, sizes: Sequence[float] | None = None) -> Array:
    """Force of three axes, ``(cycles, 3)`` [N]: to and fro 0.15 s after each beat, and breath.

    Times in a beat go with the root of the interval before it, as by Bazett's rule.
    """
    before = np.concatenate([[0.8], np.diff(beats)])
    time = PERIOD * np.arange(cycles)
    force = np.zeros((cycles, 3))
    for i, beat in enumerate(beats):
        size = 1.0 if sizes is None else sizes[i]
        for axis, (centre, height) in enumerate(((0.18, -3.0), (0.16, 4.0), (0.15, 8.0))):
            for sign, late in ((1.0, 0.0), (-1.0, 0.08)):
                stretch = np.sqrt(before[i] / 0.8)
                u = ((time - beat) / stretch - centre - late) / 0.03
                force[:, axis] += sign * size * height * np.exp(-0.5 * u * u)
    return force + np.outer(np.sin(2 * np.pi * 0.25 * time), [0.3, -0.5, 1.0])


def foretell(
    estimator: MotionEstimator,
    samples: Array,
    beats: Sequence[float] = (),
    lead: int = 4,
    note: Callable[[int], None] | None = None,
) -> Array:
    """Let an estimator see samples; return what it expected of each ``lead`` cycles before."""
    out, buffer = np.full_like(samples, np.nan), np.zeros((lead + 1, samples.shape[1]))
    told = {int(np.ceil(beat / PERIOD - 1e-9)) for beat in beats}
    for k, sample in enumerate(samples):
        if k in told:
            estimator.beat()
        estimator.correct(sample)
        estimator.preview(buffer)
        if k + lead < len(samples):
            out[k + lead] = buffer[lead]
        if note is not None:
            note(k)
        estimator.advance()
    return out


def rms(values: Array) -> Array:
    """Root of the mean square of each column."""
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def noise(cycles: int, seed: int = 5) -> Array:
    """Noise of a Mini-45."""
    return NOISE * np.random.default_rng(seed).standard_normal((cycles, 3))
