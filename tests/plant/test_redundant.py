"""Seven joints for six directions: the tip does what is asked, and the rest comes back to rest."""

from __future__ import annotations

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from plant import Cell, force_cap
from plant.arm_model import build_arm_model
from plant.config import ToolConfig
from plant.inner_loop import InnerLoop
from plant.own_arm import own_arm, tool_arm
from scenarios.physics import physics_loop

from . import arm_files, hostile

pytestmark = pytest.mark.slow

PERIOD, DAMPING = 1e-3, 20.0


@pytest.fixture(scope="module")
def panda():
    return own_arm(arm_files.PANDA)


@pytest.fixture(scope="module")
def exact(panda):
    return build_arm_model(panda)


def loop_of(exact, **changes) -> InnerLoop:
    n = exact.model.nv
    settings = {"coulomb": np.zeros(n), "viscous": np.zeros(n), "lead": 0.5 * PERIOD}
    return InnerLoop(exact, ToolConfig(**changes), force_axes=np.arange(3), **settings)


def aside(loop: InnerLoop) -> np.ndarray:
    """The motion of the joints that leaves the tip where it is, a unit vector."""
    return np.linalg.svd(loop.J)[2][6]


def test_torque_gives_the_wanted_tip_acceleration_in_mujoco(
    panda, exact, perfect, make_cell, still
):
    """As for the Viper, with the arm anywhere near home and moving in every direction."""
    cell = make_cell(
        perfect(stiffness=1e-6, arm=arm_files.PANDA), still(1), force=np.zeros(3), tool=panda
    )
    model, data, config = cell.model, cell.data, ToolConfig()
    model.actuator_forcerange[6:13] *= 100.0
    rng = np.random.default_rng(3)
    site = model.site("tool_tip").id
    jacobian, rate = np.zeros((6, model.nv)), np.zeros((6, model.nv))
    for _ in range(5):
        data.qpos[6:] = panda.home + rng.uniform(-0.3, 0.3, 7)
        data.qvel[6:] = rng.uniform(-0.5, 0.5, 7)
        mujoco.mj_forward(model, data)
        loop = loop_of(exact)
        loop.observe(data.qpos[6:] + rng.uniform(-0.02, 0.02, 7), np.zeros(7))
        loop.hold()
        loop.observe(data.qpos[6:], data.qvel[6:])
        loop._held, loop._place = loop._rotation.copy(), loop._translation.copy()
        u = rng.uniform(-5.0, 5.0, 3)
        data.ctrl[6:13] = loop.torque(u, np.zeros(3))
        mujoco.mj_forward(model, data)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], site)
        mujoco.mj_jacDot(
            model, data, rate[:3], rate[3:], data.site_xpos[site], model.site_bodyid[site]
        )
        got = jacobian @ data.qacc + rate @ data.qvel
        np.testing.assert_allclose(got[:3], u - config.velocity_damping * loop.twist[:3], atol=1e-8)
        np.testing.assert_allclose(got[3:], -config.orientation_damping * loop.twist[3:], atol=1e-8)


def test_the_choice_among_accelerations_is_the_one_of_least_energy(panda, exact):
    """At rest in its posture, nothing pulls: no other q'' for the same tip has less q'' M q''."""
    loop = loop_of(exact)
    loop.observe(panda.home, np.zeros(7))
    loop.hold()
    M = pin.crba(exact.model, exact.model.createData(), panda.home)
    gravity = pin.computeGeneralizedGravity(exact.model, exact.model.createData(), panda.home)
    u = np.array([3.0, -2.0, 5.0])
    acceleration = np.linalg.solve(M, loop.torque(u, np.zeros(3)) - gravity)
    np.testing.assert_allclose(loop.J @ acceleration, [*u, 0.0, 0.0, 0.0], atol=1e-9)
    assert aside(loop) @ M @ acceleration == pytest.approx(0.0, abs=1e-9)


@pytest.fixture
def knocked(perfect, make_cell, still, panda):
    """Knock the arm aside, with posture gains; return the way that it goes, ``(1200,)`` [rad]."""

    def run(stiffness: float, damping: float) -> np.ndarray:
        config = perfect(
            posture_stiffness=stiffness, posture_damping=damping, arm=arm_files.PANDA,
            stiffness=1e-6, enabled=False,
        )  # fmt: skip
        cell = make_cell(config, still(1200), force=np.zeros(3), tool=panda)
        cell.measure()
        start, way = cell.data.qpos[6:].copy(), aside(cell._inner)
        cell.data.qvel[6:] = 0.5 * way
        path = []
        for _ in range(1200):
            measurement = cell.measure()
            path.append((cell.data.qpos[6:] - start) @ way)
            assert np.linalg.norm(measurement.position - [0.0, 0.0, 0.42]) < 2e-4
            cell.apply(np.zeros(3))
        return np.array(path)

    return run


@pytest.mark.parametrize(("stiffness", "damping"), [(100.0, 25.0), (25.0, 30.0), (0.0, 20.0)])
def test_a_knock_aside_dies_out_as_the_gains_say_and_the_tip_stays(stiffness, damping, knocked):
    path, time = knocked(stiffness, damping), PERIOD * np.arange(1200)
    fast, slow = np.roots([1.0, damping, stiffness])
    expected = 0.5 * (np.exp(fast * time) - np.exp(slow * time)) / (fast - slow)
    np.testing.assert_allclose(path, expected, rtol=0, atol=0.06 * expected.max())


def test_posture_gains_change_nothing_for_six_joints(realistic, make_cell, beating, drive):
    runs = [
        drive(make_cell(realistic(posture_stiffness=k, posture_damping=d), beating(20)), 2.0)
        for k, d in ((100.0, 20.0), (7.0, 3.0))
    ]
    assert runs[0].equals(runs[1])


# --- what is told of the joints ------------------------------------------------------------------


def test_both_maps_are_exact_and_move_the_tip_along_its_axes(panda, exact):
    rng = np.random.default_rng(5)
    loop, axes = loop_of(exact), [0, 1, 2]
    loop.observe(panda.home, np.zeros(7))
    loop.hold()
    q, qdot = panda.home + rng.uniform(-0.02, 0.02, 7), rng.uniform(-0.4, 0.4, 7)
    loop.observe(q, qdot)
    force, previous = np.array([1.0, 2.0, -10.0]), np.array([3.0, -4.0, 5.0])
    space, v = loop.joint_space(force, previous), loop.twist[axes]
    np.testing.assert_allclose(space.speed_gain @ v + space.speed_offset, qdot, atol=1e-12)
    np.testing.assert_allclose((loop.J @ space.speed_gain)[:3], np.eye(3), atol=1e-10)
    np.testing.assert_allclose((loop.J @ space.speed_gain)[3:], 0.0, atol=1e-10)
    for u in (previous, previous + rng.uniform(-20.0, 20.0, 3)):
        told = space.command_gain @ u + space.velocity_gain @ v + space.force_gain @ force
        np.testing.assert_allclose(
            told + space.torque_offset, loop.torque(u, force), rtol=0, atol=1e-9
        )
    # A faster tip: J' q' changes too, by what the map leaves out, so around rest.
    h, rest = 1e-3, np.zeros(7)
    loop.observe(q, rest)
    space = loop.joint_space(force, previous)
    for i in range(3):
        torques = []
        for sign in (-1.0, 1.0):
            loop.observe(q, sign * h * space.speed_gain[:, i])
            torques.append(loop.torque(previous, force))
        slope = (torques[1] - torques[0]) / (2 * h)
        np.testing.assert_allclose(space.velocity_gain[:, i], slope, rtol=0, atol=1e-6)


# --- protection ----------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["panda", "gantry", "urdf"])
def test_the_compiled_loop_is_the_loop_in_python_bit_for_bit(kind, tmp_path):
    arm = arm_files.own(tmp_path, kind)
    loop = physics_loop(own_arm(arm).joints)
    if loop.binary is None:
        pytest.skip(loop.told)
    in_python, in_c = (next(hostile.rings(1, 1, 120, which, arm)) for which in (None, loop.binary))
    tripped = 0
    for controller in (hostile.constant, hostile.bang_bang, hostile.ram, hostile.nothing):
        runs = []
        for ring in (in_python, in_c):
            rng = np.random.default_rng(1)
            send, cell, rows = controller(rng), ring.cell, []
            cell.move_tool(ring.start)
            for k in range(120):
                measurement = cell.measure()
                rows.append([*cell.data.qpos, *cell.data.qvel, cell.truth().force_peak])
                cell.apply(send(k, measurement))
            runs.append((np.array(rows), cell.truth().trip))
        assert np.array_equal(runs[0][0], runs[1][0]), controller.__name__
        assert runs[0][1] == runs[1][1]
        tripped += runs[0][1] is not None
    assert tripped >= 2


@pytest.mark.parametrize("kind", ["panda", "gantry", "urdf"])
def test_no_hostile_controller_breaks_a_promise(kind, tmp_path):
    """Joints in range, force below its cap, as for the Viper."""
    arm = arm_files.own(tmp_path, kind)
    library = physics_loop(own_arm(arm).joints).binary
    worst = hostile.Worst()
    for ring in hostile.rings([7, 1], 2, 300, library, arm):
        for controller in hostile.CONTROLLERS:
            ring.fight(controller(ring.rng), worst)
    assert worst.sequences == 2 * len(hostile.CONTROLLERS)
    assert worst.sequences - worst.tripped["none"] >= 12


@pytest.mark.hostile
@pytest.mark.parametrize("kind", ["panda", "gantry", "urdf"])
def test_a_thousand_hostile_sequences_break_no_promise(kind, tmp_path):
    arm = arm_files.own(tmp_path, kind)
    library = physics_loop(own_arm(arm).joints).binary
    worst = hostile.Worst()
    for ring in hostile.rings([11, 5], 14, 400, library, arm):
        for controller in hostile.CONTROLLERS:
            for _ in range(6):
                ring.fight(controller(ring.rng), worst)
    assert worst.sequences == 1008
    print(kind, worst)


def test_the_cap_is_that_of_the_arm(realistic):
    config = realistic(arm=arm_files.PANDA)
    assert force_cap(config, 0.1) == force_cap(config, 0.1, tool_arm(config))
    assert force_cap(config, 0.1) != force_cap(realistic(), 0.1)


def test_after_a_trip_it_retracts_along_the_normal_and_brakes(realistic, still, panda):
    config = realistic(arm=arm_files.PANDA, unilateral=True)
    cell = Cell(config, still(1200), force=np.array([0.0, 0.0, -5.0]), seed=0, tool=panda)
    start = None
    for _ in range(1200):
        measurement = cell.measure()
        start = measurement.position if start is None else start
        cell.apply(None)
    truth = cell.truth()
    assert truth.trip is not None
    assert truth.trip.cause == "heartbeat"
    assert not truth.touching
    way = cell.measure().position - start
    assert way[2] == pytest.approx(0.03, abs=0.006)
    assert np.abs(way[:2]).max() < 0.003
    assert np.abs(truth.joint_velocity).max() < 1e-3
    assert cell.data.eq_active[:7].all()
