"""Force sensors: resolution, noise, seeds."""

from __future__ import annotations

import numpy as np
import pytest

from plant.sensors import SENSORS, ForceSensor

REAL = ("nano17", "mini45")
FORCE = np.array([1.0, 2.0, -10.0])


def readings(model: str, n: int, seed: int = 0, force: np.ndarray = FORCE) -> np.ndarray:
    sensor = ForceSensor(SENSORS[model], np.random.SeedSequence(seed))
    return np.array([sensor.read(force) for _ in range(n)])


def test_the_ideal_sensor_is_exact():
    force = np.array([1 / 3, -np.pi, 1e-9])
    assert np.array_equal(readings("ideal", 1500, force=force), np.tile(force, (1500, 1)))


@pytest.mark.parametrize(("model", "resolution"), [("nano17", 1 / 320), ("mini45", 0.2)])
def test_readings_are_whole_steps_of_the_resolution(model, resolution):
    steps = readings(model, 3000) / resolution
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    assert set(np.unique(np.diff(np.unique(np.round(steps[:, 2]))))) == {1.0}  # no step left out
    assert float(SENSORS[model].resolution.si) == resolution


@pytest.mark.parametrize("model", REAL)
def test_noise_has_its_level_and_no_memory(model):
    spec = SENSORS[model]
    noise = readings(model, 20000) - FORCE
    expected = np.hypot(float(spec.noise.si), float(spec.resolution.si) / np.sqrt(12.0))
    np.testing.assert_allclose(noise.std(axis=0), expected, rtol=0.03)
    np.testing.assert_allclose(noise.mean(axis=0), 0.0, atol=5 * expected / np.sqrt(20000))
    together = np.corrcoef(np.hstack([noise[1:], noise[:-1]]).T)  # axes, and one sample later
    np.testing.assert_allclose(together, np.eye(6), atol=0.04)


@pytest.mark.parametrize("model", REAL)
def test_a_seed_is_a_stream(model):
    first, again, other = (readings(model, 2500, seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert (first != other).mean() > 0.3
    # The stream is one: its blocks do not repeat.
    assert (first[:1024] != first[1024:2048]).mean() > 0.3


@pytest.mark.parametrize("model", [*REAL, "ideal"])
def test_a_reading_is_an_array_of_its_own(model):
    sensor = ForceSensor(SENSORS[model], np.random.SeedSequence(0))
    force = FORCE.copy()
    reading = sensor.read(force)
    kept = reading.copy()
    sensor.read(force + 1.0)
    assert np.array_equal(reading, kept)
    reading[:] = 7.0
    assert np.array_equal(force, FORCE)
