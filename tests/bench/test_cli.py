"""The command line as its users meet it: a process, its streams, its exit code, its files."""

from __future__ import annotations

import json
import signal
import time
import tomllib
from importlib import import_module
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from bench import cli
from qpmpc.backends import _registry, available
from qpmpc.backends.daqp import DaqpBackend
from scenarios import shipped

FILES = ["config.toml", "forces.png", "log.parquet", "report.html", "summary.json"]
SHORT = ("--duration", "0.05")


# --- good input ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def table_run(tmp_path_factory, call):
    folder = tmp_path_factory.mktemp("table")
    return folder, call("run", "paper", *SHORT, "--seed", "3", folder=folder)


def test_a_run_shows_progress_a_table_and_where_the_results_are(table_run):
    folder, done = table_run
    assert done.returncode == 0
    (results,) = (folder / "runs").iterdir()
    assert results.name.startswith("paper-")
    assert sorted(p.name for p in results.iterdir()) == FILES
    assert f"runs/{results.name}" in done.stdout
    for word in ("RMS", "x", "y", "z", "solved", "real time"):
        assert word in done.stdout
    assert "compensated: 100 %" in done.stderr
    assert "Traceback" not in done.stderr


def test_the_files_hold_what_they_should(table_run):
    (results,) = (table_run[0] / "runs").iterdir()
    summary = json.loads((results / "summary.json").read_text())
    assert (summary["scenario"], summary["seed"], summary["cycles"]) == ("paper", 3, 50)
    config = tomllib.loads((results / "config.toml").read_text())
    assert (config["duration"], config["seed"]) == (0.05, 3)
    assert pq.read_table(results / "log.parquet").num_rows == 50
    assert (results / "forces.png").read_bytes().startswith(b"\x89PNG")


def test_a_trip_is_told_in_one_line_and_by_the_exit_code(leave, said_once, tmp_path):
    code, out, err = leave(
        "run", "paper", "--duration", "0.3", "--set", "cell.protection.tip_speed=0.02",
        "--set", "setpoint.steps=[{time=0.1, z=-13.0}]",
        "--out", "tripped", "--json",
    )  # fmt: skip
    assert code == 1
    assert "cell.protection.tip_speed" in said_once(err)
    summary = json.loads(out)
    assert summary["complete"] is True
    assert summary["trip"]["cause"] == "tip_speed"
    assert 0.0 < summary["trip"]["time"] < 0.28
    table = pq.read_table(tmp_path / "tripped" / "log.parquet")
    assert table.num_rows == 300  # it goes on: the log shows the way back
    first = table["trip"].to_pylist().index("tip_speed")
    assert summary["counted"] == first + 1
    assert table["time"][first].as_py() < summary["trip"]["time"]
    assert summary["trip"]["time"] <= table["time"][first + 1].as_py() + 1e-12
    assert f"at t = {summary['trip']['time']:.6g} s" in err


def test_json_is_all_there_is_on_standard_output(leave, tmp_path):
    arguments = ("--backend", "osqp", "--set", "cell.sensor.model=mini45", "--out", "here")
    code, out, err = leave("run", "paper", *SHORT, *arguments, "--json")
    assert code == 0
    summary = json.loads(out)
    assert out == (tmp_path / "here" / "summary.json").read_text()
    assert err == ""
    assert summary["backend"] == "osqp"
    config = tomllib.loads((tmp_path / "here" / "config.toml").read_text())
    assert config["cell"]["sensor"]["model"] == "mini45"
    assert [p.name for p in tmp_path.iterdir()] == ["here"]


@pytest.mark.parametrize(
    "verb", ["run", "compare", "bench", "bench latency", "bench compare", "scenarios", "backends"]
)
def test_every_verb_has_help_with_an_example(verb, leave):
    code, out, _ = leave(*verb.split(), "--help")
    assert code == 0
    assert f"`pulsempc {verb}" in out


def test_the_options_of_the_issue_are_in_the_help(leave):
    out = leave("run", "--help")[1]
    for option in (
        "--backend", "--motion", "--beats", "--setpoint", "--duration", "--seed", "--set", "--out",
        "--json",
    ):  # fmt: skip
        assert option in out


def test_help_lists_the_verbs(leave):
    code, out, _ = leave("--help")
    assert code == 0
    for verb in ("run", "compare", "bench", "scenarios", "backends"):
        assert verb in out


def test_scenarios_lists_all(leave):
    code, out, _ = leave("scenarios")
    assert code == 0
    assert all(name in out for name in shipped())


def test_backends_tells_what_each_of_them_can(leave, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")
    _, out, _ = leave("backends")
    for heading in ("warm", "start", "new", "rows", "limits"):
        assert heading in out
    lines = {line.split()[0]: line.split()[1:] for line in out.splitlines() if line.strip()}
    for backend in available():
        told = lines[backend.name]
        assert told[0] == ("yes" if backend.warm_starts else "no"), backend.name
        limits = " ".join(told[2:4])
        assert ("iter" in limits) == ("iterations" in backend.limits), backend.name
        assert ("time" in limits) == ("time" in backend.limits), backend.name
    assert lines["analytic"][1] == lines["daqp"][1]  # both take new rows


def test_a_backend_that_takes_no_new_rows_is_told_from_one_that_does(leave, monkeypatch):
    class Rebuilt(DaqpBackend):
        name, replaces_rows, limits = "rebuilt-one", False, frozenset()

    monkeypatch.setitem(_registry._table, "rebuilt-one", Rebuilt)
    monkeypatch.setenv("COLUMNS", "160")
    lines = {
        line.split()[0]: line.split() for line in leave("backends")[1].splitlines() if line.split()
    }
    assert lines["rebuilt-one"][2] != lines["daqp"][2]
    assert lines["rebuilt-one"][3] == "none"


def test_the_table_of_backends_fits_a_terminal(leave, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    _, out, _ = leave("backends")
    assert max(len(line) for line in out.splitlines()) <= 80
    for backend in available():
        assert f" {backend.name} " in out


def test_backends_lists_all_with_version_and_installation(leave, monkeypatch):
    monkeypatch.setenv("COLUMNS", "160")  # no line is broken
    monkeypatch.setattr(
        "qpmpc.backends._registry.version", lambda package: None if package == "osqp" else "9.8.7"
    )
    code, out, _ = leave("backends")
    assert code == 0
    assert all(backend.name in out for backend in available())
    assert "pip install osqp" in " ".join(out.split())
    assert "9.8.7" in out


def test_pulsempc_is_python_m_bench(root):
    script = tomllib.loads((root / "pyproject.toml").read_text())["project"]["scripts"]["pulsempc"]
    module, _, function = script.partition(":")
    assert getattr(import_module(module), function) is cli.main


def test_several_settings_may_follow_one_option(leave, tmp_path):
    settings = ("--set", "seed=5", "duration=0.01", "--set", "cell.contact.damping=2.0")
    code, out, _ = leave("run", "paper-1d", *settings, "--out", "r", "--json")
    assert code == 0
    assert json.loads(out)["seed"] == 5
    config = tomllib.loads((tmp_path / "r" / "config.toml").read_text())
    assert (config["duration"], config["cell"]["contact"]["damping"]) == (0.01, 2.0)


# --- bad input -----------------------------------------------------------------------------------


def write_csv(path: Path, *, change=lambda rows: rows, scale=1e-3, duration=1.0) -> None:
    t = np.arange(0.0, duration, 0.01)
    rows = [[f"{v:.6f}", *[f"{scale * np.sin(6 * v):.9f}"] * 3] for v in t]
    path.write_text(
        "\n".join(",".join(row) for row in [["t", "x", "y", "z"], *change(rows)]) + "\n"
    )


def with_cell(value):
    return lambda rows: [*rows[:5], [rows[5][0], value, "0", "0"], *rows[6:]]


CSV = {
    "nan.csv": {"change": with_cell("nan")},
    "word.csv": {"change": with_cell("high")},
    "unsorted.csv": {"change": lambda rows: [*rows[:9], rows[3], *rows[9:]]},
    "few.csv": {"change": lambda rows: rows[:2]},
    "brief.csv": {"duration": 0.04},
    "millimetres.csv": {"scale": 2.0},
    "far.csv": {  # 0.1 m to either side is a plausible file; out there the arm ends
        "change": lambda rows: [
            [r[0], f"{0.0999 * np.tanh(9 * np.sin(3 * float(r[0]))):.6f}", "0", "0"] for r in rows
        ]
    },
    "fast.csv": {
        "change": lambda rows: [
            [r[0], "0", "0", f"{0.09 * np.sin(60 * float(r[0])):.6f}"] for r in rows
        ]
    },
}
BAD = {
    "unknown scenario": (["papr"], ["papr", "did you mean 'paper'"]),
    "missing file": (["none.toml"], ["none.toml", "No such file"]),
    "unknown backend": (["--backend", "osqq"], ["osqq", "did you mean 'osqp'"]),
    "unknown key": (["--set", "controller.horizont=9"], ["did you mean 'horizon'"]),
    "no key": (["--set", "horizon"], ["key.path=value"]),
    "wrong type": (["--set", "seed=one"], ["seed"]),
    "negative stiffness": (["--set", "cell.contact.stiffness=-1.0"], ["cell.contact.stiffness"]),
    "horizon 0": (["--set", "controller.horizon=0"], ["controller.horizon"]),
    "min > max": (["--set", "controller.bounds.command=[2.0, 1.0]"], ["controller.bounds.command"]),
    "setpoint outside": (["--set", "setpoint.z=1.0"], ["setpoint.z", "controller.bounds.force.z"]),
    "duration 0": (["--duration", "0"], ["duration"]),
    "duration nan": (["--duration", "nan"], ["duration"]),
    "seed -1": (["--seed=-1"], ["seed"]),
    "no motion": (["--motion", "none.csv"], ["none.csv", "no such file"]),
    "no beats": (["--beats", "none.csv"], ["none.csv", "no such file"]),
    "no setpoint": (["--setpoint", "none.csv"], ["none.csv", "no such file"]),
    "setpoint out of bounds": (
        ["--setpoint", "far.csv", "--duration", "0.9"], ["far.csv", "controller.bounds.force.z"],
    ),
    "short setpoint": (["--setpoint", "beats.csv"], ["beats.csv", "no column 'x'"]),
    "setpoint twice": (
        ["--set", "setpoint.file=far.csv", "setpoint.z=-9.0"], ["setpoint.z", "no effect"],
    ),
    "motion and beats": (["--motion", "far.csv", "--beats", "far.csv"], ["exclude"]),
    "nan in motion": (["--motion", "nan.csv"], ["nan.csv: line 7", "'x'"]),
    "word in motion": (["--motion", "word.csv"], ["word.csv: line 7"]),
    "unsorted motion": (["--motion", "unsorted.csv"], ["unsorted.csv: line 11", "increase"]),
    "two rows": (["--motion", "few.csv"], ["few.csv", "at least 4"]),
    "short motion": (["--motion", "brief.csv", "--duration", "0.5"], ["brief.csv", "lasts"]),
    "short beats": (["--beats", "beats.csv", "--duration", "9"], ["beats.csv", "beats last"]),
    "millimetres": (["--motion", "millimetres.csv"], ["millimetres.csv", "metres"]),
    "unreachable": (["--motion", "far.csv", "--duration", "0.9"], ["Robot_Heart", "t = "]),
    "too fast": (["--motion", "fast.csv", "--duration", "0.2"], ["Robot_Heart", "deg/s", "t = "]),
    "out exists": (["--out", "taken"], ["taken", "not empty"]),
    "out is a file": (["--out", "nan.csv"], ["nan.csv", "no folder"]),
    "unknown option": (["--bogus", "3"], ["--bogus"]),
    "wrong type of option": (["--duration", "long"], ["--duration"]),
    "option without value": (["--out"], ["--out"]),
    "two scenarios": (["paper", "ideal"], ["ideal"]),
    "broken file": (["broken.toml"], ["broken.toml", "not TOML"]),
    "no text": (["picture.toml"], ["picture.toml", "UTF-8"]),
}  # fmt: skip


@pytest.fixture
def prepared(tmp_path):
    for name, how in CSV.items():
        write_csv(tmp_path / name, **how)
    (tmp_path / "beats.csv").write_text("t\n0.5\n1.5\n2.5\n3.5\n4.5\n")
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "summary.json").write_text("{}")
    (tmp_path / "broken.toml").write_text("duration = = 3")
    (tmp_path / "picture.toml").write_bytes(b"\x89PNG\xff\xfe")


@pytest.mark.parametrize(("arguments", "words"), BAD.values(), ids=BAD)
def test_bad_input_is_one_line_and_leaves_no_folder(arguments, words, prepared, refuse):
    line = refuse("run", *arguments, "--json")
    for word in words:
        assert word in line


@pytest.mark.parametrize("arguments", [(), ("fly",), ("scenarios", "paper"), ("--bogus",)])
def test_wrong_usage_is_one_line(arguments, refuse):
    refuse(*arguments)


def test_a_process_that_got_bad_input_ends_with_2_and_one_line(call, said_once, tmp_path):
    done = call("run", "papr", folder=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    said_once(done.stderr)
    assert list(tmp_path.iterdir()) == []


# --- Ctrl-C --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory, start):
    """A long run that gets a Ctrl-C as soon as it has shown some progress."""
    folder = tmp_path_factory.mktemp("interrupted")
    process = start("run", "paper", "--duration", "4", "--out", "r", folder=folder)
    seen = []
    for line in process.stderr:
        seen.append(line)
        if line.startswith("compensated: 10 %"):
            process.send_signal(signal.SIGINT)
            break
    out, err = process.communicate(timeout=60)
    return folder, process.returncode, out, "".join(seen) + err


def test_ctrl_c_ends_with_130_and_says_where_the_rest_is(interrupted):
    _, code, _, err = interrupted
    assert code == 130
    assert "interrupted" in err.splitlines()[-1]
    assert "r" in err.splitlines()[-1].split()
    assert "Traceback" not in err


def test_ctrl_c_leaves_a_valid_partial_log(interrupted):
    folder = interrupted[0] / "r"
    assert sorted(p.name for p in folder.iterdir()) == FILES
    summary = json.loads((folder / "summary.json").read_text(), parse_constant=pytest.fail)
    table = pq.read_table(folder / "log.parquet")
    assert summary["complete"] is False
    assert 400 <= summary["cycles"] == table.num_rows < 4000
    np.testing.assert_allclose(table["time"].to_numpy(), 1e-3 * np.arange(table.num_rows))
    assert np.isfinite(table["force_z"].to_numpy()).all()
    assert np.isnan(table["force_uncompensated_z"].to_numpy()).all()
    assert summary["axes"]["z"]["uncompensated"]["rms"] is None
    assert summary["axes"]["z"]["compensated"]["rms"] < 0.5
    assert [p.name for p in interrupted[0].iterdir()] == ["r"]


def test_ctrl_c_before_the_simulation_leaves_nothing(start, said_once, tmp_path):
    process = start("run", "paper", "--duration", "300", "--out", "r", folder=tmp_path)
    process.stderr.readline()  # the set-up has begun
    time.sleep(0.2)
    for _ in range(2):
        process.send_signal(signal.SIGINT)
        time.sleep(0.2)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130
    said_once(err.splitlines(keepends=True)[-1])
    assert "Traceback" not in err
    assert list(tmp_path.iterdir()) == []
