"""The bounds over a run, step by step against a plain reading of the scenario."""

from __future__ import annotations

import math

import numpy as np
import pytest

from qpmpc.config import BoundsConfig, ControllerConfig, PerAxis
from scenarios import AxesChange, BoundsStep, Scenario, ScenarioError, Schedule

PERIOD, CYCLES, HORIZON = 1e-3, 40, 5
INF = math.inf
FORCE = PerAxis(x=(-8.0, 8.0), z=(-20.0, INF))


def schedule(*steps, axes=("x", "y", "z"), horizon=HORIZON, **bounds) -> Schedule:
    """The schedule of 40 cycles of 1 ms under steps (time, {...}) and bounds by name."""
    return Schedule(
        Scenario(
            "test",
            duration=CYCLES * PERIOD,
            axes=axes,
            controller=ControllerConfig(
                horizon=horizon, bounds=BoundsConfig(**{"force": FORCE} | bounds)
            ),
            bounds_steps=tuple(BoundsStep(time, **change) for time, change in steps),
        )
    )


def test_without_steps_the_bounds_are_the_configured_ones():
    made = schedule(velocity=(-0.4, 0.5), command=PerAxis(y=(-3.0, 4.0)))
    expected = {
        "force": ([-8.0, -INF, -20.0], [8.0, INF, INF]),
        "velocity": ([-0.4] * 3, [0.5] * 3),
        "command": ([-INF, -3.0, -INF], [INF, 4.0, INF]),
    }
    for name, sides in expected.items():
        for got, want in zip(made.over(name, CYCLES), sides, strict=True):
            assert np.array_equal(got, np.tile(want, (CYCLES, 1)))
    assert made.moving == ()
    assert not made.due.any()
    assert made.due.shape == (CYCLES,)
    assert [side.tolist() for side in made.first_command] == list(expected["command"])


def test_columns_are_the_axes_in_their_order():
    made = schedule((0.01, {"force": AxesChange(x=(-1.0, 1.0))}), axes=("z", "x"))
    lower, upper = made.over("force", CYCLES)
    assert (lower[0].tolist(), upper[0].tolist()) == ([-20.0, -8.0], [INF, 8.0])
    assert (lower[-1].tolist(), upper[-1].tolist()) == ([-20.0, -1.0], [INF, 1.0])


def test_a_step_holds_from_its_time_and_for_the_axes_that_it_names():
    made = schedule(
        (0.010, {"force": AxesChange(z=(-9.0, INF))}),
        (0.020, {"velocity": (-0.1, 0.2)}),
        (0.0304, {"force": (-2.0, 3.0)}),  # 30.4 ms: to the nearest instant
    )
    lower, upper = made.over("force", CYCLES)
    assert lower[:, 2].tolist() == [-20.0] * 10 + [-9.0] * 20 + [-2.0] * 10
    assert upper[:, 2].tolist() == [INF] * 30 + [3.0] * 10
    assert lower[:, 0].tolist() == [-8.0] * 30 + [-2.0] * 10
    assert upper[:, 1].tolist() == [INF] * 30 + [3.0] * 10
    lower, upper = made.over("velocity", CYCLES)
    assert lower.tolist() == [[-INF] * 3] * 20 + [[-0.1] * 3] * 20
    assert upper.tolist() == [[INF] * 3] * 20 + [[0.2] * 3] * 20
    assert made.moving == ("force", "velocity")


def test_a_ramp_is_a_straight_line_between_finite_values():
    made = schedule((0.010, {"ramp": 0.004, "force": AxesChange(z=(-9.0, INF), x=(-8.0, 0.0))}))
    lower, upper = made.over("force", CYCLES)
    assert lower[8:16, 2] == pytest.approx([-20, -20, -20, -17.25, -14.5, -11.75, -9, -9])
    assert upper[8:16, 0] == pytest.approx([8, 8, 8, 6, 4, 2, 0, 0])
    assert (lower[:, 0] == -8.0).all()
    assert (upper[:, 2] == INF).all()


@pytest.mark.parametrize(
    ("before", "after"), [((-20.0, INF), (-INF, 5.0)), ((-INF, 5.0), (-20.0, INF))]
)
def test_to_and_from_infinity_there_is_no_ramp(before, after):
    made = schedule((0.010, {"ramp": 0.010, "force": after}), force=before, axes=("z",))
    for side, old, new in zip(made.over("force", CYCLES), before, after, strict=True):
        assert side[:, 0].tolist() == [old] * 10 + [new] * 30


def test_a_step_in_the_middle_of_a_ramp_starts_from_where_it_is():
    made = schedule(
        (0.010, {"ramp": 0.010, "force": AxesChange(z=(-10.0, INF))}),
        (0.015, {"ramp": 0.005, "force": AxesChange(z=(-20.0, INF))}),
    )
    z = made.over("force", CYCLES)[0][:, 2]
    assert z[[10, 12, 15]] == pytest.approx([-20, -18, -15])
    assert z[15:22] == pytest.approx([-15, -16, -17, -18, -19, -20, -20])


def test_a_step_without_an_interval_changes_nothing():
    made = schedule((0.010, {"ramp": 0.01}), (0.020, {"force": AxesChange()}))
    assert made.moving == ()
    assert np.array_equal(made.over("force", 1)[0][0], made.over("force", CYCLES)[0][-1])


@pytest.mark.parametrize("horizon", [1, 5])
def test_the_preview_is_of_the_horizon_that_begins_with_the_next_instant(horizon):
    made = schedule((0.010, {"ramp": 0.004, "force": AxesChange(z=(-9.0, INF))}), horizon=horizon)
    everything = made.over("force", CYCLES + horizon)
    for k in range(CYCLES):
        for got, whole in zip(made.preview("force", k), everything, strict=True):
            assert got.shape == (horizon, 3)
            assert np.array_equal(got, whole[k + 1 : k + 1 + horizon])


def test_a_step_after_the_run_is_previewed_only_and_one_far_after_it_not_at_all():
    near = schedule((0.042, {"force": AxesChange(z=(-9.0, INF))}))
    assert near.over("force", CYCLES)[0][:, 2].tolist() == [-20.0] * CYCLES
    assert near.preview("force", CYCLES - 1)[0][:, 2].tolist() == [-20.0] * 2 + [-9.0] * 3
    for far in (0.05, 7.0, 1e9):
        made = schedule((far, {"ramp": 1e6, "force": (-9.0, 9.0), "velocity": (-1.0, 1.0)}))
        assert made.preview("force", CYCLES - 1)[0][:, 2].tolist() == [-20.0] * HORIZON
        assert not made.due.any()
        assert made.moving == ("force", "velocity")  # its rows are kept all the same


def test_a_ramp_that_outlives_the_run_is_cut_off():
    made = schedule((0.035, {"ramp": 0.1, "force": AxesChange(z=(-10.0, INF))}))
    lower = made.preview("force", CYCLES - 1)[0][:, 2]
    assert lower == pytest.approx([-19.5, -19.4, -19.3, -19.2, -19.1])


def test_a_step_before_the_first_instant_is_there_from_the_start():
    made = schedule((0.0004, {"force": AxesChange(z=(-9.0, INF))}))
    assert (made.over("force", CYCLES)[0][:, 2] == -9.0).all()
    assert made.due[0]  # the controller was set up with the configured bounds


CHANGES = {
    "step": [(0.010, {"force": AxesChange(z=(-9.0, INF))})],
    "ramp": [(0.010, {"ramp": 0.004, "force": AxesChange(z=(-9.0, INF))})],
    "two": [(0.010, {"force": (-9.0, 9.0)}), (0.025, {"ramp": 0.003, "velocity": (-1.0, 1.0)})],
    "early": [(0.002, {"velocity": (-0.1, 0.1)})],
    "first": [(0.0004, {"velocity": (-0.1, 0.1)})],
    "late": [(0.042, {"ramp": 0.5, "force": AxesChange(z=(-9.0, INF))})],
    "equal": [(0.010, {"ramp": 0.005, "force": AxesChange(z=(-20.0, INF))})],
}


def differs(made: Schedule) -> np.ndarray:
    """Whether the preview of each cycle is another than the one that was moved to last."""
    found = np.zeros(CYCLES, dtype=bool)
    start = {"force": schedule().preview("force", 0), "velocity": (-INF, INF)}
    for k in range(CYCLES):
        for name in ("force", "velocity"):
            before = made.preview(name, k - 1) if k else start[name]
            for now, then in zip(made.preview(name, k), before, strict=True):
                found[k] |= not np.array_equal(now, np.broadcast_to(then, now.shape))
    return found


@pytest.mark.parametrize("steps", CHANGES.values(), ids=CHANGES)
def test_whoever_moves_the_bounds_when_due_has_the_right_preview(steps):
    made, kept = schedule(*steps), {}
    for k in range(CYCLES):
        for name in ("force", "velocity"):
            now = [side.copy() for side in made.preview(name, k)]
            if made.due[k] and name in made.moving:
                kept[name] = now
            start = schedule().preview(name, 0)
            for got, want in zip(kept.get(name, start), now, strict=True):
                assert np.array_equal(got, want), (name, k)


@pytest.mark.parametrize("steps", CHANGES.values(), ids=CHANGES)
def test_due_is_true_exactly_where_the_preview_differs(steps):
    made = schedule(*steps)
    assert np.array_equal(made.due, differs(made))


def test_steps_that_together_cross_are_told_with_their_time():
    """Each interval is right; the lower side jumps from infinity while the upper one ramps."""
    with pytest.raises(
        ScenarioError, match=r"bounds_steps: .*force cross.* t = 0\.010 s"
    ) as caught:
        schedule((0.010, {"ramp": 0.010, "force": (-9.5, -5.0)}), force=(-INF, -9.9))
    assert "\n" not in str(caught.value)


def test_a_ramp_keeps_room_for_the_margins():
    bounds = {"force": (-INF, -9.0), "force_margin": 0.5}
    with pytest.raises(ScenarioError, match="force_margin"):
        schedule((0.010, {"ramp": 0.010, "force": (-9.5, -5.0)}), **bounds)
    schedule((0.010, {"force": (-9.5, -5.0)}), **bounds)
