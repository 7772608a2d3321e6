"""What no controller can undo: how well a motion can be foretold from a sensor with noise."""

import numpy as np
from numpy.typing import NDArray
from scipy.signal import welch

Array = NDArray[np.float64]
_MEMORY = 4096
"""Samples over which the spectrum is taken: at 1 kHz, predictors that remember four seconds."""
_LENGTH = 1 << 16
"""Points of the spectrum; many more than samples, as the responses of its factor are long."""
_FLOOR = 1e-12
"""Least power at a frequency, as a share of the largest: keeps the logarithm finite."""


def prediction_bound(motion: Array, noise: float, cycles: int) -> Array:
    """Return the least RMS error of a linear time-invariant prediction, ``(n_axes,)``.

    The best causal predictor of ``motion(k + cycles)`` from ``motion + white noise`` up to ``k``,
    for a motion of which nothing but the spectrum is known, and that exactly: Wiener's, by spectral
    factorisation. The tool does not help: what it does is known, and subtracted. A force that
    commands reach after ``cycles`` cannot be held better than that by such a controller.

    Args:
        motion: ``(n, n_axes)`` [N], the force that it causes on a tool at rest.
        noise: standard deviation of a sample [N]. cycles: of the prediction.
    """
    return np.array([_bound(column, noise, cycles) for column in motion.T])


def _bound(motion: Array, noise: float, cycles: int) -> float:
    _, power = welch(
        motion - motion.mean(),
        nperseg=min(_MEMORY, motion.size),
        nfft=_LENGTH,
        return_onesided=False,
        detrend="linear",
    )
    power = np.maximum(power, _FLOOR * power.max())
    power *= np.var(motion) / power.mean()
    measured = power + noise**2
    cepstrum = np.fft.ifft(np.log(measured)).real
    half = _LENGTH // 2
    folded = np.concatenate([[cepstrum[0] / 2], cepstrum[1:half], np.zeros(_LENGTH - half)])
    factor = np.exp(np.fft.fft(folded))  # minimum phase, |factor|^2 = measured
    ahead = np.exp(2j * np.pi * np.fft.fftfreq(_LENGTH) * cycles)
    gain = np.fft.ifft(power / factor.conj() * ahead).real[:half]
    return float(np.sqrt(max(power.mean() - float(np.sum(gain**2)), 0.0)))
