"""An arm of one's own: both engines and the file itself agree, and it stands where it should."""

from __future__ import annotations

from dataclasses import fields, replace
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant import CellConfig, PlantError
from plant.arm_file import read_arm_file
from plant.arm_model import build_arm_model, viper_arm
from plant.chain import rotation_between
from plant.config import ArmConfig
from plant.mjcf import cell_mjcf
from plant.own_arm import own_arm, tool_arm
from plant.viper import CONTACT_POINT, HEART, TOOL, VIPER_S650

from . import arm_files

FIGURES = ("home", "lower", "upper", "speed", "torque_limit", "armature", "coulomb", "viscous")
WORLD = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("arms")


@pytest.fixture(scope="module", params=arm_files.KINDS)
def config(request, folder):
    return arm_files.own(folder, request.param)


@pytest.fixture(scope="module")
def arm(config):
    return own_arm(config)


def cell_of(arm):
    text = cell_mjcf(
        viper_arm(VIPER_S650, HEART), arm, timestep=125e-6, stiffness=2500.0, damping=0.0,
        friction=1.0, torque_lag=0.001,
    )  # fmt: skip
    return mujoco.MjModel.from_xml_string(text)


def states(arm, count, seed=0):
    rng = np.random.default_rng(seed)
    for _ in range(count):
        q = rng.uniform(arm.lower, arm.upper)
        yield q, rng.uniform(-arm.speed, arm.speed), rng.uniform(-5.0, 5.0, arm.joints)


def mass_matrix(model, data):
    full = np.zeros((model.nv, model.nv))
    column = np.zeros(model.nv)
    for i in range(model.nv):
        mujoco.mj_mulM(model, data, column, np.eye(model.nv)[i])
        full[:, i] = column
    return full


def test_mujoco_and_pinocchio_agree(arm):
    """RNEA, CRBA, Jacobian and pose of both engines over random states, as for the Viper."""
    model, n = cell_of(arm), arm.joints
    data = mujoco.MjData(model)
    own = build_arm_model(arm)
    work, site = own.model.createData(), model.site("tool_tip").id
    data.qpos[:6] = viper_arm(VIPER_S650, HEART).home
    jacobian, inverse = np.zeros((2, 3, 6 + n)), np.zeros(6 + n)
    for q, v, a in states(arm, 100):
        data.qpos[6:], data.qvel[6:] = q, v
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        M = mass_matrix(model, data)[6:, 6:]
        scale = np.abs(M).max()
        np.testing.assert_allclose(pin.crba(own.model, work, q), M, rtol=0, atol=1e-12 * scale)
        np.testing.assert_allclose(
            pin.nonLinearEffects(own.model, work, q, v), data.qfrc_bias[6:], rtol=0, atol=1e-10
        )
        data.qacc[6:] = a
        mujoco.mj_rne(model, data, 1, inverse)  # without armature
        torque = pin.rnea(own.model, work, q, v, a) - arm.armature * a
        np.testing.assert_allclose(torque, inverse[6:], rtol=0, atol=1e-10)
        mujoco.mj_jacSite(model, data, jacobian[0], jacobian[1], site)
        J = pin.computeFrameJacobian(own.model, work, q, own.tip, WORLD)
        np.testing.assert_allclose(J, jacobian[:, :, 6:].reshape(6, n), rtol=0, atol=1e-12)
        pin.framesForwardKinematics(own.model, work, q)
        np.testing.assert_allclose(
            work.oMf[own.tip].translation, data.site_xpos[site], rtol=0, atol=1e-12
        )


def test_the_arm_is_what_the_file_says(config, arm):
    """Mass matrix, gravity and tip against MuJoCo on the file alone; fingers are locked."""
    bare = own_arm(replace(config, instrument=False))
    file = read_arm_file(Path(config.file))
    model, data = file.model, mujoco.MjData(file.model)
    own = build_arm_model(bare)
    work, n = own.model.createData(), bare.joints
    model.dof_armature[:n] = bare.armature
    world = bare.base.placement
    start = np.linalg.inv(own_base(file))
    for q, _, _ in states(bare, 20, seed=1):
        data.qpos[:] = model.qpos0
        data.qpos[:n] = q
        data.qvel[:] = 0.0
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        M = mass_matrix(model, data)[:n, :n]
        np.testing.assert_allclose(
            pin.crba(own.model, work, q), M, rtol=0, atol=1e-12 * np.abs(M).max()
        )
        np.testing.assert_allclose(
            pin.computeGeneralizedGravity(own.model, work, q), data.qfrc_bias[:n], atol=1e-10
        )
        pin.framesForwardKinematics(own.model, work, q)
        kind = data.site if mujoco.mj_name2id(model, 6, config.tip) >= 0 else data.body
        tip = [*kind(config.tip).xpos, 1.0]
        np.testing.assert_allclose(
            work.oMf[own.tip].translation, (world @ start @ tip)[:3], rtol=0, atol=1e-12
        )


def own_base(file):
    """Pose of the body that the arm begins with, in the file's world."""
    data = mujoco.MjData(file.model)
    mujoco.mj_kinematics(file.model, data)
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = data.xmat[1].reshape(3, 3), data.xpos[1]
    return pose


def test_both_formats_give_the_same_arm(folder):
    first, second = (own_arm(arm_files.own(folder, kind)) for kind in ("urdf", "mjcf"))
    for name in (
        "home",
        "lower",
        "upper",
        "speed",
        "torque_limit",
        "armature",
        "coulomb",
        "viscous",
    ):
        np.testing.assert_allclose(getattr(first, name), getattr(second, name), atol=1e-9)
    for one, other in zip(first.links, second.links, strict=True):
        np.testing.assert_allclose(one.placement, other.placement, atol=1e-12)
        assert one.inertia.mass == pytest.approx(other.inertia.mass)
        np.testing.assert_allclose(one.inertia.tensor, other.inertia.tensor, atol=1e-12)


def test_figures_come_from_the_file(folder):
    six = own_arm(arm_files.own(folder, "urdf"))
    assert six.torque_limit.tolist() == list(arm_files.TORQUE)
    assert (six.speed == arm_files.SPEED).all()
    assert (six.coulomb == arm_files.FRICTION).all()
    assert (six.viscous == arm_files.DAMPING).all()
    assert [link.inertia.mass for link in six.links] == pytest.approx(arm_files.MASS)
    gantry = own_arm(arm_files.own(folder, "gantry"))
    assert gantry.torque_limit.tolist() == [300.0, 300.0, 400.0, 20.0, 20.0, 20.0]
    assert gantry.armature.tolist() == [5.0, 5.0, 5.0, 0.05, 0.05, 0.05]
    assert [link.slides for link in gantry.links] == [True] * 3 + [False] * 3


def test_it_presses_straight_down_on_the_contact_point(config, arm):
    exact = build_arm_model(arm)
    data = exact.model.createData()
    pin.framesForwardKinematics(exact.model, data, arm.home)
    tip = data.oMf[exact.tip]
    np.testing.assert_allclose(tip.translation, CONTACT_POINT.si, atol=1e-9)
    np.testing.assert_allclose(tip.rotation, np.eye(3), atol=1e-12)
    # From the end of the instrument to where it is mounted: up, as it is world-aligned at home.
    np.testing.assert_allclose(arm.tip[:3, :3].T @ [0.0, 0.0, 1.0], [0.0, 0.0, -1.0], atol=1e-9)
    assert (arm.lower < arm.home).all()
    assert (arm.home < arm.upper).all()
    J = pin.computeFrameJacobian(exact.model, data, arm.home, exact.tip, WORLD)
    assert np.linalg.svd(J, compute_uv=False)[-1] > 0.02


def test_the_site_and_the_frame_coincide_in_the_cell(arm):
    model = cell_of(arm)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    for name in ("heart_surface", "tool_tip"):
        np.testing.assert_allclose(data.site(name).xpos, CONTACT_POINT.si, atol=1e-9)
        np.testing.assert_allclose(data.site(name).xmat.reshape(3, 3), np.eye(3), atol=1e-9)
    assert not model.geom_contype.any()
    assert model.nu == 6 + arm.joints + 3


def test_a_base_that_is_found_is_upright_on_the_floor_on_the_tools_side(config, arm):
    file = read_arm_file(Path(config.file))
    base = arm.base.placement @ np.linalg.inv(own_base(file))
    np.testing.assert_allclose(base[:3, 2], [0.0, 0.0, 1.0], atol=1e-9)
    assert base[2, 3] == pytest.approx(0.0, abs=1e-9)
    assert 0.2 < base[0, 3] < 0.9
    assert base[1, 3] == pytest.approx(0.0, abs=1e-9)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    x=st.floats(0.25, 0.45), y=st.floats(-0.15, 0.15), z=st.floats(-0.1, 0.15),
    bend=st.floats(-0.2, 0.2),
)  # fmt: skip
def test_from_any_base_nearby_the_home_is_found(x, y, z, bend):
    home = np.array([0.0, -0.8, 0.0, -2.3, 0.0, 1.6, 0.8]) + bend
    arm = own_arm(replace(arm_files.PANDA, base=(x, y, z), home=tuple(home.tolist())))
    exact = build_arm_model(arm)
    data = exact.model.createData()
    pin.framesForwardKinematics(exact.model, data, arm.home)
    np.testing.assert_allclose(data.oMf[exact.tip].translation, CONTACT_POINT.si, atol=1e-9)
    np.testing.assert_allclose(arm.base.placement[:3, 3], [x, y, z], atol=1e-12)
    assert (arm.lower <= arm.home).all()
    assert (arm.home <= arm.upper).all()


def test_a_viper_from_a_file_stands_where_the_viper_stands(folder):
    """The cell's own tool, taken out of the cell's MJCF and read back: the same to rounding."""
    viper = viper_arm(VIPER_S650, TOOL)
    root = ET.fromstring(
        cell_mjcf(
            viper_arm(VIPER_S650, HEART), viper, timestep=1e-3, stiffness=1.0, damping=0.0,
            friction=1.0, torque_lag=0.0,
        )
    )  # fmt: skip
    for part, kept in (("worldbody", "tool_base"), ("actuator", "tool_motor")):
        section = root.find(part)
        for child in list(section):
            if not child.get("name", "").startswith(kept):
                section.remove(child)
    for part in ("equality", "keyframe"):
        root.remove(root.find(part))
    instrument = next(b for b in root.iter("body") if b.get("name") == "tool_instrument")
    ET.SubElement(instrument, "site", name="end", pos="0 0 0.12")
    mine = own_arm(
        ArmConfig(
            arm_files.write(folder, ET.tostring(root, encoding="unicode"), "viper.xml"), "end",
            instrument=False, joint_speed=tuple(viper.speed.tolist()), base=(0.0, 0.0, 0.0),
            base_yaw=0.0, home=tuple(viper.home.tolist()),
        )
    )  # fmt: skip
    for name in ("home", "lower", "upper", "torque_limit", "armature", "coulomb", "viscous"):
        np.testing.assert_allclose(getattr(mine, name), getattr(viper, name), atol=1e-9)
    one, other = (build_arm_model(arm) for arm in (viper, mine))
    for q, v, a in states(viper, 10):
        torques = [pin.rnea(arm.model, arm.model.createData(), q, v, a) for arm in (one, other)]
        np.testing.assert_allclose(*torques, rtol=0, atol=1e-9)


PARTS = {
    "tip": "link7",
    "instrument": False,
    "home": (0.1, -0.8, 0.1, -2.4, 0.0, 1.7, 0.8),
    "base": (0.35, 0.0, 0.0),
    "joint_range": ((-2.0, 2.0),) * 3
    + ((-3.0, -0.5),)
    + ((-2.0, 2.0),)
    + ((0.0, 3.0), (-2.0, 2.0)),
    "joint_speed": 1.0,
    "torque_limit": 50.0,
    "armature": 0.0,
    "coulomb_friction": 2.0,
    "viscous_friction": (1.0,) * 7,
}


def differs(first, second):
    """Whether anything about two arms is different."""
    arrays = (
        "tip",
        "home",
        "lower",
        "upper",
        "speed",
        "torque_limit",
        "armature",
        "coulomb",
        "viscous",
    )
    same = all(np.array_equal(getattr(first, a), getattr(second, a)) for a in arrays)
    same &= np.array_equal(first.base.placement, second.base.placement)
    return not (same and (first.effector is None) == (second.effector is None))


@pytest.mark.parametrize("key", sorted(PARTS))
def test_every_key_has_an_effect(key):
    usual = own_arm(arm_files.PANDA)
    assert not differs(usual, own_arm(arm_files.PANDA))
    assert differs(usual, own_arm(replace(arm_files.PANDA, **{key: PARTS[key]})))


def test_the_turn_of_a_given_base_has_an_effect():
    here = replace(arm_files.PANDA, base=(0.35, 0.0, 0.0))
    assert differs(own_arm(here), own_arm(replace(here, base_yaw=2.5)))
    assert {f.name for f in fields(ArmConfig)} == {*PARTS, "file", "base_yaw"}


def test_without_an_arm_of_ones_own_it_is_the_viper():
    assert tool_arm(CellConfig()).speed.tolist() == VIPER_S650.joint_speed.si.tolist()


@pytest.mark.parametrize("seed", range(20))
def test_the_smallest_rotation_between_two_directions(seed):
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((2, 3))
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)
    for start, end in ((a, b), (a, a), (a, -a), (np.eye(3)[seed % 3], -np.eye(3)[seed % 3])):
        turn = rotation_between(start, end)
        np.testing.assert_allclose(turn @ start, end, atol=1e-12)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(turn) == pytest.approx(1.0)
        assert np.trace(turn) == pytest.approx(1.0 + 2.0 * (start @ end))


# --- files of others -----------------------------------------------------------------------------

THIRD_PARTY = {
    "panda_description/urdf/panda.urdf": ("panda_link8", {}),
    "ur_description/urdf/ur5_robot.urdf": ("tool0", {}),
    "xarm_description/urdf/xarm7.urdf": ("link7", {}),
    "kinova_description/robots/kinova.urdf": (
        "j2s6s200_end_effector",
        {"joint_range": ((-3.0, 3.0),) * 6},
    ),
    "baxter_description/urdf/baxter.urdf": ("left_wrist", {}),
}


@pytest.mark.parametrize("name", sorted(THIRD_PARTY))
def test_descriptions_of_others_are_read(name):
    """Where the package example-robot-data is installed; it is no dependency."""
    try:
        files = metadata.files("example-robot-data") or []
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    path = next(file.locate() for file in files if str(file).endswith(name))
    tip, keys = THIRD_PARTY[name]
    losses = {"coulomb_friction": 1.0, "viscous_friction": 0.5}
    arm = own_arm(ArmConfig(str(path), tip, armature=0.1, **losses, **keys))
    assert arm.joints in (6, 7)


def test_it_is_an_error_of_the_plant(folder):
    with pytest.raises(PlantError):
        own_arm(ArmConfig(str(folder / "none.xml"), "flange"))
