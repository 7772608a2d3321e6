"""Bounds, their changes in time and the solver's limits as a scenario's file has them."""

from __future__ import annotations

import math
import re
from contextlib import suppress

import pytest

from qpmpc.config import FREE, PerAxis, TangentialConfig
from scenarios import (
    AxesChange,
    BoundsStep,
    ScenarioError,
    ScenarioKeyError,
    Schedule,
    dump_scenario,
    load_scenario,
)

INF = math.inf
STEP = "bounds_steps = [{{time = 1.0, {}}}]"
PYTHON = re.compile(
    r"\b(tuple|list|dict|str|int|float|bool|NoneType|Interval|PerAxis|AxesChange|BoundsStep"
    r"|Annotated|Literal|Traceback|dataclass|validation)\b",
    re.IGNORECASE,
)
"""Words of the language and of the code, which no user wrote."""


def refused(text: str, write) -> ScenarioKeyError:
    with pytest.raises(ScenarioKeyError) as caught:
        load_scenario(write(text))
    error = caught.value
    assert str(error) == f"mine.toml: {error.key}: {error.reason}"
    assert "\n" not in str(error)
    assert not PYTHON.search(error.reason), error.reason
    return error


# --- unknown keys --------------------------------------------------------------------------------

UNKNOWN = [
    ("controller.bounds.force.zz = [0.0, 1.0]", "controller.bounds.force.zz", "z"),
    ("controller.bounds.velocity.zz = [0.0, 1.0]", "controller.bounds.velocity.zz", "z"),
    ("controller.bounds.command.zz = [0.0, 1.0]", "controller.bounds.command.zz", "z"),
    ("controller.bounds.force_margins = 1.0", "controller.bounds.force_margins", "force_margin"),
    ("controller.bounds.orders = []", "controller.bounds.orders", "order"),
    ("controller.bounds.large_error = 1.0", "controller.bounds.large_error", "largest_error"),
    (
        "controller.bounds.tangential.limits = 1.0",
        "controller.bounds.tangential.limits",
        "limit",
    ),
    ("controller.bounds.tangential.facet = 8", "controller.bounds.tangential.facet", "facets"),
    ("controller.bounds.joints.speeds = 1.0", "controller.bounds.joints.speeds", "speed"),
    ("controller.bounds.joints.torq = 1.0", "controller.bounds.joints.torq", "torque"),
    ("controller.solver.max_iteration = 3", "controller.solver.max_iteration", "max_iterations"),
    ("controller.solver.time_limits = 3.0", "controller.solver.time_limits", "time_limit"),
    (STEP.format("ramps = 0.1"), "bounds_steps.0.ramps", "ramp"),
    (STEP.format("forces = [0.0, 1.0]"), "bounds_steps.0.forces", "force"),
    (STEP.format("velocities = [0.0, 1.0]"), "bounds_steps.0.velocities", "velocity"),
    (STEP.format("force.zz = [0.0, 1.0]"), "bounds_steps.0.force.zz", "z"),
    (STEP.format("velocity.zz = [0.0, 1.0]"), "bounds_steps.0.velocity.zz", "z"),
    ("[[bounds_step]]\ntime = 1.0", "bounds_step", "bounds_steps"),
]


@pytest.mark.parametrize(("text", "key", "near"), UNKNOWN, ids=[key for _, key, _ in UNKNOWN])
def test_an_unknown_key_is_told_with_the_nearest_one(text, key, near, write):
    error = refused(text, write)
    assert error.key == key
    assert f"unknown key, did you mean '{near}'?" in error.reason


# --- wrong values --------------------------------------------------------------------------------

WRONG = [
    # a band is an interval or a table of intervals, nothing else
    ("controller.bounds.force = 3.0", "controller.bounds.force"),
    ("controller.bounds.force = true", "controller.bounds.force"),
    ("controller.bounds.force = 'soft'", "controller.bounds.force"),
    ("controller.bounds.force = [1.0]", "controller.bounds.force.1"),
    ("controller.bounds.force = ['a', 1.0]", "controller.bounds.force.0"),
    ("controller.bounds.force = [[-1.0, 1.0]]", "controller.bounds.force.0"),
    ("controller.bounds.force = [nan, 1.0]", "controller.bounds.force.0"),
    ("controller.bounds.force.y = 3.0", "controller.bounds.force.y"),
    ("controller.bounds.force.y = [1.0]", "controller.bounds.force.y.1"),
    ("controller.bounds.force.y = ['a', 3.0]", "controller.bounds.force.y.0"),
    ("controller.bounds.force.y = [nan, 3.0]", "controller.bounds.force.y.0"),
    ("controller.bounds.force = {z = [1.0, 2.0], x = 3}", "controller.bounds.force.x"),
    ("controller.bounds.command = 20", "controller.bounds.command"),
    ("controller.bounds.command.x = [-1.0, 'b']", "controller.bounds.command.x.1"),
    ("controller.bounds.rate = false", "controller.bounds.rate"),
    ("controller.bounds.velocity = {x = [0.0]}", "controller.bounds.velocity.x.1"),
    # margins
    ("controller.bounds.force_margin = -1.0", "controller.bounds.force_margin"),
    ("controller.bounds.force_margin = inf", "controller.bounds.force_margin"),
    ("controller.bounds.force_margin = nan", "controller.bounds.force_margin"),
    ("controller.bounds.velocity_margin = 'a'", "controller.bounds.velocity_margin"),
    # tangential, joints, order, largest_error
    ("controller.bounds.tangential = 3.0", "controller.bounds.tangential"),
    ("controller.bounds.tangential.limit = -1.0", "controller.bounds.tangential.limit"),
    ("controller.bounds.tangential.limit = nan", "controller.bounds.tangential.limit"),
    ("controller.bounds.tangential.friction = inf", "controller.bounds.tangential.friction"),
    ("controller.bounds.tangential.friction = -0.1", "controller.bounds.tangential.friction"),
    ("controller.bounds.tangential.facets = 2", "controller.bounds.tangential.facets"),
    ("controller.bounds.tangential.facets = 65", "controller.bounds.tangential.facets"),
    ("controller.bounds.tangential.facets = 8.0", "controller.bounds.tangential.facets"),
    ("controller.bounds.joints = 1.0", "controller.bounds.joints"),
    ("controller.bounds.joints.speed = 0.0", "controller.bounds.joints.speed"),
    ("controller.bounds.joints.speed = 'a'", "controller.bounds.joints.speed"),
    ("controller.bounds.joints.torque = -1.0", "controller.bounds.joints.torque"),
    ("controller.bounds.joints.torque = nan", "controller.bounds.joints.torque"),
    ("controller.bounds.order = 'force'", "controller.bounds.order"),
    ("controller.bounds.order = []", "controller.bounds.order"),
    ("controller.bounds.order = [1, 2]", "controller.bounds.order.0"),
    ("controller.bounds.order = ['force', 'velocity']", "controller.bounds.order"),
    (
        "controller.bounds.order = "
        "['force', 'force', 'velocity', 'tangential', 'joint_speed']",
        "controller.bounds.order",
    ),
    (
        "controller.bounds.order = "
        "['joint_torque', 'joint_speed', 'velocity', 'tangential', 'force', 'force']",
        "controller.bounds.order",
    ),
    (
        "controller.bounds.order = "
        "['joint_torque', 'joint_speed', 'velocity', 'tangential', 'forces']",
        "controller.bounds.order.4",
    ),
    ("controller.bounds.largest_error = 0.0", "controller.bounds.largest_error"),
    ("controller.bounds.largest_error = inf", "controller.bounds.largest_error"),
    # the solver's limits
    ("controller.solver = 3", "controller.solver"),
    ("controller.solver.max_iterations = 0", "controller.solver.max_iterations"),
    ("controller.solver.max_iterations = 1.5", "controller.solver.max_iterations"),
    ("controller.solver.max_iterations = 'a'", "controller.solver.max_iterations"),
    ("controller.solver.time_limit = 0.0", "controller.solver.time_limit"),
    ("controller.solver.time_limit = inf", "controller.solver.time_limit"),
    ("controller.solver.deadline = 0.0", "controller.solver.deadline"),
    ("controller.solver.deadline = 'soon'", "controller.solver.deadline"),
    ("controller.solver.time_limit = 'a'", "controller.solver.time_limit"),
    # changes of bounds
    ("bounds_steps = 3", "bounds_steps"),
    ("bounds_steps = [3]", "bounds_steps.0"),
    ("bounds_steps = {time = 1.0}", "bounds_steps"),
    ("bounds_steps = [{force = [-1.0, 1.0]}]", "bounds_steps.0.time"),
    ("bounds_steps = [{time = 0.0}]", "bounds_steps.0.time"),
    ("bounds_steps = [{time = 'a'}]", "bounds_steps.0.time"),
    ("bounds_steps = [{time = inf}]", "bounds_steps.0.time"),
    (STEP.format("ramp = -0.1"), "bounds_steps.0.ramp"),
    (STEP.format("ramp = nan"), "bounds_steps.0.ramp"),
    (STEP.format("ramp = 'a'"), "bounds_steps.0.ramp"),
    (STEP.format("command = [-1.0, 1.0]"), "bounds_steps.0.command"),
    (STEP.format("force = 1.0"), "bounds_steps.0.force"),
    (STEP.format("force = 'a'"), "bounds_steps.0.force"),
    (STEP.format("force = [1.0]"), "bounds_steps.0.force.1"),
    (STEP.format("force = ['a', 1.0]"), "bounds_steps.0.force.0"),
    (STEP.format("force = [nan, 1.0]"), "bounds_steps.0.force.0"),
    (STEP.format("force.z = 1.0"), "bounds_steps.0.force.z"),
    (STEP.format("force.z = ['a', 1.0]"), "bounds_steps.0.force.z.0"),
    (STEP.format("force.z = [nan, 1.0]"), "bounds_steps.0.force.z.0"),
    (STEP.format("velocity = true"), "bounds_steps.0.velocity"),
    (STEP.format("velocity.x = {}"), "bounds_steps.0.velocity.x"),
    # values that do not fit one another
    ("controller.bounds.force = [3.0, 2.0]", "controller.bounds.force"),
    ("controller.bounds.force = [0.0, 1.0]", "setpoint.y"),
    ("controller.bounds.velocity = [0.1, 0.2]", "controller.bounds.velocity"),
    ("controller.bounds.rate = [inf, inf]", "controller.bounds.rate"),
    (
        "controller.bounds.velocity_margin = 0.2\ncontroller.bounds.velocity = [-0.1, 0.1]",
        "controller.bounds.velocity",
    ),
    (
        "controller.bounds.force_margin = 11.0\ncontroller.bounds.force = [-20.0, 1.0]",
        "controller.bounds.force",
    ),
    ("controller.bounds.tangential.friction = 0.5", "controller.bounds.tangential.friction"),
    ("axes = ['x', 'z']\ncontroller.bounds.tangential.limit = 1.0", "controller.bounds.tangential"),
    (STEP.format("force = [2.0, 1.0]"), "bounds_steps.0.force"),
    (STEP.format("velocity = [0.1, 0.2]"), "bounds_steps.0.velocity"),
    (
        f"controller.bounds.velocity_margin = 0.2\n{STEP.format('velocity = [-0.1, 0.1]')}",
        "bounds_steps.0.velocity",
    ),
    (
        "bounds_steps = [{time = 2.0, force = [-1.0, 1.0]}, {time = 1.0, force = [-1.0, 1.0]}]",
        "bounds_steps",
    ),
    ("cell.contact.gap = 0.01", "cell.contact.gap"),
    ("cell.contact.gap = 0.2\ncell.contact.unilateral = true", "cell.contact.gap"),
    ("cell.contact.unilateral = 1", "cell.contact.unilateral"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "key"), WRONG, ids=[text.replace("\n", "; ") for text, _ in WRONG]
)
def test_a_wrong_value_is_one_line_about_its_key(text, key, write):
    assert refused(text, write).key == key


def test_a_margin_on_velocity_that_leaves_no_room_is_told_as_the_margin(write):
    text = "controller.bounds.velocity_margin = 0.2\ncontroller.bounds.velocity = [-0.1, 0.1]"
    assert "margin" in refused(text, write).reason


THREE = "[-1.0, 0.0, 1.0]"


@pytest.mark.parametrize(
    ("text", "key"),
    [
        (f"controller.bounds.force = {THREE}", "controller.bounds.force"),
        (f"controller.bounds.command = {THREE}", "controller.bounds.command"),
        (STEP.format(f"force.z = {THREE}"), "bounds_steps.0.force.z"),
        ("motion.force_rms = [1.0, 1.0, 1.0, 1.0]", "motion.force_rms"),
    ],
)
def test_too_many_values_are_told_in_plain_words(text, key, write):
    assert refused(text, write).key == key


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ("controller.bounds.force.y = [3.0, 2.0]", "controller.bounds.force.y"),
        ("controller.bounds.velocity.z = [0.1, 0.2]", "controller.bounds.velocity.z"),
        (
            "controller.bounds.force_margin = 9.0\ncontroller.bounds.force.z = [-11.0, 0.0]",
            "controller.bounds.force.z",
        ),
        (STEP.format("force.z = [2.0, 1.0]"), "bounds_steps.0.force.z"),
        (STEP.format("velocity.x = [0.1, 0.2]"), "bounds_steps.0.velocity.x"),
    ],
)
def test_an_interval_of_one_axis_is_told_with_the_axis(text, key, write):
    assert refused(text, write).key == key


def test_an_endless_ramp_is_told(write):
    assert refused(STEP.format("ramp = inf, force = [-9.0, 9.0]"), write).key == (
        "bounds_steps.0.ramp"
    )


@pytest.mark.parametrize("interval", ["[inf, inf]", "[-inf, -inf]"])
def test_an_interval_that_holds_no_number_is_told(interval, write):
    assert refused(STEP.format(f"force.z = {interval}"), write).key.startswith(
        "bounds_steps.0.force"
    )


@pytest.mark.parametrize(
    ("before", "after"), [("[-inf, -9.9]", "[-9.5, -5.0]"), ("[-10.1, inf]", "[-15.0, -12.0]")]
)
def test_bounds_do_not_cross_while_one_ramps_and_the_other_jumps(before, after):
    """Each interval is right; refused before the run, or laid out in another way."""
    settings = [
        f"controller.bounds.force.z={before}",
        f"bounds_steps=[{{time=0.02, ramp=0.01, force={{z={after}}}}}]",
    ]
    with suppress(ScenarioError):
        schedule = Schedule(load_scenario("paper", top={"duration": 0.05}, settings=settings))
        lower, upper = schedule.over("force", 50)
        assert (lower <= upper).all()


def test_the_order_of_axes_does_not_matter_where_nothing_is_tangential(write):
    assert load_scenario(write("axes = ['z', 'x', 'y']")).axes == ("z", "x", "y")


# --- what is read --------------------------------------------------------------------------------


def test_a_band_is_an_interval_or_a_table(write):
    bounds = load_scenario(
        write(
            "[controller.bounds]\nforce = [-20, 15.5]\ncommand.y = [-1, 2.0]\nrate = [-inf, 3]\n"
            "velocity = {x = [-0.1, 0.1], z = [-0.2, inf]}\n"
        )
    ).controller.bounds
    assert bounds.force == (-20.0, 15.5)
    assert bounds.command == PerAxis(y=(-1.0, 2.0))
    assert bounds.rate == (-INF, 3.0)
    assert bounds.velocity == PerAxis((-0.1, 0.1), FREE, (-0.2, INF))


def test_a_bounds_step_has_an_interval_or_a_table_too(write):
    text = """
        [[bounds_steps]]
        time = 0.5
        force = [-20, 5]
        [[bounds_steps]]
        time = 0.5
        ramp = 0.25
        force.z = [-9, inf]
        velocity.x = [-0.1, 0.2]
    """
    assert load_scenario(write(text)).bounds_steps == (
        BoundsStep(0.5, 0.0, (-20.0, 5.0), None),
        BoundsStep(0.5, 0.25, AxesChange(z=(-9.0, INF)), AxesChange(x=(-0.1, 0.2))),
    )


ALL = """
axes = ["x", "y", "z"]
[controller.bounds]
command = {x = [-3, 3]}
rate = [-inf, 5.0]
force = {z = [-20.0, inf]}
force_margin = 0.25
velocity = [-0.4, inf]
velocity_margin = 0.0125
order = ["force", "velocity", "tangential", "joint_speed", "joint_torque"]
largest_error = 12.5
tangential = {limit = 3.5, friction = 0.25, facets = 12}
joints = {speed = 0.5, torque = 0.75}
[controller.solver]
max_iterations = 17
time_limit = 0.0005
deadline = 0.00075
[[bounds_steps]]
time = 0.125
force = [-inf, inf]
[[bounds_steps]]
time = 0.25
ramp = 0.1
force = {z = [-inf, 3.0], x = [-1.0, 1.0]}
velocity = [-0.1, inf]
[cell.contact]
unilateral = true
gap = 0.002
"""


def test_every_key_survives_the_dump_infinities_included(write):
    scenario = load_scenario(write(ALL))
    text = dump_scenario(scenario)
    assert re.search(r"-inf\b", text)
    assert load_scenario(write(text)) == scenario
    bounds = scenario.controller.bounds
    assert bounds.tangential == TangentialConfig(3.5, 0.25, 12)
    assert (bounds.joints.speed, bounds.joints.torque) == (0.5, 0.75)
    assert (bounds.force_margin, bounds.velocity_margin, bounds.largest_error) == (
        0.25, 0.0125, 12.5,
    )  # fmt: skip
    assert bounds.order[0] == "force"
    solver = scenario.controller.solver
    assert (solver.max_iterations, solver.time_limit, solver.deadline) == (17, 0.0005, 0.00075)
    assert scenario.bounds_steps[1].force == AxesChange(x=(-1.0, 1.0), z=(-INF, 3.0))


def test_with_changes_of_bounds_a_later_setpoint_may_lie_outside(write):
    text = "setpoint.steps = [{time = 1.0, z = -30.0}]\ncontroller.bounds.force.z = [-20.0, 0.0]\n"
    assert refused(text, write).key == "setpoint.steps.0.z"
    later = load_scenario(write(text + "bounds_steps = [{time = 1.0, force.z = [-40.0, 0.0]}]"))
    assert later.setpoint.steps[0].z == -30.0
    start = "setpoint.z = -30.0\n" + text.splitlines()[1]
    assert refused(start + "\nbounds_steps = [{time = 1.0}]", write).key == "setpoint.z"
