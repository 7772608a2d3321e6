"""Every controller on the cell, chosen by its key."""

from __future__ import annotations

import numpy as np
import pytest

from bench.compare_controllers import MOTIONS
from qpmpc.errors import UnknownNameError
from qpmpc.kinds import controllers
from scenarios import ScenarioError, load_scenario, run_experiment, shipped

KINDS = [kind.name for kind in controllers()]


@pytest.fixture(scope="module")
def runs(simulate):
    return {
        kind: simulate("paper", f"controller.kind={kind}", duration=0.7, still=kind == "mpc")
        for kind in KINDS
    }


@pytest.mark.parametrize("kind", KINDS)
def test_every_controller_runs_on_the_cell_and_is_better_than_none(kind, runs):
    run, held = runs[kind], runs["mpc"].summary["axes"]
    assert run.summary["trip"] is None
    assert run.summary["controller"] == kind
    assert run.summary["backend"] == ("daqp" if kind == "mpc" else None)
    assert sum(run.summary["status"].values()) == 700
    assert run.summary["status"].get("failed", 0) == 0
    for axis, figures in run.summary["axes"].items():
        assert figures["compensated"]["rms"] < 0.5 * held[axis]["uncompensated"]["rms"]


@pytest.mark.parametrize("kind", KINDS)
def test_it_starts_without_a_bump(kind, simulate):
    """At rest on the setpoint, with a sensor without noise."""
    run = simulate("ideal", f"controller.kind={kind}", duration=0.01, still=False)
    assert np.abs(run.log.command[0]).max() < 1e-4


def test_the_chatter_of_the_torques_is_that_of_their_increments(runs):
    log = runs["pi"].log
    expected = np.sqrt(np.mean(np.diff(log.torque, axis=0) ** 2))
    assert runs["pi"].summary["torque_increment_rms"] == pytest.approx(expected)
    assert runs["pi"].summary["torque_increment_rms"] > 0.0


def test_the_paper_law_is_the_scenario_of_that_name(simulate):
    """With its weight and time, and what the scenario's bounds on force and velocity do not do."""
    config = load_scenario("paper-law").controller
    values = [
        f"controller.paper_law.increment_weight={config.increment_weight}",
        f"controller.paper_law.reference_time={config.reference_time}",
    ]
    kind = simulate("paper", "controller.kind=paper-law", *values, duration=0.2, still=False)
    scenario = simulate("paper-law", duration=0.2, still=False)
    assert np.array_equal(kind.log.command, scenario.log.command)


@pytest.mark.parametrize("kind", ["aob", "pi", "pi-ilc"])
def test_a_sensor_that_falls_silent_is_survived(kind, simulate):
    faults = ("cell.sensor.dropout_rate=5.0", "cell.sensor.dropout_time=0.01")
    run = simulate("paper", f"controller.kind={kind}", *faults, duration=0.8, still=False)
    assert run.summary["trip"] is None
    assert np.isfinite(run.log.command).all()
    silent = int(np.isnan(run.log.force_measured).any(axis=1).sum())
    assert silent > 0
    assert run.summary["status"]["failed"] == run.summary["source"]["analytic"] == silent


def test_bounds_that_move_are_met_by_those_who_do_not_know_them(simulate):
    cap = "bounds_steps=[{time=0.05, force={z=[-9.0, inf]}}]"
    run = simulate("paper", "controller.kind=pi", cap, duration=0.2, still=False)
    assert run.summary["violations"]["force"]["count"] > 100
    assert run.log.bounds == ()


@pytest.mark.parametrize("kind", ["aob", "pi", "pi-ilc", "paper-law"])
def test_a_contact_that_is_lost_is_found_again(kind, simulate):
    """What looks after the contact stands in for whatever controller there is."""
    run = simulate("lost-contact", f"controller.kind={kind}", duration=1.5, still=False)
    assert run.summary["trip"] is None
    assert np.isfinite(run.log.command).all()
    assert run.log.touching[-200:].any()


def test_an_unknown_controller_is_told_before_anything_is_done():
    scenario = load_scenario("paper", settings=["controller.kind=pid"])
    with pytest.raises(UnknownNameError, match="did you mean 'pi'"):
        run_experiment(scenario, report=pytest.fail, stop=lambda: False)


def test_what_watches_a_qp_needs_one():
    scenario = load_scenario("paper", top={"duration": 0.01}, settings=["controller.kind=pi"])
    with pytest.raises(ScenarioError, match=r"controller\.kind: pi solves no QP"):
        run_experiment(
            scenario, report=lambda *_: None, stop=lambda: False, shadow=lambda _: pytest.fail
        )


# --- what is told of the motion ------------------------------------------------------------------


def test_the_learning_controller_is_told_the_periods_of_the_motion():
    given = load_scenario("paper", settings=["motion.heart_rate=2", "motion.respiration_rate=0.2"])
    assert (given.controller.ilc.heart_period, given.controller.ilc.breath_period) == (0.5, 5.0)
    told = load_scenario(
        "paper", settings=["motion.heart_rate=2.0", "controller.ilc.heart_period=0.7"]
    )
    assert told.controller.ilc.heart_period == 0.7
    assert load_scenario("paper").controller.ilc.heart_period == pytest.approx(1 / 1.2)


@pytest.mark.parametrize("value", ["0.0", "-1.0", '"fast"', "[1.0]"])
def test_a_wrong_rate_is_still_the_motions_error(value):
    with pytest.raises(ScenarioError, match=r"motion\.heart_rate"):
        load_scenario("paper", settings=[f"motion.heart_rate={value}"])


def test_every_motion_that_is_compared_is_shipped_and_lasts():
    assert set(MOTIONS) <= set(shipped())
    for name in MOTIONS:
        assert load_scenario(name).duration == 15.0
    assert {load_scenario(name).controller.kind for name in MOTIONS} == {"mpc"}


@pytest.mark.parametrize(
    ("setting", "reason"),
    [
        ("controller.pi.velocity=0.0", "greater than 0"),
        ("controller.pi.feedforward=1.5", "less than or equal to 1"),
        ("controller.ilc.forgetting=1.0", "less than 1"),
        ("controller.ilc.heart_gain=-0.1", "greater than or equal to 0"),
        ("controller.aob.closed_loop_time=nan", "got NaN"),
        ("controller.paper_law.increment_weight=0.0", "greater than 0"),
        ("controller.pi.gain=3.0", "unknown key"),
        ("controller.kind=3", "valid string"),
    ],
)
def test_bad_values_are_refused_in_one_line(setting, reason):
    with pytest.raises(ScenarioError, match=reason) as caught:
        load_scenario("paper", settings=[setting])
    assert "\n" not in str(caught.value)
    assert setting.split("=")[0] in str(caught.value)
