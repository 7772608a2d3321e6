"""Figures of merit against plain numpy, on logs with known content."""

from __future__ import annotations

import json

import numpy as np
import pytest

from plant import Cause, Trip
from qpmpc.fallback import Source
from qpmpc.status import Status
from scenarios import Experiment, Log, Schedule, load_scenario, summarise
from scenarios.metrics import PAPER, statistics
from scenarios.results import to_json

CYCLES = 1000
SETPOINT = np.array([1.0, 2.0, -10.0])
KEYS = {"rms", "max", "p99", "peak_to_peak"}
PERCENTILES = {"p50", "p99", "p999", "max"}


def experiment(rows=CYCLES, *, held=True, stopped=None, axes=("x", "y", "z")) -> Experiment:
    """A log of random figures of which ``rows`` were reached."""
    rng = np.random.default_rng(8)
    log = Log(CYCLES, axes, ("command",))
    n = len(axes)
    log.setpoint[:] = [{"x": 1.0, "y": 2.0, "z": -10.0}[axis] for axis in axes]
    log.setpoint[CYCLES // 2 :, -1] += 0.5
    log.force[:] = SETPOINT + rng.normal(0.01, [0.02, 0.03, 0.05], (CYCLES, 3))
    if held:
        log.force_uncompensated[:] = SETPOINT + rng.normal(0, [1.0, 1.6, 3.5], (CYCLES, 3))
    log.command[:] = rng.normal(0, 5, (CYCLES, n))
    log.torque_saturated[::10] = True
    log.command_saturated[::4] = True
    log.status[::100] = list(Status).index(Status.INACCURATE)
    log.source[::50] = list(Source).index(Source.PLAN)
    log.source[::100] = list(Source).index(Source.HOLD)
    log.build_time[:] = rng.gamma(3.0, 5e-6, CYCLES)
    log.solve_time[:] = rng.gamma(3.0, 5e-6, CYCLES)
    log.cycle_time[:] = log.solve_time + 1e-4
    log.cycle_time[5:8] = 2e-3
    log.plant_time[:] = 3.0 * log.solve_time
    log.cycles = rows
    wall = {"setup": 1.0, "compensated": 0.25, "uncompensated": 0.125}
    scenario = load_scenario("paper", settings=[f"axes={list(axes)}", "duration=1.0"])
    return Experiment(scenario, log, Schedule(scenario), stopped, wall)


@pytest.fixture(scope="module")
def complete():
    return experiment()


@pytest.fixture(scope="module")
def summary(complete):
    return summarise(complete)


def test_every_stable_key_is_there(summary):
    assert {
        "scenario", "backend", "backend_facts", "seed", "cycles", "axes", "paper", "timing",
        "saturation", "status", "source", "violations", "increment_rms", "complete", "stopped",
        "versions", "trip", "counted", "force_peak", "physics", "controller",
        "torque_increment_rms",
    } <= set(summary)  # fmt: skip
    assert set(summary["axes"]) == {"x", "y", "z"}
    for figures in summary["axes"].values():
        assert set(figures) == {"uncompensated", "compensated", "reduction"}
        assert set(figures["uncompensated"]) == set(figures["compensated"]) == KEYS
        assert set(figures["reduction"]) == {"rms", "max"}
    times = ("build_us", "solve_us", "cycle_us", "plant_us")
    assert {*times, "misses"} <= set(summary["timing"])
    assert all(set(summary["timing"][name]) == PERCENTILES for name in times)
    assert set(summary["source"]) == {"solution", "plan", "analytic", "hold"}
    assert set(summary["violations"]) == {"force", "velocity", "command"}
    for figures in summary["violations"].values():
        assert set(figures) == {"count", "worst", "integral"}
    assert set(summary["saturation"]) == {"torque", "command"}
    assert {"python", "numpy", "mujoco", "pin", "osqp", "daqp", "pulsempc"} <= set(
        summary["versions"]
    )
    assert summary["versions"]["numpy"] == np.__version__


def test_what_was_run_is_told(summary):
    assert (summary["scenario"], summary["backend"], summary["seed"]) == ("paper", "daqp", 0)
    assert summary["controller"] == "mpc"
    assert summary["cycles"] == CYCLES
    assert summary["complete"] is True
    assert summary["status"] == {"solved": CYCLES - 10, "inaccurate": 10}
    assert summary["source"] == {"solution": CYCLES - 20, "plan": 10, "analytic": 0, "hold": 10}
    assert summary["paper"] == PAPER


@pytest.mark.parametrize(("j", "axis"), list(enumerate("xyz")))
def test_errors_are_those_of_numpy(j, axis, complete, summary):
    log, figures = complete.log, summary["axes"][axis]
    held = log.force_uncompensated[:, j] - log.setpoint[0, j]
    controlled = log.force[:, j] - log.setpoint[:, j]
    for error, given in ((held, figures["uncompensated"]), (controlled, figures["compensated"])):
        assert given["rms"] == pytest.approx(np.sqrt(np.mean(error**2)))
        assert given["max"] == pytest.approx(np.max(np.abs(error)))
        assert given["p99"] == pytest.approx(np.percentile(np.abs(error), 99))
        assert given["peak_to_peak"] == pytest.approx(error.max() - error.min())
    for key in ("rms", "max"):
        expected = 100 * (1 - figures["compensated"][key] / figures["uncompensated"][key])
        assert figures["reduction"][key] == pytest.approx(expected)


def test_a_step_of_the_setpoint_counts_for_the_controlled_run_only(complete, summary):
    z = complete.log.force[:, 2]
    late = z[CYCLES // 2 :] + 9.5
    assert summary["axes"]["z"]["compensated"]["max"] == pytest.approx(np.abs(late).max())


def test_times_and_shares_are_those_of_numpy(complete, summary):
    log, timing = complete.log, summary["timing"]
    for name, times in (
        ("build_us", log.build_time), ("solve_us", log.solve_time), ("cycle_us", log.cycle_time),
        ("plant_us", log.plant_time),
    ):  # fmt: skip
        expected = np.percentile(1e6 * times, [50, 99, 99.9, 100])
        assert list(timing[name].values()) == pytest.approx(expected)
    assert timing["misses"] == 3
    assert timing["real_time_factor"] == {"compensated": 4.0, "uncompensated": 8.0}
    assert summary["saturation"] == {"torque": 0.1, "command": 0.25}
    increments = np.diff(log.command, axis=0, prepend=0.0)
    assert list(summary["increment_rms"].values()) == pytest.approx(
        np.sqrt(np.mean(increments**2, axis=0))
    )


def test_fewer_axes_in_another_order_find_their_columns():
    partial = experiment(axes=("z", "x"))
    log, figures = partial.log, summarise(partial)["axes"]
    assert list(figures) == ["z", "x"]
    error = log.force[:, 2] - log.setpoint[:, 0]
    assert figures["z"]["compensated"]["max"] == pytest.approx(np.abs(error).max())


@pytest.mark.parametrize("rows", [0, 1, 300])
def test_an_interrupted_run_has_none_and_no_nan(rows):
    summary = summarise(experiment(rows, held=False, stopped="interrupted"))
    read = json.loads(to_json(summary), parse_constant=pytest.fail)
    assert read == summary
    assert read["cycles"] == rows
    assert read["complete"] is False
    for figures in read["axes"].values():
        assert set(figures["uncompensated"].values()) == {None}
        assert set(figures["reduction"].values()) == {None}
        assert (figures["compensated"]["rms"] is None) == (rows == 0)
    assert (read["timing"]["solve_us"]["p50"] is None) == (rows == 0)
    assert read["timing"]["real_time_factor"]["uncompensated"] is None
    assert (read["saturation"]["torque"] is None) == (rows == 0)


def test_rows_that_were_not_reached_do_not_count():
    early, all_rows = summarise(experiment(300)), summarise(experiment())
    log = experiment(300).log
    error = (log.force[:300] - log.setpoint[:300])[:, 0]
    assert early["axes"]["x"]["compensated"]["max"] == pytest.approx(np.abs(error).max())
    assert early["timing"]["solve_us"] != all_rows["timing"]["solve_us"]
    assert sum(early["status"].values()) == 300


def test_no_number_anywhere_in_an_error_makes_none():
    assert statistics(np.array([1.0, np.nan])) == dict.fromkeys(sorted(KEYS))
    assert statistics(np.array([])) == dict.fromkeys(sorted(KEYS))
    assert statistics(np.array([3.0, -4.0])) == {
        "rms": pytest.approx(np.sqrt(12.5)),
        "max": 4.0,
        "p99": pytest.approx(3.99),
        "peak_to_peak": 7.0,
    }


def test_nan_never_becomes_json():
    with pytest.raises(ValueError, match="JSON"):
        to_json({"rms": float("nan")})


def test_after_a_trip_no_cycle_counts(complete):
    tripped = experiment()
    log, k = tripped.log, 300
    log.trip = Trip(Cause.FORCE, (k + 0.5) * 1e-3, 31.0, 30.0)
    log.tripped[k:] = True
    log.force[k + 1 :] = 1e3
    log.command[k + 1 :] = 1e3
    log.torque_saturated[k + 1 :] = True
    log.force_peak[:] = 12.0
    log.force_peak[k + 2] = 34.0
    summary = summarise(tripped)
    assert summary["trip"] == {"cause": "force", "time": 0.3005}
    assert (summary["cycles"], summary["counted"]) == (CYCLES, k + 1)
    assert summary["force_peak"] == 34.0
    whole = complete.log.force[: k + 1, 0] - 1.0
    assert summary["axes"]["x"]["compensated"]["max"] == pytest.approx(np.abs(whole).max())
    assert max(v for v in summary["increment_rms"].values()) < 20.0
    assert summary["saturation"]["torque"] == pytest.approx(0.1, abs=0.01)
    assert summary["violations"]["command"]["worst"] < 100.0
    assert summarise(complete)["trip"] is None
    assert summarise(complete)["counted"] == CYCLES
