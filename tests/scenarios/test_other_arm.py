"""Robot_Tool from a file, as a scenario: the shipped one, one beside its own file, and bad ones."""

from __future__ import annotations

import shutil

import numpy as np
import pyarrow.parquet as pq
import pytest

from scenarios import ScenarioError, ScenarioKeyError, dump_scenario, load_scenario, run_experiment
from scenarios.load import shipped

FILE = shipped()["other-arm"]


@pytest.fixture(scope="module")
def run(simulate):
    return simulate("other-arm", duration=1.0)


def test_the_shipped_arm_holds_the_force_under_protection(run):
    assert run.scenario.cell.protection.enabled
    assert run.log.trip is None
    assert run.summary["status"] == {"solved": 1000}
    for axis, bound in (("x", 0.03), ("y", 0.03), ("z", 0.04)):
        assert run.summary["axes"][axis]["compensated"]["rms"] < bound
        assert run.summary["axes"][axis]["reduction"]["rms"] > 97.0


def test_it_is_the_experiment_of_paper_but_for_the_arm():
    other, paper = load_scenario("other-arm"), load_scenario("paper")
    for name in ("duration", "backend", "axes", "setpoint", "motion", "controller"):
        assert getattr(other, name) == getattr(paper, name), name
    for name in ("contact", "sensor", "tool", "imperfections", "protection"):
        assert getattr(other.cell, name) == getattr(paper.cell, name), name


def test_the_log_has_a_column_for_each_joint(run, tmp_path):
    run.log.write(tmp_path / "log.parquet")
    names = pq.read_schema(tmp_path / "log.parquet").names
    for name in ("torque", "joint_velocity"):
        assert [n for n in names if n.startswith(f"{name}_") and n[-1].isdigit()] == [
            f"{name}_{i}" for i in range(1, 8)
        ]
    assert run.log.torque.shape == (1000, 7)
    assert np.abs(run.log.torque[:, 6]).max() > 0.0


def test_bounds_on_joints_hold_for_every_joint(simulate):
    free = simulate("other-arm", still=False, duration=0.3)
    speeds = np.abs(free.log.joint_velocity) / free.scenario.cell.arm.joint_speed
    share = round(0.6 * float(speeds.max()), 4)
    run = simulate(
        "other-arm", f"controller.bounds.joints.speed={share}", still=False, duration=0.3
    )
    bounded = np.abs(run.log.joint_velocity) / run.scenario.cell.arm.joint_speed
    assert bounded.max() < 1.1 * share


def test_a_path_is_relative_to_the_scenario_and_what_is_written_reads_back(write, tmp_path):
    shutil.copy(FILE.parent / "arms" / "panda.xml", tmp_path / "mine.xml")
    text = FILE.read_text().replace("arms/panda.xml", "mine.xml")
    scenario = load_scenario(write(text))
    assert scenario.cell.arm.file == str(tmp_path / "mine.xml")
    again = write(dump_scenario(scenario), "again.toml")
    assert load_scenario(again) == scenario


def test_a_cell_without_one_reads_back_without_one(write):
    scenario = load_scenario("paper")
    assert scenario.cell.arm is None
    assert load_scenario(write(dump_scenario(scenario))) == scenario


BAD_KEYS = {
    '[cell.arm]\nfile = "a.xml"': "cell.arm.tip: is missing",
    '[cell.arm]\ntip = "a"': "cell.arm.file: is missing",
    '[cell.arm]\nfile = "a.xml"\ntip = "a"\nflie = 1': "cell.arm.flie: unknown key, did you mean",
    '[cell.arm]\nfile = "a.xml"\ntip = "a"\narmature = -1.0': "cell.arm.armature",
    '[cell.arm]\nfile = "a.xml"\ntip = "a"\narmature = [0.1, -1.0]': "cell.arm.armature",
    '[cell.arm]\nfile = "a.xml"\ntip = "a"\narmature = "much"': "cell.arm.armature",
    '[cell.arm]\nfile = "a.xml"\ntip = "a"\nbase = [0.0, 1.0]': "cell.arm.base",
    '[cell.arm]\nfile = "a.xml"\ntip = "a"\nhome = [nan]': "cell.arm.home",
    '[cell.arm]\nfile = "a.xml"\ntip = "a"\njoint_range = [[1.0]]': "cell.arm.joint_range",
    '[cell]\narm = "a.xml"': "cell.arm: must be a table",
}


@pytest.mark.parametrize("text", sorted(BAD_KEYS))
def test_bad_keys_are_refused_in_one_line(text, write):
    with pytest.raises(ScenarioKeyError) as caught:
        load_scenario(write(text))
    assert BAD_KEYS[text] in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "float" not in caught.value.key


def test_nothing_is_simulated_and_no_port_opened_with_an_arm_that_cannot_be_used(write):
    scenario = load_scenario(
        write('[cell.arm]\nfile = "none.xml"\ntip = "a"\n[setpoint.live]\nport = 5999')
    )
    stages = []
    for _ in range(2):  # a port that stayed open would be in use
        with pytest.raises(Exception, match=r"none\.xml: there is no such file") as caught:
            run_experiment(scenario, report=lambda *now: stages.append(now), stop=lambda: False)
        assert not isinstance(caught.value, ScenarioError)
    assert stages == []


def test_a_path_that_is_set_is_relative_to_where_one_is(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    for setting in ('cell.arm={file="a.xml", tip="t"}', "cell.arm.file=a.xml"):
        scenario = load_scenario("paper", settings=[setting, "cell.arm.tip=t"])
        assert scenario.cell.arm.file == str(tmp_path / "a.xml")
    scenario = load_scenario("paper", settings=["motion.file=m.csv"])
    assert scenario.motion.file == str(tmp_path / "m.csv")
