"""The guard: what it trips on, and when; what becomes of the tool; what holds whatever comes.

``make test-hostile`` runs the property on 10,000 sequences, the suite on a sample of them.
"""

from __future__ import annotations

import ctypes
import math
from dataclasses import fields, replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from plant import Cause, PlantError, ProtectionConfig, force_cap
from plant.cell import heart_programme
from plant.memory import layout, struct_text
from plant.viper import VIPER_S650
from scenarios.physics import physics_loop

from . import hostile

PERIOD, STEP, K, K2 = 1e-3, 1.25e-4, 2500.0, 20.0
ASIDE, BACK, UP = np.eye(3)
DOWN = -UP


def until_trip(cell, command):
    """Run until the protection trips, at most to the end; return what it tells."""
    for k in range(cell.cycles):
        cell.measure()
        cell.apply(command(k) if callable(command) else command)
        if cell.truth().trip:
            break
    return cell.truth().trip


def go_on(cell, command, cycles):
    """Run on; return the tip, its velocity, true force, and joint angles, one row a cycle."""
    rows = []
    for _ in range(cycles):
        measured, truth = cell.measure(), cell.truth()
        rows.append(
            np.concatenate(
                [measured.position, measured.velocity, truth.force, cell.data.qpos[6:12].copy()]
            )
        )
        cell.apply(command)
    tip, velocity, force, joints = np.split(np.array(rows), [3, 6, 9], axis=1)
    return tip, velocity, force, joints


# --- what it trips on, and when ------------------------------------------------------------------

TRIPPING = {
    Cause.JOINT_SPEED: ({"joint_speed": 0.1}, 10.0 * UP),
    Cause.TIP_SPEED: ({"tip_speed": 0.2}, 10.0 * UP),
    Cause.TRACKING_VELOCITY: ({"tracking_velocity": 0.1, "delay": 2}, 150.0 * ASIDE),
    Cause.TRACKING_ORIENTATION: (
        {"tracking_orientation": 1e-3, "tracking_velocity": 9.0},
        199.0 * ASIDE,
    ),
    Cause.TRACKING_HEART: ({"tracking_heart": 1e-4}, 10.0 * DOWN),
    Cause.FORCE: ({"force": 20.0}, 10.0 * DOWN),
}
"""What leads to each cause but those of the joint range and the heartbeat."""


class Witness:
    """Sees every physics step, and reckons by itself what is watched there."""

    def __init__(self, cell, motion, config, command):
        self.cell, self.config, self.command = cell, config, command
        self.angles = heart_programme(config, motion).angles
        self.found = {cause: [] for cause in TRIPPING}
        self.before = cell.data.site("tool_tip").xpos.copy()
        self.held = cell.data.site("tool_tip").xmat.reshape(3, 3).copy()
        self.expected = np.zeros(3)

    def step1(self, model, data):
        mujoco.mj_step1(model, data)
        i = len(self.found[Cause.FORCE])
        tip, surface = data.site("tool_tip"), data.site("heart_surface").xpos
        velocity = (tip.xpos - self.before) / STEP
        self.before = tip.xpos.copy()
        acts = i // 8 >= self.config.imperfections.delay
        self.expected += (1 - math.exp(-K2 * STEP)) * (self.command * acts / K2 - self.expected)
        k, share = i // 8, (i % 8 + 1) / 8
        heart = (1 - share) * self.angles[k] + share * self.angles[k + 1]
        cosine = (np.trace(self.held.T @ tip.xmat.reshape(3, 3)) - 1) / 2
        rated = VIPER_S650.joint_speed.si
        for cause, value in (
            (Cause.JOINT_SPEED, (np.abs(data.qvel[6:12]) / rated).max()),
            (Cause.TIP_SPEED, np.linalg.norm(velocity)),
            (Cause.TRACKING_VELOCITY, np.linalg.norm(velocity - self.expected)),
            (Cause.TRACKING_ORIENTATION, math.acos(min(cosine, 1.0))),
            (Cause.TRACKING_HEART, np.abs(data.qpos[:6] - heart).max()),
            (Cause.FORCE, K * np.linalg.norm(tip.xpos - surface)),
        ):
            self.found[cause].append(float(value))


@pytest.mark.parametrize(
    "case", [(cause, joints) for cause in TRIPPING for joints in (0.0, 60.0)], ids=str
)
def test_it_trips_after_the_very_step_that_passes_a_limit(
    case, realistic, make_cell, beating, monkeypatch
):
    """With flexible joints, the step in which the links pass it, wherever the motors are."""
    cause, joints = case
    changes, command = TRIPPING[cause]
    config, motion = realistic(joint_frequency=joints, **changes), beating(200)
    cell = make_cell(config, motion)
    witness = Witness(cell, motion, config, command)
    monkeypatch.setattr(
        "plant.stepping.mujoco", SimpleNamespace(mj_step1=witness.step1, mj_step2=mujoco.mj_step2)
    )
    trip = until_trip(cell, command)
    assert trip is not None
    assert trip.cause is cause
    n = round(trip.time / STEP)
    assert trip.time == pytest.approx(n * STEP, abs=1e-12)
    for watched, values in witness.found.items():
        beyond = np.array(values[:n]) > getattr(config.protection, watched)
        assert list(np.flatnonzero(beyond)) == ([n - 1] if watched is cause else [])
    if cause is Cause.JOINT_SPEED:
        rated = VIPER_S650.joint_speed.si
        assert trip.limit == pytest.approx(0.1 * rated[trip.joint - 1])
    else:
        assert trip.limit == pytest.approx(changes[cause])
        assert trip.value == pytest.approx(witness.found[cause][n - 1], rel=1e-6)
    assert trip.value > trip.limit
    assert (trip.joint is not None) == (cause in (Cause.JOINT_SPEED, Cause.TRACKING_HEART))


@pytest.mark.parametrize(
    "case", [(8.0 * UP, 0.3), (8.0 * ASIDE, 0.3), (8.0 * ASIDE, 0.0)], ids=["up", "aside", "none"]
)
def test_a_joint_stops_before_the_margin_of_its_range(case, realistic, make_cell, still, library):
    direction, margin = case
    config = realistic(joint_margin=margin, unilateral=True, gap=0.01)
    cell = make_cell(config, still(3000), library=library)
    trip, joint = until_trip(cell, direction), 5
    assert (trip.cause, trip.joint) == (Cause.JOINT_RANGE, joint)
    end = VIPER_S650.upper[joint - 1] - margin
    assert trip.limit == pytest.approx(end)
    at_trip = cell.data.qpos[6 + joint - 1]
    joints = go_on(cell, direction, 500)[3][:, joint - 1]
    assert at_trip < end
    assert joints.max() < end
    assert joints.max() > at_trip + 5e-4  # it had to be stopped, and not at once
    assert joints.max() > end - 0.1


@pytest.mark.parametrize("missed", [0, 1, 5])
@pytest.mark.parametrize(
    "command",
    [None, *(np.array([0.0, x, 1.0]) for x in (np.nan, np.inf, -np.inf, 1e300, 51.0, -51.0))],
    ids=str,
)
def test_a_silent_or_raving_controller_trips_the_heartbeat(
    command, missed, realistic, make_cell, still
):
    cell = make_cell(realistic(heartbeat=missed, command=50.0), still(30))
    start = 7
    trip = until_trip(cell, lambda k: command if k >= start else np.full(3, 2.0))
    assert trip.cause is Cause.HEARTBEAT
    assert trip.time == pytest.approx((start + missed) * PERIOD, abs=1e-12)
    assert (trip.value, trip.limit) == (missed + 1, missed)


def test_one_command_in_time_is_a_heartbeat(realistic, make_cell, still):
    cell = make_cell(realistic(heartbeat=3, command=5.0), still(100))
    assert until_trip(cell, lambda k: None if k % 4 else np.full(3, 5.0) * (-1) ** (k // 4)) is None


@pytest.mark.parametrize("protected", [True, False])
def test_where_no_command_came_the_last_one_goes_on(
    protected, realistic, make_cell, beating, drive
):
    config = realistic(enabled=protected, heartbeat=60)
    told = drive(make_cell(config, beating(50)), 1.5)
    cell = make_cell(config, beating(50))
    for k in range(50):
        measured = cell.measure()
        assert np.array_equal(measured.velocity, told.velocity[k])
        cell.apply(np.full(3, 1.5) if k == 0 else None)


def test_without_protection_nothing_trips(realistic, make_cell, still):
    cell = make_cell(realistic(enabled=False, unilateral=True), still(150))
    assert until_trip(cell, 150.0 * DOWN) is None
    assert cell.measure().force[2] < -3.0 * force_cap(realistic(), 0.0)


def test_every_key_is_tested_here():
    """By its effect: causes above, the others by name."""
    others = {"enabled", "joint_margin", "heartbeat", "command", "retraction", "retraction_speed"}
    assert {f.name for f in fields(ProtectionConfig)} == others | {str(c) for c in TRIPPING}


def test_brakes_let_the_guard_rest(realistic, make_cell, beating, drive):
    cell = make_cell(realistic(force=11.0), beating(300))
    cell.close_brakes()
    trace = drive(cell, 100.0)
    assert np.abs(trace.force).max() > 11.5
    assert cell.truth().trip is None


# --- what becomes of the tool --------------------------------------------------------------------


@pytest.mark.parametrize("unilateral", [False, True])
@pytest.mark.parametrize("way", [(0.01, 0.25), (0.03, 0.1), (0.05, 0.25)], ids=str)
def test_the_tool_is_taken_off_the_tissue_and_held(way, unilateral, realistic, make_cell, still):
    distance, speed = way
    config = realistic(retraction=distance, retraction_speed=speed, unilateral=unilateral)
    cell = make_cell(config, still(1500), library=physics_loop(6).binary)
    trip = until_trip(cell, 10.0 * DOWN)
    assert trip.cause is Cause.FORCE
    tissue = cell.truth().tissue
    tip, velocity, force, joints = go_on(cell, 10.0 * DOWN, 1000)
    height = tip[:, 2] - tissue[2]
    assert distance < height[-1] < distance + 0.01
    assert np.abs(tip[:, :2] - tip[0, :2]).max() < 3e-3  # along the normal
    assert velocity[:, 2].max() < 1.25 * speed
    travel = distance - height[0]
    arrived = int(np.argmax(height > distance))
    assert 0.9 * travel / speed < arrived * PERIOD < 1.4 * travel / speed + 0.03
    assert force[:, 2].max() < 0.5  # nothing glues it to the tissue any more
    assert not force[-1].any()
    assert np.ptp(joints[-300:], axis=0).max() < 1e-5
    assert cell.data.eq_active[:6].all()


def test_it_is_taken_away_along_the_normal_of_the_tissue(realistic, make_cell, still, library):
    """The pad's normal at the trip, wherever it points: here it is told otherwise."""
    cell = make_cell(realistic(), still(600), library=library)
    until_trip(cell, None)
    block = cell._guard._block
    np.testing.assert_allclose(block["normal"], UP, atol=1e-3)
    np.testing.assert_allclose(
        block["normal"], cell.data.site("heart_surface").xmat[2::3], atol=1e-6
    )
    tilted = np.array([0.6, 0.0, 0.8])
    block["normal"] = tilted
    tip = go_on(cell, None, 500)[0]
    way = tip[-1] - tip[0]
    assert way @ tilted > 0.03
    assert np.linalg.norm(way - (way @ tilted) * tilted) < 3e-3


@pytest.mark.parametrize("joint", [1, 2, 4])
def test_a_joint_at_its_end_does_not_keep_the_tool_on_the_tissue(
    joint, realistic, make_cell, still, library
):
    cell = make_cell(realistic(), still(900), library=library)
    until_trip(cell, 10.0 * DOWN)
    block, start = cell._guard._block, cell.data.qpos[6:12].copy()
    block["goal_upper"][joint] = block["goal_lower"][joint] = start[joint]
    tip, _, force, joints = go_on(cell, None, 600)
    assert tip[-1, 2] - tip[0, 2] > 0.03
    assert not force[-1].any()
    assert np.abs(joints[:, joint] - start[joint]).max() < 0.02
    assert cell.data.eq_active[:6].all()


def test_a_tool_in_the_air_is_only_stopped(realistic, make_cell, still, library):
    config = realistic(unilateral=True, gap=0.05, tip_speed=0.2)
    cell = make_cell(config, still(500), library=library)
    assert until_trip(cell, 10.0 * ASIDE).cause is Cause.TIP_SPEED
    tip = go_on(cell, 10.0 * ASIDE, 300)[0]
    assert np.linalg.norm(tip[-1] - tip[0]) < 5e-3
    assert cell.data.eq_active[:6].all()


@pytest.mark.parametrize("compiled", [False, True])
def test_nothing_that_is_sent_after_a_trip_has_an_effect(
    compiled, realistic, make_cell, beating, request
):
    library = request.getfixturevalue("library") if compiled else None
    runs = []
    for later in (None, 150.0 * DOWN, np.full(3, np.nan)):
        cell = make_cell(realistic(delay=3), beating(400), library=library)
        trip = until_trip(cell, 10.0 * DOWN)
        runs.append(np.hstack(go_on(cell, later, 250)))
        assert cell.truth().trip == trip  # latched
    assert np.array_equal(runs[0], runs[1])
    assert np.array_equal(runs[0], runs[2])


def test_a_new_start_clears_a_trip(realistic, make_cell, beating, drive):
    config, place = realistic(model="ideal"), np.array([0.0, 0.0, -4e-3])
    cell = make_cell(config, beating(400))
    cell.move_tool(place)
    fresh = drive(cell, 0.5, cycles=100)
    cell.move_tool(place)
    assert until_trip(cell, 10.0 * DOWN)
    go_on(cell, None, 250)
    assert cell.data.eq_active[:6].all()
    cell.move_tool(place)
    assert cell.truth().trip is None
    assert drive(cell, 0.5, cycles=100).equals(fresh)


def test_the_peak_of_the_force_is_that_of_all_physics_steps(
    realistic, make_cell, still, monkeypatch
):
    cell = make_cell(realistic(damping=10.0), still(30))
    sizes = []

    def step1(model, data):
        mujoco.mj_step1(model, data)
        along = data.actuator_length[12:] * K + 10.0 * data.actuator_velocity[12:]
        sizes.append(np.linalg.norm(along))

    monkeypatch.setattr(
        "plant.stepping.mujoco", SimpleNamespace(mj_step1=step1, mj_step2=mujoco.mj_step2)
    )
    for k in range(30):
        cell.measure()
        assert cell.truth().force_peak == pytest.approx(max(sizes[-8:], default=0.0))
        cell.apply(20.0 * UP * (-1) ** (k // 3))


# --- the loop in C -------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", [hostile.some_config, hostile.flawed_config])
@pytest.mark.parametrize("seed", range(3))
def test_the_compiled_loop_is_the_loop_in_python_bit_for_bit(seed, kind, library):
    """Under every controller, in cells of every kind, until long after a trip."""
    in_python, in_c = (
        next(hostile.rings(seed, 1, 150, which, config=kind)) for which in (None, library)
    )
    tripped = 0
    for make in hostile.CONTROLLERS:
        runs = []
        for ring in (in_python, in_c):
            rng = np.random.default_rng(seed)
            controller, cell, rows = make(rng), ring.cell, []
            cell.move_tool(ring.start)
            for k in range(150):
                measurement, truth = cell.measure(), cell.truth()
                rows.append([*cell.data.qpos, *cell.data.qvel, *truth.force, truth.force_peak])
                cell.apply(controller(k, measurement))
            runs.append((np.array(rows), cell.truth().trip))
        assert np.array_equal(runs[0][0], runs[1][0]), make.__name__
        assert runs[0][1] == runs[1][1]
        tripped += runs[0][1] is not None
    assert tripped >= 4


@pytest.mark.parametrize("joints", [6, 7])
def test_the_struct_is_the_layout(joints):
    counts, _, *lines, _ = struct_text(joints).splitlines()
    own = layout(joints)
    assert f"JOINTS = {joints} " in counts
    assert len(lines) == len(own.names)
    assert f"  double goal[{joints}];" in lines
    assert f"  double inertia[{joints**2}];" in lines
    assert "  double heart[6];" in lines
    assert "  int64_t substeps;" in lines
    assert "  double *qpos;" in lines
    assert own.itemsize == 8 * sum(math.prod(own[n].shape) for n in own.names)


def test_a_library_of_something_else_is_refused(realistic, make_cell, still):
    with pytest.raises(PlantError, match="advance"):
        make_cell(realistic(), still(3), library=ctypes.CDLL(None))


# --- whatever is sent ----------------------------------------------------------------------------


def test_the_cap_follows_stiffness_speed_and_lag(realistic):
    base = force_cap(realistic(), 0.1)
    assert 30.0 < base < 80.0
    for harder in (realistic(stiffness=3000.0), realistic(damping=10.0), realistic(force=31.0),
                   realistic(tip_speed=0.6), realistic(torque_lag=0.002)):  # fmt: skip
        assert force_cap(harder, 0.1) > base
    assert force_cap(realistic(), 0.2) > base
    slower = replace(realistic(), substeps=2)
    assert force_cap(slower, 0.1) > base
    assert force_cap(realistic(enabled=False), 0.1) == math.inf
    assert force_cap(realistic(stiffness=1e-9), 0.1) == pytest.approx(30.0)


def besiege(seed, count, sequences, cycles, library, *, kind=hostile.some_config):
    """Let every controller loose ``sequences`` times in all, in ``count`` cells."""
    worst, n = hostile.Worst(), 0
    for ring in hostile.rings(seed, count, cycles, library, config=kind):
        for _ in range(sequences // count):
            ring.fight(hostile.CONTROLLERS[n % len(hostile.CONTROLLERS)](ring.rng), worst)
            n += 1
    return worst


@pytest.mark.parametrize("cycles", [350, 2500])
def test_whatever_is_sent_joints_stay_in_range_and_force_below_its_cap(cycles, library):
    worst = besiege(cycles, 6, 60 if cycles < 1000 else 24, cycles, library)
    assert len(worst.tripped) >= 4
    assert worst.force > 30.0


def test_so_do_they_with_every_imperfection(library):
    """Flexible joints, weak motors, coarse encoders, late commands: in half of the cells each."""
    worst = besiege(11, 6, 48, 350, library, kind=hostile.flawed_config)
    assert len(worst.tripped) >= 4
    assert worst.force > 30.0


@pytest.mark.hostile
@pytest.mark.parametrize("half", [0, 1])
def test_ten_thousand_hostile_sequences(half, library):
    """4,500 of 0.4 s and 500 of 2.5 s, which lead further, in each half."""
    short = besiege([half, 0], 75, 4500, 400, library)
    far = besiege([half, 1], 25, 500, 2500, library)
    assert short.sequences + far.sequences == 5000
    for name, worst in (("0.4 s", short), ("2.5 s", far)):
        print(f"{worst.sequences} sequences of {name}: {worst}")


@pytest.mark.hostile
def test_a_thousand_hostile_sequences_with_every_imperfection(library):
    worst = besiege([0, 2], 50, 1200, 400, library, kind=hostile.flawed_config)
    print(f"{worst.sequences} sequences of 0.4 s, every imperfection: {worst}")
