"""How often, how far and how long bounds were really passed, on logs made by hand."""

from __future__ import annotations

import math

import pytest

from qpmpc.config import BoundsConfig, ControllerConfig, PerAxis
from scenarios import AxesChange, BoundsStep, Log, Scenario, Schedule
from scenarios.metrics import violations

PERIOD, CYCLES = 1e-3, 100
INF = math.inf
NONE = {"count": 0, "worst": 0.0, "integral": 0.0}
START = {
    "force": PerAxis((-8.0, 8.0), (-8.0, 8.0), (-14.0, INF)),
    "velocity": (-0.1, 0.1),
    "command": (-20.0, 20.0),
}


class Case:
    """A log whose figures are inside their bounds until a test changes them."""

    def __init__(self, axes=("x", "y", "z"), steps=(), **bounds):
        self.schedule = Schedule(
            Scenario(
                "test",
                duration=CYCLES * PERIOD,
                axes=axes,
                controller=ControllerConfig(bounds=BoundsConfig(**START | bounds)),
                bounds_steps=steps,
            )
        )
        self.log = Log(CYCLES, axes, ())
        self.log.force[:] = [1.0, 2.0, -10.0]
        self.log.tool_velocity[:] = [0.0, 0.05, -0.05]
        self.log.command[:] = 5.0
        self.log.cycles = CYCLES

    def found(self):
        return violations(self.log, self.schedule, PERIOD)


def test_inside_the_bounds_there_is_none():
    assert Case().found() == {"force": NONE, "velocity": NONE, "command": NONE}


@pytest.mark.parametrize(
    ("name", "column", "bound"),
    [("force", "force", -14.0), ("velocity", "tool_velocity", -0.1), ("command", "command", -20.0)],
)
def test_cycles_worst_and_integral_below(name, column, bound):
    case = Case()
    values = getattr(case.log, column)
    values[10:15, 2] = 1.5 * bound
    values[20, 2] = 2.0 * bound
    expected = {
        "count": 6,
        "worst": pytest.approx(abs(bound)),
        "integral": pytest.approx(PERIOD * abs(bound) * (5 * 0.5 + 1.0)),
    }
    assert case.found() == {"force": NONE, "velocity": NONE, "command": NONE} | {name: expected}


def test_above_counts_like_below_and_a_cycle_counts_once():
    case = Case()
    case.log.force[5, :2] = [9.0, -10.0]
    case.log.force[6, 0] = 8.5
    found = case.found()["force"]
    assert found["count"] == 2
    assert found["worst"] == pytest.approx(2.0)
    assert found["integral"] == pytest.approx(PERIOD * (1.0 + 2.0 + 0.5))


def test_an_infinite_side_is_never_passed():
    case = Case(velocity=(-INF, INF), command=(-INF, 20.0))
    case.log.force[:, 2] = 1e3
    case.log.tool_velocity[:] = 1e3
    case.log.command[:] = -1e3
    assert case.found() == {"force": NONE, "velocity": NONE, "command": NONE}


def test_bounds_that_move_are_taken_as_they_are_at_each_instant():
    case = Case(
        steps=(
            BoundsStep(0.020, ramp=0.010, force=AxesChange(z=(-9.0, INF))),
            BoundsStep(0.060, force=AxesChange(z=(-14.0, INF))),
            BoundsStep(0.080, velocity=(-0.02, 0.1)),
        )
    )
    # -10 N is passed on the ramp, from -9.5 N at instant 29 on, until the bound steps back.
    found = case.found()
    assert found["force"] == {
        "count": 31, "worst": pytest.approx(1.0), "integral": pytest.approx(PERIOD * (30 + 0.5)),
    }  # fmt: skip
    assert found["velocity"] == {
        "count": 20, "worst": pytest.approx(0.03), "integral": pytest.approx(PERIOD * 20 * 0.03),
    }  # fmt: skip


def test_only_the_axes_under_control_count_each_against_its_own_bound():
    case = Case(axes=("z", "x"), command=PerAxis(x=(-3.0, 3.0), z=(-20.0, 20.0)))
    case.log.force[:, 1] = 99.0
    case.log.tool_velocity[:, 1] = 9.0
    case.log.command[:, 0], case.log.command[:, 1] = 19.0, 2.0
    assert case.found() == {"force": NONE, "velocity": NONE, "command": NONE}
    case.log.force[3, 0] = 9.0
    case.log.force[4, 2] = -15.0
    case.log.command[7, 1] = -4.0
    found = case.found()
    assert (found["force"]["count"], found["command"]["count"]) == (2, 1)
    assert found["command"]["worst"] == pytest.approx(1.0)


def test_margins_are_the_controllers_own_affair():
    case = Case(force_margin=3.0, velocity_margin=0.08)
    case.log.force[:, 2], case.log.tool_velocity[:, 0] = -13.5, 0.09
    assert case.found() == {"force": NONE, "velocity": NONE, "command": NONE}


def test_the_true_force_counts_not_what_the_sensor_reads():
    case = Case()
    case.log.force_measured[:] = 1e3
    assert case.found()["force"] == NONE


def test_rounding_is_no_violation():
    case = Case()
    for values, bound in ((case.log.force, -14.0), (case.log.tool_velocity, -0.1)):
        values[:, 2] = bound * (1 + 1e-12)
    case.log.command[:] = -20.0 * (1 + 1e-12)
    assert case.found() == {"force": NONE, "velocity": NONE, "command": NONE}
    case.log.force[0, 2] = -14.0 * (1 + 1e-5)
    assert case.found()["force"]["count"] == 1


@pytest.mark.parametrize("other", [14.0, INF])
def test_rounding_at_a_bound_of_zero_is_no_violation(other):
    case = Case(command=(0.0, other), force=PerAxis(z=(-other, 0.0)))
    case.log.command[:] = -1e-15
    case.log.force[:, 2] = 1e-14
    assert case.found()["force"] == NONE
    assert case.found()["command"] == NONE


@pytest.mark.parametrize("rows", [0, 30])
def test_cycles_that_were_not_reached_do_not_count(rows):
    case = Case()
    case.log.force[:, 2] = -20.0
    case.log.cycles = rows
    assert case.found()["force"]["count"] == rows
    assert case.found()["velocity"] == NONE
