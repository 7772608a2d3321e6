"""``pulsempc compare`` as its users meet it: one table, one folder, exit codes."""

from __future__ import annotations

import json
import signal
import tomllib

import matplotlib.image
import numpy as np
import pyarrow.parquet as pq
import pytest

from qpmpc.backends import available

PERCENTILES = {"p50", "p99", "p999", "max"}
TIMES = ("build_time", "solve_time", "cycle_time", "plant_time")
RUN = ["config.toml", "log.parquet", "summary.json"]
MAIN = [
    name for name in ("analytic", "daqp", "osqp", "clarabel", "piqp", "casadi")
    if name in {backend.name for backend in available() if backend.version}
]  # fmt: skip
NO_TIME = sorted(b.name for b in available() if b.version and "time" not in b.limits)


@pytest.fixture(scope="module")
def compared(tmp_path_factory, call):
    """The approach from free motion, in which the closed form goes faster than it may."""
    folder = tmp_path_factory.mktemp("compared")
    arguments = ("--backends", "analytic, daqp,osqp", "--duration", "0.15", "--seed", "3")
    done = call("compare", "constrained", *arguments, "--out", "c", "--json", folder=folder)
    return folder / "c", done


@pytest.fixture(scope="module")
def summary(compared):
    return json.loads((compared[0] / "compare.json").read_text(), parse_constant=pytest.fail)


def test_json_is_all_there_is_on_standard_output(compared):
    folder, done = compared
    assert done.returncode == 0
    assert done.stderr == ""
    assert done.stdout == (folder / "compare.json").read_text()


def test_the_keys_are_the_stable_ones(summary):
    assert set(summary) == {"scenario", "seed", "cycles", "bounds", "rows", "versions"}
    assert (summary["scenario"], summary["seed"], summary["cycles"]) == ("constrained", 3, 150)
    assert summary["bounds"] == "on"
    assert [row["backend"] for row in summary["rows"]] == ["analytic", "daqp", "osqp"]
    for row in summary["rows"]:
        assert {
            "backend", "controller", "scenario", "seed", "axes", "violations", "status", "solve_us",
            "command_error", "complete", "error", "source", "build_us", "without_reference",
        } <= set(row)  # fmt: skip
        assert (row["controller"], row["scenario"], row["seed"]) == ("mpc", "constrained", 3)
        assert (row["complete"], row["error"]) == (True, None)
        assert set(row["axes"]) == {"x", "y", "z"}
        for figures in row["axes"].values():
            assert set(figures) == {
                "rms", "max", "p99", "peak_to_peak", "reduction_rms", "reduction_max",
            }  # fmt: skip
            assert all(isinstance(value, float) for value in figures.values())
        assert set(row["violations"]) == {"force", "velocity", "command"}
        for figures in row["violations"].values():
            assert {"count", "worst"} <= set(figures)
        assert set(row["solve_us"]) == set(row["build_us"]) == PERCENTILES
        assert sum(row["status"].values()) == 150


def test_what_the_rows_say_is_what_the_runs_say(compared, summary):
    for row in summary["rows"]:
        run = json.loads((compared[0] / row["backend"] / "summary.json").read_text())
        assert run["backend"] == row["backend"]
        for axis, figures in row["axes"].items():
            mine = run["axes"][axis]
            assert figures["rms"] == mine["compensated"]["rms"]
            assert figures["max"] == mine["compensated"]["max"]
            assert figures["reduction_rms"] == mine["reduction"]["rms"]
        for key in ("violations", "status", "source"):
            assert row[key] == run[key]
        assert row["solve_us"] == run["timing"]["solve_us"]


def test_the_bounds_make_the_difference(summary):
    analytic, *solvers = summary["rows"]
    assert analytic["violations"]["velocity"]["worst"] > 0.2
    assert analytic["violations"]["velocity"]["count"] > 20
    assert analytic["command_error"] > 1.0
    for row in solvers:
        assert row["violations"]["velocity"]["worst"] <= 1e-3
        assert row["command_error"] < 1e-5
        assert row["without_reference"] == 0


def test_the_folder_holds_table_picture_and_a_folder_a_run(compared):
    folder, _ = compared
    beats = ["beats.csv", *RUN]
    assert sorted(p.name for p in folder.iterdir()) == [
        "analytic", "compare.json", "comparison.png", "daqp", "osqp", "report.html",
    ]  # fmt: skip
    assert all(
        sorted(p.name for p in (folder / name).iterdir()) == beats
        for name in ("analytic", "daqp", "osqp")
    )
    assert min(matplotlib.image.imread(folder / "comparison.png").shape[:2]) > 300
    assert [p.name for p in folder.parent.iterdir()] == ["c"]


def test_all_runs_are_of_the_same_motion_and_noise(compared):
    logs = [pq.read_table(compared[0] / name / "log.parquet") for name in ("analytic", "daqp")]
    for axis in "xyz":
        columns = [f"force_uncompensated_{axis}", f"setpoint_{axis}"]
        assert logs[0].select(columns).equals(logs[1].select(columns))
        # Before contact the force is nothing, and what is read is noise.
        free = 35
        noise = [log[f"force_measured_{axis}"].to_numpy()[:free] for log in logs]
        assert np.array_equal(*noise)
        assert noise[0].any()


def test_run_repeats_each_of_its_runs(compared, leave, tmp_path):
    folder = compared[0] / "daqp"
    code, out, _ = leave("run", str(folder / "config.toml"), "--out", "again", "--json")
    assert code == 0
    logs = [pq.read_table(f / "log.parquet").drop(TIMES) for f in (folder, tmp_path / "again")]
    assert logs[0].equals(logs[1])
    given = json.loads((folder / "summary.json").read_text())
    assert json.loads(out) | {"timing": None} == given | {"timing": None}


def test_a_run_that_was_not_made_has_no_speed(compared):
    speeds = {
        name: json.loads((compared[0] / name / "summary.json").read_text())["timing"][
            "real_time_factor"
        ]["uncompensated"]
        for name in ("analytic", "daqp")
    }
    assert 0.1 < speeds["analytic"] < 100
    assert speeds["daqp"] is None


# --- in this process -----------------------------------------------------------------------------


@pytest.fixture
def undrawn(monkeypatch):
    """A picture costs a second."""
    monkeypatch.setattr("bench.verbs.compare.draw_comparison", lambda *_: None)


def rows(out: str) -> dict:
    return {row["backend"]: row for row in json.loads(out, parse_constant=pytest.fail)["rows"]}


def test_the_same_seed_is_the_same_comparison(leave, undrawn):
    arguments = ("compare", "paper-1d", "--backends", "daqp", "--duration", "0.03", "--json")
    made = [
        rows(leave(*arguments, "--seed", "1", "--out", out)[1])["daqp"] for out in ("one", "two")
    ]
    for row in made:
        assert row["seed"] == 1
        del row["solve_us"], row["build_us"]
    assert made[0] == made[1]


def test_without_bounds_every_backend_gives_the_analytic_command(leave, undrawn, tmp_path):
    """Violations are counted all the same, and the folders hold what was run."""
    code, out, _ = leave(
        "compare", "constrained", "--bounds", "off", "--backends", ",".join(MAIN),
        "--duration", "0.06", "--out", "c", "--json",
    )  # fmt: skip
    assert code == 0
    assert json.loads(out)["bounds"] == "off"
    logs = {name: pq.read_table(tmp_path / "c" / name / "log.parquet") for name in MAIN}
    largest = np.abs(logs["analytic"]["command_z"].to_numpy()).max()
    assert largest > 20.0  # beyond what the bound on the command would allow
    for name, row in rows(out).items():
        given, closed = (logs[n]["command_z"].to_numpy() for n in (name, "analytic"))
        assert np.abs(given - closed).max() <= 1e-5 * largest, name
        assert row["command_error"] <= 1e-5 * largest
        assert row["violations"]["velocity"]["worst"] > 0.2
        assert row["violations"]["command"]["count"] > 0
        bounds = tomllib.loads((tmp_path / "c" / name / "config.toml").read_text())["controller"][
            "bounds"
        ]
        assert bounds["velocity"] == bounds["command"] == [-np.inf, np.inf]


BAD = {
    "unknown backend": (["--backends", "daqp,osqq"], ["osqq", "did you mean 'osqp'"]),
    "backend twice": (["--backends", "daqp, osqp,daqp"], ["--backends", "daqp"]),
    "no backend": (["--backends", ""], ["backend"]),
    "comma too many": (["--backends", "daqp,"], ["backend"]),
    "unknown scenario": (["constraint"], ["constraint", "did you mean 'constrained'"]),
    "wrong bounds": (["--bounds", "maybe"], ["--bounds"]),
    "wrong key": (["--set", "controller.horizont=9"], ["did you mean 'horizon'"]),
    "no motion": (["--motion", "none.csv"], ["none.csv"]),
    "out exists": (["--out", "taken"], ["taken", "not empty"]),
    "unknown option": (["--backend", "daqp"], ["--backend"]),
}


@pytest.mark.parametrize(("arguments", "words"), BAD.values(), ids=BAD)
def test_bad_input_is_one_line_and_leaves_nothing(arguments, words, refuse, tmp_path):
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "mine.txt").write_text("precious")
    line = refuse("compare", *arguments, "--json")
    for word in words:
        assert word in line


def test_a_backend_that_is_not_installed_is_one_line_and_leaves_nothing(refuse, monkeypatch):
    for place in ("qpmpc.backends.version", "qpmpc.backends._registry.version"):
        monkeypatch.setattr(place, lambda package: None if package == "osqp" else "1.0")
    line = refuse("compare", "--backends", "daqp,osqp")
    assert "osqp" in line
    assert "pip install osqp" in line


@pytest.mark.skipif(not NO_TIME, reason="every installed backend has a limit of time")
@pytest.mark.parametrize("shown", [["--json"], []])
def test_a_backend_that_refuses_becomes_a_row_and_the_others_run(shown, leave, tmp_path):
    refusing = NO_TIME[0]
    code, out, err = leave(
        "compare", "paper-1d", "--backends", f"{refusing},daqp", "--duration", "0.03",
        "--set", "controller.solver.time_limit=1.0", "--out", "c", *shown,
    )  # fmt: skip
    assert code == 1
    told = err.splitlines()[-1]
    assert told.startswith(f"pulsempc: {refusing}: ")
    assert "has no limit of time" in told
    found = rows((tmp_path / "c" / "compare.json").read_text())
    assert list(found) == [refusing, "daqp"]
    assert set(found[refusing]) == {
        "backend", "controller", "scenario", "seed", "complete", "error",
    }  # fmt: skip
    assert "has no limit of time" in found[refusing]["error"]
    assert found["daqp"]["status"] == {"solved": 30}
    assert sorted(p.name for p in (tmp_path / "c").iterdir()) == [
        "compare.json", "comparison.png", "daqp", "report.html",
    ]  # fmt: skip
    if shown:
        assert out == (tmp_path / "c" / "compare.json").read_text()
        assert err == f"{told}\n"
    else:
        assert f"{refusing}: refused the problem" in out
        assert "daqp (interpreted): solved 30" in out  # as there is a limit of time


@pytest.mark.skipif(not NO_TIME, reason="every installed backend has a limit of time")
def test_if_all_refuse_there_is_still_a_table_and_a_picture(leave, tmp_path):
    code, out, _ = leave(
        "compare", "paper-1d", "--backends", NO_TIME[0], "--duration", "0.03",
        "--set", "controller.solver.time_limit=1.0", "--out", "c",
    )  # fmt: skip
    assert code == 1
    assert "refused the problem" in out
    assert sorted(p.name for p in (tmp_path / "c").iterdir()) == ["compare.json", "comparison.png"]


def test_a_simulation_that_fails_keeps_what_was_done(leave, undrawn, tmp_path, monkeypatch):
    monkeypatch.setattr("plant.cell._ABSURD", 11.0)
    code, out, err = leave(
        "compare", "ideal", "--backends", "daqp,analytic", "--duration", "0.1", "--out", "c",
        "--set", "setpoint.steps=[{time=0.02, z=-14.0}]", "--json",
    )  # fmt: skip
    assert code == 1
    assert [line.split(":")[1].strip() for line in err.splitlines()] == ["daqp", "analytic"]
    for name, row in rows(out).items():
        assert "unstable at t = 0.0" in row["error"]
        assert row["complete"] is False
        assert row["axes"]["z"]["rms"] is not None
        assert 10 < pq.read_table(tmp_path / "c" / name / "log.parquet").num_rows < 100


# --- tables --------------------------------------------------------------------------------------


def test_tables_fit_a_terminal_and_keep_their_units(leave, undrawn, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = leave(
        "compare", "constrained", "--backends", "analytic,daqp", "--duration", "0.05", "--out", "c"
    )
    assert code == 0
    assert max(len(line) for line in out.splitlines()) <= 80
    for unit in ("error [N]", "[N, m/s, m/s^2]", "time [us]", "command [m/s^2]"):
        assert unit in " ".join(out.split())
    assert "…" not in out
    for word in (
        "RMS x",
        "max z",
        "p99.9",
        "build p50",
        "analytic (compiled): solved",
        "results: c",
    ):
        assert word in out
    assert out.count("analytic") >= 4
    done = [line for line in err.splitlines() if line.endswith(": 100 %")]
    assert done == ["analytic: 100 %", "held still: 100 %", "daqp: 100 %"]


# --- Ctrl-C --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory, start):
    """A comparison that gets a Ctrl-C while its second backend runs."""
    folder = tmp_path_factory.mktemp("interrupted")
    arguments = ("--backends", "analytic,daqp,osqp", "--duration", "1", "--out", "c")
    process = start("compare", "paper-1d", *arguments, folder=folder)
    seen = []
    for line in process.stderr:
        seen.append(line)
        if line.startswith("daqp: 20 %"):
            process.send_signal(signal.SIGINT)
            break
    out, err = process.communicate(timeout=60)
    return folder, process.returncode, out, "".join(seen) + err


def test_ctrl_c_ends_with_130_and_says_so(interrupted):
    _, code, out, err = interrupted
    assert code == 130
    assert "Traceback" not in out + err
    assert err.splitlines()[-1] == "pulsempc: daqp: interrupted"
    assert not any(line.startswith("osqp") for line in err.splitlines())


def test_ctrl_c_leaves_what_is_done(interrupted):
    folder = interrupted[0] / "c"
    assert [p.name for p in interrupted[0].iterdir()] == ["c"]
    assert sorted(p.name for p in folder.iterdir()) == [
        "analytic", "compare.json", "comparison.png", "daqp", "report.html",
    ]  # fmt: skip
    found = rows((folder / "compare.json").read_text())
    assert list(found) == ["analytic", "daqp"]
    assert (found["analytic"]["complete"], found["analytic"]["error"]) == (True, None)
    assert (found["daqp"]["complete"], found["daqp"]["error"]) == (False, "interrupted")
    cycles = {name: pq.read_table(folder / name / "log.parquet").num_rows for name in found}
    assert cycles["analytic"] == 1000
    assert 200 <= cycles["daqp"] < 1000
    assert sum(found["daqp"]["status"].values()) == cycles["daqp"]
