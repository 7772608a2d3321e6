"""``margins``, ``tune`` and ``sweep`` as processes, and what their arguments may be."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
from dataclasses import replace

import numpy as np
import pytest

from bench.cli import main
from bench.margins import assess, motion_of, rhythm, true_plant
from bench.sweep import Range, combinations, parse
from bench.verbs.margins import values
from qpmpc.margins import Loop, force_law
from scenarios import ScenarioError, load_scenario, run_experiment, summarise
from scenarios.motion import load_motion

pytestmark = pytest.mark.slow


def pulsempc(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bench", *arguments],
        capture_output=True, text=True, check=False, timeout=300,
        env={**os.environ, "COLUMNS": "120"},
    )  # fmt: skip


# ---- margins


@pytest.fixture(scope="module")
def told():
    scenario = load_scenario("paper", top={"duration": 4.0})
    return scenario, assess(scenario, [0.25, 1.0, 4.0], [0.0, 0.0005, 0.002])


def test_the_figures_are_those_of_the_loop(told):
    scenario, figures = told
    law = force_law(scenario.controller, 1e-3)
    plant = true_plant(scenario)
    assert plant.delay == 1e-3
    assert plant.gain == 1.2
    assert figures["nominal"]["radius"] == Loop(plant, law).closed.radius
    assert [row["stable"] for row in figures["stiffness"]] == [False, True, False]
    assert figures["stiffness"][1] == {"ratio": 1.0, **figures["nominal"]}
    assert [row["stable"] for row in figures["later"]] == [True, True, False]
    for name, field in (("stiffness", "stiffness"), ("delay", "delay"), ("gain", "gain")):
        low, high = figures["stable"][name]
        assert low <= getattr(plant, field) <= high
        assert not Loop(replace(plant, **{field: high * 1.001}), law).stable


def test_an_unstable_loop_has_no_figures_but_its_pole(told):
    row = told[1]["stiffness"][0]
    assert row["radius"] > 1
    assert all(
        value is None for key, value in row.items() if key not in ("ratio", "stable", "radius")
    )


def test_the_linear_reduction_is_near_that_of_the_cell():
    """Without friction; what saturates, samples and couples is not in the linear loop."""
    scenario = load_scenario(
        "paper",
        top={"duration": 4.0},
        settings=["cell.imperfections.friction=0.0", "cell.imperfections.inertia_error=0.0"],
    )
    run = run_experiment(scenario, report=lambda *_: None, stop=lambda: False)
    axes = summarise(run)["axes"]
    figures = assess(scenario, [1.0], [0.0])
    for axis, found in axes.items():
        rms = found["compensated"]["rms"]
        assert rms == pytest.approx(figures["nominal"]["rms"][axis], rel=0.5)
        assert figures["lower_bound"]["rms"][axis] < rms


def test_the_power_of_the_motion_is_all_there():
    scenario = load_scenario("paper", top={"duration": 5.0})
    found = motion_of(scenario)
    motion = load_motion(scenario.motion, 5.0, 1e-3, scenario.seed)
    np.testing.assert_allclose(
        np.sqrt(np.sum(found.rms**2, axis=0)), motion.position.std(axis=0), rtol=1e-6
    )
    assert (np.diff(found.omega) > 0).all()


def test_rejection_is_told_at_breath_and_beats():
    scenario = load_scenario("paper", settings=["motion.heart_rate=2.0"])
    assert rhythm(scenario)[:3] == [0.25, 2.0, 4.0]


def test_margins_as_a_process():
    done = pulsempc("margins", "paper", "--duration", "2", "--stiffness", "0.5:1:2", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    figures = json.loads(done.stdout)
    assert [row["ratio"] for row in figures["stiffness"]] == [0.5, 1.0]
    assert len(figures["later"]) == 5
    shown = pulsempc("margins", "paper", "--duration", "2", "--set", "cell.imperfections.delay=3")
    assert shown.returncode == 1
    assert "unstable" in shown.stdout
    assert "delay: unstable as it is" in shown.stdout


# ---- tune


def test_what_tune_prints_can_be_set(tmp_path):
    asked = ("--duration", "2", "--stiffness", "1:1:1", "--evaluations", "200", "--model")
    done = pulsempc("tune", "paper", "--sensitivity", "2.5", *asked)
    assert done.returncode == 0, done.stderr
    text, _, last = done.stdout.partition("largest Ms")
    settings = last.partition("--set ")[2].split()
    table = tomllib.loads(text)["controller"]
    for name, value in (setting.split("=") for setting in settings):
        here = table
        for part in name.split(".")[1:]:
            here = here[part]
        assert here == float(value)
    file = tmp_path / "tuned.toml"
    file.write_text(f'description = "tuned"\n{text}')
    tuned = load_scenario(str(file))
    same = load_scenario("paper", settings=settings)
    assert tuned.controller.observer == same.controller.observer
    assert tuned.controller.model == same.controller.model
    figures = assess(same, [1.0], [0.0])["nominal"]
    assert figures["sensitivity"] <= 2.5 * 1.001


def test_a_margin_that_is_out_of_reach_ends_with_1():
    asked = ("--stiffness", "0.1:10:3", "--evaluations", "10", "--duration", "1", "--json")
    done = pulsempc("tune", "paper", "--sensitivity", "1.05", *asked)
    assert done.returncode == 1
    assert json.loads(done.stdout)["met"] is False
    assert done.stderr.count("\n") == 1
    assert "was not reached" in done.stderr


# ---- sweep


def test_sweep_as_a_process():
    over = "cell.contact.stiffness+motion.reference_stiffness=[2000, 2500.0]"
    more = 'cell.sensor.model=["ideal", "nano17"]'
    done = pulsempc(
        "sweep", "paper-1d", "--over", over, "--over", more, "--duration", "0.05", "--json"
    )
    assert (done.returncode, done.stderr) == (0, "")
    rows = json.loads(done.stdout)["rows"]
    assert [tuple(row["changed"].values()) for row in rows] == [
        (2000, 2000, "ideal"), (2000, 2000, "nano17"), (2500.0, 2500.0, "ideal"),
        (2500.0, 2500.0, "nano17"),
    ]  # fmt: skip
    assert len({row["axes"]["z"]["rms"] for row in rows}) == 4


def test_a_run_that_trips_has_its_row_and_ends_with_1(capsys):
    over = "cell.protection.tip_speed=[0.5, 0.001]"
    with pytest.raises(SystemExit) as left:
        main(["sweep", "paper-1d", "--over", over, "--duration", "0.5"])
    assert left.value.code == 1
    said = capsys.readouterr().out
    assert "reduction of" in said
    assert said.count("tip_speed") == 2  # the heading, and the run that tripped


def test_ranges_and_combinations():
    ranges = [parse("a.b+c=[1, 2]"), parse('d=["x", [0.0, inf], {e = true}]')]
    assert ranges[0] == Range(("a.b", "c"), (1, 2))
    found = combinations(ranges)
    assert found[0] == {"a.b": 1, "c": 1, "d": "x"}
    assert found[-1] == {"a.b": 2, "c": 2, "d": {"e": True}}
    assert len(found) == 6


@pytest.mark.parametrize(
    ("verb", "arguments", "message"),
    [
        ("margins", ["nowhere"], "unknown scenario 'nowhere'"),
        ("margins", ["--stiffness", "1"], "--stiffness: must be LOW:HIGH or LOW:HIGH:N, got '1'"),
        ("margins", ["--stiffness", "4:0.25"], "LOW must be positive and not above HIGH"),
        ("margins", ["--set", "controller.model.stiffness=-1"], "controller.model.stiffness"),
        ("tune", ["--sensitivity", "1"], "--sensitivity: must exceed 1, got 1"),
        ("tune", ["--evaluations", "0"], "--evaluations: must be from 1 to 100000, got 0"),
        ("sweep", [], "--over: at least one KEY=[V, V, ...] is needed"),
        ("sweep", ["--over", "seed=1"], "--over seed=1: must be KEY=[V, V, ...]"),
        ("sweep", ["--over", "seed=[]"], "--over seed=[]: no value is given"),
        ("sweep", ["--over", "seeds=[1]"], "seeds: unknown key, did you mean 'seed'?"),
        ("sweep", ["--over", "seed=[1]", "--over", "seed=[2]"], "names seed more than once"),
        ("sweep", ["--over", "seed=[-1]"], "seed"),
    ],
)  # fmt: skip
def test_bad_input_is_one_line(verb, arguments, message, capsys):
    with pytest.raises(SystemExit) as left:
        main([verb, *arguments])
    said = capsys.readouterr()
    assert left.value.code == 2
    assert said.out == ""
    assert said.err.startswith("pulsempc: ")
    assert said.err.count("\n") == 1
    assert message in said.err


@pytest.mark.parametrize(
    "text",
    ["", ":", "1:2:3:4", "a:1", "nan:1", "1:nan", "1:inf", "0:1", "-1:1", "1:2:0", "1:2:1.5",
     "1:2:201", "1e-300:1"],
)  # fmt: skip
def test_ranges_that_are_none(text):
    with pytest.raises(ScenarioError, match="--stiffness"):
        values("--stiffness", text, 3, ratio=True)


def test_values_of_a_range():
    assert values("--later", "0:0.002", 3, ratio=False) == [0.0, 0.001, 0.002]
    assert values("--stiffness", "0.25:4:3", 9, ratio=True) == [0.25, 1.0, 4.0]


@pytest.mark.parametrize("text", ["", "=", "=[1]", "+=[1]", "a=[1", "a=[1]\nb=[2]", "a=1", "a={}"])
def test_sweeps_that_are_none(text):
    with pytest.raises(ScenarioError, match="--over"):
        parse(text)


def test_too_many_runs_are_none():
    with pytest.raises(ScenarioError, match="1024 runs, at most 1000"):
        combinations([Range((str(i),), (0, 1)) for i in range(10)])
