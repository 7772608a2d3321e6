"""Force sensors: drift, noise, quantisation; and what goes wrong with them now and then."""

import math
from dataclasses import dataclass

import numpy as np

from plant.config import SensorConfig, SensorModel
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
    """Three axes of force; the same seed gives the same noise and the same faults.

    Each fault draws from a stream of its own: switching one on leaves the noise as it was.
    """

    def __init__(self, config: SensorConfig, period: float, seed: np.random.SeedSequence) -> None:
        """Prepare for one reading every ``period`` [s]."""
        spec = SENSORS[config.model]
        self._resolution = float(spec.resolution.si)
        self._noise = float(spec.noise.si)
        self._drift = config.bias_drift * math.sqrt(period)
        self._spike_chance, self._spike = config.spike_rate * period, config.spike_size
        self._dropout_chance = config.dropout_rate * period
        self._dropout = max(1, round(config.dropout_time / period))
        drift, spikes, dropouts = seed.spawn(3)
        self._generator = np.random.default_rng(seed)
        self._drifts, self._spikes, self._dropouts = (
            np.random.default_rng(child) for child in (drift, spikes, dropouts)
        )
        self._bias = np.zeros(3)
        self._silent = 0
        """Readings for which the sensor stays silent."""
        self._silenced = 0
        """The same, as it was told by `silence`."""
        self._gone = np.zeros(_BLOCK, dtype=np.bool_)
        self._block = np.empty((_BLOCK, 3))
        self._next = _BLOCK

    def read(self, force: FloatArray) -> FloatArray:
        """Return the reading of a true force ``(3,)`` [N], a new array; NaN where it is silent."""
        if self._next == _BLOCK:
            self._draw()
        reading: FloatArray = force + self._block[self._next]
        gone = self._gone[self._next]
        self._next += 1
        if self._silenced:
            self._silenced -= 1
            gone = True
        if gone:
            reading.fill(np.nan)
        elif self._resolution:
            reading /= self._resolution
            np.rint(reading, out=reading)
            reading *= self._resolution
        return reading

    def silence(self, readings: int) -> None:
        """Let there be nothing in the next ``readings``; the noise of those after is as it was."""
        self._silenced = max(self._silenced, readings)

    def _draw(self) -> None:
        """Draw what the next readings add to the force, and when there are none."""
        block = self._block
        self._generator.standard_normal(out=block)
        block *= self._noise
        if self._drift:
            walk = self._bias + np.cumsum(
                self._drift * self._drifts.standard_normal(block.shape), axis=0
            )
            block += walk
            self._bias = walk[-1]
        if self._spike_chance:
            struck = self._spikes.random(block.shape) < self._spike_chance
            block += struck * np.where(self._spikes.random(block.shape) < 0.5, -1, 1) * self._spike
        if self._dropout_chance:
            for i, begins in enumerate(self._dropouts.random(_BLOCK) < self._dropout_chance):
                if begins:
                    self._silent = self._dropout
                self._gone[i] = self._silent > 0
                self._silent = max(0, self._silent - 1)
        self._next = 0
