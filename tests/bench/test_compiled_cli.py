"""The compiled step from the command line: chosen, told, left out without a compiler."""

from __future__ import annotations

import json

import pytest

SHORT = ("--duration", "0.05")


def summary(leave, *arguments: str) -> dict:
    code, out, _ = leave("run", "paper", *SHORT, "--out", "here", "--json", *arguments)
    assert code == 0
    return json.loads(out)


def test_a_run_tells_which_path_its_steps_took(leave):
    assert summary(leave)["compiled"] == {"used": True, "reason": None, "interpreted_cycles": 0}


@pytest.mark.parametrize(
    "arguments", [("--compiled", "off"), ("--set", "controller.solver.compiled=off")]
)
def test_off_is_interpreted(arguments, leave):
    found = summary(leave, *arguments)["compiled"]
    assert found == {"used": False, "reason": "switched off", "interpreted_cycles": 0}


def test_the_option_goes_before_the_key(leave):
    arguments = ("--compiled", "on", "--set", "controller.solver.compiled=off")
    assert summary(leave, *arguments)["compiled"]["used"]


def test_both_paths_control_alike(leave, tmp_path):
    runs = []
    for choice in ("on", "off"):
        code, out, _ = leave(
            "run", "ideal", *SHORT, "--out", choice, "--json", "--compiled", choice
        )
        assert code == 0
        runs.append(json.loads(out))
    first, second = (run["axes"]["z"]["compensated"] for run in runs)
    assert first["rms"] == pytest.approx(second["rms"], rel=1e-6)
    assert first["max"] == pytest.approx(second["max"], rel=1e-6)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (("--compiled", "on", "--backend", "piqp"), "the backend has no compiled form"),
        (
            ("--compiled", "on", "--set", "controller.bounds.joints.torque=0.5"),
            "rows of joint_torque change in every cycle",
        ),
    ],
)
def test_on_where_it_cannot_be_is_one_line(arguments, word, refuse):
    assert word in refuse("run", "paper", *SHORT, "--json", *arguments)


def test_auto_where_it_cannot_be_says_why(leave):
    found = summary(leave, "--set", "controller.bounds.joints.torque=0.5")["compiled"]
    assert found["used"] is False
    assert found["reason"] == "rows of joint_torque change in every cycle"


def test_without_a_compiler_a_process_says_so_and_runs(call, tmp_path, monkeypatch):
    monkeypatch.setenv("CC", "/nonexistent")
    monkeypatch.setenv("PATH", "")
    done = call("run", "paper", *SHORT, "--out", "here", folder=tmp_path)
    assert done.returncode == 0
    assert "step: interpreted (no C compiler: looked for /nonexistent" in done.stdout
    assert "Traceback" not in done.stderr
    refused = call("run", "paper", *SHORT, "--out", "not", "--compiled", "on", folder=tmp_path)
    assert refused.returncode == 2
    assert "no compiled step: no C compiler" in refused.stderr
    assert not (tmp_path / "not").exists()


def test_a_comparison_leaves_out_what_cannot_be_compiled_and_tells_the_rest(leave):
    arguments = ("--backends", "daqp,piqp", "--compiled", "on", "--out", "here", "--json")
    code, out, err = leave("compare", "paper-1d", *SHORT, *arguments)
    assert code == 1
    daqp, piqp = json.loads(out)["rows"]
    assert daqp["compiled"]["used"]
    assert "no compiled form" in piqp["error"]
    assert "piqp" in err


def test_a_steady_state_takes_no_memory(leave):
    arguments = ("--cycles", "4000", "--recorded", "0.2", "--json")
    code, out, _ = leave("bench", "steady", *arguments)
    assert code == 0
    found = json.loads(out)
    assert found["cycles"] == 4000
    assert max(found["python_bytes"]) - found["python_bytes"][0] < 4000
    assert len(found["resident_bytes"]) == 11


def test_a_backend_without_a_compiled_form_has_no_steady_state(refuse):
    assert "no compiled form" in refuse(
        "bench", "steady", "--backend", "piqp", "--recorded", "0.05", "--json"
    )
