"""From tool to joints: against finite differences, and against the simulation a step later."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pinocchio as pin
import pytest

from plant import JointPlant, JointSpace
from plant.arm_model import build_arm_model, viper_arm
from plant.config import ToolConfig
from plant.inner_loop import InnerLoop
from plant.viper import TOOL, VIPER_S650

ARM = build_arm_model(viper_arm(VIPER_S650, TOOL), 0.2)
Q = np.array([0.1, -1.6, 2.9, 0.2, 0.5, -0.1])
QDOT = np.array([0.3, -0.2, 0.4, -0.5, 0.2, 0.6])
FORCE, PREVIOUS = np.array([1.0, 2.0, -10.0]), np.array([3.0, -4.0, 5.0])
COULOMB, VISCOUS = 0.8 * VIPER_S650.coulomb_friction.si, 0.8 * VIPER_S650.viscous_friction.si
AXES = [[0, 1, 2], [2], [2, 0]]
every_choice = pytest.mark.parametrize("axes", AXES, ids=["xyz", "z", "zx"])


def observed(axes, *, q=Q, qdot=QDOT, coulomb=COULOMB) -> InnerLoop:
    """A loop off its held pose."""
    loop = InnerLoop(
        ARM, ToolConfig(), coulomb=coulomb, viscous=VISCOUS, lead=0.0025, force_axes=np.array(axes)
    )
    loop.observe(Q - 1e-3, np.zeros(6))
    loop.hold()
    loop.observe(q, qdot)
    return loop


def speeds(space: JointSpace, v) -> np.ndarray:
    return space.speed_gain @ v + space.speed_offset


def torques(space: JointSpace, u, v, force) -> np.ndarray:
    return (
        space.command_gain @ u
        + space.velocity_gain @ v
        + space.force_gain @ force
        + space.torque_offset
    )


@every_choice
def test_both_maps_are_exact_where_they_are_made(axes):
    loop = observed(axes)
    space = loop.joint_space(FORCE, PREVIOUS)
    v = loop.twist[axes]
    np.testing.assert_allclose(speeds(space, v), QDOT, rtol=0, atol=1e-12)
    torque = loop.torque(PREVIOUS, FORCE)
    np.testing.assert_allclose(torques(space, PREVIOUS[axes], v, FORCE[axes]), torque, atol=1e-9)


@every_choice
def test_torque_is_linear_in_command_and_force(axes):
    loop = observed(axes, coulomb=np.zeros(6))
    space = loop.joint_space(FORCE, PREVIOUS)
    v = loop.twist[axes]
    rng = np.random.default_rng(0)
    for _ in range(3):
        u, force = PREVIOUS.copy(), FORCE.copy()
        u[axes] += rng.uniform(-20.0, 20.0, len(axes))
        force[axes] += rng.uniform(-20.0, 20.0, len(axes))
        np.testing.assert_allclose(
            torques(space, u[axes], v, force[axes]), loop.torque(u, force), rtol=0, atol=1e-9
        )


def test_coulomb_friction_counts_as_it_is():
    with_it, without = (
        observed([0, 1, 2], coulomb=c).joint_space(FORCE, PREVIOUS) for c in (COULOMB, np.zeros(6))
    )
    for name in ("command_gain", "velocity_gain", "force_gain"):
        assert np.array_equal(getattr(with_it, name), getattr(without, name))
    friction = with_it.torque_offset - without.torque_offset
    np.testing.assert_allclose(np.abs(friction), COULOMB, rtol=0.05)


@every_choice
def test_the_joint_speeds_move_the_tip_along_its_axes(axes):
    """Against the tip's pose a moment before and after; the orientation stays."""
    space = observed(axes).joint_space(FORCE, PREVIOUS)
    data, h = ARM.model.createData(), 1e-5
    for column, axis in zip(space.speed_gain.T, axes, strict=True):
        poses = []
        for sign in (-1.0, 1.0):
            pin.framesForwardKinematics(ARM.model, data, Q + sign * h * column)
            poses.append(data.oMf[ARM.tip].copy())
        moved = (poses[1].translation - poses[0].translation) / (2 * h)
        turned = pin.log3(poses[1].rotation @ poses[0].rotation.T) / (2 * h)
        np.testing.assert_allclose(moved, np.eye(3)[axis], atol=1e-8)
        np.testing.assert_allclose(turned, 0.0, atol=1e-8)


@every_choice
def test_torque_follows_the_speed_of_the_tip(axes):
    """At rest, where Coriolis forces do not change with speed, by central differences."""
    rest = np.zeros(6)
    space = observed(axes, qdot=rest, coulomb=rest).joint_space(FORCE, PREVIOUS)
    h = 1e-3
    for i in range(len(axes)):
        step = h * space.speed_gain[:, i]
        plus, minus = (
            observed(axes, qdot=qdot, coulomb=rest).torque(PREVIOUS, FORCE)
            for qdot in (step, -step)
        )
        np.testing.assert_allclose((plus - minus) / (2 * h), space.velocity_gain[:, i], atol=1e-8)


def test_coriolis_forces_matter_little_at_the_speeds_of_the_paper():
    """What is left out of the torque's change with speed, as a share of what the joints can do."""
    qdot = observed([0, 1, 2]).joint_space(FORCE, PREVIOUS).speed_gain @ [0.1, -0.1, 0.1]
    space = observed([0, 1, 2], qdot=qdot, coulomb=np.zeros(6)).joint_space(FORCE, PREVIOUS)
    h, slopes = 1e-3, []
    for column in space.speed_gain.T:
        plus, minus = (
            observed([0, 1, 2], qdot=qdot + s * h * column, coulomb=np.zeros(6)).torque(
                PREVIOUS, FORCE
            )
            for s in (1.0, -1.0)
        )
        slopes.append((plus - minus) / (2 * h))
    left_out = np.array(slopes).T - space.velocity_gain
    share = 0.1 * np.abs(left_out) / space.torque_limit[:, None]
    assert 0.0 < share.max() < 0.01


# --- in the cell ---------------------------------------------------------------------------------


def push(k: int) -> np.ndarray:
    return np.array([6.0, 4.0, -8.0]) * np.cos(0.05 * k + np.arange(3))


@pytest.mark.parametrize("axes", ["xyz", "z", "zx"])
def test_one_step_of_the_simulation_goes_as_predicted(axes, perfect, make_cell, beating):
    """Made at one instant, the maps give speeds and torques of the next from what is measured."""
    index = ["xyz".index(axis) for axis in axes]
    cell = make_cell(perfect(), beating(150), axes=list(axes))
    before, asked, worst_speed, worst_torque = None, [], 0.0, 0.0
    for k in range(150):
        measurement, truth, command = cell.measure(), cell.truth(), push(k)
        v, force = measurement.velocity[index], measurement.force[index]
        assert np.array_equal(truth.joint_velocity, cell.data.qvel[6:])
        assert np.array_equal(truth.joint_angle, cell.data.qpos)
        space = cell.joint_space(measurement.force, push(k - 1))
        np.testing.assert_allclose(speeds(space, v), truth.joint_velocity, rtol=0, atol=1e-9)
        cell.apply(command)
        asked.append(cell.truth().torque)
        assert np.array_equal(cell.truth().joint_angle, truth.joint_angle)  # still of the measure
        assert not cell.truth().saturated
        if before is not None:
            wrong = np.abs(speeds(before, v) - truth.joint_velocity)
            worst_speed = max(worst_speed, wrong.max())
            wrong = np.abs(torques(before, command[index], v, force) - asked[-1])
            worst_torque = max(worst_torque, wrong.max())
        before = space
    assert worst_speed < 2e-3
    assert worst_torque < 0.1
    assert np.ptp(asked, axis=0).max() > 5.0


def test_asking_changes_nothing(realistic, make_cell, beating):
    runs = []
    for asks in (False, True):
        cell = make_cell(realistic(), beating(40))
        rows = []
        for k in range(40):
            measurement = cell.measure()
            if asks:
                cell.joint_space(measurement.force, push(k - 1))
            cell.apply(push(k))
            rows.append(np.concatenate([measurement.position, cell.truth().torque]))
        runs.append(rows)
    assert np.array_equal(runs[0], runs[1])


def test_the_limits_are_those_of_the_arm(realistic, make_cell, still):
    cell = make_cell(realistic(), still(5))
    assert isinstance(cell, JointPlant)
    space = cell.joint_space(cell.measure().force, np.zeros(3))
    np.testing.assert_array_equal(space.speed_limit, VIPER_S650.joint_speed.si)
    np.testing.assert_array_equal(space.torque_limit, VIPER_S650.torque_limit.si)
    for limit in (space.speed_limit, space.torque_limit):
        with pytest.raises(ValueError, match="read-only"):
            limit[:] = 0.0


@every_choice
def test_shapes_and_arrays_of_its_own(axes, realistic, make_cell, beating):
    cell = make_cell(realistic(), beating(20), axes=["xyz"[i] for i in axes])
    space = cell.joint_space(cell.measure().force, np.zeros(3))
    kept = {f.name: getattr(space, f.name).copy() for f in fields(space)}
    for k in range(10):
        cell.apply(push(k))
        cell.joint_space(cell.measure().force, push(k))
    for name, array in kept.items():
        assert np.array_equal(getattr(space, name), array)
        assert array.shape == ((6, len(axes)) if name.endswith("_gain") else (6,))
