from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from plant.arm_model import (
    TIP_NAME,
    Solid,
    base_placement,
    body_placements,
    build_arm_model,
    effector_solids,
    home_configuration,
    link_inertias,
    link_solids,
    mass_properties,
    rotation,
    viper_arm,
)
from plant.errors import PlantError
from plant.mjcf import cell_mjcf
from plant.viper import HEART, TOOL, VIPER_S650, ArmSpec, FloatArray, Quantity, Station

STATES = 500
ARMS = [(HEART, slice(0, 6)), (TOOL, slice(6, 12))]
arms = pytest.mark.parametrize(("station", "joints"), ARMS, ids=["heart", "tool"])


@pytest.fixture(scope="module")
def cell() -> mujoco.MjModel:
    text = cell_mjcf(
        viper_arm(VIPER_S650, HEART),
        viper_arm(VIPER_S650, TOOL),
        timestep=125e-6,
        stiffness=2500.0,
        damping=0.0,
        friction=1.0,
        torque_lag=0.001,
    )
    return mujoco.MjModel.from_xml_string(text)


def random_states(seed: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    spec = VIPER_S650
    lower, upper = np.tile(spec.lower, 2), np.tile(spec.upper, 2)
    speed = np.tile(spec.joint_speed.si, 2)
    return rng.uniform(lower, upper, (STATES, 12)), rng.uniform(-speed, speed, (STATES, 12))


@arms
def test_mujoco_and_pinocchio_agree(cell: mujoco.MjModel, station: Station, joints: slice) -> None:
    arm = build_arm_model(viper_arm(VIPER_S650, station))
    model, work = arm.model, arm.model.createData()
    assert model.frames[arm.tip].name == TIP_NAME[station.name]
    data = mujoco.MjData(cell)
    site = cell.site(TIP_NAME[station.name]).id
    identity, column = np.eye(12), np.zeros(12)
    jacobian = np.zeros((2, 3, 12))
    pose = data.site_xpos[site], data.site_xmat[site]
    difference = dict.fromkeys(("mass", "bias", "gravity", "jacobian", "pose"), 0.0)

    def note(name: str, ours: FloatArray, theirs: FloatArray) -> None:
        difference[name] = max(difference[name], float(np.abs(ours - theirs).max()))

    for qpos, qvel in zip(*random_states(1), strict=True):
        q, v = qpos[joints], qvel[joints]
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_fwdPosition(cell, data)
        mujoco.mj_fwdVelocity(cell, data)
        note("bias", pin.nonLinearEffects(model, work, q, v), data.qfrc_bias[joints])
        data.qvel[:] = 0.0
        mujoco.mj_fwdVelocity(cell, data)
        note("gravity", pin.computeGeneralizedGravity(model, work, q), data.qfrc_bias[joints])

        mass = pin.crba(model, work, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        for i in range(6):
            mujoco.mj_mulM(cell, data, column, identity[joints][i])
            note("mass", mass[:, i], column[joints])

        frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        mujoco.mj_jacSite(cell, data, jacobian[0], jacobian[1], site)
        note(
            "jacobian",
            pin.computeFrameJacobian(model, work, q, arm.tip, frame),
            jacobian[:, :, joints].reshape(6, 6),
        )
        pin.framesForwardKinematics(model, work, q)
        note("pose", work.oMf[arm.tip].translation, pose[0])
        note("pose", work.oMf[arm.tip].rotation.ravel(), pose[1])
    assert max(difference.values()) < 1e-10, difference


@arms
def test_armature_is_in_the_mass_matrix(station: Station, joints: slice) -> None:
    q = home_configuration(VIPER_S650, station)
    bare = replace(VIPER_S650, armature=Quantity((0.0,) * 6, "kg m^2", "a test"))
    masses = [
        pin.crba(arm.model, arm.model.createData(), q)
        for arm in (build_arm_model(viper_arm(spec, station)) for spec in (VIPER_S650, bare))
    ]
    np.testing.assert_allclose(
        np.diag(masses[0] - masses[1]), VIPER_S650.armature.si, rtol=0, atol=1e-14
    )


@pytest.mark.parametrize("error", [-0.5, 0.2])
def test_inertia_error_scales_the_whole_dynamics(error: float) -> None:
    true, wrong = (build_arm_model(viper_arm(VIPER_S650, TOOL), e).model for e in (0.0, error))
    qpos, qvel = random_states(2)
    for q, v in zip(qpos[:5, 6:], qvel[:5, 6:], strict=True):
        acceleration = np.arange(6.0)
        torques = [pin.rnea(m, m.createData(), q, v, acceleration) for m in (true, wrong)]
        np.testing.assert_allclose(torques[1], (1 + error) * torques[0], rtol=1e-12, atol=1e-12)
        masses = [pin.crba(m, m.createData(), q) for m in (true, wrong)]
        np.testing.assert_allclose(masses[1], (1 + error) * masses[0], rtol=1e-12, atol=1e-14)


def test_limits_are_set() -> None:
    model = build_arm_model(viper_arm(VIPER_S650, TOOL)).model
    np.testing.assert_array_equal(model.velocityLimit, VIPER_S650.joint_speed.si)
    np.testing.assert_array_equal(model.effortLimit, VIPER_S650.torque_limit.si)
    np.testing.assert_array_equal(model.lowerPositionLimit, VIPER_S650.lower)
    np.testing.assert_array_equal(model.upperPositionLimit, VIPER_S650.upper)
    assert list(model.names)[1:] == [f"tool_joint{i}" for i in range(1, 7)]


def denavit_hartenberg(theta: float, d: float, a: float, alpha: float) -> FloatArray:
    """The textbook matrix, written out; it shares nothing with the code under test."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0.0, sa, ca, d],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def flange_by_hand(q: FloatArray, lengths: dict[str, float]) -> FloatArray:
    n, right = lengths, np.pi / 2
    pose = np.eye(4)
    for step in (
        denavit_hartenberg(q[0], n["d1"], n["a1"], -right),
        denavit_hartenberg(q[1], 0.0, n["a2"], 0.0),
        denavit_hartenberg(q[2] - np.pi, 0.0, n["a3"], -right),
        denavit_hartenberg(q[3], n["d4"], 0.0, right),
        denavit_hartenberg(q[4], 0.0, 0.0, -right),
        denavit_hartenberg(q[5] - np.pi, n["d6"], 0.0, 0.0),
    ):
        pose = pose @ step
    return pose


LENGTHS = {"d1": 0.335, "a1": 0.075, "a2": 0.270, "a3": 0.090, "d4": 0.295, "d6": 0.080}


@arms
@pytest.mark.parametrize("changed", [None, *LENGTHS])
def test_forward_kinematics_against_a_denavit_hartenberg_product(
    changed: str | None, station: Station, joints: slice
) -> None:
    spec, lengths = VIPER_S650, dict(LENGTHS)
    if changed is not None:
        lengths[changed] *= 1.05
        spec = replace(spec, **{changed: Quantity(lengths[changed], "m", "a test")})
    arm = build_arm_model(viper_arm(spec, station))
    work = arm.model.createData()
    effector = station.effector
    tip = np.array([-float(effector.rise.si), 0.0, float(effector.reach.si), 1.0])
    sign = {"heart": 1.0, "tool": -1.0}[station.name]  # the tool's base is turned by half a turn
    base_x = {"heart": -0.52, "tool": 0.40}[station.name]
    for q in random_states(3)[0][:20, joints]:
        pin.framesForwardKinematics(arm.model, work, q)
        x, y, z = (flange_by_hand(q, lengths) @ tip)[:3]
        expected = [base_x + sign * x, sign * y, z]
        np.testing.assert_allclose(work.oMf[arm.tip].translation, expected, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("degrees", "position", "out_of_flange"),
    [
        ((0, 0, 0, 0, 0, 0), (0.075 + 0.270 - 0.090, 0, 0.335 + 0.375), (0, 0, 1)),
        ((0, -90, 90, 0, 0, 0), (0.075 - 0.090, 0, 0.335 + 0.270 + 0.375), (0, 0, 1)),
        ((0, -90, 180, 0, 0, 0), (0.075 + 0.375, 0, 0.335 + 0.270 + 0.090), (1, 0, 0)),
        ((90, -90, 180, 0, 0, 0), (0, 0.075 + 0.375, 0.335 + 0.270 + 0.090), (0, 1, 0)),
    ],
)
def test_documented_configurations(
    degrees: tuple[float, ...], position: tuple[float, ...], out_of_flange: tuple[float, ...]
) -> None:
    flange = np.eye(4)
    for placement, angle in zip(
        body_placements(VIPER_S650), np.deg2rad([*degrees, 0.0]), strict=True
    ):
        turn = np.eye(4)
        turn[:3, :3] = rotation("z", angle)
        flange = flange @ placement @ turn
    np.testing.assert_allclose(flange[:3, 3], position, rtol=0, atol=1e-15)
    np.testing.assert_allclose(flange[:3, 2], out_of_flange, rtol=0, atol=1e-15)


@arms
def test_home_is_within_range_and_not_singular(station: Station, joints: slice) -> None:
    q = home_configuration(VIPER_S650, station)
    margin = np.minimum(q - VIPER_S650.lower, VIPER_S650.upper - q)
    assert np.rad2deg(margin).min() > 35.0
    arm = build_arm_model(viper_arm(VIPER_S650, station))
    work = arm.model.createData()
    jacobian = pin.computeFrameJacobian(
        arm.model, work, q, arm.tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    assert np.linalg.svd(jacobian, compute_uv=False)[-1] > 0.1
    pin.framesForwardKinematics(arm.model, work, q)
    np.testing.assert_allclose(work.oMf[arm.tip].translation, [0, 0, 0.42], rtol=0, atol=1e-15)
    np.testing.assert_allclose(work.oMf[arm.tip].rotation, np.eye(3), rtol=0, atol=1e-15)


def moved(x: float, y: float, z: float) -> Station:
    return replace(TOOL, home_tip=Quantity((x, y, z), "m", "a test"))


@pytest.mark.parametrize(
    ("spec", "station", "message"),
    [
        (VIPER_S650, moved(-0.4, 0.0, 0.42), "tool arm cannot reach"),
        (VIPER_S650, moved(0.325, 0.0, 0.135), "tool arm cannot reach"),  # wrist on the shoulder
        (VIPER_S650, moved(0.0, 0.01, 0.42), "tool arm cannot reach"),
        (
            replace(
                VIPER_S650,
                joint_range=Quantity(
                    ((-170, 170), (-190, 45), (-29, 190), *[(-360, 360)] * 3), "deg", "a test"
                ),
            ),
            TOOL,
            "joint 3 out of range",
        ),
    ],
)
def test_home_out_of_reach_is_refused(spec: ArmSpec, station: Station, message: str) -> None:
    with pytest.raises(PlantError, match=message):
        home_configuration(spec, station)


@pytest.mark.parametrize(
    "solids",
    [*link_solids(VIPER_S650), effector_solids(HEART.effector), effector_solids(TOOL.effector)],
)
def test_mass_properties_against_mujocos_own(solids: tuple[Solid, ...]) -> None:
    geoms = "".join(
        f'<geom type="{s.shape}" fromto="{" ".join(map(repr, (*s.start, *s.end)))}" '
        f'size="{s.radius!r}" density="1"/>'
        for s in solids
    )
    text = f"<mujoco><worldbody><body><freejoint/>{geoms}</body></worldbody></mujoco>"
    theirs = mujoco.MjModel.from_xml_string(text)
    volume = theirs.body_mass[1]
    ours = mass_properties(volume, solids)
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, theirs.body_iquat[1])
    axes = rotation.reshape(3, 3)
    np.testing.assert_allclose(ours.com, theirs.body_ipos[1], rtol=0, atol=1e-13)
    tensor = axes @ np.diag(theirs.body_inertia[1]) @ axes.T
    np.testing.assert_allclose(ours.tensor, tensor, rtol=0, atol=1e-10 * tensor.max())


def test_link_inertias_carry_the_link_masses() -> None:
    inertias = link_inertias(VIPER_S650)
    assert [inertia.mass for inertia in inertias] == VIPER_S650.link_mass.si.tolist()
    for inertia in inertias:
        principal = np.linalg.eigvalsh(inertia.tensor)
        assert principal[0] > 0
        assert principal[0] + principal[1] >= principal[2]


def test_base_placement() -> None:
    np.testing.assert_allclose(
        base_placement(TOOL),
        [[-1, 0, 0, 0.4], [0, -1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]],
        atol=1e-15,
    )
