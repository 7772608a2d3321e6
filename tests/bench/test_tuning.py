"""The procedure that tunes the controllers: budget, cost, and what it left as data."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from bench import tune_rivals
from bench.tune_rivals import RESULTS, RIVALS, TRAINING, exercise, mean_cost, run, tune
from bench.tuning.cost import CHATTER, WORST, Cost, cost
from bench.tuning.search import descend, fill, gathered, spread
from qpmpc.config import ControllerConfig
from qpmpc.kinds import (
    ControllerKind,
    Tunable,
    by_law,
    controller_kind,
    controllers,
    register_controller,
)
from qpmpc.rivals.pi import PiLaw
from scenarios.log import Log

RANGES = (Tunable("a", 1e-3, 1e3), Tunable("b", 1.0, 1e4))
TUNED = json.loads(RESULTS.read_text())


class Counted:
    """A valley in the logarithm of both values, with its bottom at a = 0.5, b = 200."""

    def __init__(self):
        self.values = []

    def __call__(self, values):
        self.values.append(values)
        a, b = np.log(values / [0.5, 200.0])
        return a**2 + 0.5 * a * b + b**2


# --- the search ----------------------------------------------------------------------------------


def test_the_budget_is_used_exactly_and_within_the_ranges():
    filling, going_down = Counted(), Counted()
    found = fill(filling, RANGES, 16, seed=1)
    assert len(filling.values) == found.evaluations == 16
    for count in (1, 2, 5, 40, 300):
        going_down.values.clear()
        assert descend(going_down, RANGES, found.values, count, 0.1).evaluations == count
        assert len(going_down.values) == count
    every = np.array(filling.values + going_down.values)
    assert (every >= [1e-3, 1.0]).all()
    assert (every <= [1e3 * (1 + 1e-9), 1e4 * (1 + 1e-9)]).all()


def test_it_comes_to_the_bottom():
    start = fill(Counted(), RANGES, 32, seed=0)
    found = descend(Counted(), RANGES, start.values, 120, 0.1)
    assert found.values == pytest.approx([0.5, 200.0], rel=0.02)
    assert found.cost < 1e-3 < start.cost


def test_the_bottom_may_lie_on_the_edge():
    found = descend(lambda values: float(values[0]), RANGES, np.array([1.0, 1e4]), 60, 0.1)
    assert found.values[0] == pytest.approx(1e-3, rel=1e-3)


def test_the_same_seed_gives_the_same_points():
    first, second, other = (fill(Counted(), RANGES, 8, seed=s).values for s in (3, 3, 4))
    assert np.array_equal(first, second)
    assert not np.array_equal(first, other)


def test_values_and_points_of_the_cube_are_inverse():
    for point in np.random.default_rng(0).random((20, 2)):
        assert gathered(spread(point, RANGES), RANGES) == pytest.approx(point)
    assert spread(np.array([0.5, 0.25]), RANGES) == pytest.approx([1.0, 10.0])


# --- the cost ------------------------------------------------------------------------------------


def test_the_parts_of_the_cost_are_those_of_numpy():
    rng = np.random.default_rng(5)
    log = Log(400, ("x", "z"), ())
    log.setpoint[:] = [1.0, -10.0]
    log.force[:] = rng.normal([1.0, 7.0, -10.0], [0.1, 9.0, 0.3], (400, 3))
    log.torque[:] = rng.normal(0, 2, (400, 6))
    log.torque_saturated[:40] = log.command_saturated[20:60] = True
    log.cycles = 400
    held = rng.normal(0, [1.0, 5.0, 4.0], (400, 3))
    found = cost(log, held, 400)
    error = [np.std(log.force[:, 0] - 1), np.sqrt(np.mean((log.force[:, 2] + 10) ** 2))]
    ratio = np.array([np.sqrt(np.mean((log.force[:, 0] - 1) ** 2)), error[1]])
    ratio /= np.sqrt(np.mean(held[:, [0, 2]] ** 2, axis=0))
    assert found.error == pytest.approx(np.sqrt(np.mean(ratio**2)))
    assert found.chatter == pytest.approx(np.sqrt(np.mean(np.diff(log.torque, axis=0) ** 2)))
    assert (found.saturated, found.lost) == (0.15, 0.0)


def test_chatter_is_free_up_to_the_limit_and_a_trip_weighs_most():
    free = Cost(0.02, CHATTER, 0.0, 0.0)
    assert free.total == 0.02
    assert replace(free, chatter=1.5 * CHATTER).total == pytest.approx(0.52)
    assert replace(free, saturated=0.1).total == pytest.approx(0.12)
    assert replace(free, lost=0.01).total > replace(free, error=1.0).total
    assert Cost(1.0, CHATTER, 1.0, 1.0).total <= WORST


# --- the procedure -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def short():
    return [exercise("regular", 101, 0.8)]


def test_who_is_better_has_the_lower_cost(short):
    costs = {kind: mean_cost(short, {}, kind)[0] for kind in ("pi", "mpc")}
    assert costs["mpc"] < costs["pi"] < 1.0


def test_what_is_asked_for_is_what_runs(short):
    slow, fast = (run(short[0], {"pi.proportional": gain}, "pi").error for gain in (1.0, 60.0))
    assert fast < 0.7 * slow


def test_a_run_ends_with_its_trip(short, monkeypatch):
    class Pushing(PiLaw):
        def decide(self, force, velocity, setpoint, known):
            return np.array([0.0, 0.0, -20.0])

    monkeypatch.setattr("qpmpc.kinds._table", {})
    register_controller(ControllerKind("push", "", "", "", by_law(Pushing)))
    found = run(short[0], {}, "push")
    assert 0.5 < found.lost < 1.0
    assert found.total > 1.5


def test_a_controller_that_cannot_be_made_costs_most(short):
    assert mean_cost(short, {"pi.proportional": 9000.0}, "pi-ilc") == (WORST, [])


def test_tuning_betters_what_it_tunes(short, monkeypatch):
    for name, count in (("STARTS", 2), ("FILLED", 3), ("DESCENDED", 5)):
        monkeypatch.setattr(tune_rivals, name, count)
    values, told = tune(controller_kind("aob"), short, {}, seed=0)
    assert set(values) == {t.key for t in controller_kind("aob").tunables}
    for tunable in controller_kind("aob").tunables:
        assert tunable.low <= values[tunable.key] <= tunable.high
    assert (told["runs"][0]["motion"], told["runs"][0]["seed"]) == ("regular", 101)
    assert told["cost"] == pytest.approx(mean_cost(short, values, "aob")[0], rel=1e-9)
    assert told["cost"] == min(each["cost"] for each in told["searches"]) < WORST
    assert len(told["searches"]) == 2
    assert told["searches"][0] != told["searches"][1]


def test_bad_arguments_are_told_in_one_line(capsys):
    assert tune_rivals.main(["--controllers", "pid"]) == 2
    said = capsys.readouterr().err
    assert said.startswith("bench.tune_rivals: unknown controller 'pid'")
    assert said.count("\n") == 1


# --- the data ------------------------------------------------------------------------------------


def value(config, key: str) -> float:
    for part in key.split("."):
        config = getattr(config, part)
    return config


def test_what_was_found_is_of_this_procedure_and_of_every_rival():
    assert set(TUNED["controllers"]) == set(RIVALS)
    assert {"mpc", *RIVALS} <= {kind.name for kind in controllers()}
    assert set(TUNED["evaluations"]) == {"starts", "fill", "descend"}
    assert TUNED["free_chatter"] == CHATTER
    assert [(m["motion"], m["seed"]) for m in TUNED["motions"]] == list(TRAINING)
    for name in RIVALS:
        found = TUNED["controllers"][name]
        assert set(found["values"]) == {t.key for t in controller_kind(name).tunables}
        for search in found["searches"]:
            assert search["cost"] >= found["cost"]


@pytest.mark.parametrize("kind", RIVALS)
def test_the_rivals_defaults_are_what_was_found(kind):
    for key, found in TUNED["controllers"][kind]["values"].items():
        assert value(ControllerConfig(), key) == found


def test_no_training_motion_is_one_of_the_comparison():
    assert all(seed != 0 for _, seed in TRAINING)
