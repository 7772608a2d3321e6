"""Robot_Heart's programme: inverse kinematics, joint speeds, feed-forward, and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from plant import PlantError, UnreachableMotionError
from plant.arm_model import build_arm_model, viper_arm
from plant.mjcf import SERVO_DAMPING, SERVO_STIFFNESS
from plant.playback import Programme, programme
from plant.viper import CONTACT_POINT, HEART, VIPER_S650, Quantity

PERIOD = 1e-3
SAMPLES = (0, 1, 57, 130, 222, 299)


@pytest.fixture(scope="module")
def motion(beating):
    return beating(301)


@pytest.fixture(scope="module")
def play():
    exact = build_arm_model(viper_arm(VIPER_S650, HEART))

    def run(motion, *, spec=VIPER_S650, friction=0.0) -> Programme:
        arm = viper_arm(spec, HEART)
        return programme(arm, exact, motion, period=PERIOD, friction=friction)

    return run


@pytest.fixture(scope="module")
def reached(play, motion):
    """Angles and speeds at a sample: where a programme that begins with it starts."""

    def at(k):
        begun = play(motion.only(k))
        return begun.q, begun.qdot

    return at


@pytest.fixture(scope="module")
def mj(perfect, make_cell, still):
    cell = make_cell(perfect(), still(1), force=np.zeros(3))
    return cell.model, cell.data


def test_forward_kinematics_give_the_motion_back(motion, reached):
    arm = build_arm_model(viper_arm(VIPER_S650, HEART))
    data = arm.model.createData()
    for k in range(0, 301, 10):
        pin.framesForwardKinematics(arm.model, data, reached(k)[0])
        pose = data.oMf[arm.tip]
        np.testing.assert_allclose(
            pose.translation, CONTACT_POINT.si + motion.position[k], atol=1e-8
        )
        np.testing.assert_allclose(pose.rotation, np.eye(3), atol=1e-8)
    assert np.ptp(motion.position, axis=0).min() > 1e-3


@pytest.mark.parametrize("k", SAMPLES[1:])
def test_joint_speeds_are_the_slopes_of_the_angles(k, reached):
    (before, _), (_, speed), (after, _) = (reached(i) for i in (k - 1, k, k + 1))
    np.testing.assert_allclose(speed, (after - before) / (2 * PERIOD), atol=2e-4)


@pytest.mark.parametrize("k", SAMPLES)
def test_the_feed_forward_is_mujocos_inverse_dynamics(k, motion, play, reached, mj):
    model, data = mj
    q, qdot = reached(k)
    data.qpos[:6], data.qvel[:6] = q, qdot
    mujoco.mj_forward(model, data)
    site = model.site("heart_surface").id
    J, rate = np.zeros((6, model.nv)), np.zeros((6, model.nv))
    mujoco.mj_jacSite(model, data, J[:3], J[3:], site)
    body = model.site_bodyid[site]
    mujoco.mj_jacDot(model, data, rate[:3], rate[3:], data.site_xpos[site], body)
    goal = np.append(motion.acceleration[k], np.zeros(3))
    data.qacc[:] = 0.0
    data.qacc[:6] = np.linalg.solve(J[:, :6], goal - rate[:, :6] @ qdot)
    mujoco.mj_inverse(model, data)
    torque = (play(motion).ctrl[k] - q) * SERVO_STIFFNESS - SERVO_DAMPING * qdot
    # The programme's own angles and these differ by the tolerance of the inverse kinematics.
    np.testing.assert_allclose(torque, data.qfrc_inverse[:6], atol=1e-4)
    assert np.abs(torque).max() > 0.1


@pytest.mark.parametrize("friction", [0.5, 1.0])
def test_friction_is_fed_forward(friction, motion, play, reached):
    added = (play(motion, friction=friction).ctrl - play(motion).ctrl) * SERVO_STIFFNESS
    k = int(np.argmax(np.abs(motion.velocity[:, 2])))
    speed = reached(k)[1]
    expected = friction * (
        VIPER_S650.coulomb_friction.si * np.sign(speed) + VIPER_S650.viscous_friction.si * speed
    )
    moving = np.abs(speed) > 0.02  # faster than where the sign is smoothed
    assert moving.sum() >= 3
    np.testing.assert_allclose(added[k][moving], expected[moving], rtol=2e-3)


def line(still, n, *, position=None, velocity=None):
    """Rest, then one axis z that changes from sample 40 on."""
    path = still(n)
    if position is not None:
        path.position[40:, position[0]] = position[1] * np.arange(n - 40)
    if velocity is not None:
        path.velocity[40:, 2] = velocity
    return path


def test_a_point_beyond_the_arm_is_unreachable(play, still):
    path = line(still, 400, position=(0, 5e-3))  # forward, 5 mm a sample
    with pytest.raises(UnreachableMotionError, match="no posture") as caught:
        play(path)
    assert caught.value.joint is None
    k = round(caught.value.time / PERIOD)
    assert 40 < k < 400
    play(replace(path, position=path.position[:k], velocity=path.velocity[:k]))  # it got that far
    assert f"t = {caught.value.time:.3f} s" in str(caught.value)


def test_a_speed_beyond_a_joint_is_unreachable(play, still):
    with pytest.raises(UnreachableMotionError, match="deg/s") as caught:
        play(line(still, 60, velocity=20.0))
    assert caught.value.time == pytest.approx(40 * PERIOD)
    assert caught.value.joint in range(1, 7)
    play(line(still, 60, velocity=0.5))


@pytest.mark.parametrize("joint", range(1, 7))
def test_an_angle_beyond_a_joints_range_is_unreachable(joint, play, motion, reached):
    """A range that ends in the middle of a joint's travel is left where the joint passes it."""
    j = joint - 1
    angles = np.rad2deg([reached(k)[0][j] for k in range(120)])
    assert np.ptp(angles) > 1e-3
    limit = 0.5 * (angles.min() + angles.max())
    pair = (-400.0, limit) if angles[0] < limit else (limit, 400.0)
    ranges = (*VIPER_S650.joint_range.value[:j], pair, *VIPER_S650.joint_range.value[joint:])
    tight = replace(VIPER_S650, joint_range=Quantity(ranges, "deg", "of this test"))
    with pytest.raises(UnreachableMotionError, match="range") as caught:
        play(motion, spec=tight)
    assert caught.value.joint == joint
    outside = np.flatnonzero((angles < pair[0]) | (angles > pair[1]))
    assert caught.value.time == pytest.approx(outside[0] * PERIOD)


def test_the_error_is_one_line_of_the_plant(play, still):
    with pytest.raises(PlantError) as caught:
        play(line(still, 60, velocity=20.0))
    assert "\n" not in str(caught.value)
    assert "t = 0.040 s" in str(caught.value)
