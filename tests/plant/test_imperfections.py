"""Each imperfection by its effect, against what it is said to be; all of them at once."""

from __future__ import annotations

from dataclasses import fields
from itertools import pairwise
from types import SimpleNamespace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import eigh

from plant import Cell, ImperfectionConfig, PlantError
from plant.arm_model import build_arm_model, viper_arm
from plant.transport import Transport
from plant.viper import TOOL, VIPER_S650
from scenarios.physics import physics_loop

from . import arm_files

PERIOD, STEP = 1e-3, 1.25e-4
COULOMB, VISCOUS = VIPER_S650.coulomb_friction.si, VIPER_S650.viscous_friction.si
RATED = VIPER_S650.torque_limit.si
ARM = viper_arm(VIPER_S650, TOOL)
FREE = {"stiffness": 1e-6, "enabled": False}
"""Nothing to touch and nobody to watch."""


@pytest.fixture
def free_cell(perfect, make_cell, still):
    """A perfect cell with changes, that touches nothing."""

    def build(**changes) -> Cell:
        return make_cell(
            perfect(**(FREE | changes)),
            still(4),
            force=np.zeros(3),
            library=physics_loop(6).binary,
        )

    return build


def step(cell, count: int = 1) -> None:
    for _ in range(count):
        mujoco.mj_step2(cell.model, cell.data)
        mujoco.mj_step1(cell.model, cell.data)


def inertia_of(cell) -> np.ndarray:
    """MuJoCo's matrix of inertia, ``(nv, nv)``."""
    columns = np.eye(cell.model.nv)
    for column in columns:
        mujoco.mj_mulM(cell.model, cell.data, column, column.copy())
    return columns


# --- inertia, link by link -----------------------------------------------------------------------


@pytest.mark.parametrize("wrong", range(7))
def test_an_error_of_one_link_is_that_of_this_link_alone(wrong):
    right = build_arm_model(ARM).model
    errors = np.zeros(7)
    errors[wrong] = 0.5
    model = build_arm_model(ARM, errors).model
    mass = [inertia.mass for inertia in model.inertias][1:]
    true = [inertia.mass for inertia in right.inertias][1:]
    expected, armature = np.array(true), right.armature.copy()
    carried = float(TOOL.effector.mass.si)
    if wrong < 6:
        link = true[wrong] - (carried if wrong == 5 else 0.0)
        expected[wrong] += 0.5 * link
        armature[wrong] *= 1.5
    else:
        expected[5] += 0.5 * carried
    np.testing.assert_allclose(mass, expected, rtol=1e-12)
    np.testing.assert_allclose(model.armature, armature, rtol=1e-12)


def test_one_error_for_all_is_the_same_as_seven(realistic, make_cell, beating, drive):
    runs = [
        drive(make_cell(realistic(inertia_error=error), beating(30)), 2.0)
        for error in (0.3, (0.3,) * 7, (0.3,) * 6 + (0.0,))
    ]
    assert runs[0].equals(runs[1])
    assert not runs[0].equals(runs[2])


@pytest.mark.parametrize("wrong", [1, 2, 4, 6])
def test_a_wrong_link_is_borne_wrongly(wrong, free_cell, drive):
    """The torques at rest differ by the weight of this link, as MuJoCo has it."""
    errors = np.zeros(7)
    errors[wrong] = 0.4
    right, cell = free_cell(), free_cell(inertia_error=tuple(errors))
    model, data, jacobian = cell.model, cell.data, np.zeros((3, 12))
    body = model.body("tool_instrument" if wrong == 6 else f"tool_link{wrong + 1}").id
    mujoco.mj_jacBodyCom(model, data, jacobian, None, body)
    weight = 9.81 * model.body_mass[body] * jacobian[2, 6:]
    change = drive(cell, 0.0, cycles=1).torque[0] - drive(right, 0.0, cycles=1).torque[0]
    np.testing.assert_allclose(change, 0.4 * weight, atol=1e-9)
    assert np.abs(change).max() > 0.1


# --- friction ------------------------------------------------------------------------------------

SPEEDS = (0.02, 0.08, 0.3, 1.5)
"""At which a friction curve is taken [rad/s]; the fastest is a quarter of the rated speeds."""


def friction_at(cell, joint: int, speed: float) -> float:
    """Mean torque that turns one joint at a constant speed, back and forth over the same way.

    As a friction curve is identified on a robot. Weight and centrifugal torque are taken off; what
    else depends on the posture is the same both ways, and falls out of half the difference.
    """
    cycles = max(240, round(4.8 / speed))  # until the drive has wound up against the friction
    data, way = cell.data, speed * cycles * PERIOD
    turned = np.diag(inertia_of(cell))[-6:]  # of the motor, with its link if that is rigid
    gain = 9e4 * turned
    angles, speeds = data.qpos[-6:], data.qvel[-6:]
    home, means = ARM.home, []
    for sign in (1.0, -1.0):
        goal, pace = home.copy(), sign * speed * np.eye(6)[joint]
        goal[joint] -= 0.5 * sign * way
        data.qpos[6:12], data.qvel[6:12] = goal, pace
        angles[:], speeds[:] = goal, pace
        mujoco.mj_step1(cell.model, data)
        if cell.model.ntendon:
            goal += data.qfrc_bias[6:12] / cell.model.tendon_stiffness
            angles[:] = goal
            mujoco.mj_step1(cell.model, data)
        torques = []
        for _ in range(cycles):
            data.ctrl[6:12] = (
                data.qfrc_bias[6:12] + gain * (goal - angles) + gain / 150 * (pace - speeds)
            )
            torques.append(data.ctrl[6 + joint] - data.qfrc_bias[6 + joint])
            cell._stepper.advance()
            goal = goal + PERIOD * pace
        np.testing.assert_allclose(speeds[joint], pace[joint], rtol=0.02)
        means.append(np.mean(torques[cycles // 4 : -cycles // 4 + 1]))  # the same way in both
    return 0.5 * (means[0] - means[1])


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"friction": 0.5},
        {"stribeck": 0.3, "stribeck_speed": 0.02},
        {"stribeck": 0.3, "joint_frequency": 40.0, "joint_damping": 0.5},
    ],
    ids=str,
)
def test_the_friction_curve_is_the_identified_one(changes, free_cell):
    """That of the sister robot, with the Stribeck peak where there is one."""
    flaws = {"friction": 1.0, "stribeck": 0.0, "stribeck_speed": 0.05} | changes
    near = 4e-3 if "joint_frequency" in changes else 1e-3  # links swing a little along the way
    cell = free_cell(**flaws)
    share, peak, slow = (flaws[n] for n in ("friction", "stribeck", "stribeck_speed"))
    for joint in range(6):
        for speed in SPEEDS:
            expected = VISCOUS[joint] * speed
            expected += COULOMB[joint] * (1.0 + peak / (1.0 + (speed / slow) ** 2))
            found = friction_at(cell, joint, speed)
            assert found == pytest.approx(share * expected, rel=near), (joint + 1, speed)


@pytest.mark.parametrize("joint", range(6))
@pytest.mark.parametrize("changes", [{}, {"joint_frequency": 20.0}], ids=["rigid", "flexible"])
def test_stribeck_friction_holds_a_joint_at_rest_under_more_torque(joint, changes, free_cell):
    """And lets it go beyond, up to speed."""
    for torque, moves in ((1.27, False), (1.33, True)):
        cell = free_cell(friction=1.0, stribeck=0.3, **changes)
        cell.data.ctrl[6 + joint] += torque * COULOMB[joint]
        if cell.model.na:
            cell.data.act[joint] = cell.data.ctrl[6 + joint]
        start = cell.data.qpos[-6 + joint]
        for _ in range(150):
            cell._stepper.advance()
        assert (cell.data.qpos[-6 + joint] - start > 1e-3) == moves, torque


def test_without_stribeck_friction_coulomb_friction_is_what_holds(free_cell):
    for torque, moves in ((0.98, False), (1.02, True)):
        cell = free_cell(friction=1.0)
        cell.data.ctrl[6] += torque * COULOMB[0]
        for _ in range(300):
            cell._stepper.advance()
        assert (cell.data.qvel[6] > 1e-3) == moves


def test_compensation_knows_nothing_of_stribeck_friction(realistic, make_cell, still, drive):
    """The same torque in the first cycle, from the same measurement."""
    torques = [
        drive(make_cell(realistic(stribeck=peak), still(2)), 9.0, cycles=1).torque[0]
        for peak in (0.0, 0.5)
    ]
    assert np.array_equal(*torques)


# --- torque --------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", [(0.3, 0.0), (0.3, 0.002), (0.7, 0.0)], ids=str)
def test_motors_saturate_at_their_share(case, perfect, make_cell, still, drive):
    share, lag = case
    cell = make_cell(perfect(torque_limit=share, torque_lag=lag, enabled=False), still(20))
    trace = drive(cell, 150.0)
    assert trace.saturated.any()
    assert np.abs(trace.torque / RATED).max() == pytest.approx(share)
    assert np.abs(cell.data.actuator_force[6:12] / RATED).max() <= share * (1 + 1e-12)
    space = cell.joint_space(np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(space.torque_limit, share * RATED)
    # Weaker motors: less acceleration from the same command.
    strong = drive(make_cell(perfect(torque_lag=lag, enabled=False), still(20)), 150.0)
    assert np.linalg.norm(trace.velocity[-1]) < 0.9 * np.linalg.norm(strong.velocity[-1])


def test_the_guard_knows_the_weaker_motors(perfect, make_cell, still):
    """They brake later: a joint has to stop sooner before the end of its range."""
    strong, weak = (
        make_cell(perfect(torque_limit=share), still(2))._guard._block for share in (1.0, 0.4)
    )
    assert (weak["stopping"] > strong["stopping"]).all()
    np.testing.assert_allclose(weak["torque_limit"], 0.4 * strong["torque_limit"])


def test_motors_that_cannot_bear_the_arm_are_refused(perfect, make_cell, still):
    with pytest.raises(
        PlantError, match=r"torque_limit: joint 3 can give 4\.5 N m, .* at home: 8\.4 N m"
    ) as caught:
        make_cell(perfect(torque_limit=0.05), still(2))
    assert "\n" not in str(caught.value)


# --- flexible joints -----------------------------------------------------------------------------


def test_springs_are_wound_up_by_what_they_bear(perfect, make_cell, still):
    """In equilibrium under weight and contact force: nothing moves, for a second."""
    cell = make_cell(perfect(joint_frequency=12.0), still(2))
    data, model = cell.data, cell.model
    start, force = data.qpos.copy(), cell.truth().force
    wound = data.qpos[12:] - data.qpos[6:12]
    held = data.qfrc_bias[6:12] + cell._inner.J[:3].T @ force
    np.testing.assert_allclose(wound * model.tendon_stiffness, held, rtol=1e-2, atol=1e-2)
    assert np.abs(wound).max() > 1e-3
    step(cell, 8000)
    np.testing.assert_allclose(data.qpos, start, atol=1e-9)
    np.testing.assert_allclose(force, [1.0, 2.0, -10.0], atol=1e-6)


@pytest.mark.parametrize(("frequency", "damping"), [(20.0, 0.0), (20.0, 0.05), (60.0, 0.1)])
def test_with_motors_held_the_first_mode_swings_as_it_is_told(frequency, damping, free_cell):
    """In the simulation, against the eigenvalues of stiffness and inertia that MuJoCo has."""
    cell = free_cell(joint_frequency=frequency, joint_damping=damping)
    model, data = cell.model, cell.data
    mass = inertia_of(cell)
    squares, modes = eigh(np.diag(model.tendon_stiffness), mass[6:12, 6:12])
    assert np.sqrt(squares[0]) / (2 * np.pi) == pytest.approx(frequency, rel=1e-3)
    assert squares[1] > 1.5 * squares[0]
    cell.close_brakes()
    rest, shape = data.qpos[6:12].copy(), modes[:, 0]
    data.qpos[6:12] += 2e-4 * shape / np.abs(shape).max()
    mujoco.mj_step1(model, data)
    swing = []
    for _ in range(round(6.5 / frequency / STEP)):
        step(cell)
        swing.append((data.qpos[6:12] - rest) @ mass[6:12, 6:12] @ shape)
    swing = np.array(swing)
    up = np.flatnonzero((swing[:-1] < 0) & (swing[1:] >= 0))
    times = STEP * (up - swing[up] / (swing[up + 1] - swing[up]))
    swung = frequency * np.sqrt(1 - damping**2)
    np.testing.assert_allclose(1 / np.diff(times), swung, rtol=1e-2)
    tops = [swing[i:j].max() for i, j in pairwise(up)]
    decay = np.log(np.array(tops[:-1]) / tops[1:]) / (2 * np.pi)
    np.testing.assert_allclose(decay / np.hypot(1, decay), damping, atol=4e-3)


def test_without_damping_and_friction_energy_and_momentum_stay(free_cell):
    """Links and rotors swing against each other; nothing drives them, nothing brakes them.

    Joint 1 is vertical: its momentum and that of its rotor only pass from one to the other.
    """
    cell = free_cell(joint_frequency=20.0, joint_damping=0.0)
    model, data = cell.model, cell.data
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    model.opt.gravity[:] = 0.0
    data.ctrl[6:12] = 0.0
    data.qpos[12:] = data.qpos[6:12]
    data.qvel[6:12] = 0.3, -0.2, 0.3, 0.5, -0.5, 1.0
    mujoco.mj_step1(model, data)
    energy, momentum, of_rotor = [], [], []
    for _ in range(2400):
        step(cell)
        energy.append(data.energy.copy())
        moved = np.zeros(18)
        mujoco.mj_mulM(model, data, moved, data.qvel)
        momentum.append(moved[6] + moved[12])
        of_rotor.append(moved[12])
    total, kinetic = np.sum(energy, axis=1), np.array(energy)[:, 1]
    assert np.ptp(kinetic) > 0.3 * kinetic.max()
    # A step moves it to and fro, by the fastest mode, but it does not go.
    np.testing.assert_allclose(total, total[0], rtol=0.03)
    assert total[-600:].mean() == pytest.approx(total[:600].mean(), rel=2e-3)
    assert np.ptp(of_rotor) > 0.5 * abs(momentum[0])
    np.testing.assert_allclose(momentum, momentum[0], rtol=1e-3)


def test_encoders_sit_on_the_motors(free_cell):
    cell = free_cell(joint_frequency=20.0)
    model, data = cell.model, cell.data
    before = cell.measure()
    data.qpos[6:12] += 1e-3
    data.qvel[6:12] = 0.1
    mujoco.mj_step1(model, data)
    assert np.array_equal(cell.measure().position, before.position)
    assert not np.array_equal(cell.truth().joint_velocity, np.zeros(6))  # the truth is the links'
    data.qpos[12:] += 1e-3
    mujoco.mj_step1(model, data)
    assert not np.array_equal(cell.measure().position, before.position)


def test_brakes_hold_motors_and_the_links_give_way(perfect, make_cell, still):
    tips = {}
    for frequency in (0.0, 20.0):
        cell = make_cell(perfect(joint_frequency=frequency), still(300), force=np.zeros(3))
        cell.move_tool(np.array([0.0, 0.0, -4e-3]))
        cell.close_brakes()
        start, motors = cell.data.site("tool_tip").xpos.copy(), cell.data.qpos[-6:].copy()
        cell.data.xfrc_applied[cell.model.body("tool_instrument").id, 0] = 20.0
        step(cell, 4000)
        np.testing.assert_allclose(cell.data.qpos[-6:], motors, atol=2e-5)
        tips[frequency] = float(cell.data.site("tool_tip").xpos[0] - start[0])
    assert abs(tips[0.0]) < 2e-5
    assert 5e-5 < tips[20.0] < 1e-3


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"joint_frequency": 2.0}, r"2 Hz the arm's weight winds .* at least 4 Hz"),
        (
            {"joint_frequency": 200.0, "joint_damping": 0.0},
            "too stiff for a physics step of 125 us",
        ),
    ],
)
def test_springs_that_cannot_be_are_refused(changes, told, perfect, make_cell, still):
    with pytest.raises(PlantError, match=told) as caught:
        make_cell(perfect(**changes), still(2))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("case", "bursts"),
    [
        ((8, 200.0, 0.05), False),
        ((8, 30.0, 0.0), False),
        ((8, 40.0, 0.0), True),
        ((4, 150.0, 0.2), False),
        ((4, 200.0, 0.2), True),
        ((2, 60.0, 0.2), False),
        ((2, 60.0, 0.05), True),
    ],
    ids=str,
)
def test_springs_are_refused_where_the_physics_bursts_and_not_before(
    case, bursts, free_cell, tmp_path, monkeypatch
):
    substeps, frequency, damping = case
    changes = {"substeps": substeps, "joint_frequency": frequency, "joint_damping": damping}
    if bursts:
        with pytest.raises(PlantError, match="more substeps or damping"):
            free_cell(**changes)
        monkeypatch.setattr("plant.flexibility.growth", lambda *_: 0.0)
        monkeypatch.chdir(tmp_path)  # MuJoCo writes there what it thinks of it
    cell = free_cell(**changes)
    cell.model.opt.gravity[:] = 0.0
    cell.data.ctrl[6:12] = 0.0
    cell.data.qpos[12:] = cell.data.qpos[6:12]
    cell.data.qvel[6:12] = 0.01, -0.02, 0.01, 0.02, 0.02, 0.02
    mujoco.mj_step1(cell.model, cell.data)
    step(cell, 1500)
    assert (not np.abs(cell.data.qvel).max() < 0.1) == bursts


# --- encoders ------------------------------------------------------------------------------------


class Recorder:
    """Sees what the motors do at every physics step."""

    def __init__(self, monkeypatch, cell):
        self.angles, self.tips, self.velocities = [], [], []
        self._site = cell.model.site("tool_tip").id
        monkeypatch.setattr(
            "plant.stepping.mujoco",
            SimpleNamespace(mj_step1=self.step1, mj_step2=mujoco.mj_step2),
        )

    def step1(self, model, data):
        mujoco.mj_step1(model, data)
        self.angles.append(data.qpos[-6:].copy())
        twist = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, self._site, twist, 0)
        self.velocities.append(twist[3:])


@pytest.mark.parametrize(
    "case",
    [
        (1e-4, 0.0, 0.0),
        (1e-4, 0.0, 20.0),
        (3e-6, 0.002, 0.0),
        (0.0, 0.003, 0.0),
        (0.0, 0.003, 20.0),
    ],
    ids=str,
)
def test_encoders_count_and_speed_is_the_filtered_difference(
    case, perfect, make_cell, still, monkeypatch
):
    resolution, filtered, flexible = case
    config = perfect(
        encoder_resolution=resolution, velocity_filter=filtered, joint_frequency=flexible
    )
    cell = make_cell(config, still(40))

    def counted(angles):
        return np.round(angles / resolution) * resolution if resolution else angles.copy()

    before, speed, fastest = counted(cell.data.qpos[-6:]), np.zeros(6), 0.0
    recorder = Recorder(monkeypatch, cell)
    share = 1.0 - np.exp(-STEP / filtered) if filtered else 1.0
    arm = build_arm_model(ARM)
    data = arm.model.createData()
    for k in range(40):
        measured = cell.measure()
        for angles in recorder.angles:
            now = counted(angles)
            speed = speed + share * ((now - before) / STEP - speed)
            before, fastest = now, max(fastest, np.abs(speed).max())
        recorder.angles.clear()
        pin.framesForwardKinematics(arm.model, data, before)
        np.testing.assert_allclose(measured.position, data.oMf[arm.tip].translation, atol=1e-12)
        J = pin.computeFrameJacobian(
            arm.model, data, before, arm.tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        np.testing.assert_allclose(measured.velocity, (J @ speed)[:3], atol=1e-11)
        cell.apply(np.array([4.0, -3.0, 2.0]) * np.cos(0.2 * k))
    assert fastest > 1e-3


def test_coarser_encoders_and_slower_filters_tell_worse_velocities(
    perfect, make_cell, beating, drive
):
    motion = beating(200)

    def error(**changes):
        trace = drive(make_cell(perfect(**changes), motion), lambda k: 3.0 * np.sin(0.06 * k))
        true = drive(make_cell(perfect(), motion), lambda k: 3.0 * np.sin(0.06 * k))
        return np.abs(trace.velocity - true.velocity).max()

    fine, coarse = error(encoder_resolution=1e-7), error(encoder_resolution=1e-5)
    fast, slow = error(velocity_filter=0.0005), error(velocity_filter=0.004)
    assert 5.0 * fine < coarse
    assert 2.0 * fast < slow


# --- delay with jitter ---------------------------------------------------------------------------


def carried(delay, jitter, periods, seed=0):
    line = Transport(delay, jitter, np.random.SeedSequence(seed))
    line.begin(-1)
    return [line.carry(k, k) for k in range(periods)]


@given(
    delay=st.integers(0, 6),
    jitter=st.floats(0.0, 0.9),
    seed=st.integers(0, 99),
    periods=st.integers(1, 200),
)
@settings(max_examples=60, deadline=None)
def test_nothing_overtakes_and_nothing_comes_early(delay, jitter, seed, periods):
    acting = np.array(carried(delay, jitter, periods, seed))
    latest = np.maximum(np.arange(periods) - delay, -1)
    assert (np.diff(acting) >= 0).all()
    assert (acting <= latest).all()
    if jitter == 0.0:
        assert np.array_equal(acting, latest)


def test_of_those_that_arrive_together_the_last_one_counts():
    """Against a line that is worked out by hand."""
    line = Transport(1, 0.5, np.random.SeedSequence(0))
    extra = [2, 0, 0, 0, 3, 1, 0, 0, 0, 0]
    line._extra = extra[::-1]
    line.begin("start")
    acting = [line.carry(k, k) for k in range(10)]
    # Items arrive in periods 3, 3, 3, 4, 8, 8, 8, 8, 9, 10: 0 and 1 are lost, then 4, 5, 6.
    assert acting == ["start", "start", "start", 2, 3, 3, 3, 3, 7, 8]


@pytest.mark.parametrize("jitter", [0.05, 0.3, 0.7])
def test_the_extra_delay_is_geometric(jitter):
    """P(n >= i) = jitter^i, seen from outside: an item acts at once if neither it nor one before
    it is still under way, so it acts in its own period with the product of their probabilities.
    """
    n = 20000
    acting = np.array(carried(0, jitter, n, seed=5))
    age = np.arange(n) - acting
    # Item k - i acts in period k at the latest if all up to it have arrived.
    for i in range(4):
        expected = np.prod(1.0 - jitter ** np.arange(i + 1, 200))
        assert np.mean(age <= i) == pytest.approx(expected, abs=0.02)


def test_jitter_has_a_stream_of_its_own(realistic, make_cell, beating, drive):
    motion = beating(60)

    def run(jitter, seed):
        config = realistic(delay_jitter=jitter)
        return drive(make_cell(config, motion, seed=seed), lambda k: 5.0 * np.cos(0.3 * k))

    late, again, other, none = run(0.3, 1), run(0.3, 1), run(0.3, 2), run(0.0, 1)
    assert late.equals(again)
    assert not np.array_equal(late.torque, other.torque)
    assert not np.array_equal(late.position, none.position)
    # Until the first command that is late the run is the same, sensor noise included.
    assert np.array_equal(late.read[0], none.read[0])


def test_the_guard_expects_what_acts_and_not_what_was_sent(perfect, make_cell, still):
    config = perfect(delay_jitter=0.8, tracking_velocity=0.02, velocity_damping=0.0, stiffness=1.0)
    cell = make_cell(config, still(60), force=np.zeros(3))
    asked, apart = 0.0, 0.0
    for k in range(60):
        velocity = cell.measure().velocity[0]
        apart = max(apart, abs(velocity - asked))
        sent = 5.0 * (-1) ** (k // 4)
        cell.apply(np.array([sent, 0.0, 0.0]))
        asked += PERIOD * sent
    assert cell.truth().trip is None
    assert apart > 0.1  # it would have tripped by far


# --- mass beyond the sensor ----------------------------------------------------------------------


@pytest.mark.parametrize("case", [(0.01, 0.0), (0.1, 0.0), (0.1, 20.0)], ids=str)
def test_a_mass_beyond_the_sensor_is_felt(case, perfect, make_cell, beating, monkeypatch):
    """What is read too much is mass times acceleration: of MuJoCo's velocity of the tip."""
    mass, flexible = case
    config = perfect(tip_mass=mass, joint_frequency=flexible, enabled=False)
    cell = make_cell(config, beating(60))
    recorder = Recorder(monkeypatch, cell)
    largest = 0.0
    for k in range(60):
        measured, truth = cell.measure(), cell.truth()
        if k:
            felt = np.subtract(*recorder.velocities[-1:-3:-1]) / STEP
            np.testing.assert_allclose(measured.force - truth.force, mass * felt, atol=0.02 * mass)
            largest = max(largest, float(np.abs(felt).max()))
        else:
            np.testing.assert_allclose(measured.force, truth.force, atol=1e-9)  # tared
        cell.apply(np.array([6.0, -4.0, 5.0]) * np.cos(0.2 * k))
    assert largest > 3.0


def test_its_weight_is_tared_in_the_frame_of_the_sensor(free_cell):
    """At rest, turned by a quarter: m g was taken off along the shaft, where it is no longer."""
    cell = free_cell(tip_mass=0.1)
    data, mass = cell.data, cell._tip_mass
    assert np.abs(mass.force()).max() < 1e-9
    before = data.site("tool_tip").xmat.reshape(3, 3).copy()
    data.qpos[6 + 4] -= np.pi / 2
    mujoco.mj_step1(cell.model, data)
    for _ in range(2):
        mass.remember()
    turn = data.site("tool_tip").xmat.reshape(3, 3) @ before.T
    weight = np.array([0.0, 0.0, -0.1 * 9.81])
    np.testing.assert_allclose(mass.force(), turn @ weight - weight, atol=1e-9)
    assert np.abs(mass.force()[2]) > 0.9
    assert np.abs(mass.force()[0]) > 0.9


def test_more_than_the_flange_carries_is_refused(perfect, make_cell, still):
    with pytest.raises(PlantError, match=r"0\.2 kg are more than the 0\.15 kg"):
        make_cell(perfect(tip_mass=0.2), still(2))


# --- all of them ---------------------------------------------------------------------------------

EVERYTHING = {
    "inertia_error": (0.2, -0.1, 0.3, 0.1, 0.2, 0.4, 0.5),
    "stribeck": 0.3,
    "torque_limit": 0.7,
    "joint_frequency": 20.0,
    "encoder_resolution": 1e-6,
    "velocity_filter": 0.0003,
    "delay_jitter": 0.1,
    "tip_mass": 0.02,
}


def test_everything_is_on():
    keys = {f.name for f in fields(ImperfectionConfig)}
    usual = {"friction", "friction_compensation", "torque_lag", "delay", "command_resolution"}
    assert keys == usual | set(EVERYTHING) | {"stribeck_speed", "joint_damping"}


@pytest.mark.parametrize("left_out", [None, *EVERYTHING])
def test_the_compiled_loop_is_the_loop_in_python_bit_for_bit(
    left_out, realistic, make_cell, beating, library
):
    """Until long after a trip; any one of them may be missing."""
    flaws = {key: value for key, value in EVERYTHING.items() if key != left_out}
    runs = []
    for which in (None, library):
        cell = make_cell(realistic(**flaws), beating(160), library=which)
        rows = []
        for k in range(160):
            measured, truth = cell.measure(), cell.truth()
            rows.append(
                [*cell.data.qpos, *cell.data.qvel, *measured.velocity, *measured.force,
                 *truth.force, *truth.joint_velocity, truth.force_peak]
            )  # fmt: skip
            cell.apply(np.array([5.0, -4.0, 6.0]) * np.cos(0.15 * k) * (1 if k < 60 else 30))
        runs.append((np.array(rows), cell.truth().trip))
    assert np.array_equal(runs[0][0], runs[1][0])
    assert runs[0][1] == runs[1][1]
    assert runs[0][1] is not None


def test_each_of_them_changes_the_run(realistic, make_cell, beating, drive, library):
    def run(flaws):
        cell = make_cell(realistic(**flaws), beating(60), library=library)
        return drive(cell, lambda k: np.array([9.0, -8.0, 9.0]) * np.cos(0.3 * k))

    whole = run(EVERYTHING | {"torque_limit": 0.3})
    for key in EVERYTHING:
        rest = {name: value for name, value in EVERYTHING.items() if name != key}
        if key != "torque_limit":
            rest["torque_limit"] = 0.3
        assert not whole.equals(run(rest)), key


def test_a_new_start_forgets_the_run_before(realistic, make_cell, beating, drive, library):
    """But for the streams of random numbers, which go on."""
    flaws = EVERYTHING | {"delay_jitter": 0.0}
    cell = make_cell(realistic(model="ideal", **flaws), beating(100), library=library)
    place = np.array([0.0, 0.0, -3e-3])
    cell.move_tool(place)
    limits = cell.model.dof_frictionloss.copy()
    np.testing.assert_allclose(limits[-6:], 1.3 * COULOMB)
    fresh = drive(cell, 2.0, cycles=50)
    assert not np.array_equal(cell.model.dof_frictionloss, limits)
    cell.move_tool(place)
    assert np.array_equal(cell.model.dof_frictionloss, limits)
    assert drive(cell, 2.0, cycles=50).equals(fresh)


def test_an_arm_of_seven_joints_has_them_too(realistic, make_cell, beating):
    """All of them, the same bits in both loops; its first mode is the one that is told."""
    flaws = EVERYTHING | {"inertia_error": (0.2,) * 7 + (0.4,), "torque_limit": 0.9}
    config = realistic(**flaws, arm=arm_files.PANDA)
    library, runs = physics_loop(7).binary, []
    for which in (None, library) if library else (None,):
        cell, rows = make_cell(config, beating(60), library=which), []
        for k in range(60):
            measured = cell.measure()
            rows.append([*cell.data.qpos, *cell.data.qvel, *measured.velocity, *measured.force])
            cell.apply(np.array([4.0, -3.0, 5.0]) * np.cos(0.15 * k))
        runs.append(np.array(rows))
    assert np.array_equal(runs[0], runs[-1])
    still = make_cell(config, beating(2))
    still.data.qpos[6:13] = still._arm.home
    mujoco.mj_forward(still.model, still.data)
    links = inertia_of(still)[6:13, 6:13]
    lowest = eigh(np.diag(still.model.tendon_stiffness), links, eigvals_only=True)[0]
    assert np.sqrt(lowest) / (2 * np.pi) == pytest.approx(20.0, rel=1e-9)
