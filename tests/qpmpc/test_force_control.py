from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    BoundsConfig,
    BoundsError,
    ControllerConfig,
    ForceController,
    JointsConfig,
    ModelConfig,
    ModelError,
    ObserverConfig,
    PerAxis,
    QpmpcError,
    Status,
    UnknownNameError,
    axis_model,
    contact_model,
)
from qpmpc.config import FREE, Disturbance, RhythmConfig

PERIOD = 1e-3
KINDS = Disturbance.__args__
kinds = pytest.mark.parametrize("kind", KINDS)
bounded = pytest.mark.parametrize("velocity", [FREE, (-0.2, 0.2)], ids=["free", "bounded"])


class Cell:
    """Tissue that moves, tools that obey with one cycle of delay, sensors with fixed noise."""

    def __init__(self, axes: int, *, amplitude: float = 0.02, error: float = 0.0) -> None:
        self.contact = contact_model(2500.0, 20.0, PERIOD, lag=1e-3)
        self.x = np.zeros((axes, 3))
        self.x[:, 0] = np.array([2.0, 3.0, 4.0])[:axes]
        self.late = np.zeros(axes)
        self.amplitude, self.error, self.k = amplitude, error, 0

    @property
    def force(self) -> np.ndarray:
        return self.x[:, 0].copy()

    @property
    def velocity(self) -> np.ndarray:
        return self.x[:, 1].copy()

    def apply(self, command: np.ndarray) -> None:
        axes = np.arange(len(self.x))
        tissue = self.amplitude * np.sin(2 * np.pi * (5 + 3 * axes) * self.k * PERIOD + axes)
        m, c = self.contact.model, self.contact
        self.x = (
            self.x @ m.A.T
            + np.outer(self.late, m.B)
            + np.outer(tissue, c.tissue)
            + self.error * np.ravel(c.load)
        )
        self.late, self.k = command, self.k + 1


@dataclass(frozen=True, eq=False)
class Joints:
    """An arm whose joints move with the axes, one each."""

    speed_gain: np.ndarray = field(default_factory=lambda: np.eye(3))
    speed_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    command_gain: np.ndarray = field(default_factory=lambda: np.eye(3))
    velocity_gain: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    force_gain: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    torque_offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    speed_limit: np.ndarray = field(default_factory=lambda: np.ones(3))
    torque_limit: np.ndarray = field(default_factory=lambda: np.full(3, 10.0))


def trace(
    config: ControllerConfig,
    axes: tuple[Any, ...] = ("x", "y", "z"),
    cycles: int = 80,
    *,
    backend: str = "daqp",
    cell: Cell | None = None,
    faults: Mapping[int, float] = MappingProxyType({}),
) -> tuple[np.ndarray, Cell, list[Status]]:
    """Commands of a closed loop, ``(cycles, n_axes)``; ``faults``: off by how much, and when."""
    cell = cell or Cell(len(axes))
    controller = ForceController(config, axes, PERIOD, backend, joints=Joints())
    controller.reset(cell.force)
    wish = np.tile(cell.force, (config.horizon + 1, 1))
    commands, statuses, noise = [], [], np.random.default_rng(3)
    for k in range(cycles):
        if k == 20:
            wish = wish + 0.5
        measured = cell.force + 3e-3 * noise.standard_normal(len(axes)) + faults.get(k, 0.0)
        speed = cell.velocity + 1e-4 * noise.standard_normal(len(axes))
        controller.view(Joints())
        step = controller.step(measured, speed, wish)
        cell.apply(step.command)
        controller.prepare()
        commands.append(step.command)
        statuses.append(step.status)
    return np.array(commands), cell, statuses


def configured(kind: str = "fused", velocity: tuple[float, float] = FREE) -> ControllerConfig:
    return ControllerConfig(
        observer=ObserverConfig(disturbance=kind), bounds=BoundsConfig(velocity=velocity)
    )


# ---- every field of the configuration does something

LATERAL = ("bounds.tangential",)
"""What says nothing about z."""
SOLVER_FIELDS = (
    "solver.max_iterations", "solver.time_limit", "solver.smallest_part", "solver.deadline",
    "solver.compiled",
    "solver.form",
)  # fmt: skip
"""What does not change the answer; tested below by what it does change."""
RIVALS = ("kind", "pi.", "ilc.", "aob.", "paper_law.")
"""What others than this controller read; tested with them, in ``rivals``."""
FAULTY = ("observer.tissue_acceleration", "observer.tissue_jerk", "observer.patience",
          "observer.force_gate")  # fmt: skip
"""What matters where measurements are missing or wrong."""
FAULTS = dict.fromkeys(range(30, 45), np.nan) | {60: 5.0}
BEAT_FIELDS = tuple(
    f"observer.rhythm.{f.name}" for f in fields(RhythmConfig) if f.name != "jerk_drift"
)
"""What has no effect before a few beats; tested in rhythm/test_preview.py."""
LATER = SOLVER_FIELDS + BEAT_FIELDS
TIGHT_FORCE = {"bounds.force": PerAxis((1.9, 2.1), (2.9, 3.1), (3.9, 4.1))}
TIGHT_VELOCITY = {"bounds.velocity": (-0.01, 0.01)}
EFFECTS: dict[str, tuple[Any, dict[str, Any]]] = {
    # field: (other value, what else must be set for it to matter)
    "horizon": (6, {}),
    "control_horizon": (3, {}),
    "decision": ("absolute", {}),
    "force_weight": (2.0, {}),
    "increment_weight": (0.01, {}),
    "reference_time": (0.01, {}),
    "model.stiffness": (2000.0, {}),
    "model.velocity_damping": (30.0, {}),
    "model.delay": (2, {}),
    "model.lag": (0.0, {}),
    "model.damping": (20.0, {}),
    "observer.disturbance": ("constant", {}),
    "observer.force_noise": (0.01, {}),
    "observer.velocity_noise": (1e-3, {}),
    "observer.input_drift": (3.0, {}),
    "observer.input_slope_drift": (30.0, {"observer.disturbance": "ramp"}),
    "observer.tissue_jerk_drift": (1000.0, {}),
    "observer.tissue_acceleration": (0.1, {}),
    "observer.tissue_jerk": (1.0, {}),
    "observer.patience": (0.005, {}),
    "observer.force_gate": (10.0, {}),
    "observer.rhythm.jerk_drift": (500.0, {"observer.disturbance": "tracked"}),
    "bounds.command": ((-4.0, 4.0), {}),
    "bounds.rate": ((-0.5, 0.5), {}),
    "bounds.force": (PerAxis((1.95, 2.05), (2.95, 3.05), (3.95, 4.05)), {}),
    "bounds.force_margin": (0.05, TIGHT_FORCE),
    "bounds.velocity": ((-0.01, 0.01), {}),
    "bounds.velocity_margin": (0.005, TIGHT_VELOCITY),
    "bounds.order": (
        ("force", "velocity", "joint_torque", "joint_speed", "tangential"),
        TIGHT_FORCE | {"bounds.velocity": (-1e-4, 1e-4)},
    ),
    "bounds.largest_error": (1e-4, TIGHT_FORCE | TIGHT_VELOCITY),
    "bounds.tangential.limit": (1.0, {}),
    "bounds.tangential.friction": (0.3, {"bounds.tangential.limit": 1.0}),
    "bounds.tangential.facets": (3, {"bounds.tangential.limit": 1.0}),
    "bounds.joints.speed": (0.01, {}),
    "bounds.joints.torque": (0.2, {}),
}


def paths(record: Any, prefix: str = "") -> Iterator[str]:
    for f in fields(record):
        value = getattr(record, f.name)
        if is_dataclass(value):
            yield from paths(value, f"{prefix}{f.name}.")
        elif not (prefix + f.name).startswith(RIVALS):
            yield prefix + f.name


def changed(record: Any, path: str, value: Any) -> Any:
    name, _, rest = path.partition(".")
    return replace(record, **{name: changed(getattr(record, name), rest, value) if rest else value})


@pytest.mark.parametrize("path", [p for p in paths(ControllerConfig()) if p not in LATER])
def test_every_field_has_an_effect(path: str) -> None:
    assert path in EFFECTS, f"state in EFFECTS what another value of {path} changes"
    value, context = EFFECTS[path]
    base = ControllerConfig()
    for other, setting in context.items():
        base = changed(base, other, setting)
    faults = FAULTS if path in FAULTY else {}
    before, after = (trace(c, faults=faults)[0] for c in (base, changed(base, path, value)))
    difference = np.abs(before - after).max(axis=0)
    axes = difference[:2] if path.startswith(LATERAL) else difference
    assert (axes > 1e-3).all()


def test_a_bound_of_one_axis_is_that_axis_alone() -> None:
    for i, axis in enumerate("xyz"):
        bounds = PerAxis(**{axis: (1.95 + i, 2.05 + i)})
        base = ControllerConfig()
        after = trace(changed(base, "bounds.force", bounds))[0]
        difference = np.abs(trace(base)[0] - after).max(axis=0)
        alone = np.arange(3) == i
        assert (difference[alone] > 1e-3).all()
        assert (difference[~alone] < 1e-6).all()


def test_fields_of_the_solver_change_how_it_solves() -> None:
    base = changed(ControllerConfig(), "bounds.force", TIGHT_FORCE["bounds.force"])
    assert Status.ITERATION_LIMIT in trace(changed(base, "solver.max_iterations", 1))[2]
    hasty = trace(changed(base, "solver.time_limit", 1e-9), backend="clarabel")[2]
    assert Status.ITERATION_LIMIT in hasty
    late = trace(changed(base, "solver.deadline", 1e-9))[2]
    assert set(late) == {Status.LATE}
    parts = [
        ForceController(
            changed(base, "solver.smallest_part", smallest), ("x", "y", "z"), PERIOD
        ).general.solver.parts
        for smallest in (8, 100)
    ]
    assert parts == [3, 1]
    forms = [
        ForceController(changed(base, "solver.form", name), ("z",), PERIOD).general.problem.form
        for name in ("condensed", "structured")
    ]
    assert forms == ["condensed", "structured"]


def test_effects_are_stated_for_fields_there_are() -> None:
    assert set(EFFECTS) | set(LATER) == set(paths(ControllerConfig()))


# ---- measurements


@kinds
@bounded
def test_three_axes_are_three_controllers(kind: str, velocity: tuple[float, float]) -> None:
    """Nothing leaks from axis to axis, neither measurement nor set point nor bound."""
    config = replace(
        configured(kind, velocity),
        bounds=BoundsConfig(velocity=velocity, force=PerAxis((1.9, 2.2), FREE, (3.9, 4.2))),
    )
    names = ("x", "y", "z")
    rng = np.random.default_rng(4)
    force, speed = 3 + rng.standard_normal((20, 3)), 0.05 * rng.standard_normal((20, 3))
    wish = 3 + rng.standard_normal((20, 9, 3))
    together = ForceController(config, names, PERIOD)
    together.reset(force[0])
    joint = np.array([together.step(*v).command for v in zip(force, speed, wish, strict=True)])
    for i, name in enumerate(names):
        single = ForceController(config, (name,), PERIOD)
        single.reset(force[0, [i]])
        for k in range(20):
            step = single.step(force[k, [i]], speed[k, [i]], wish[k][:, [i]])
            assert step.command[0] == pytest.approx(joint[k, i], rel=1e-6, abs=1e-6)


def test_bounds_follow_the_order_of_the_axes() -> None:
    config = ControllerConfig(bounds=BoundsConfig(force=PerAxis((0, 1), (0, 2), (0, 3))))
    problem = ForceController(config, ("z", "x"), PERIOD).general.problem
    rows = problem.rows["force"]
    np.testing.assert_array_equal(problem.qp.u[rows].reshape(-1, 2)[:, 0], 3)
    np.testing.assert_array_equal(problem.qp.u[rows].reshape(-1, 2)[:, 1], 1)


@kinds
@bounded
def test_velocity_is_used_where_the_model_says_so(kind: str, velocity: Any) -> None:
    axis = axis_model(
        ModelConfig(), ObserverConfig(disturbance=kind), PERIOD, tool_velocity=velocity != FREE
    )
    readings = []
    for speed in (0.0, 0.05):
        controller = ForceController(configured(kind, velocity), ("y",), PERIOD)
        controller.reset(np.array([2.0]))
        controller.step(np.array([2.0]), np.array([speed]), np.full((9, 1), 2.0))
        readings.append(axis.velocity @ controller.general.observer.state)
    assert (readings[1] - readings[0] > 0.01) == (axis.measured.shape[0] == 2)
    assert axis.measured.shape[0] == (1 if kind in ("constant", "ramp") and velocity == FREE else 2)


@kinds
@bounded
def test_estimate_finds_force_and_tool_velocity(kind: str, velocity: Any) -> None:
    config = configured(kind, velocity)
    axis = axis_model(config.model, config.observer, PERIOD, tool_velocity=velocity != FREE)
    cell = Cell(1, amplitude=0.0, error=3.0 if kind != "none" else 0.0)
    controller = ForceController(config, ("x",), PERIOD)
    controller.reset(np.array([0.0]))
    for _ in range(1500):
        step = controller.step(cell.force, cell.velocity, np.full((9, 1), 2.5))
        force, speed = cell.force, cell.velocity
        estimate = controller.general.observer.state.copy()
        known = 0.0 if controller.preview is None else controller.preview.motion[0, 0]
        cell.apply(step.command)
        controller.prepare()
    assert axis.model.C @ estimate + known == pytest.approx(force, abs=1e-4)
    assert axis.velocity @ estimate == pytest.approx(speed, abs=1e-5)


# ---- disturbance models


@kinds
@bounded
def test_runs_and_holds_the_force_on_moving_tissue(kind: str, velocity: Any) -> None:
    config = configured(kind, velocity)
    cell = Cell(3)
    commands, cell, statuses = trace(config, cycles=400, cell=cell)
    assert set(statuses) <= {Status.SOLVED}
    still = Cell(3)
    worst = 0.0
    for _ in range(400):
        still.apply(np.zeros(3))
        worst = max(worst, np.abs(still.force - [2, 3, 4]).max())
    assert worst > 2.0
    assert np.abs(cell.force - [2.5, 3.5, 4.5]).max() < (1.5 if kind == "none" else 0.3)
    assert np.abs(commands).max() <= 20.0


@pytest.mark.parametrize("kind", [k for k in KINDS if k != "none"])
@bounded
def test_no_offset_under_a_constant_input_error(kind: str, velocity: Any) -> None:
    cell = Cell(1, amplitude=0.0, error=4.0)
    controller = ForceController(configured(kind, velocity), ("x",), PERIOD)
    controller.reset(cell.force)
    for _ in range(1500):
        step = controller.step(cell.force, cell.velocity, np.full((9, 1), 2.5))
        cell.apply(step.command)
    assert cell.force[0] == pytest.approx(2.5, abs=1e-4)
    assert step.command[0] == pytest.approx(-4.0, abs=1e-3)


def test_without_a_disturbance_state_there_is_an_offset() -> None:
    cell = Cell(1, amplitude=0.0, error=4.0)
    controller = ForceController(configured("none"), ("x",), PERIOD)
    controller.reset(cell.force)
    for _ in range(1500):
        cell.apply(controller.step(cell.force, cell.velocity, np.full((9, 1), 2.5)).command)
    assert abs(cell.force[0] - 2.5) > 0.01


# ---- bounds: margins, moves, joints


def ramp_of(config: ControllerConfig, on_own_model: Any, **others: Any) -> Any:
    """One axis from 2 to 6 N on the controller's own model."""
    moving = others.pop("moving", ())
    controller = ForceController(config, ("x",), PERIOD, moving=moving)
    return on_own_model(controller, [2.0], [6.0], 250, **others)


@pytest.mark.parametrize("margin", [0.0, 0.3])
def test_margin_keeps_the_force_away_from_its_bound(on_own_model: Any, margin: float) -> None:
    bounds = BoundsConfig(command=(-100.0, 100.0), force=(0.0, 5.0), force_margin=margin)
    trace = ramp_of(ControllerConfig(bounds=bounds), on_own_model)
    assert trace.force.max() <= 5.0 - margin + 1e-6
    assert trace.force[-1, 0] == pytest.approx(5.0 - margin, abs=1e-3)


@pytest.mark.parametrize("margin", [0.0, 0.004])
def test_margin_keeps_the_velocity_away_from_its_bound(on_own_model: Any, margin: float) -> None:
    bounds = BoundsConfig(velocity=(-0.02, 0.02), velocity_margin=margin)
    trace = ramp_of(ControllerConfig(bounds=bounds), on_own_model)
    assert trace.velocity.max() == pytest.approx(0.02 - margin, abs=1e-5)


@pytest.mark.parametrize("name", ["force", "velocity"])
def test_moved_bound_keeps_its_margin(on_own_model: Any, name: str) -> None:
    """Free at first; then a cap that closes, step by step ahead, and opens again."""
    caps = {"force": (4.0, 0.25), "velocity": (0.01, 0.002)}
    cap, margin = caps[name]
    bounds = BoundsConfig(command=(-100.0, 100.0), **{f"{name}_margin": margin})
    controller = ForceController(ControllerConfig(bounds=bounds), ("x",), PERIOD, moving=(name,))
    assert name in controller.general.problem.rows

    def before(k: int, force: Any, velocity: Any) -> None:
        if k == 0:
            upper = np.full((8, 1), np.inf)
            upper[5:] = cap  # from the sixth step of the horizon on
            controller.move(name, -cap, upper)
        elif k == 5:
            controller.move(name, np.array([-cap]), np.array([cap]))
        elif k == 150:
            controller.move(name, -np.inf, np.inf)

    trace = on_own_model(controller, [2.0], [6.0], 400, before=before)
    seen = getattr(trace, name)[:, 0]
    assert seen[8:150].max() == pytest.approx(cap - margin, abs=2e-3 * cap)
    assert seen[150:].max() > 1.2 * cap
    assert trace.force[-1, 0] == pytest.approx(6.0, abs=1e-2)
    problem = controller.general.problem
    controller.move(name, -cap, cap)
    low, high = problem.l, problem.u
    problem.update(np.zeros(problem.model.n_states), np.zeros(1), np.zeros((8, 1)))
    np.testing.assert_allclose((high - low)[problem.rows[name]], 2 * (cap - margin), rtol=1e-12)


def test_command_and_rate_can_be_moved(on_own_model: Any) -> None:
    controller = ForceController(ControllerConfig(), ("x",), PERIOD, moving=("command", "rate"))

    def before(k: int, force: Any, velocity: Any) -> None:
        controller.move("command", *((-3.0, 3.0) if k < 100 else (-20.0, 20.0)))
        controller.move("rate", *((-np.inf, np.inf) if k < 100 else (-0.5, 0.5)))

    commands = on_own_model(controller, [2.0], [9.0], 200, before=before).commands[:, 0]
    assert np.abs(commands[:100]).max() == pytest.approx(3.0)
    assert np.abs(np.diff(commands[100:])).max() <= 0.5 + 1e-9


def test_what_was_not_to_move_does_not(on_own_model: Any) -> None:
    bounds = BoundsConfig(force=(0.0, 5.0), force_margin=1.0)
    controller = ForceController(ControllerConfig(bounds=bounds), ("x",), PERIOD)
    controller.move("force", -1.0, 6.0)  # it has rows, so it can
    with pytest.raises(UnknownNameError, match="velocity"):
        controller.move("velocity", -1.0, 1.0)
    with pytest.raises(BoundsError, match="moving=True"):
        controller.move("rate", -1.0, 1.0)
    with pytest.raises(BoundsError, match="margin of 1 on both sides leaves no room"):
        controller.move("force", 1.0, 2.0)
    with pytest.raises(BoundsError, match="must contain 0"):
        controller.move("command", 1.0, 2.0)
    with pytest.raises(UnknownNameError, match="moving bound 'tangential'"):
        ForceController(ControllerConfig(), ("x",), PERIOD, moving=("tangential",))


def test_a_velocity_that_will_be_bounded_is_known_from_the_start() -> None:
    """The disturbance models that need no tool velocity get it as a state of its own."""
    for kind in ("constant", "ramp"):
        config = configured(kind)
        plain = ForceController(config, ("x",), PERIOD).general.problem.model
        moving = ForceController(config, ("x",), PERIOD, moving=("velocity",)).general
        assert moving.problem.model.n_states == plain.n_states + 1
        assert moving.observer.gain.shape[1] == 2


@dataclass
class Turning:
    """Joints whose maps turn with time: two arms' worth of speeds and torques on two axes."""

    k: int = 0

    @property
    def speed_gain(self) -> np.ndarray:
        angle = 0.01 * self.k
        return np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) * 2.0

    @property
    def speed_offset(self) -> np.ndarray:
        return np.array([0.005, -0.01])

    @property
    def command_gain(self) -> np.ndarray:
        return np.array([[0.5, 0.1], [0.2, -0.4]]) * (1.0 + 0.002 * self.k)

    @property
    def velocity_gain(self) -> np.ndarray:
        return np.array([[2.0, 0.0], [1.0, -3.0]])

    @property
    def force_gain(self) -> np.ndarray:
        return np.array([[0.1, 0.2], [0.0, 0.3]])

    @property
    def torque_offset(self) -> np.ndarray:
        return np.array([0.3, -0.2])

    @property
    def speed_limit(self) -> np.ndarray:
        return np.array([0.2, 0.3])

    @property
    def torque_limit(self) -> np.ndarray:
        return np.array([10.0, 8.0])

    def speed(self, velocity: np.ndarray) -> np.ndarray:
        return self.speed_gain @ velocity + self.speed_offset

    def torque(self, command: np.ndarray, velocity: np.ndarray, force: np.ndarray) -> np.ndarray:
        moved = self.command_gain @ command + self.velocity_gain @ velocity
        return moved + self.force_gain @ force + self.torque_offset


def joint_loop(on_own_model: Any, **shares: float) -> tuple[np.ndarray, np.ndarray, Any]:
    """Joint speeds and torques over their limits, ``(cycles, 2)``, while two axes go 4 N up."""
    joints, speeds, torques = Turning(), [], []
    config = ControllerConfig(bounds=BoundsConfig(joints=JointsConfig(**shares)))
    controller = ForceController(config, ("x", "y"), PERIOD, joints=joints)
    views = []

    def before(k: int, force: Any, velocity: Any) -> None:
        joints.k = k
        views.append((force, velocity))
        if controller.bounds_joints:
            controller.view(joints)

    trace = on_own_model(controller, [2.0, 3.0], [6.0, -1.0], 250, before=before)
    for k, ((force, velocity), step) in enumerate(zip(views, trace.steps, strict=True)):
        now = replace(joints, k=k)
        speeds.append(now.speed(velocity) / joints.speed_limit)
        torques.append(now.torque(step.command, velocity, force) / joints.torque_limit)
    return np.array(speeds), np.array(torques), trace


def test_joint_speeds_and_torques_are_bounded_as_the_arm_moves(on_own_model: Any) -> None:
    """Speeds are held where they are measured, torques where the command makes them."""
    speeds, torques, free = joint_loop(on_own_model)
    assert np.abs(speeds).max() > 0.5
    assert np.abs(torques).max() > 0.35
    held, _, trace = joint_loop(on_own_model, speed=0.3)
    assert np.abs(held[3:]).max() == pytest.approx(0.3, abs=5e-3)  # the map turns meanwhile
    _, held, _ = joint_loop(on_own_model, torque=0.25)
    assert np.abs(held).max() == pytest.approx(0.25, abs=1e-6)
    for run in (free, trace):
        np.testing.assert_allclose(run.force[-1], [6.0, -1.0], atol=1e-2)


def test_joints_are_looked_at_where_they_are_bounded() -> None:
    def make(**shares: float) -> ForceController:
        config = ControllerConfig(bounds=BoundsConfig(joints=JointsConfig(**shares)))
        return ForceController(config, ("x", "y"), PERIOD, joints=Turning())

    assert not make().bounds_joints
    assert set(make().general.problem.rows) == {"command"}
    for shares, names in (
        ({"speed": 1.0}, {"joint_speed"}),
        ({"torque": 1.0}, {"joint_torque"}),
        ({"speed": 1.0, "torque": 1.0}, {"joint_speed", "joint_torque"}),
    ):
        controller = make(**shares)
        assert controller.bounds_joints
        assert set(controller.general.problem.rows) == {"command"} | names
        controller.view(Turning(7))
        assert controller.general.problem.rows_changed
    config = ControllerConfig(bounds=BoundsConfig(joints=JointsConfig(speed=1.0)))
    with pytest.raises(BoundsError, match="tells nothing about its joints"):
        ForceController(config, ("x",), PERIOD)


# ---- the rest


def test_reset_starts_at_rest_with_the_force_given() -> None:
    config = configured()
    used, fresh = (ForceController(config, ("x", "z"), PERIOD) for _ in range(2))
    for k in range(5):
        used.step(np.array([1.0, k]), np.array([0.1, 0.2]), np.full((9, 2), 3.0))
        used.prepare()
    steps = []
    for controller in (used, fresh):
        controller.reset(np.array([2.0, 3.0]))
        force = controller.general.problem.model.C @ controller.general.observer.state
        np.testing.assert_array_equal(force, [2.0, 3.0])
        assert np.count_nonzero(controller.general.observer.state) == 2
        steps.append(
            controller.step(np.array([2.1, 3.0]), np.array([0.0, 0.01]), np.full((9, 2), 3.0))
        )
    np.testing.assert_allclose(steps[0].command, steps[1].command, rtol=1e-9)


@pytest.mark.parametrize(("patience", "lost"), [(0.0, Status.FAILED), (0.04, Status.SOLVED)])
def test_lost_measurement_is_one_of_one_cycle(patience: float, lost: Status) -> None:
    config = changed(ControllerConfig(), "observer.patience", patience)
    controller = ForceController(config, ("x",), PERIOD)
    controller.reset(np.array([2.0]))
    good = np.array([2.0]), np.zeros(1), np.full((9, 1), 2.2)
    statuses = [controller.step(*good).status]
    statuses.append(controller.step(np.array([np.nan]), *good[1:]).status)
    statuses.append(controller.step(good[0], np.array([np.inf]), good[2]).status)
    statuses.append(controller.step(*good).status)
    assert statuses == [Status.SOLVED, lost, lost, Status.SOLVED]


@pytest.mark.parametrize(
    ("path", "value", "error"),
    [
        ("horizon", 0, ModelError),
        ("control_horizon", 9, ModelError),
        ("decision", "relative", UnknownNameError),
        ("force_weight", -1.0, ModelError),
        ("increment_weight", 0.0, ModelError),
        ("reference_time", -1.0, ModelError),
        ("model.stiffness", 0.0, ModelError),
        ("model.velocity_damping", -1.0, ModelError),
        ("model.delay", -1, ModelError),
        ("model.lag", -1.0, ModelError),
        ("observer.disturbance", "fuse", UnknownNameError),
        ("observer.force_noise", 0.0, QpmpcError),
        ("bounds.command", (5.0, 6.0), BoundsError),
        ("bounds.rate", (-6.0, -5.0), BoundsError),
        ("bounds.force", PerAxis(x=(2.0, 1.0)), BoundsError),
        ("bounds.order", ("velocity", "force"), BoundsError),
        ("bounds.tangential.limit", 1.0, BoundsError),
        ("bounds.tangential.friction", 0.3, BoundsError),
        ("bounds.joints.speed", 0.5, BoundsError),
        ("solver.max_iterations", 0, QpmpcError),
        ("solver.time_limit", -1.0, QpmpcError),
        ("solver.deadline", 0.0, ModelError),
        ("solver.deadline", float("nan"), ModelError),
        ("bounds.velocity", (0.1, -0.1), BoundsError),
    ],
)
def test_out_of_range(path: str, value: Any, error: type[Exception]) -> None:
    with pytest.raises(error):
        ForceController(changed(ControllerConfig(), path, value), ("x",), PERIOD)


def test_unknown_axis() -> None:
    with pytest.raises(UnknownNameError, match="unknown axis 'w'"):
        ForceController(ControllerConfig(), ("w",), PERIOD)  # type: ignore[arg-type]
