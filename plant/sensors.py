"""Force sensors: noise, then quantisation."""

from dataclasses import dataclass

import numpy as np

from plant.config import SensorModel
from plant.viper import FloatArray, Quantity

_BLOCK = 1024
"""Samples of noise that are drawn at once."""


@dataclass(frozen=True)
class SensorSpec:
    """A force sensor's figures, the same on every axis."""

    resolution: Quantity
    """Step of the quantisation; 0: none."""
    noise: Quantity
    """Standard deviation of white noise before quantisation."""

    @property
    def deviation(self) -> float:
        """Standard deviation of a reading, noise and quantisation together [N]; never 0."""
        step = float(self.resolution.si)
        return max(float(np.hypot(self.noise.si, step / np.sqrt(12.0))), 3e-4)


_ESTIMATE = "estimate: one step of resolution, white, per sample at 1 kHz"

SENSORS: dict[SensorModel, SensorSpec] = {
    "ideal": SensorSpec(Quantity(0.0, "N", "by definition"), Quantity(0.0, "N", "by definition")),
    "nano17": SensorSpec(
        Quantity(1 / 320, "N", "ATI Nano17 SI-12-0.12: 1/320 N on every axis (3 mN)"),
        Quantity(0.003, "N", _ESTIMATE, estimated=True),
    ),
    "mini45": SensorSpec(
        Quantity(0.2, "N", "Dominici et al., IROS 2009: Mini-45 on the tool, 0.2 N"),
        Quantity(0.2, "N", _ESTIMATE, estimated=True),
    ),
}


class ForceSensor:
    """Three axes of force; the same seed gives the same noise."""

    def __init__(self, spec: SensorSpec, seed: np.random.SeedSequence) -> None:
        """Prepare a stream of noise of its own."""
        self._resolution = float(spec.resolution.si)
        self._noise = float(spec.noise.si)
        self._generator = np.random.default_rng(seed)
        self._block = np.empty((_BLOCK, 3))
        self._next = _BLOCK

    def read(self, force: FloatArray) -> FloatArray:
        """Return the reading of a true force ``(3,)`` [N], a new array."""
        if self._next == _BLOCK:
            self._generator.standard_normal(out=self._block)
            self._block *= self._noise
            self._next = 0
        reading: FloatArray = force + self._block[self._next]
        self._next += 1
        if self._resolution:
            reading /= self._resolution
            np.rint(reading, out=reading)
            reading *= self._resolution
        return reading
