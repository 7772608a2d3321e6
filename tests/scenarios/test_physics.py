"""The physics loop: compiled where it can be, in Python with the same result where it cannot."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios import ScenarioKeyError, load_scenario, run_experiment, summarise
from scenarios.physics import physics_loop


@pytest.fixture
def afresh():
    physics_loop.cache_clear()
    yield
    physics_loop.cache_clear()


def run():
    scenario = load_scenario(
        "paper", top={"duration": 0.05}, settings=["controller.solver.compiled=off"]
    )
    held = np.zeros((scenario.cycles, 3))
    return run_experiment(scenario, report=lambda *_: None, stop=lambda: False, held=held)


@pytest.mark.parametrize(
    ("variable", "value", "why"),
    [("CC", "no-such-compiler", "no C compiler"), ("PULSEMPC_CACHE", "/dev/null", "cache")],
)
def test_without_a_compiler_or_a_cache_the_run_is_the_same(
    variable, value, why, afresh, monkeypatch
):
    compiled = run()
    if physics_loop(6).binary is None:
        pytest.skip(physics_loop(6).told)
    assert summarise(compiled)["physics"] == "compiled"
    physics_loop.cache_clear()
    monkeypatch.setenv(variable, value)
    plain = run()
    told = summarise(plain)["physics"]
    assert told.startswith("python (")
    assert why in told
    for name in ("force", "force_measured", "force_peak", "torque", "tool", "command"):
        assert np.array_equal(getattr(plain.log, name), getattr(compiled.log, name)), name


def test_the_loop_is_compiled_once_in_a_process():
    assert physics_loop(6) is physics_loop(6)


@pytest.mark.parametrize(
    ("setting", "place"),
    [
        ("cell.protection.force=10.2", "setpoint"),
        ("setpoint.steps=[{time=1.0, z=-19.0}, {time=2.0, z=-9.0, y=7.5, x=7.5}]", None),
        ("setpoint.steps=[{time=1.0, z=-19.9}, {time=2.0, y=7.9, x=7.9}]", "setpoint.steps.1"),
    ],
)
def test_a_setpoint_must_not_trip_the_protection(setting, place):
    settings = [setting, "controller.bounds.force=[-50.0, 50.0]"]
    limit = [] if "protection" in setting else ["cell.protection.force=22.0"]
    if place is None:
        load_scenario("paper", settings=settings + limit)
        return
    with pytest.raises(ScenarioKeyError, match=r"cell\.protection\.force") as caught:
        load_scenario("paper", settings=settings + limit)
    assert caught.value.key == place
    load_scenario("paper", settings=[*settings, *limit, "cell.protection.enabled=false"])
