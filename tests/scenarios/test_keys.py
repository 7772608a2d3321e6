"""Every key of bounds and solver does to a run what it says; on the perfect cell, to the letter.

And every imperfection of that cell has an effect.
"""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from plant import ImperfectionConfig
from plant.viper import VIPER_S650
from qpmpc.backends import available
from qpmpc.errors import BackendSetupError
from qpmpc.force_control import ForceController
from scenarios import load_scenario, run_experiment

SPEEDS, TORQUES = VIPER_S650.joint_speed.si, VIPER_S650.torque_limit.si
DEMANDING = (
    "controller.reference_time=0.0",
    "setpoint.steps=[{time=0.01, z=-16.0}]",
    "controller.bounds.velocity=[-inf, inf]",
)
"""A step of 6 N at once: without bounds 0.2 m/s, and past the new setpoint by more than 0.5 N."""
SLOWER = "controller.bounds.velocity=[-0.1, 0.1]"
NO_TIME = sorted(b.name for b in available() if b.version and "time" not in b.limits)


@pytest.fixture(scope="module")
def press(simulate):
    """The demanding step under more settings, 80 ms; the heart rests that long."""

    def run(*settings, backend="daqp", duration=0.08):
        return simulate(
            "ideal", *DEMANDING, *settings, still=False, backend=backend, duration=duration
        )

    return run


@pytest.fixture(scope="module")
def free(press):
    return press()


@pytest.fixture(scope="module")
def capped(press):
    return press(SLOWER)


def tool_speed(run) -> float:
    return float(np.abs(run.log.tool_velocity).max())


def test_without_them_the_run_is_demanding(free):
    assert tool_speed(free) > 0.2
    assert free.log.force[:, 2].min() < -16.5
    assert free.log.command_saturated.any()
    assert free.summary["status"] == {"solved": 80}


# --- velocity, force, command, rate --------------------------------------------------------------


def test_velocity_is_capped(capped):
    assert 0.0999 < tool_speed(capped) < 0.1 * (1 + 1e-3)
    assert capped.summary["violations"]["velocity"]["worst"] < 1e-4


def test_velocity_of_one_axis_is_capped_and_the_margin_kept(press):
    run = press(
        "controller.bounds.velocity={z=[-0.1, 0.1]}", "controller.bounds.velocity_margin=0.04"
    )
    assert 0.0599 < tool_speed(run) < 0.06 * (1 + 1e-3)
    assert run.summary["violations"]["velocity"]["count"] == 0


def test_force_is_capped(press, capped):
    """The setpoint is the bound; at 0.1 m/s the tool can stop within the horizon."""
    assert capped.log.force[:, 2].min() < -16.05
    run = press(SLOWER, "controller.bounds.force.z=[-16.0, inf]")
    assert run.log.force[:, 2].min() > -16.0 - 1e-3
    assert run.log.force[-1, 2] == pytest.approx(-16.0, abs=0.05)


def test_a_force_margin_keeps_away_from_the_bound(press):
    run = press(
        SLOWER, "controller.bounds.force=[-16.0, 16.0]", "controller.bounds.force_margin=1.0"
    )
    assert run.log.force[:, 2].min() > -15.0 - 1e-3
    assert run.log.force[-1, 2] == pytest.approx(-15.0, abs=0.05)


def test_command_and_rate_have_bounds_of_their_own_for_each_axis(press):
    run = press(
        "controller.bounds.command={z=[-8.0, 3.0]}", "controller.bounds.rate={z=[-4.0, inf]}"
    )
    z = run.log.command[:, 2]
    assert (z.min(), z.max()) == (-8.0, 3.0)
    steps = np.diff(z, prepend=0.0)
    assert steps.min() >= -4.0 * (1 + 1e-9)
    assert np.isclose(steps, -4.0).any()
    assert steps.max() > 4.0
    assert np.array_equal(run.log.command_saturated, np.isin(z, (-8.0, 3.0)))
    assert run.summary["violations"]["command"]["count"] == 0


# --- order and largest error ---------------------------------------------------------------------

LATE_CAP = (  # 0.4 mm to go
    "setpoint.steps=[]",
    "controller.bounds.velocity=[-0.02, 0.02]",
    "bounds_steps=[{time=0.03, force={z=[-9.0, inf]}}]",
)
"""A cap on force that is passed as long as the tool is not faster than it may."""


@pytest.mark.parametrize("first", ["velocity", "force"])
def test_of_two_bounds_that_contradict_the_first_in_the_order_holds(first, press):
    others = [
        name for name in ("joint_torque", "joint_speed", "velocity", "tangential", "force")
        if name != first
    ]  # fmt: skip
    order = str([first, *others]).replace("'", '"')
    found = press(*LATE_CAP, f"controller.bounds.order={order}").summary["violations"]
    if first == "velocity":
        assert found["velocity"]["worst"] < 1e-4
        assert found["force"]["count"] > 10  # it takes 20 cycles and is seen 8 ahead
    else:
        assert found["velocity"]["worst"] > 0.05
        assert found["force"]["count"] < 10


def test_beyond_the_largest_error_the_setpoint_outweighs_a_bound(press, capped, free):
    run = press(SLOWER, "controller.bounds.largest_error=0.01")
    assert tool_speed(run) > 0.15 > tool_speed(capped)


# --- tangential ----------------------------------------------------------------------------------

SIDEWAYS = ("setpoint.x=0.0", "setpoint.steps=[]", "setpoint.y=2.0")


@pytest.mark.parametrize(
    ("cone", "allowed"),
    [
        ("{limit=inf}", 2.0),
        ("{limit=1.5, friction=0.1}", 2.0),
        ("{limit=1.5}", 1.5 * np.cos(np.pi / 8)),
        ("{limit=1.5, facets=4}", 1.5 * np.cos(np.pi / 4)),
        ("{limit=1.5, facets=64}", 1.5 * np.cos(np.pi / 64)),
        ("{limit=0.5, friction=0.1, facets=4}", 1.5 * np.cos(np.pi / 4)),
        ("{limit=1.5, friction=0.1, facets=4}", 2.5 * np.cos(np.pi / 4)),
    ],
)
def test_the_tangential_force_is_what_the_polygon_allows(cone, allowed, press):
    """Towards +y lies a side of the polygon where its sides are a multiple of 4."""
    run = press(*SIDEWAYS, f"controller.bounds.tangential={cone}")
    assert run.log.force[-1, 1] == pytest.approx(allowed, abs=0.02)
    assert run.log.force[-1, 2] == pytest.approx(-10.0, abs=0.1)


# --- joints --------------------------------------------------------------------------------------


def test_joints_stay_under_their_share_of_speed(press, free):
    share = 0.05
    assert (np.abs(free.log.joint_velocity) / SPEEDS).max() > 2 * share
    run = press(f"controller.bounds.joints.speed={share}")
    assert 0.99 * share < (np.abs(run.log.joint_velocity) / SPEEDS).max() < share * (1 + 1e-3)
    assert run.log.force[-1, 2] == pytest.approx(-16.0, abs=0.05)


def test_joints_stay_under_their_share_of_torque(press, free):
    share = 0.3
    assert (np.abs(free.log.torque) / TORQUES).max() > 1.3 * share
    run = press(f"controller.bounds.joints.torque={share}")
    assert 0.99 * share < (np.abs(run.log.torque) / TORQUES).max() < share * (1 + 1e-3)
    assert not run.log.torque_saturated.any()


# --- the solver's limits -------------------------------------------------------------------------


def test_too_few_iterations_are_counted_and_something_stands_in(press, free):
    run = press("controller.solver.max_iterations=1")
    assert run.summary["status"]["iteration_limit"] > 70
    source = run.summary["source"]
    assert source["solution"] < 10
    assert source["analytic"] > 0
    assert sum(source.values()) == 80
    assert np.isfinite(run.log.command).all()
    enough = press("controller.solver.max_iterations=100")
    assert np.array_equal(enough.log.command, free.log.command)


def test_too_little_time_is_counted_and_something_stands_in(press):
    """DAQP looks at the clock every 32 iterations, which it never needs here."""
    slow = next(b for b in ("clarabel", "osqp", "daqp") if b in {i.name for i in available()})
    run = press("controller.solver.time_limit=1e-7", backend=slow, duration=0.04)
    assert run.summary["status"].get("iteration_limit", 0) > 20
    assert run.summary["source"]["solution"] < 20
    enough = press("controller.solver.time_limit=10.0", backend=slow, duration=0.04)
    assert enough.summary["status"] == {"solved": 40}


@pytest.mark.skipif(not NO_TIME, reason="every installed backend has a limit of time")
def test_a_limit_that_a_backend_has_not_is_an_error_before_anything_is_simulated():
    scenario = load_scenario(
        "ideal",
        top={"duration": 0.05, "backend": NO_TIME[0]},
        settings=["controller.solver.time_limit=0.001"],
    )
    stages = set()
    with pytest.raises(BackendSetupError, match="has no limit of time") as caught:
        run_experiment(scenario, report=lambda *now: stages.add(now[0]), stop=lambda: False)
    assert "\n" not in str(caught.value)
    assert stages == {"setup"}


@pytest.mark.parametrize(("smallest", "parts"), [(1, 3), (9, 2), (1000, 1)])
def test_the_smallest_part_decides_how_many_problems_there_are(smallest, parts):
    """Three axes of 8 increments that nothing couples."""
    scenario = load_scenario("paper", settings=[f"controller.solver.smallest_part={smallest}"])
    controller = ForceController(scenario.controller, scenario.axes, 1e-3, "daqp")
    assert controller.general.solver.parts == parts


def test_the_form_is_told_and_leads_to_the_same_run(press):
    runs = {
        name: press(f"controller.solver.form={name}", SLOWER)
        for name in ("condensed", "structured")
    }
    for name, run in runs.items():
        assert run.summary["form"] == {"name": name, "reason": "asked for"}
        assert run.summary["status"] == {"solved": 80}
    commands = [run.log.command for run in runs.values()]
    assert np.allclose(*commands, atol=1e-6)
    facts = runs["structured"].summary["backend_facts"]
    assert [part["solver"] for part in facts] == ["riccati"] * 3


# --- changes of bounds ---------------------------------------------------------------------------


def test_a_cap_that_comes_is_heeded_before_it_is_there_and_left_when_it_goes(press):
    cap = "bounds_steps=[{time=0.03, force={z=[-9.0, inf]}}, {time=0.06, force={z=[-20.0, inf]}}]"
    run = press("setpoint.steps=[]", cap, duration=0.1)
    z = run.log.force[:, 2]
    assert z[21] == pytest.approx(-10.0, abs=1e-3)  # 8 ms ahead it is not yet seen
    assert z[29] > -9.5
    assert z[30:60].min() > -9.0 - 1e-2
    assert z[-1] == pytest.approx(-10.0, abs=0.05)
    assert run.summary["violations"]["force"]["worst"] < 1e-2


def test_the_margin_is_kept_from_a_cap_that_comes(press):
    cap = "bounds_steps=[{time=0.03, force={z=[-9.0, inf]}}]"
    run = press("setpoint.steps=[]", cap, "controller.bounds.force_margin=0.5")
    assert run.log.force[40:, 2].min() > -8.5 - 1e-2
    assert run.log.force[-1, 2] == pytest.approx(-8.5, abs=0.05)


def test_a_cap_that_comes_slowly_is_followed(press):
    cap = "bounds_steps=[{time=0.02, ramp=0.05, force={z=[-9.0, inf]}}]"
    start = "controller.bounds.force.z=[-10.0, inf]"
    z = press("setpoint.steps=[]", start, cap).log.force[:, 2]
    line = np.interp(np.arange(80), [20, 70], [-10.0, -9.0])
    assert (z >= line - 1e-3).all()
    assert np.abs(z - line)[30:].max() < 0.1


def test_a_bound_on_velocity_may_come_although_there_was_none(press, free):
    run = press("bounds_steps=[{time=0.001, velocity=[-0.08, 0.08]}]")
    assert 0.0799 < tool_speed(run) < 0.08 * (1 + 1e-3)


# --- imperfections -------------------------------------------------------------------------------

FLAWS = {
    "inertia_error": ("[0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 0.0]",),
    "friction": ("1.0",),
    "friction_compensation": ("0.5", "friction=1.0"),
    "stribeck": ("0.5", "friction=1.0"),
    "stribeck_speed": ("0.5", "friction=1.0", "stribeck=0.5"),
    "torque_lag": ("0.001",),
    "torque_limit": ("0.2",),
    "joint_frequency": ("80.0",),
    "joint_damping": ("0.5", "joint_frequency=80.0"),
    "encoder_resolution": ("1e-6",),
    "velocity_filter": ("0.0005",),
    "delay": ("1",),
    "delay_jitter": ("0.2",),
    "command_resolution": ("0.01",),
    "tip_mass": ("0.01",),
}
"""A value of each key of ``cell.imperfections``, and what it needs for its effect."""


def test_no_imperfection_is_left_out():
    assert set(FLAWS) == {f.name for f in fields(ImperfectionConfig)}


@pytest.mark.parametrize("key", FLAWS)
def test_an_imperfection_changes_the_run_and_the_run_stays_whole(key, press, free):
    size, *others = FLAWS[key]
    value, *needed = (f"cell.imperfections.{text}" for text in (f"{key}={size}", *others))
    without = press(*needed) if needed else free
    run = press(*needed, value)
    assert not np.array_equal(run.log.force, without.log.force)
    assert run.summary["trip"] is None
    assert sum(run.summary["status"].values()) == 80
    assert np.isfinite(run.log.force).all()


def test_what_is_read_differs_by_the_flaw_and_errors_count_from_what_is_true(press):
    run = press("cell.imperfections.tip_mass=0.02")
    apart = np.abs(run.log.force_measured - run.log.force).max()
    assert apart > 0.1
    true = np.sqrt(np.mean((run.log.force - run.log.setpoint) ** 2, axis=0))
    told = [run.summary["axes"][axis]["compensated"]["rms"] for axis in "xyz"]
    np.testing.assert_allclose(told, true)
