"""The scenario with every imperfection: it stays under control, and says what it costs."""

from __future__ import annotations

import re
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from plant import ImperfectionConfig
from scenarios import load_scenario

HARSH = load_scenario("harsh").cell.imperfections
OFF = load_scenario("ideal").cell.imperfections
KNOWN = replace(OFF, delay=HARSH.delay, torque_lag=HARSH.torque_lag)
"""What the controller's model has is no flaw to it: without these it would be a wrong model."""
PARTS = {
    "inertia_error": (),
    "friction": ("friction_compensation",),
    "stribeck": ("friction", "friction_compensation"),
    "torque_limit": (),
    "encoder_resolution": (),
    "velocity_filter": (),
    "delay_jitter": (),
    "command_resolution": (),
    "tip_mass": (),
}
"""Each imperfection of `harsh` that the model has not, and what belongs to it."""
SHORT = 0.5


def settings(flaws: ImperfectionConfig) -> list[str]:
    """As the command line takes them."""
    return [f"cell.imperfections.{f.name}={_toml(getattr(flaws, f.name))}" for f in fields(flaws)]


def _toml(value) -> str:
    return str(list(value)) if isinstance(value, tuple) else str(value)


def error(run) -> np.ndarray:
    """RMS of the force error on each axis [N]."""
    return np.sqrt(np.mean((run.log.force - run.log.setpoint) ** 2, axis=0))


def test_it_has_everything_but_flexible_joints():
    for f in fields(HARSH):
        off = getattr(HARSH, f.name) == getattr(OFF, f.name)
        assert off == (f.name in ("joint_frequency", "joint_damping", "stribeck_speed")), f.name
    without = {"friction_compensation", "joint_frequency", "joint_damping", "stribeck_speed"}
    assert set(PARTS) == {f.name for f in fields(HARSH)} - without - {"delay", "torque_lag"}


@pytest.fixture(scope="module")
def spotless(simulate):
    return simulate("harsh", *settings(KNOWN), still=False, duration=SHORT)


@pytest.mark.parametrize("flaw", PARTS)
def test_alone_each_of_them_changes_the_run_and_is_coped_with(flaw, simulate, spotless):
    kept = (flaw, *PARTS[flaw])
    flaws = replace(KNOWN, **{name: getattr(HARSH, name) for name in kept})
    run = simulate("harsh", *settings(flaws), still=False, duration=SHORT)
    same = np.array_equal(run.log.force, spotless.log.force)
    # Motors that are strong enough for the run are as good as stronger ones.
    assert same == (flaw == "torque_limit")
    assert run.summary["trip"] is None
    assert run.summary["status"] == {"solved": run.log.cycles}
    assert (error(run) < 0.1).all()


def test_all_together_the_run_is_controlled(simulate):
    run = simulate("harsh", duration=1.5)
    assert run.summary["trip"] is None
    assert run.summary["status"] == {"solved": 1500}
    assert not run.log.command_saturated.any()
    assert not run.log.torque_saturated.any()
    still = np.sqrt(np.mean((run.log.force_uncompensated - run.log.setpoint) ** 2, axis=0))
    assert (error(run) < 0.08 * still).all()
    # What is told is the true force's error, not what the spoilt sensor reads.
    read = np.sqrt(np.mean((run.log.force_measured - run.log.setpoint) ** 2, axis=0))
    for name, rms in zip("xyz", error(run), strict=True):
        assert run.summary["axes"][name]["compensated"]["rms"] == pytest.approx(rms)
    assert np.abs(read - error(run)).max() > 1e-3


def documented() -> list[str]:
    """The settings with which the page says that flexible joints are coped with."""
    page = Path(__file__).parents[2] / "docs" / "plant.md"
    found = re.search(r"^pulsempc run harsh --set (.*joint_frequency.*)$", page.read_text(), re.M)
    assert found
    return found[1].split()


def test_with_flexible_joints_too_it_is_controlled_as_the_page_says(simulate):
    run = simulate("harsh", *documented(), duration=1.5)
    assert run.scenario.cell.imperfections.joint_frequency == 20.0
    assert run.summary["trip"] is None
    assert run.summary["status"] == {"solved": 1500}
    assert run.log.command_saturated.mean() < 0.01
    still = np.sqrt(np.mean((run.log.force_uncompensated - run.log.setpoint) ** 2, axis=0))
    assert (error(run) < 0.6 * still).all()


def test_what_a_controller_cannot_cope_with_is_told(simulate):
    """Flexible joints under the fast observer: the guard takes the tool away, and says why."""
    run = simulate("paper", "cell.imperfections.joint_frequency=20.0", still=False, duration=SHORT)
    assert run.summary["trip"]["cause"] == "tracking_velocity"
    assert run.summary["trip"]["time"] < SHORT
