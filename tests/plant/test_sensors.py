"""Force sensors: resolution, noise, seeds."""

from __future__ import annotations

import numpy as np
import pytest

from plant.config import SensorConfig
from plant.sensors import SENSORS, ForceSensor

PERIOD = 1e-3
REAL = ("nano17", "mini45")
FORCE = np.array([1.0, 2.0, -10.0])


def make(model: str, seed: int = 0, period: float = PERIOD, **faults: float) -> ForceSensor:
    return ForceSensor(SensorConfig(model, **faults), period, np.random.SeedSequence(seed))


def readings(
    model: str, n: int, seed: int = 0, force: np.ndarray = FORCE, **faults: float
) -> np.ndarray:
    sensor = make(model, seed, **faults)
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
    sensor = make(model)
    force = FORCE.copy()
    reading = sensor.read(force)
    kept = reading.copy()
    sensor.read(force + 1.0)
    assert np.array_equal(reading, kept)
    reading[:] = 7.0
    assert np.array_equal(force, FORCE)


# --- faults --------------------------------------------------------------------------------------


@pytest.mark.parametrize("period", [1e-3, 4e-3])
def test_the_zero_walks_with_the_square_root_of_time(period):
    def drift(seed):
        sensor = make("ideal", seed, period, bias_drift=0.5)
        return np.array([sensor.read(FORCE) for _ in range(round(4.0 / period))]) - FORCE

    walks = np.array([drift(seed) for seed in range(60)])  # three axes each
    second = round(1.0 / period)
    steps = np.diff(walks[:, ::second], axis=1)
    assert steps.std() == pytest.approx(0.5, rel=0.1)
    assert walks[:, -1].std() == pytest.approx(1.0, rel=0.2)
    assert abs(steps.mean()) < 4 * 0.5 / np.sqrt(steps.size)


def test_spikes_are_single_readings_of_their_size_at_their_rate():
    error = readings("ideal", 60_000, spike_rate=3.0, spike_size=7.0) - FORCE
    struck = np.abs(error) > 1e-9
    np.testing.assert_allclose(np.abs(error[struck]), 7.0, rtol=1e-12)
    assert struck.sum(axis=0) / 60.0 == pytest.approx([3.0] * 3, abs=1.0)
    assert 0.4 < (error[struck] > 0).mean() < 0.6
    assert not struck.all(axis=1).any()  # axes by themselves


def test_dropouts_silence_all_axes_for_their_time():
    gone = np.isnan(readings("nano17", 60_000, dropout_rate=0.5, dropout_time=0.03))
    assert np.array_equal(gone.any(axis=1), gone.all(axis=1))
    edges = np.flatnonzero(np.diff(gone[:, 0].astype(int)))
    lengths = np.diff(edges)[::2] if not gone[0, 0] else np.diff(edges)[1::2]
    assert lengths.size > 10
    assert set(lengths[lengths < 31]) == {30}  # one may begin while another lasts
    assert gone[:, 0].mean() == pytest.approx(0.5 * 0.03, rel=0.5)


def test_a_fault_leaves_the_noise_as_it_was():
    clean = readings("nano17", 3000)
    faulty = readings("nano17", 3000, spike_rate=5.0, dropout_rate=2.0, bias_drift=1e-9)
    same = np.abs(faulty - clean) < 1e-6
    assert (same | np.isnan(faulty) | (np.abs(faulty - clean) > 4.9)).all()
    assert 0.5 < same.mean() < 1.0


def test_faults_are_the_same_for_the_same_seed():
    faults = {"spike_rate": 5.0, "dropout_rate": 2.0, "bias_drift": 0.1}
    first, again, other = (readings("nano17", 3000, seed, **faults) for seed in (1, 1, 2))
    assert np.array_equal(first, again, equal_nan=True)
    assert not np.array_equal(np.isnan(first), np.isnan(other))
