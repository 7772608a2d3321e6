"""The previewed motion in the controller: setpoint, bounds, keys, damping, both paths."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from qpmpc import BoundsConfig, ControllerConfig, ForceController, ModelConfig, ObserverConfig
from qpmpc.arrays import Array
from qpmpc.axis import axis_model
from qpmpc.config import PerAxis, RhythmConfig
from qpmpc.rhythm.preview import MotionPreview

from .hearts import PERIOD, foretell, motion, noise, pulses

pytestmark = pytest.mark.slow

STIFFNESS, DAMPING = 2500.0, 20.0
AXES = ("x", "y", "z")
SET = np.array([1.0, 2.0, -10.0])
BEATS = (0.4 + 0.83 * np.arange(20)).tolist()


class Tissue:
    """Tools that obey without delay, pressed on tissue with a heart, springs and dampers."""

    def __init__(self, cycles: int, damping: float = 0.0) -> None:
        self.motion = pulses(BEATS, cycles + 2)
        self.x, self.v, self.k, self.damping = np.zeros(3), np.zeros(3), 0, damping

    @property
    def force(self) -> Array:
        k = self.k
        slope = (self.motion[k + 1] - self.motion[k]) / PERIOD
        moving = self.v + slope / STIFFNESS
        return np.asarray(SET + STIFFNESS * self.x + self.motion[k] + self.damping * moving)

    def apply(self, command: Array) -> None:
        decay = np.exp(-DAMPING * PERIOD)
        final = command / DAMPING
        self.x = self.x + final * PERIOD + (self.v - final) * (1.0 - decay) / DAMPING
        self.v = final + (self.v - final) * decay
        self.k += 1


def configured(kind: Any, **bounds: Any) -> ControllerConfig:
    return ControllerConfig(
        reference_time=0.002,
        increment_weight=1e-3,
        model=ModelConfig(stiffness=STIFFNESS, velocity_damping=DAMPING, delay=0, lag=0.0),
        observer=ObserverConfig(disturbance=kind, force_noise=0.2),
        bounds=BoundsConfig(**bounds),
    )


def run(config: ControllerConfig, cycles: int, tissue: Tissue | None = None) -> dict[str, Array]:
    """Close the loop; return force, command and what was predicted of the next force."""
    tissue = tissue or Tissue(cycles)
    controller = ForceController(config, AXES, PERIOD)
    controller.reset(SET)
    wish, sensor = np.tile(SET, (config.horizon + 1, 1)), noise(cycles)
    told = {int(np.ceil(beat / PERIOD)) for beat in BEATS}
    force, command, predicted = np.zeros((3, cycles, 3))
    for k in range(cycles):
        force[k] = tissue.force
        if k in told:
            controller.beat()
        step = controller.step(force[k] + sensor[k], tissue.v, wish)
        tissue.apply(step.command)
        controller.prepare()
        command[k], predicted[k] = step.command, step.predicted[0]
    return {"force": force, "command": command, "predicted": predicted}


@pytest.fixture(scope="module")
def runs() -> dict[str, dict[str, Array]]:
    return {kind: run(configured(kind), 8000) for kind in ("fused", "beats")}


def error(found: dict[str, Array], start: int = 5000) -> Array:
    return np.asarray(np.sqrt(np.mean((found["force"] - SET)[start:] ** 2, axis=0)))


def test_in_noise_the_learned_beat_holds_the_force_better(runs: dict[str, Any]) -> None:
    assert (error(runs["beats"]) < 0.7 * error(runs["fused"])).all()


def test_what_is_predicted_is_the_whole_force(runs: dict[str, Any]) -> None:
    found = runs["beats"]
    wrong = found["predicted"][5000:-1] - found["force"][5001:]
    assert np.sqrt(np.mean(wrong**2)) < 0.2


def test_bounds_are_on_the_whole_force_and_may_move() -> None:
    """A cap at half a newton from the setpoint that closes to a quarter in the run."""
    caps = PerAxis((-8.0, 8.0), (-8.0, 8.0), (-10.5, np.inf))
    config = configured("beats", force=caps)
    controller = ForceController(config, AXES, PERIOD, moving=("force",))
    controller.reset(SET)
    wish = np.tile(SET - [0.0, 0.0, 3.0], (9, 1))  # below the cap: it is the cap that is held
    tissue = Tissue(600)
    tissue.motion[:] = 0.2 * tissue.motion
    for k in range(600):
        if k == 300:
            low = np.array([-8.0, -8.0, -10.25])
            controller.move("force", low, np.array([8.0, 8.0, np.inf]))
        step = controller.step(tissue.force, tissue.v, wish)
        tissue.apply(step.command)
        controller.prepare()
        if k in (299, 599):
            cap = -10.5 if k == 299 else -10.25
            assert tissue.force[2] == pytest.approx(cap, abs=0.03)
            assert step.slack["force"].max() < 0.03


def test_the_tool_is_taken_off_the_measured_force() -> None:
    """A tool that swings on tissue at rest is no motion of the tissue."""
    model = ModelConfig(stiffness=STIFFNESS, damping=15.0)
    preview = MotionPreview(
        model, ObserverConfig(disturbance="tracked", force_noise=0.003), 1, PERIOD, 8
    )
    for k in range(2000):
        t = k * PERIOD
        x, v = 1e-3 * (1 - np.cos(12 * t)), 12e-3 * np.sin(12 * t)
        preview.update(np.array([5.0 + STIFFNESS * x + 15.0 * v]), np.array([v]))
        preview.estimator.advance()
    np.testing.assert_allclose(preview.motion, 5.0, atol=2e-3)
    preview.update(np.array([np.nan]), np.array([np.nan]))
    assert np.isfinite(preview.motion).all()
    assert np.isfinite(preview.tool).all()
    preview.reset()
    preview.update(np.array([1.0]), np.array([0.0]))
    np.testing.assert_allclose(preview.motion, 1.0)


def test_a_force_that_is_adopted_is_the_whole_force() -> None:
    controller = ForceController(configured("beats"), AXES, PERIOD)
    controller.reset(SET)
    wish = np.tile(SET, (9, 1))
    for _ in range(50):
        controller.step(SET, np.full(3, 1e-3), wish)
        controller.prepare()
    controller.adopt(force=np.zeros(3))
    step = controller.step(np.zeros(3), np.zeros(3), wish)
    np.testing.assert_allclose(step.predicted[0], 0.0, atol=0.5)


OTHER = {
    "jerk_drift": 200.0,
    "residual_jerk_drift": 20.0,
    "memory": 1.5,
    "amplitude_spread": 0.02,
    "amplitude_memory": 0.0,
    "beat_delay": 0.02,
    "interval_spread": 0.01,
}


@pytest.mark.parametrize("key", OTHER)
def test_every_key_has_an_effect(key: str) -> None:
    kind = "tracked" if key == "interval_spread" else "beats"
    sizes = 1.0 + 0.2 * np.sin(np.arange(20))
    samples = pulses(BEATS, 6500, sizes) + noise(6500)
    found = []
    for change in ({}, {key: OTHER[key]}):
        observer = ObserverConfig(
            disturbance=kind, force_noise=0.2, rhythm=replace(RhythmConfig(), **change)
        )
        preview = MotionPreview(ModelConfig(stiffness=STIFFNESS), observer, 3, PERIOD, 8)
        found.append(foretell(preview.estimator, samples, BEATS if kind == "beats" else ()))
    part = slice(10, 3000) if key == "jerk_drift" else slice(5000, None)
    assert np.abs(found[0] - found[1])[part].max() > 0.05


def test_keys_are_what_the_estimator_assumes() -> None:
    assert motion(True).drift == STIFFNESS * RhythmConfig().jerk_drift
    assert motion(True).residual_drift == STIFFNESS * RhythmConfig().residual_jerk_drift
    assert motion(True).delay_spread == RhythmConfig().beat_delay
    assert motion(False).delay_spread == RhythmConfig().interval_spread


# ---- contact damping in the model


@pytest.mark.parametrize("kind", ["constant", "ramp", "fused"])
def test_force_of_spring_and_damper_is_predicted(kind: Any) -> None:
    """``y = F + (B / K) F'``: by the model of an axis, from the force of the spring alone."""
    damping, rng = 30.0, np.random.default_rng(9)
    models = [
        axis_model(
            ModelConfig(stiffness=STIFFNESS, velocity_damping=DAMPING, delay=0, damping=b),
            ObserverConfig(disturbance=kind),
            PERIOD,
        ).model
        for b in (0.0, damping)
    ]
    np.testing.assert_array_equal(models[0].A, models[1].A)
    x = rng.standard_normal(models[0].n_states)
    fine = 1e-7
    spring, damped = (m.C @ x for m in models)
    # the spring's rate in continuous time: (C A - C) / T for the smallest period
    small = axis_model(
        ModelConfig(stiffness=STIFFNESS, velocity_damping=DAMPING, delay=0),
        ObserverConfig(disturbance=kind),
        fine,
    ).model
    rate = (small.C @ small.A @ x - small.C @ x) / fine
    assert damped[0] == pytest.approx(spring[0] + damping / STIFFNESS * rate[0], rel=1e-4)


@pytest.mark.parametrize("kind", ["fused", "beats"])
def test_damping_in_the_model_pays_where_there_is_damping(kind: Any) -> None:
    errors = []
    for b in (0.0, 25.0):
        config = configured(kind)
        config = replace(config, model=replace(config.model, damping=b))
        config = replace(config, observer=replace(config.observer, force_noise=0.003))
        found = run(config, 2500, Tissue(2500, damping=25.0))
        errors.append(error(found, 1000))
    assert (errors[1] < errors[0]).all()
