"""How far the heart is contracted: one systole a beat, early where the beat is."""

from __future__ import annotations

import numpy as np
import pytest

from plant.viper import CONTACT_POINT
from scenarios import ScenarioError, ScenarioKeyError, load_scenario
from scenarios.motion import MotionConfig, load_motion
from scenarios.motion.beats import BeatSeries
from scenarios.motion.contraction import contraction

T = np.arange(0.0, 4.0, 1e-3)


def series(*times: float) -> BeatSeries:
    t = np.array(times)
    return BeatSeries(t, np.diff(t, prepend=t[0] - 1.0), 1.0)


def test_a_beat_rises_and_falls_as_its_formula_says():
    level = contraction(series(1.0), T)
    assert not level[T < 1.0].any()
    assert level[1000 + 150] == pytest.approx(0.5, abs=1e-9)
    assert level[1000 + 300] == pytest.approx(1.0, abs=1e-9)
    assert level[1000 + 375] == pytest.approx(0.5, abs=1e-9)
    assert not level[T >= 1.45].any()
    assert np.abs(np.diff(level)).max() < 0.011 * np.pi / 2 / 1.0


def test_an_early_beat_is_an_early_and_shorter_systole():
    level = contraction(series(1.0, 1.49, 3.0), T)
    assert level[1490 + 210] == pytest.approx(1.0, abs=1e-4)  # 0.3 s times the root of 0.49 s
    assert not level[1000 + 451 : 1490].any()
    assert level[1490 + 1 : 1490 + 314].all()
    pause = level[3000:]
    assert pause[round(300 * np.sqrt(1.51))] == pytest.approx(1.0, abs=1e-4)


def test_of_two_beats_that_overlap_the_larger_counts():
    level = contraction(series(1.0, 1.3), T)
    alone = np.maximum(contraction(series(1.0), T), 0.0)
    assert level.max() <= 1.0
    assert (level >= alone - 1e-12).all()
    assert (level[1300:1600] > alone[1300:1600]).any()


@pytest.mark.parametrize(
    "config",
    [
        MotionConfig(),
        MotionConfig(early_beat_probability=0.5),
        MotionConfig(rate_irregularity=0.3),
        MotionConfig(beats="scenarios/data/beats_mitbih208.csv"),
    ],
    ids=["regular", "early", "irregular", "ecg"],
)
def test_a_motion_with_beats_has_one_systole_after_each(config):
    motion = load_motion(config, 5.0, 1e-3, 3)
    level = motion.contraction
    assert level.shape == (5000,)
    assert level.min() == 0.0
    assert level.max() <= 1.0
    for beat in motion.beats[:-1]:
        k = round(float(beat) * 1e3)
        following = motion.beats[motion.beats > beat]
        assert level[k : k + 550].max() > 0.999, (beat, following[:1])


def test_a_longer_run_begins_with_the_contraction_of_a_shorter_one():
    short, long = (load_motion(MotionConfig(), t, 1e-3, 1).contraction for t in (2.0, 4.0))
    assert np.array_equal(short, long[:2000])


def test_systole_makes_the_tissue_stiffer_in_the_run(simulate):
    """Of a tool held still the force is stiffness times depth, with the stiffness of the beat."""
    run = simulate(
        "ideal", "cell.contact.stiffness=1500", "cell.contact.systolic_stiffening=0.6", duration=0.8
    )
    level = load_motion(run.scenario.motion, 0.8, 1e-3, 0).contraction
    stiffness = 1500.0 * (1.0 + 0.6 * level)
    place = CONTACT_POINT.si[2] - 10.0 / stiffness.mean()
    expected = stiffness * (place - run.log.tissue[:, 2])
    force = run.log.force_uncompensated[:, 2]
    assert level.max() > 0.99
    assert np.abs(force - expected).max() < 0.5
    assert np.abs(force - expected / (1.0 + 0.6 * level)).max() > 2.0
    assert run.summary["trip"] is None


@pytest.fixture
def recording(tmp_path):
    path = tmp_path / "heart.csv"
    rows = [f"{0.01 * k},0,0,{1e-3 * np.sin(0.05 * k):.6f}" for k in range(100)]
    path.write_text("\n".join(["t,x,y,z", *rows]))
    return path


def test_a_recording_tells_no_beats_and_stiffening_is_refused(recording):
    assert load_motion(MotionConfig(file=str(recording)), 0.5, 1e-3, 0).contraction is None
    with pytest.raises(ScenarioKeyError, match="tells no beats") as caught:
        load_scenario(
            "paper",
            top={"duration": 0.5},
            motion=recording,
            settings=["cell.contact.systolic_stiffening=0.5"],
        )
    assert caught.value.key == "cell.contact.systolic_stiffening"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        (["cell.contact.law=rubber"], "cell.contact.law"),
        (["cell.contact.law=hunt_crossley"], "cell.contact.law"),
        (["cell.contact.law=spring", "cell.contact.damping=1.0"], "cell.contact.damping"),
        (["cell.contact.exponent=2.0"], "cell.contact.exponent"),
        (["cell.contact.exponent=0.5"], "cell.contact.exponent"),
        (["cell.contact.relaxation=1.0"], "cell.contact.relaxation"),
        (["cell.contact.bristles.static=0.0"], "cell.contact.bristles.static"),
        (["cell.contact.bristles.static=0.3"], "cell.contact.bristles"),
        (["cell.contact.gap=0.01"], "cell.contact.gap"),
        (["cell.contact.systolic_stiffening=-0.5"], "cell.contact.systolic_stiffening"),
        (["cell.contact.bristles.statik=0.3"], "cell.contact.bristles.statik"),
        (["approach.speed=0.0"], "approach.speed"),
        (["approach.threshold=0.0"], "approach.threshold"),
        (["approach.lost_after=-1.0"], "approach.lost_after"),
        (["approach.acceleration=nan"], "approach.acceleration"),
        (["approach.enabled=1"], "approach.enabled"),
        (["cell.contact.unilateral=true", "approach.threshold=5.0"], "setpoint.z"),
        (
            [
                "cell.contact.unilateral=true",
                "approach.threshold=1.0",
                "setpoint.steps=[{time=1.0, z=-1.5}]",
            ],
            "setpoint.steps.0.z",
        ),
    ],
)
def test_wrong_keys_of_contact_and_approach_are_refused_in_one_line(settings, key):
    with pytest.raises(ScenarioError) as caught:
        load_scenario("paper", settings=settings)
    assert key in str(caught.value)
    assert "\n" not in str(caught.value)
