"""How late a beat was, found by sliding the waveform along it once it is over."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from qpmpc.rhythm.waveform import Waveform, trend

_ENOUGH = 16
"""Samples below which nothing is said."""


@dataclass(frozen=True)
class Alignment:
    """How the waveform fits a beat."""

    delay: float
    """Of the waveform behind the beat's beginning, in the beat's time."""
    explained: float
    """Share of the beat's squares that the waveform explains there, trend apart; may be < 0 [-]."""


def align(waveform: Waveform, stretch: float, reach: float) -> Alignment:
    """Fit the waveform to the samples that are kept of a beat, by its delay alone.

    Args:
        waveform: with evenly spaced samples of a beat.
        stretch: time of the beat for a unit of the waveform's argument.
        reach: largest delay to either side, in the beat's time.
    """
    time, value = waveform.kept
    if time.size < _ENOUGH:
        return Alignment(0.0, 0.0)
    spacing = (time[-1] - time[0]) / (time.size - 1)
    far = max(1, round(reach / spacing))
    places = time[0] + spacing * np.arange(-far, time.size + far)
    numbers, weights, _ = waveform.spline.locate(places / stretch)
    read = np.einsum("ij,ijk->ik", weights, waveform.coefficients[numbers])
    basis = trend(time.size)
    shifted = sliding_window_view(read, time.size, axis=0)[
        ::-1
    ]  # (shifts, axes, n), earliest first
    shifted = shifted - (shifted @ basis) @ basis.T
    target = (value - basis @ (basis.T @ value)).T
    energy = float(np.sum(target**2))
    missed = energy - 2.0 * np.sum(shifted * target, axis=(1, 2)) + np.sum(shifted**2, axis=(1, 2))
    k = int(np.argmin(missed))
    offset = 0.0
    if 0 < k < 2 * far:
        before, at, after = missed[k - 1 : k + 2].tolist()
        curvature = before - 2.0 * at + after
        offset = 0.5 * (before - after) / curvature if curvature > 0 else 0.0
    explained = 1.0 - float(missed[k]) / energy if energy > 0 else 0.0
    return Alignment((k - far + offset) * spacing, explained)
