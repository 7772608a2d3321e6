"""`pulsempc bench latency` as its users meet it: a process, its streams, its files."""

from __future__ import annotations

import json
import signal
import tomllib

import jsonschema
import numpy as np
import pytest

from bench.instances import Instances
from bench.latency.result import read_result, shipped_schema
from qpmpc.backends import available

SHORT = ("--cycles", "60", "--paced-cycles", "40", "--budget", "1")


@pytest.fixture(scope="module")
def measured(tmp_path_factory, call):
    folder = tmp_path_factory.mktemp("measured")
    done = call(
        "bench", "latency", "--backends", "daqp, osqp", "--horizon", "4,7", "--axes", "x,y,z", "z",
        "--seed", "3", *SHORT, "--out", "m", "--json", folder=folder,
    )  # fmt: skip
    return folder / "m", done


@pytest.fixture(scope="module")
def told(measured):
    return json.loads((measured[0] / "latency.json").read_text(), parse_constant=pytest.fail)


def test_json_is_all_there_is_on_standard_output(measured):
    folder, done = measured
    assert done.returncode == 0
    assert done.stderr == ""
    assert done.stdout == (folder / "latency.json").read_text()


def test_the_file_follows_the_shipped_schema(measured, told):
    jsonschema.validate(told, shipped_schema())
    assert read_result(measured[0] / "latency.json").complete


def test_every_combination_has_a_row(told):
    found = [(r["axes"], r["horizon"], r["mode"], r["backend"], r["path"]) for r in told["rows"]]
    interpreted = [row[:4] for row in found if row[4] == "interpreted"]
    assert interpreted == [
        (axes, horizon, mode, backend)
        for axes in ("x,y,z", "z")
        for horizon in (4, 7)
        for mode in ("hot", "paced")
        for backend in ("analytic", "daqp", "osqp")
    ]
    assert [(s["axes"], s["horizon"]) for s in told["streams"]] == [
        ("x,y,z", 4), ("x,y,z", 7), ("z", 4), ("z", 7),
    ]  # fmt: skip


def test_rows_say_what_they_should(told):
    for row in told["rows"]:
        step = row["step_us"]
        assert set(step) >= {"p50", "p99", "p999", "p9999", "max", "floor_p999"}
        assert 0 < step["p50"] <= step["p99"] <= step["p999"] <= step["p9999"] <= step["max"]
        assert step["floor_p50"] <= step["p50"]
        assert step["floor_p999"] <= step["p999"]
        assert row["instances"] == (60 if row["mode"] == "hot" else 40)
        assert (row["cut"] is None) == (row["mode"] == "hot")
        assert (row["response_us"]["p50"] is None) == (row["mode"] == "hot")
        assert len(row["pass_p50_us"]) == row["passes"] == 3
        assert 0 <= row["missed_in_every_pass"] <= row["misses"] <= 3 * row["instances"]
        assert row["ratio_to_analytic"] > 0
        if row["backend"] != "analytic":
            assert row["error"] < 1e-4
        else:
            assert row["ratio_to_analytic"] == 1.0
    assert told["machine"]["cpu"]
    assert told["machine"]["measures"]["garbage_collection"]["in_force"]
    assert told["timer"]["cost_ns"] <= told["timer"]["cost_p50_ns"] < 1e5
    assert (told["scenario"], told["seed"], told["period_us"]) == ("latency", 3, 1000.0)


def test_the_folder_holds_what_repeats_and_shows_it(measured, told):
    folder = measured[0]
    groups = ("xyz-N4", "xyz-N7", "z-N4", "z-N7")
    assert {p.name for p in folder.iterdir()} == {
        "latency.json", "config.toml", "report.html",
        *(f"latency-{group}.png" for group in groups),
        *(f"times-{group}.npz" for group in groups),
        *(f"instances-{group}.npz" for group in groups),
    }  # fmt: skip
    assert (folder / "latency-z-N4.png").read_bytes().startswith(b"\x89PNG")
    config = tomllib.loads((folder / "config.toml").read_text())
    assert (config["duration"], config["seed"], config["axes"]) == (0.06, 3, ["x", "y", "z"])
    found = Instances.load(folder / "instances-xyz-N7.npz")
    assert (found.cycles, found.horizon, found.axes) == (60, 7, "x,y,z")
    (stream,) = [s for s in told["streams"] if (s["axes"], s["horizon"]) == ("x,y,z", 7)]
    assert stream["active_share"] == found.active.any(axis=1).mean()
    with np.load(folder / "times-z-N4.npz", allow_pickle=False) as file:
        steps = file["daqp/interpreted/hot/step"]
    (row,) = [
        r for r in told["rows"]
        if (r["axes"], r["horizon"], r["mode"], r["backend"], r["path"])
        == ("z", 4, "hot", "daqp", "interpreted")
    ]  # fmt: skip
    assert steps.shape == (3, 60)
    assert steps.max() / 1e3 == row["step_us"]["max"]
    assert steps.min(axis=0).max() / 1e3 == row["step_us"]["floor_max"]


def test_without_json_it_is_tables(leave, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    code, out, err = leave("bench", "latency", "--backends", "osqp", "--paced", "off", *SHORT)
    assert code == 0
    assert max(len(line) for line in out.splitlines()) <= 80
    for word in ("analytic", "osqp", "x,y,z, N = 8, hot", "floor", "bounds act in", "clock:",
                 "results: runs/latency-latency-"):  # fmt: skip
        assert word in out
    assert "paced" not in out
    assert "N=8 xyz: 100 %" in err


def test_all_means_every_installed_backend(leave, monkeypatch, tmp_path):
    """Those that are not there, or refuse, are in the list with the reason."""
    known = [b for b in available() if b.name in ("analytic", "daqp", "piqp", "qpsolvers:ecos")]
    monkeypatch.setattr("bench.verbs.latency.available", lambda: known)
    code, _, _ = leave(
        "bench", "latency", "--backends", "all", "--paced", "off", "--out", "m",
        "--set", "controller.solver.time_limit=0.5", *SHORT, "--json",
    )  # fmt: skip
    assert code == 0
    told = read_result(tmp_path / "m" / "latency.json")
    assert {row.backend for row in told.rows} == {"analytic", "daqp"}
    left = {entry.backend: entry.reason for entry in told.left_out if entry.path != "compiled"}
    assert "limit of time" in left["piqp"]
    missing = [b for b in known if b.version is None]
    for backend in missing:
        assert backend.install in left[backend.name]
    assert set(left) == {"piqp", *(b.name for b in missing)}


def test_rows_that_change_give_no_file_of_instances(leave, tmp_path):
    code, _, _ = leave(
        "bench", "latency", "--backends", "daqp", "--paced", "off", "--out", "m",
        "--set", "controller.bounds.joints.speed=0.5", *SHORT, "--json",
    )  # fmt: skip
    assert code == 0
    assert not list((tmp_path / "m").glob("instances*"))
    (row,) = [r for r in read_result(tmp_path / "m" / "latency.json").rows if r.backend == "daqp"]
    assert row.error < 1e-6
    assert "joint_speed" in row.violation


def test_the_folder_alone_repeats_the_measurement(leave, tmp_path):
    beats = tmp_path / "beats.csv"
    beats.write_text("t\n" + "\n".join(f"{0.8 * i:.1f}" for i in range(8)) + "\n")
    options = ("--backends", "daqp", "--paced", "off", "--passes", "1", "--json")
    assert leave("bench", "latency", "--beats", "beats.csv", *SHORT, *options, "--out", "m")[0] == 0
    beats.unlink()
    assert leave("bench", "latency", "m/config.toml", *options, "--out", "again")[0] == 0
    first, second = (Instances.load(tmp_path / f / "instances-xyz-N8.npz") for f in ("m", "again"))
    np.testing.assert_array_equal(first.measurement, second.measurement)


BAD = {
    "unknown scenario": (["latncy"], ["did you mean 'latency'"]),
    "missing file": (["none.toml"], ["none.toml", "No such file"]),
    "unknown backend": (["--backends", "daqp,osqq"], ["osqq", "did you mean 'osqp'"]),
    "no backend": (["--backends", ""], ["--backends"]),
    "a hole in the list": (["--backends", "daqp,,osqp"], ["--backends", "commas"]),
    "twice the same": (["--backends", "daqp,osqp,daqp"], ["--backends", "daqp more than once"]),
    "horizon 0": (["--horizon", "0"], ["--horizon 0", "greater than or equal to 1"]),
    "horizon too long": (["--horizon", "8,513"], ["--horizon 513", "512"]),
    "horizon negative": (["--horizon=-8"], ["--horizon", "'-8' is not a whole number"]),
    "horizon a word": (["--horizon", "8,long"], ["--horizon", "'long' is not a whole number"]),
    "horizon a fraction": (["--horizon", "8.5"], ["--horizon", "'8.5'"]),
    "horizon in other digits": (["--horizon", "\u0668"], ["--horizon"]),
    "horizon twice": (["--horizon", "8,16,8"], ["--horizon", "8 more than once"]),
    "horizon empty": (["--horizon", ""], ["--horizon"]),
    "horizon below the moves": (
        ["--horizon", "4", "--set", "controller.control_horizon=6"], ["control_horizon"],
    ),
    "unknown axis": (["--axes", "x,q"], ["--axes x,q", "'x', 'y' or 'z'"]),
    "axis twice": (["--axes", "x,x"], ["--axes", "x more than once"]),
    "axes twice": (["--axes", "x,y", "x,y"], ["--axes", "more than once"]),
    "no axes": (["--axes", ""], ["--axes"]),
    "axes of a cone": (
        ["--axes", "z", "--set", "controller.bounds.tangential.limit=3.0"], ["tangential"],
    ),
    "no cycles": (["--cycles", "0"], ["--cycles", "at least 1"]),
    "too many cycles": (["--cycles", "99999999"], ["--cycles", "seconds", "3600"]),
    "no passes": (["--passes", "0"], ["--passes", "at least 1"]),
    "no paced cycles": (["--paced-cycles", "0"], ["--paced-cycles"]),
    "budget 0": (["--budget", "0"], ["--budget", "positive"]),
    "budget nan": (["--budget", "nan"], ["--budget"]),
    "budget infinite": (["--budget", "inf"], ["--budget"]),
    "paced perhaps": (["--paced", "perhaps"], ["--paced"]),
    "compiled perhaps": (["--compiled", "perhaps"], ["--compiled"]),
    "seed -1": (["--seed=-1"], ["seed"]),
    "unknown key": (["--set", "controller.horizont=9"], ["did you mean 'horizon'"]),
    "no motion": (["--motion", "none.csv"], ["none.csv", "no such file"]),
    "short motion": (["--motion", "brief.csv"], ["brief.csv", "lasts"]),
    "out exists": (["--out", "taken"], ["taken", "not empty"]),
    "out is a file": (["--out", "brief.csv"], ["brief.csv", "no folder"]),
    "unknown option": (["--bogus", "3"], ["--bogus"]),
}  # fmt: skip


@pytest.fixture
def prepared(tmp_path):
    lines = [f"{0.01 * i:.2f},0.0,0.0,{0.001 * (i % 5):.4f}" for i in range(20)]
    (tmp_path / "brief.csv").write_text("\n".join(["t,x,y,z", *lines]) + "\n")
    (tmp_path / "taken").mkdir()
    (tmp_path / "taken" / "latency.json").write_text("{}")


@pytest.mark.parametrize(("arguments", "words"), BAD.values(), ids=BAD)
def test_bad_input_is_one_line_and_leaves_no_folder(arguments, words, prepared, refuse):
    said = refuse("bench", "latency", *arguments, "--json")
    for word in words:
        assert word in said


@pytest.mark.parametrize("arguments", [(), ("fly",), ("latency", "a", "b"), ("--bogus",)])
def test_wrong_usage_is_one_line(arguments, refuse):
    refuse("bench", *arguments)


# --- Ctrl-C --------------------------------------------------------------------------------------


def _interrupted(start, folder, line, *arguments):
    process = start("bench", "latency", "--out", "m", *arguments, folder=folder)
    seen = []
    for said in process.stderr:
        seen.append(said)
        if said.startswith(line):
            process.send_signal(signal.SIGINT)
            break
    out, err = process.communicate(timeout=100)
    return process.returncode, out, "".join(seen) + err


def test_ctrl_c_keeps_the_groups_that_are_whole(start, tmp_path):
    arguments = ("--backends", "daqp", "--horizon", "4,5", "--cycles", "60", "--paced-cycles", "5")
    code, _, err = _interrupted(start, tmp_path, "N=5 xyz: 0 %", *arguments, "--passes", "30")
    assert code == 130
    assert "Traceback" not in err
    assert "interrupted; what was measured until then is in m" in err.splitlines()[-1]
    told = read_result(tmp_path / "m" / "latency.json")
    assert not told.complete
    assert {row.horizon for row in told.rows} == {4}
    assert {p.name for p in (tmp_path / "m").iterdir()} == {
        "latency.json", "config.toml", "report.html", "latency-xyz-N4.png", "times-xyz-N4.npz",
        "instances-xyz-N4.npz",
    }  # fmt: skip
    assert [p.name for p in tmp_path.iterdir()] == ["m"]


@pytest.mark.parametrize("line", ["recording: 0 %", "N=8 xyz: 0 %"])
def test_ctrl_c_before_a_group_is_whole_leaves_nothing(line, start, tmp_path, said_once):
    code, out, err = _interrupted(start, tmp_path, line, "--backends", "daqp", "--cycles", "900")
    assert code == 130
    assert out == ""
    assert "Traceback" not in err
    said_once(err.splitlines(keepends=True)[-1])
    assert list(tmp_path.iterdir()) == []
