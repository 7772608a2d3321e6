"""Rhythm on the cell: R peaks reach the controller as they happen, keys are checked."""

from __future__ import annotations

import numpy as np
import pytest

from qpmpc import ControllerConfig, ForceController, ModelConfig
from scenarios import load_scenario
from scenarios.errors import ScenarioKeyError
from scenarios.experiment import assemble, told_beats
from scenarios.loop import control_loop
from scenarios.motion import load_motion

pytestmark = pytest.mark.slow

AGILE = ("controller.reference_time=0.002", "controller.increment_weight=0.001")


def test_beats_are_told_in_the_cycle_after_they_happened() -> None:
    scenario = load_scenario("paper", top={"duration": 3.0})
    motion = load_motion(scenario.motion, 3.0, 1e-3, 0)
    told = np.flatnonzero(told_beats(motion, 3000)) * 1e-3
    late = told - motion.beats
    assert told.size >= 3
    assert (late > -1e-9).all()
    assert (late < 1e-3).all()


def test_a_controller_is_told_the_beats_of_a_run_and_nothing_of_those_to_come() -> None:
    scenario = load_scenario(
        "paper", top={"duration": 2.0}, settings=["controller.observer.disturbance='beats'", *AGILE]
    )
    made = assemble(scenario, lambda *_: None)
    heard = []
    estimator = made.controller.preview.estimator  # type: ignore[union-attr]
    beat = estimator.beat
    estimator.beat = lambda: (heard.append(made.log.cycles), beat())  # type: ignore[method-assign,assignment,func-returns-value]
    control_loop(
        made.cell, made.controller, made.setpoint, made.log, scenario.cycles,
        schedule=made.schedule, beats=made.beats, progress=lambda *_: None, stop=lambda: False,
    )  # fmt: skip
    assert heard == np.flatnonzero(made.beats).tolist()
    assert estimator.following
    error = (made.log.force - made.log.setpoint)[500:]
    assert np.abs(error).max() < 0.3


def test_on_a_sensor_with_noise_the_learned_beat_pays() -> None:
    found = {}
    for kind in ("fused", "beats"):
        scenario = load_scenario(
            "paper",
            top={"duration": 5.0},
            settings=[
                f"controller.observer.disturbance='{kind}'", "cell.sensor.model='mini45'",
                *(AGILE if kind == "beats" else ()),
            ],
        )  # fmt: skip
        made = assemble(scenario, lambda *_: None)
        control_loop(
            made.cell, made.controller, made.setpoint, made.log, scenario.cycles,
            schedule=made.schedule, beats=made.beats, progress=lambda *_: None, stop=lambda: False,
        )  # fmt: skip
        error = (made.log.force - made.log.setpoint)[3000:]
        found[kind] = np.sqrt(np.mean(error**2, axis=0))
    assert (found["beats"] < 0.85 * found["fused"]).all()


@pytest.mark.parametrize(
    ("setting", "named"),
    [
        ("controller.observer.rhythm.memory=0.0", "rhythm.memory"),
        ("controller.observer.rhythm.jerk_drift=-1.0", "rhythm.jerk_drift"),
        ("controller.observer.rhythm.amplitude_memory=1.0", "rhythm.amplitude_memory"),
        ("controller.observer.rhythm.beat_delay=0.5", "rhythm.beat_delay"),
        ("controller.observer.rhythm.interval_spread=inf", "rhythm.interval_spread"),
        ("controller.observer.rhythm.beats=3", "rhythm.beats"),
        ("controller.observer.disturbance='beat'", "observer.disturbance"),
        ("controller.model.damping=-1.0", "model.damping"),
    ],
)
def test_bad_keys_are_refused_in_one_line(setting: str, named: str) -> None:
    with pytest.raises(ScenarioKeyError, match=named) as caught:
        load_scenario("paper", settings=[setting])
    assert "\n" not in str(caught.value)


def test_a_recording_has_no_r_peaks(tmp_path) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "heart.csv"
    path.write_text("t,x,y,z\n0,0,0,0\n0.01,0,0,0\n0.02,0,0,0\n0.03,0,0,0\n")
    settings = ["controller.observer.disturbance='beats'"]
    with pytest.raises(ScenarioKeyError, match="needs R peaks"):
        load_scenario("paper", motion=path, settings=settings)


# ---- delay, lag and damping of the model each do what they say


def unmatched(**model: float) -> float:
    """Largest error of one-step predictions in closed loop with a plant of delay 1 and lag 1 ms."""
    settings = [f"controller.model.{key}={value}" for key, value in model.items()]
    scenario = load_scenario(
        "ideal",
        top={"duration": 0.5},
        settings=[
            "cell.imperfections.delay=1", "cell.imperfections.torque_lag=0.001",
            "cell.contact.damping=5.0", "setpoint.steps=[{time=0.1, z=-11.0}]",
            "controller.model.delay=1", "controller.model.lag=0.001",
            "controller.model.damping=5.0", *settings,
        ],
    )  # fmt: skip
    made = assemble(scenario, lambda *_: None)
    control_loop(
        made.cell, made.controller, made.setpoint, made.log, scenario.cycles,
        schedule=made.schedule, progress=lambda *_: None, stop=lambda: False,
    )  # fmt: skip
    wrong = made.log.force_predicted[90:-1, 2] - made.log.force[91:, 2]
    return float(np.abs(wrong).max())


def test_a_model_with_the_plant_s_delay_lag_and_damping_predicts_best() -> None:
    right = unmatched()
    assert unmatched(delay=0) > 1.5 * right
    assert unmatched(lag=0.0) > 1.5 * right
    assert unmatched(damping=0.0) > 1.5 * right


def test_damping_is_in_the_prediction_matrices() -> None:
    one, other = (
        ForceController(ControllerConfig(model=ModelConfig(damping=b)), ("z",), 1e-3)
        for b in (0.0, 10.0)
    )
    a, b = (c.general.problem.prediction for c in (one, other))
    velocity = a.Psi[:, 1] / 2500.0  # its effect on the path
    assert not np.allclose(a.Theta, b.Theta)
    assert (b.Psi[:, 1] > a.Psi[:, 1]).all()
    assert velocity.min() > 0
