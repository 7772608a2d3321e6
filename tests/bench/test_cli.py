"""The command line as its users meet it: a process, its streams, its exit code, its files."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import tomllib
from importlib import import_module
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from bench import cli, ownership
from qpmpc.backends import available
from scenarios import shipped

ROOT = Path(cli.__file__).parents[1]
FILES = ["config.toml", "forces.png", "log.parquet", "summary.json"]
SHORT = ("--duration", "0.05")


def environment() -> dict[str, str]:
    return os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "OPENBLAS_NUM_THREADS": "1",
        "COLUMNS": "100",
    }


def call(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bench", *arguments],
        cwd=folder,
        env=environment(),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


def said_once(text: str) -> str:
    """Check that standard error is one line of ours; return it."""
    assert text.startswith("pulsempc: "), text
    assert text.count("\n") == 1, text
    assert text.endswith("\n")
    assert "Traceback" not in text
    return text


@pytest.fixture
def leave(monkeypatch, capsys, tmp_path):
    """Run the command line in this process, in an empty folder: exit code, stdout, stderr.

    A process of its own costs two seconds, and reading the metadata of every package half of one:
    the dozens of bad inputs share this process and do without.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ownership, "packages_distributions", dict)

    def run(*arguments):
        with pytest.raises(SystemExit) as left:
            cli.main(list(arguments))
        said = capsys.readouterr()
        return left.value.code, said.out, said.err

    return run


# --- good input ----------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def table_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("table")
    return folder, call("run", "paper", *SHORT, "--seed", "3", folder=folder)


@pytest.fixture(scope="module")
def json_run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("json")
    arguments = (
        "--backend",
        "osqp",
        "--set",
        "cell.sensor.model=mini45",
        "--out",
        "here",
        "--json",
    )
    return folder, call("run", "paper", *SHORT, *arguments, folder=folder)


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


def test_json_is_all_there_is_on_standard_output(json_run):
    folder, done = json_run
    assert done.returncode == 0
    summary = json.loads(done.stdout)
    assert done.stdout == (folder / "here" / "summary.json").read_text()
    assert done.stderr == ""
    assert summary["backend"] == "osqp"
    config = tomllib.loads((folder / "here" / "config.toml").read_text())
    assert config["cell"]["sensor"]["model"] == "mini45"
    assert [p.name for p in folder.iterdir()] == ["here"]


@pytest.mark.parametrize("verb", ["run", "scenarios", "backends"])
def test_every_verb_has_help_with_an_example(verb, leave):
    code, out, _ = leave(verb, "--help")
    assert code == 0
    assert f"`pulsempc {verb}" in out


def test_the_options_of_the_issue_are_in_the_help(leave):
    out = leave("run", "--help")[1]
    for option in (
        "--backend", "--motion", "--beats", "--duration", "--seed", "--set", "--out", "--json",
    ):  # fmt: skip
        assert option in out


def test_help_lists_the_verbs(leave):
    code, out, _ = leave("--help")
    assert code == 0
    for verb in ("run", "scenarios", "backends"):
        assert verb in out


def test_scenarios_lists_all(leave):
    code, out, _ = leave("scenarios")
    assert code == 0
    assert all(name in out for name in shipped())


def test_backends_lists_all_with_version_and_installation(leave, monkeypatch):
    monkeypatch.setattr(
        "qpmpc.backends._version", lambda package: None if package == "osqp" else "9.8.7"
    )
    code, out, _ = leave("backends")
    assert code == 0
    assert all(backend.name in out for backend in available())
    assert "pip install osqp" in " ".join(out.split())
    assert "9.8.7" in out


def test_pulsempc_is_python_m_bench():
    script = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["scripts"]["pulsempc"]
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
    return sorted(tmp_path.rglob("*"))


@pytest.mark.parametrize(("arguments", "words"), BAD.values(), ids=BAD)
def test_bad_input_is_one_line_and_leaves_no_folder(arguments, words, prepared, leave, tmp_path):
    code, out, err = leave("run", *arguments, "--json")
    assert code == 2
    assert out == ""
    line = said_once(err)
    for word in words:
        assert word in line
    assert sorted(tmp_path.rglob("*")) == prepared


@pytest.mark.parametrize("arguments", [(), ("fly",), ("scenarios", "paper"), ("--bogus",)])
def test_wrong_usage_is_one_line(arguments, leave):
    code, out, err = leave(*arguments)
    assert code == 2
    assert out == ""
    said_once(err)


@pytest.mark.parametrize("arguments", [("papr",), ("--bogus", "3")])
def test_a_process_that_got_bad_input_ends_with_2_and_one_line(arguments, tmp_path):
    done = call("run", *arguments, folder=tmp_path)
    assert done.returncode == 2
    assert done.stdout == ""
    said_once(done.stderr)
    assert list(tmp_path.iterdir()) == []


# --- Ctrl-C --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    """A long run that gets a Ctrl-C as soon as it has shown some progress."""
    folder = tmp_path_factory.mktemp("interrupted")
    process = subprocess.Popen(
        [sys.executable, "-m", "bench", "run", "paper", "--duration", "10", "--out", "r"],
        cwd=folder,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
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
    assert 1000 <= summary["cycles"] == table.num_rows < 10000
    np.testing.assert_allclose(table["time"].to_numpy(), 1e-3 * np.arange(table.num_rows))
    assert np.isfinite(table["force_z"].to_numpy()).all()
    assert np.isnan(table["force_uncompensated_z"].to_numpy()).all()
    assert summary["axes"]["z"]["uncompensated"]["rms"] is None
    assert summary["axes"]["z"]["compensated"]["rms"] < 0.5
    assert [p.name for p in interrupted[0].iterdir()] == ["r"]


def test_ctrl_c_before_the_simulation_leaves_nothing(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "bench", "run", "paper", "--duration", "300", "--out", "r"],
        cwd=tmp_path,
        env=environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
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
