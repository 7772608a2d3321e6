from dataclasses import replace
from typing import Any

import mujoco
import numpy as np
import pytest

from plant.arm_model import viper_arm
from plant.flexibility import JointSprings
from plant.mjcf import SERVO_DAMPING, SERVO_STIFFNESS, cell_mjcf
from plant.viper import HEART, TOOL, VIPER_S650, ArmSpec, FloatArray, Quantity, Station

HEART_JOINTS, TOOL_JOINTS, CONTACT = slice(0, 6), slice(6, 12), slice(12, 15)
TIMESTEP = 125e-6
Cell = tuple[mujoco.MjModel, mujoco.MjData]


def cell_text(
    spec: ArmSpec = VIPER_S650, heart: Station = HEART, tool: Station = TOOL, **changed: float
) -> str:
    arguments: dict[str, Any] = {
        "timestep": TIMESTEP,
        "stiffness": 2500.0,
        "damping": 0.0,
        "friction": 1.0,
        "torque_lag": 0.0,
    }
    return cell_mjcf(viper_arm(spec, heart), viper_arm(spec, tool), **(arguments | changed))


def cell_at_home(
    spec: ArmSpec = VIPER_S650, heart: Station = HEART, tool: Station = TOOL, **changed: float
) -> Cell:
    model = mujoco.MjModel.from_xml_string(cell_text(spec, heart, tool, **changed))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return model, data


def site_jacobian(cell: Cell, name: str) -> FloatArray:
    model, data = cell
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, jacobian, None, model.site(name).id)
    return jacobian


def near_home(cell: Cell, seed: int, spread: float = 0.05) -> None:
    model, data = cell
    rng = np.random.default_rng(seed)
    data.qpos[:] = model.key("home").qpos + rng.uniform(-spread, spread, 12)
    data.qvel[:] = rng.uniform(-0.5, 0.5, 12)
    mujoco.mj_forward(model, data)


def test_names_and_their_order() -> None:
    model, _ = cell_at_home()
    joints = [f"{arm}_joint{i}" for arm in ("heart", "tool") for i in range(1, 7)]
    assert [model.joint(i).name for i in range(model.njnt)] == joints
    assert [model.actuator(i).name for i in range(model.nu)] == [
        *(f"heart_servo{i}" for i in range(1, 7)),
        *(f"tool_motor{i}" for i in range(1, 7)),
        *("contact_x", "contact_y", "contact_z"),
    ]
    assert {model.site(i).name for i in range(model.nsite)} == {"heart_surface", "tool_tip"}
    bodies = {model.body(i).name for i in range(1, model.nbody)}
    parts = ["base", *(f"link{i}" for i in range(1, 7))]
    links = {f"{arm}_{part}" for arm in ("heart", "tool") for part in parts}
    assert bodies == links | {"heart_pad", "tool_instrument"}
    assert model.camera("overview").id == 0


def test_nothing_collides() -> None:
    model, _ = cell_at_home()
    assert not model.geom_contype.any()
    assert not model.geom_conaffinity.any()


@pytest.mark.parametrize(
    ("heart", "tool"),
    [
        (HEART, TOOL),
        (replace(HEART, base_x=Quantity(-0.50, "m", "a test")), TOOL),
        (HEART, replace(TOOL, base_x=Quantity(0.43, "m", "a test"))),
        (
            replace(HEART, effector=replace(HEART.effector, reach=Quantity(0.05, "m", "a test"))),
            replace(TOOL, effector=replace(TOOL.effector, reach=Quantity(0.10, "m", "a test"))),
        ),
        (
            replace(HEART, effector=replace(HEART.effector, rise=Quantity(0.04, "m", "a test"))),
            replace(TOOL, effector=replace(TOOL.effector, pitch=Quantity(170.0, "deg", "a test"))),
        ),
    ],
)
def test_sites_coincide_at_home_and_are_world_aligned(heart: Station, tool: Station) -> None:
    _, data = cell_at_home(heart=heart, tool=tool)
    for name in ("heart_surface", "tool_tip"):
        np.testing.assert_allclose(data.site(name).xpos, [0, 0, 0.42], rtol=0, atol=1e-15)
        np.testing.assert_allclose(
            data.site(name).xmat.reshape(3, 3), np.eye(3), rtol=0, atol=1e-15
        )


def test_tool_comes_from_above_and_heart_from_the_side() -> None:
    _, data = cell_at_home()
    tip, surface = data.site("tool_tip").xpos, data.site("heart_surface").xpos
    # The body of an end-effector has the frame of its flange, z out of it.
    assert data.body("tool_instrument").xmat[[2, 5, 8]] == pytest.approx([0, 0, -1], abs=1e-15)
    assert data.body("heart_pad").xmat[[2, 5, 8]] == pytest.approx([1, 0, 0], abs=1e-15)
    assert data.body("tool_instrument").xpos[2] - tip[2] == pytest.approx(0.12)
    assert surface[2] - data.body("heart_pad").xpos[2] == pytest.approx(0.06)


def test_arms_weigh_28_kg_each() -> None:
    model, _ = cell_at_home()
    assert model.body("heart_base").subtreemass[0] == pytest.approx(28.25, abs=1e-12)
    assert model.body("tool_base").subtreemass[0] == pytest.approx(28.15, abs=1e-12)


def test_heart_is_carried_and_tool_is_not() -> None:
    _, data = cell_at_home()
    np.testing.assert_allclose(
        data.qfrc_gravcomp[HEART_JOINTS], data.qfrc_bias[HEART_JOINTS], atol=1e-12
    )
    assert not data.qfrc_gravcomp[TOOL_JOINTS].any()
    assert np.abs(data.qfrc_bias[TOOL_JOINTS]).max() > 5.0


def scaled(quantity: Quantity) -> Quantity:
    value = 1.01 * np.asarray(quantity.value)
    return replace(quantity, value=value.tolist())


@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("coulomb_friction", "dof_frictionloss"),
        ("viscous_friction", "dof_damping"),
        ("armature", "dof_armature"),
        ("joint_range", "jnt_range"),
        ("link_mass", "body_mass"),
        ("link_radius", "geom_size"),
        ("link_radius", "body_inertia"),
        ("torque_limit", "actuator_forcerange"),
    ],
)
def test_every_figure_of_the_spec_reaches_both_arms(name: str, field: str) -> None:
    changed = replace(VIPER_S650, **{name: scaled(getattr(VIPER_S650, name))})
    before, after = (
        getattr(mujoco.MjModel.from_xml_string(cell_text(spec)), field)
        for spec in (VIPER_S650, changed)
    )
    rows = {
        "dof_frictionloss": range(12),
        "dof_damping": range(12),
        "dof_armature": range(12),
        "jnt_range": range(12),
        "body_mass": [*range(1, 8), *range(9, 16)],
        "geom_size": [*range(1, 4), *range(20, 24)],
        "body_inertia": [*range(1, 8), *range(9, 16)],
        "actuator_forcerange": range(6, 12),
    }[field]
    for row in rows:
        if name == "link_radius":
            assert (after[row] != before[row]).any(), row
        else:
            np.testing.assert_allclose(after[row], 1.01 * before[row], rtol=1e-14)


def test_mass_of_the_end_effectors_reaches_the_model() -> None:
    heavy = Quantity(1.5, "kg", "a test")
    model, _ = cell_at_home(
        heart=replace(HEART, effector=replace(HEART.effector, mass=heavy)),
        tool=replace(TOOL, effector=replace(TOOL.effector, mass=scaled(heavy))),
    )
    assert model.body("heart_pad").mass[0] == 1.5
    assert model.body("tool_instrument").mass[0] == 1.5 * 1.01


def test_numbers_survive_the_text() -> None:
    model, _ = cell_at_home(timestep=1e-3 / 7, friction=1 / 3)
    assert model.opt.timestep == 1e-3 / 7
    np.testing.assert_array_equal(
        model.dof_frictionloss, np.tile(VIPER_S650.coulomb_friction.si, 2) * (1 / 3)
    )


def test_servo_torque() -> None:
    cell = model, data = cell_at_home()
    near_home(cell, 1)
    data.ctrl[HEART_JOINTS] = data.qpos[HEART_JOINTS] + np.linspace(-1e-3, 2e-3, 6)
    mujoco.mj_forward(model, data)
    expected = SERVO_STIFFNESS * np.linspace(-1e-3, 2e-3, 6) - SERVO_DAMPING * data.qvel[:6]
    np.testing.assert_allclose(data.actuator_force[HEART_JOINTS], expected, rtol=0, atol=1e-9)


def test_motor_torque_without_lag_is_the_command_up_to_the_limit() -> None:
    model, data = cell_at_home()
    assert model.na == 0
    limit = VIPER_S650.torque_limit.si
    for factor in (0.5, -0.9, 3.0, -3.0):
        data.ctrl[TOOL_JOINTS] = factor * limit
        mujoco.mj_forward(model, data)
        np.testing.assert_array_equal(
            data.actuator_force[TOOL_JOINTS], np.clip(factor, -1, 1) * limit
        )


@pytest.mark.parametrize("lag", [0.0005, 0.002])
def test_motor_torque_lags_exactly(lag: float) -> None:
    model, data = cell_at_home(torque_lag=lag)
    assert model.na == 6
    data.ctrl[TOOL_JOINTS] = 10.0
    mujoco.mj_step(model, data, nstep=8)
    np.testing.assert_allclose(data.act, 10.0 * (1 - np.exp(-0.001 / lag)), rtol=1e-12)
    mujoco.mj_forward(model, data)
    np.testing.assert_array_equal(data.actuator_force[TOOL_JOINTS], data.act)


@pytest.mark.parametrize(("stiffness", "damping"), [(2500.0, 0.0), (300.0, 20.0), (1.0, 5.0)])
@pytest.mark.parametrize("seed", range(5))
def test_contact_law_holds_in_the_world_and_pushes_both_arms(
    stiffness: float, damping: float, seed: int
) -> None:
    cell = cell_at_home(stiffness=stiffness, damping=damping)
    data = cell[1]
    near_home(cell, seed, spread=0.2)  # turns the heart's flange by many degrees
    surface, tip = data.site("heart_surface"), data.site("tool_tip")
    to_surface, to_tip = site_jacobian(cell, "heart_surface"), site_jacobian(cell, "tool_tip")
    assert np.abs(surface.xmat.reshape(3, 3) - np.eye(3)).max() > 0.03
    y = stiffness * (tip.xpos - surface.xpos) + damping * (to_tip - to_surface) @ data.qvel

    in_world = -surface.xmat.reshape(3, 3) @ data.actuator_force[CONTACT]
    np.testing.assert_allclose(in_world, y, rtol=0, atol=1e-9)

    # Alone, by taking servos and motors away: the tool feels -y, the heart +y, at their sites.
    contact = data.qfrc_actuator - np.concatenate(
        [data.actuator_force[HEART_JOINTS], data.actuator_force[TOOL_JOINTS]]
    )
    np.testing.assert_allclose(contact, (to_surface - to_tip).T @ y, rtol=0, atol=1e-9)
    assert np.abs(y).max() > 0.05


def test_pressing_down_is_a_negative_force_and_pushes_the_tool_up() -> None:
    cell = model, data = cell_at_home(stiffness=1000.0, friction=0.0)
    down = np.linalg.pinv(site_jacobian(cell, "tool_tip")) @ [0.0, 0.0, -0.002]
    data.qpos += down
    mujoco.mj_forward(model, data)
    on_tool = data.actuator_force[CONTACT]
    assert on_tool == pytest.approx([0.0, 0.0, 2.0], abs=0.02)
    with_contact = data.qacc.copy()
    model.actuator_biasprm[CONTACT] = 0.0
    mujoco.mj_forward(model, data)
    pushed = with_contact - data.qacc
    assert (site_jacobian(cell, "tool_tip") @ pushed)[2] > 0.1
    assert (site_jacobian(cell, "heart_surface") @ pushed)[2] < -0.1


@pytest.mark.parametrize("friction", [0.0, 0.8, 1.0])
def test_friction_scale(friction: float) -> None:
    text = cell_text(friction=friction)
    model = mujoco.MjModel.from_xml_string(text)
    for ours, spec in (
        (model.dof_frictionloss, VIPER_S650.coulomb_friction),
        (model.dof_damping, VIPER_S650.viscous_friction),
    ):
        np.testing.assert_allclose(ours, friction * np.tile(spec.si, 2), rtol=1e-15)
    if friction == 0:
        assert not any(word in text for word in ("frictionloss", "damping=", "solreffriction"))


@pytest.mark.parametrize("speed", [0.3, -0.3])
def test_joint_at_constant_speed_feels_coulomb_and_viscous_torque(speed: float) -> None:
    model, data = cell_at_home(stiffness=1e-9)
    model.opt.gravity[:] = 0.0
    # Joint 1 of the tool turns about the vertical; the rest of the arm is held by its friction.
    torque = np.sign(speed) * (9.6 + 23.7 * abs(speed))
    data.ctrl[6] = torque
    mujoco.mj_step(model, data, nstep=8000)
    assert data.qvel[6] == pytest.approx(speed, rel=1e-6)
    mujoco.mj_forward(model, data)
    losses = data.qfrc_constraint[6] + data.qfrc_passive[6]
    assert losses == pytest.approx(-torque, rel=1e-6)


def test_stiction_hardly_creeps() -> None:
    model, data = cell_at_home(stiffness=1e-9)
    data.ctrl[TOOL_JOINTS] = data.qfrc_bias[TOOL_JOINTS] + 0.5 * VIPER_S650.coulomb_friction.si
    mujoco.mj_step(model, data, nstep=800)
    start = data.qpos[TOOL_JOINTS].copy()
    mujoco.mj_step(model, data, nstep=1600)
    creep = (data.qpos[TOOL_JOINTS] - start) / (1600 * TIMESTEP)
    assert np.abs(creep).max() < 5e-6  # rad/s; 0.03 with MuJoCo's defaults


def test_heart_holds_against_10_newton() -> None:
    cell = model, data = cell_at_home(stiffness=1e-9, friction=0.0)
    data.qfrc_applied[HEART_JOINTS] = (site_jacobian(cell, "heart_surface").T @ [6.0, 0, -8.0])[:6]
    mujoco.mj_step(model, data, nstep=4000)
    mujoco.mj_forward(model, data)
    sag = data.site("heart_surface").xpos - [0, 0, 0.42]
    assert 1e-6 < np.linalg.norm(sag) < 5e-4


def test_stiff_damped_contact_is_stable() -> None:
    # The damper couples the arms, which implicitfast does not see: it must hold all the same.
    model, data = cell_at_home(stiffness=3000.0, damping=20.0, friction=0.0)
    data.ctrl[TOOL_JOINTS] = data.qfrc_bias[TOOL_JOINTS]
    data.qvel[TOOL_JOINTS] = 0.02
    peak = []
    for _ in range(200):
        mujoco.mj_step(model, data, nstep=8)
        peak.append(np.abs(data.actuator_force[CONTACT]).max())
    assert max(peak[100:]) < max(peak[:100]) < 20.0


def test_servo_damping_is_implicit() -> None:
    # Explicit integration would overshoot: damping times step is larger than the wrist's inertia.
    model, data = cell_at_home(friction=0.0)
    data.qvel[5] = 1.0
    mujoco.mj_step(model, data)
    assert 0.2 < data.qvel[5] < 0.5


# --- flexible joints -----------------------------------------------------------------------------


def test_flexible_joints_leave_everything_in_its_place_and_give_the_motors_to_rotors() -> None:
    springs = JointSprings(np.arange(1.0, 7.0) * 1e3, np.arange(1.0, 7.0))
    rigid, _ = cell_at_home()
    model, data = cell_at_home(springs=springs)  # type: ignore[arg-type]
    assert (model.nq, model.nv, model.nu, model.ntendon) == (18, 18, rigid.nu, 6)
    assert [model.joint(i).name for i in range(12)] == [rigid.joint(i).name for i in range(12)]
    assert [model.joint(i).name for i in range(12, 18)] == [f"tool_rotor{i}" for i in range(1, 7)]
    for name in ("dof_armature", "dof_frictionloss", "dof_damping"):
        found, usual = getattr(model, name), getattr(rigid, name)
        np.testing.assert_array_equal(
            found[12:], usual[6:]
        )  # of the motors, no longer of the links
        np.testing.assert_array_equal(found[:6], usual[:6])
        assert not found[6:12].any()
    for i in range(6):
        assert model.actuator(f"tool_motor{i + 1}").trnid[0] == 12 + i
        assert model.equality(f"tool_brake{i + 1}").obj1id == 12 + i
    np.testing.assert_array_equal(model.actuator_forcerange, rigid.actuator_forcerange)
    np.testing.assert_array_equal(model.tendon_stiffness, springs.stiffness)
    np.testing.assert_array_equal(model.tendon_damping, springs.damping)
    np.testing.assert_array_equal(data.qpos[12:], data.qpos[6:12])
    assert not data.qfrc_bias[12:].any()  # a rotor has no weight
    # A turn of a link against its rotor is what winds its spring up.
    data.qpos[6] += 0.1
    data.qpos[13] += 0.1
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.ten_length, [0.1, -0.1, 0, 0, 0, 0], atol=1e-12)
    torque = data.qfrc_passive[[6, 12, 7, 13]]
    np.testing.assert_allclose(torque, [-100.0, 100.0, 200.0, -200.0], atol=1e-9)
