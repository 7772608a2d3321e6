"""``pulsempc compare --controllers`` and ``run --controller`` as their users meet them."""

from __future__ import annotations

import json

import matplotlib.image
import pytest
from rich.console import Console

from bench.compare_controllers import MOTIONS, ahead
from bench.contest_report import contest_lines, contest_tables, draw_contest
from qpmpc.kinds import controllers

FIGURES = {"rms", "max", "p99", "peak_to_peak", "reduction_rms", "reduction_max"}


@pytest.fixture(scope="module")
def compared(tmp_path_factory, call):
    folder = tmp_path_factory.mktemp("contest")
    arguments = ("--controllers", "pi, mpc", "--duration", "0.3", "--out", "c", "--json")
    done = call("compare", "regular", "breath-held", *arguments, folder=folder)
    return folder / "c", done


@pytest.fixture(scope="module")
def summary(compared):
    return json.loads((compared[0] / "compare.json").read_text(), parse_constant=pytest.fail)


def test_json_is_all_there_is_on_standard_output(compared):
    folder, done = compared
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == (folder / "compare.json").read_text()


def test_the_keys_are_those_of_the_backends_and_more(summary):
    assert set(summary) == {"scenarios", "controllers", "rows", "versions"}
    assert summary["controllers"] == ["pi", "mpc"]
    assert summary["scenarios"] == [
        {"scenario": name, "seed": 0, "cycles": 300} for name in ("regular", "breath-held")
    ]
    ran = [(row["scenario"], row["controller"]) for row in summary["rows"]]
    assert ran == [(s, c) for s in ("regular", "breath-held") for c in ("pi", "mpc")]
    for row in summary["rows"]:
        assert {
            "backend", "controller", "scenario", "seed", "complete", "error", "trip", "axes",
            "violations", "saturation", "increment_rms", "torque_increment_rms", "status", "source",
            "compiled", "build_us", "solve_us", "command_error", "command_error_rms",
            "without_reference",
        } == set(row)  # fmt: skip
        assert set(row["axes"]) == {"x", "y", "z"}
        assert all(set(figures) == FIGURES for figures in row["axes"].values())
        assert row["backend"] == (None if row["controller"] == "pi" else "daqp")
        assert row["torque_increment_rms"] > 0


def test_every_run_has_its_folder_and_all_see_the_same_motion(compared, summary):
    folder, _ = compared
    assert sorted(p.name for p in folder.iterdir()) == [
        "breath-held", "compare.json", "comparison.png", "regular",
    ]  # fmt: skip
    for row in summary["rows"]:
        run = json.loads(
            (folder / row["scenario"] / row["controller"] / "summary.json").read_text()
        )
        assert run["controller"] == row["controller"]
        for axis, figures in row["axes"].items():
            assert figures["p99"] == run["axes"][axis]["compensated"]["p99"]
            assert figures["reduction_max"] == run["axes"][axis]["reduction"]["max"]
    held = [
        json.loads((folder / "regular" / name / "summary.json").read_text())["axes"]
        for name in ("pi", "mpc")
    ]
    assert held[0]["z"]["uncompensated"] == held[1]["z"]["uncompensated"]
    assert min(matplotlib.image.imread(folder / "comparison.png").shape[:2]) > 300


def test_a_run_with_a_rival_says_so(call, tmp_path):
    done = call(
        "run", "ideal", "--controller", "aob", "--duration", "0.05", "--json", "--out", "r",
        folder=tmp_path,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    told = json.loads(done.stdout)
    assert (told["controller"], told["backend"]) == ("aob", None)
    assert "reason" in told["compiled"]


def test_controllers_lists_all_with_their_source(leave, monkeypatch):
    monkeypatch.setenv("COLUMNS", "240")
    code, out, _ = leave("controllers")
    assert code == 0
    for kind in controllers():
        assert kind.name in out
        assert kind.summary in out
        assert kind.source in out
    monkeypatch.setenv("COLUMNS", "80")
    assert max(map(len, leave("controllers")[1].splitlines())) <= 80


BAD = {
    "unknown controller": (
        ["compare", "--controllers", "pi,aoc"],
        ["unknown controller 'aoc'", "did you mean 'aob'", "mpc, paper-law, aob, pi, pi-ilc"],
    ),
    "no controller": (["compare", "--controllers", ""], ["unknown controller ''"]),
    "twice": (["compare", "--controllers", "pi,aob,pi"], ["--controllers", "pi more than once"]),
    "scenario twice": (["compare", "ecg", "ecg", "--controllers", "pi"], ["ecg: more than one"]),
    "unknown scenario": (["compare", "papr", "--controllers", "pi"], ["did you mean 'paper'"]),
    "backends too": (
        ["compare", "--controllers", "pi", "--backends", "osqp"], ["--backends: no effect"],
    ),
    "bounds too": (["compare", "--controllers", "pi", "--bounds", "off"], ["--bounds off"]),
    "two scenarios for backends": (["compare", "ecg", "paper"], ["ecg paper", "--controllers"]),
    "live": (
        ["compare", "paper", "--controllers", "pi", "--set", "setpoint.live.port=50000"],
        ["setpoint.live", "nothing to compare by"],
    ),
    "backends of a rival": (
        ["compare", "paper", "--set", "controller.kind=pi"], ["--backends", "takes no backend"],
    ),
    "run unknown": (["run", "--controller", "mcp"], ["unknown controller 'mcp'", "'mpc'"]),
    "run with a backend": (
        ["run", "--controller", "pi", "--backend", "osqp"],
        ["--backend osqp: no effect on controller.kind = pi", "mpc"],
    ),
    "latency": (
        ["bench", "latency", "paper", "--set", "controller.kind=pi"],
        ["takes no backend"],
    ),
    "deadline": (
        ["bench", "deadline", "paper", "--set", "controller.kind=pi"],
        ["takes no backend"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_bad_input_is_one_line_and_leaves_nothing(case, refuse):
    arguments, told = BAD[case]
    line = refuse(*arguments)
    for part in told:
        assert part in line


def test_gains_that_are_not_stable_are_refused_before_anything_is_simulated(leave, tmp_path):
    code, out, err = leave(
        "run", "--controller", "pi-ilc", "--set", "controller.pi.proportional=9000.0"
    )
    assert (code, out) == (2, "")
    told = "pulsempc: controller.pi: this loop does not settle on controller.model"
    assert err.splitlines() == ["setup ...", told]
    assert not list(tmp_path.iterdir())


# --- what the rows are made into -----------------------------------------------------------------


def row(scenario: str, controller: str, rms: float, *, trip: bool = False) -> dict:
    figures = dict.fromkeys(FIGURES, rms)
    return {
        "scenario": scenario,
        "controller": controller,
        "complete": True,
        "error": None,
        "trip": {"cause": "force", "time": 1.5} if trip else None,
        "axes": {"x": figures, "z": figures | {"rms": 2 * rms}},
        "increment_rms": {"x": 3.0, "z": 4.0},
        "torque_increment_rms": 1.25,
        "saturation": {"torque": 0.25, "command": 0.0},
    }


ROWS = [
    row("one", "pi", 0.1), row("one", "aob", 0.3), row("one", "mpc", 0.2),
    row("two", "pi", 0.1, trip=True), row("two", "aob", 0.3), row("two", "mpc", 0.2),
]  # fmt: skip


def test_who_is_ahead_is_told_and_who_tripped_is_not():
    assert ahead(ROWS, "mpc", "rms") == {
        "one x": ["pi"], "one z": ["pi"], "two x": [], "two z": [],
    }  # fmt: skip
    fallen = [*ROWS[:5], row("two", "mpc", 0.01, trip=True)]
    assert ahead(fallen, "mpc", "rms")["two z"] == ["aob"]


def test_the_lines_tell_trips_and_who_is_ahead():
    lines = contest_lines(ROWS)
    assert lines[0] == "two, pi: tripped at 1.5 s on force"
    assert lines[1] == "ahead of mpc by rms: one x: pi; one z: pi"
    assert contest_lines([ROWS[1], ROWS[2]])[0].endswith("nobody, on no scenario and axis")


def test_the_tables_have_every_run(tmp_path):
    console = Console(width=120, record=True, file=(tmp_path / "out").open("w"))
    for table in contest_tables(ROWS):
        console.print(table)
    text = console.export_text()
    assert text.count("pi (tripped)") == 3
    assert text.count("one") == 3  # a scenario is named once in each table
    for part in ("0.2000", "0.4000", "1.25", "3.54", "25.00%"):
        assert part in text


def test_the_picture_is_drawn_for_any_rows(tmp_path):
    for rows in (ROWS, []):
        draw_contest(rows, tmp_path / "picture.png")
        assert matplotlib.image.imread(tmp_path / "picture.png").shape[0] > 300


def test_every_motion_is_taken_where_no_scenario_is_named(leave, monkeypatch):
    asked = []

    def noted(scenarios, names, **_):
        asked.append(([s.name for s in scenarios], names))
        raise KeyboardInterrupt

    monkeypatch.setattr("bench.verbs.compare.contest", noted)
    assert leave("compare", "--controllers", "pi,mpc")[0] == 130
    assert asked == [(list(MOTIONS), ["pi", "mpc"])]
