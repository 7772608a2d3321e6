"""``pulsempc bench deadline`` as a process: results, bad input, Ctrl-C, no privileges."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import jsonschema
import pytest
from hdrh.histogram import HdrHistogram
from hdrh.log import HistogramLogReader

SHORT = ("bench", "deadline", "paper", "--cycles", "150", "--backends", "analytic,daqp")
FILES = {
    "config.toml", "deadline.json", "percentiles.png", "report.html", "response.hlog",
    "response-analytic.hgrm", "response-daqp.hgrm", "response-empty.hgrm", "response-plant.hgrm",
}  # fmt: skip

UNPRIVILEGED = """
import ctypes, resource, sys
resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))
resource.setrlimit(resource.RLIMIT_MEMLOCK, (65536, 65536))
libc = ctypes.CDLL(None, use_errno=True)
header = (ctypes.c_uint32 * 2)(0x20080522, 0)  # version 3, this process
assert libc.capset(header, (ctypes.c_uint32 * 6)()) == 0  # none at all
from bench.cli import main
main(sys.argv[1:])
"""


def load(folder: Path, root: Path) -> dict:
    told = json.loads((folder / "deadline.json").read_text(encoding="utf-8"))
    schema = (root / "bench" / "deadline.schema.json").read_text(encoding="utf-8")
    jsonschema.validate(told, json.loads(schema))
    return told


@pytest.fixture(scope="module")
def paced(tmp_path_factory, call):
    folder = tmp_path_factory.mktemp("paced")
    done = call(*SHORT, "--realtime", "--out", "out", folder=folder)
    return done, folder / "out"


def test_a_paced_run_writes_everything_and_says_what_was_in_force(paced, root) -> None:
    done, out = paced
    assert done.returncode == 0, done.stderr
    assert {path.name for path in out.iterdir()} == FILES
    told = load(out, root)
    assert told["mode"] == "paced"
    assert told["complete"]
    assert [row["name"] for row in told["rows"]] == ["empty", "plant", "analytic", "daqp"]
    assert {row["cycles"] for row in told["rows"]} == {150}
    assert told["machine"]["measures"]["affinity"]["in_force"]
    assert told["machine"]["measures"]["garbage_collection"]["in_force"]
    assert "in force: one core" in done.stdout
    assert "results: out" in done.stdout
    for row in told["rows"]:
        assert row["response_us"]["max"] >= row["response_us"]["p50"] > 0
        assert row["wake_us"]["max"] <= row["response_us"]["max"]


def test_histograms_hold_every_response(paced) -> None:
    _, out = paced
    told = json.loads((out / "deadline.json").read_text(encoding="utf-8"))
    reader = HistogramLogReader(str(out / "response.hlog"), HdrHistogram(1, 10**10, 3))
    for row in told["rows"]:
        histogram = reader.get_next_interval_histogram()
        assert histogram.get_tag() == row["name"]
        assert histogram.get_total_count() == row["cycles"]
        assert histogram.get_max_value() == pytest.approx(row["response_us"]["max"] * 1e3, rel=2e-3)
        table = (out / f"response-{row['name']}.hgrm").read_text(encoding="utf-8")
        assert f"TotalCount     = {150:12d}]" in table


def test_json_is_all_there_is_and_waits_are_left_out(call, root, tmp_path) -> None:
    done = call(*SHORT, "--json", "--out", "out", "--deadline", "0.5", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    told = json.loads(done.stdout)
    assert told == load(tmp_path / "out", root)
    assert told["mode"] == "hot"
    assert told["deadline_us"] == 500_000.0
    assert told["pacing"]["sleeps_by"] == "waits are skipped"
    assert told["rows"][3]["late"]["count"] == 0
    assert told["rows"][3]["source"]["solution"] == 150
    assert not told["machine"]["measures"]["scheduler"]["in_force"]


def test_without_privileges_it_runs_all_the_same_and_says_so(root, tmp_path, environment) -> None:
    done = subprocess.run(
        [sys.executable, "-c", UNPRIVILEGED, *SHORT, "--realtime", "--out", "out"],
        cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    told = load(tmp_path / "out", root)
    held = told["machine"]["measures"]
    assert not held["scheduler"]["in_force"]
    assert held["scheduler"]["reason"] == "Operation not permitted"
    assert held["scheduler"]["value"]["policy"] == "SCHED_OTHER"
    assert not held["memory_locked"]["in_force"]
    assert held["affinity"]["in_force"]
    assert "not in force: real-time scheduler: Operation not permitted" in done.stdout


def test_what_late_cycles_did_is_in_the_result(call, root, tmp_path) -> None:
    """No answer can be there within a microsecond of the release: the closed form stands in."""
    done = call(*SHORT, "--deadline", "1e-6", "--out", "out", folder=tmp_path)
    assert done.returncode == 0, done.stderr
    for row in load(tmp_path / "out", root)["rows"][2:]:
        assert row["misses"] == row["longest_run"] == row["late"]["count"] == 150
        assert row["late"]["actions"] == {"plan": 0, "analytic": 150, "hold": 0}
        assert row["status"] == {"late": 150}


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--cycles", "0"], "--cycles: must be at least 1"),
        (["--cycles", "-5"], "--cycles"),
        (["--cycles", "many"], "many"),
        (["--cycles", "99999999"], "the longest run is 3600 s"),
        (["--deadline", "0"], "--deadline: must be a positive time"),
        (["--deadline", "nan"], "--deadline"),
        (["--deadline", "-1"], "--deadline"),
        (["--backends", "daqp,nosuch"], "unknown backend 'nosuch'"),
        (["--backends", "daqp,daqp"], "more than once"),
        (["--backends", ""], "unknown backend ''"),
        (["--realtime", "--priority", "100"], "--priority: must be from 0 to 99"),
        (["--realtime", "--spin", "-1"], "--spin"),
        (["--realtime", "--spin", "nan"], "--spin"),
        (["--realtime", "--cpu", "-1"], "--cpu"),
        (["nosuch"], "nosuch"),
        (["--set", "controller.horizon=0"], "controller.horizon"),
        (["--motion", "nowhere.csv"], "nowhere.csv"),
        (["paper", "--set", "setpoint.live.port=5005"], "cannot be shared"),
        (["--unknown"], "--unknown"),
    ],
)
def test_bad_input_is_one_line_and_leaves_nothing(arguments, words, refuse, tmp_path) -> None:
    said = refuse("bench", "deadline", *arguments)
    assert words in said


def test_a_folder_that_is_taken_is_not_touched(leave, said_once, tmp_path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "mine").write_text("mine")
    code, _, said = leave(*SHORT, "--out", "out")
    assert code == 2
    assert "not empty" in said_once(said)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["mine"]


def test_ctrl_c_ends_with_130_and_a_valid_part(start, root, tmp_path) -> None:
    process = start(
        "bench", "deadline", "paper", "--backends", "daqp", "--cycles", "8000",
        "--out", "out", folder=tmp_path,
    )  # fmt: skip
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("cycles:"):
            process.send_signal(signal.SIGINT)
            break
    _, rest = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted after" in rest
    told = load(tmp_path / "out", root)
    assert not told["complete"]
    assert 0 < told["rows"][0]["cycles"] < 8000


def test_help_says_what_it_does_with_an_example(leave) -> None:
    code, said, _ = leave("bench", "deadline", "--help")
    assert code == 0
    assert "For example" in said
    for option in ("--realtime", "--backends", "--cycles", "--deadline", "--json", "--out"):
        assert option in said
