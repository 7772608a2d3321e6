"""The loop joins any plant with the small interface to the force controller."""

from __future__ import annotations

import gc
import time

import numpy as np
import pytest

from plant.interface import JointSpace, Measurement, Truth
from qpmpc.config import BoundsConfig, ControllerConfig, JointsConfig, ModelConfig, ObserverConfig
from qpmpc.force_control import ForceController
from scenarios import (
    AxesChange,
    BoundsStep,
    Log,
    Scenario,
    ScenarioError,
    Schedule,
    Setpoint,
    SetpointConfig,
    SetpointStep,
    control_loop,
    watch_loop,
)

PERIOD, STIFFNESS, DAMPING = 1e-3, 1000.0, 20.0
BOUND = 20.0


class Springs:
    """Somebody's own plant: a damped unit mass per axis, pressed on a spring that swings."""

    period = PERIOD

    def __init__(self, swing=0.0, faulty_at=None):
        self.k, self.x, self.v = 0, np.array([1.0, 2.0, -10.0]) / STIFFNESS, np.zeros(3)
        self.swing, self.faulty_at, self.commands = swing, faulty_at, []

    def measure(self):
        if self.k == self.faulty_at:
            raise RuntimeError("sensor lost")
        self.tissue = np.full(3, self.swing * np.sin(8.0 * self.k * PERIOD))
        self.force = STIFFNESS * (self.x - self.tissue)
        return Measurement(self.k * PERIOD, self.force.copy(), self.x.copy(), self.v.copy())

    def apply(self, command):
        self.commands.append(command.copy())
        self.x = self.x + PERIOD * self.v
        self.v = self.v + PERIOD * (command - DAMPING * self.v)
        self.k += 1

    def truth(self):
        return Truth(self.force.copy(), self.tissue.copy(), np.zeros(6), False)


class Exact(Springs):
    """The model itself as a plant: exact hold, whole cycles of delay, tissue at rest."""

    def __init__(self, delay):
        super().__init__()
        self.line = [np.zeros(3)] * delay

    def apply(self, command):
        self.line = [*self.line, command.copy()]
        u, self.line = self.line[0], self.line[1:]
        decay = np.exp(-DAMPING * PERIOD)
        final = u / DAMPING
        self.x = self.x + final * PERIOD + (self.v - final) * (1.0 - decay) / DAMPING
        self.v = final + (self.v - final) * decay
        self.k += 1


class Bench:
    """Controller, setpoint and log for a plant."""

    def __init__(
        self,
        cycles=1000,
        *,
        axes=("x", "y", "z"),
        steps=(),
        disturbance="constant",
        delay=0,
        bounds=None,
        bounds_steps=(),
        joints=None,
    ):
        config = ControllerConfig(
            model=ModelConfig(stiffness=STIFFNESS, velocity_damping=DAMPING, delay=delay, lag=0.0),
            observer=ObserverConfig(disturbance=disturbance),
            bounds=bounds or BoundsConfig(),
        )
        self.schedule = Schedule(
            Scenario(
                "bench",
                duration=cycles * PERIOD,
                axes=axes,
                controller=config,
                bounds_steps=bounds_steps,
            )
        )
        self.controller = ForceController(
            config, axes, PERIOD, joints=joints, moving=self.schedule.moving
        )
        self.setpoint = Setpoint(SetpointConfig(steps=steps), axes, cycles, 8, PERIOD)
        self.controller.reset(self.setpoint.force[0])
        self.log = Log(cycles, axes, tuple(self.controller.general.problem.rows))
        self.cycles, self.reports = cycles, []

    def run(self, plant, stop=lambda: False, watch=None):
        return control_loop(
            plant,
            self.controller,
            self.setpoint,
            self.log,
            self.cycles,
            schedule=self.schedule,
            watch=watch,
            progress=lambda done, total: self.reports.append((done, total)),
            stop=stop,
        )


@pytest.mark.parametrize("disturbance", ["constant", "ramp", "fused"])
def test_any_plant_with_the_interface_is_controlled(disturbance):
    plant, bench = Springs(swing=2e-3), Bench(disturbance=disturbance)
    assert bench.run(plant)
    error = np.abs(bench.log.force - bench.setpoint.force[:1000])
    assert error[300:].max() < 0.05
    assert 1e3 * plant.swing > 20 * 0.05  # what the swing alone would do
    assert bench.log.cycles == 1000


def test_a_step_of_the_setpoint_is_reached():
    plant, bench = Springs(), Bench(cycles=600, steps=(SetpointStep(0.2, x=3.0, z=-5.0),))
    bench.run(plant)
    np.testing.assert_allclose(bench.log.force[190], [1.0, 2.0, -10.0], atol=1e-3)
    assert bench.log.force[199, 2] > -9.9  # the preview lets it begin ahead
    np.testing.assert_allclose(bench.log.force[-1], [3.0, 2.0, -5.0], atol=0.02)


@pytest.mark.parametrize("delay", [0, 1, 3])
@pytest.mark.parametrize("disturbance", ["none", "constant", "ramp", "fused"])
def test_in_closed_loop_the_predicted_force_is_the_force_that_comes(disturbance, delay):
    """On its own model, to rounding: Theta's diagonal, the delay, K_s and K2 are all in here."""
    steps = (SetpointStep(0.05, x=3.0, y=1.0, z=-7.0),)
    bench = Bench(cycles=200, steps=steps, disturbance=disturbance, delay=delay)
    assert bench.run(Exact(delay))
    log = bench.log
    np.testing.assert_allclose(log.force_predicted[:-1], log.force[1:], atol=1e-8)
    assert np.abs(np.diff(log.command, axis=0)).max() > 1.0


@pytest.mark.parametrize("axes", [("z",), ("y", "x"), ("z", "x", "y")])
def test_columns_of_the_controller_meet_the_axes_of_the_plant(axes):
    steps = (SetpointStep(0.1, x=3.0, y=4.0, z=-5.0),)
    plant, bench = Springs(), Bench(cycles=500, axes=axes, steps=steps)
    bench.run(plant)
    goal = {"x": (1.0, 3.0), "y": (2.0, 4.0), "z": (-10.0, -5.0)}
    expected = [goal[axis][axis in axes] for axis in "xyz"]
    np.testing.assert_allclose(bench.log.force[-1], expected, atol=0.05)
    index = ["xyz".index(axis) for axis in axes]
    commands = np.array(plant.commands)
    assert np.array_equal(commands[:, index], bench.log.command)
    assert not np.delete(commands, index, axis=1).any()


def test_rows_of_the_log_belong_together():
    plant, bench = Springs(swing=1e-3), Bench(cycles=50, steps=(SetpointStep(0.02, z=-9.0),))
    bench.run(plant)
    log = bench.log
    np.testing.assert_allclose(log.time, PERIOD * np.arange(50))
    np.testing.assert_allclose(log.force, STIFFNESS * (log.tool - log.tissue))
    assert np.array_equal(log.force, log.force_measured)
    assert np.array_equal(log.setpoint, bench.setpoint.force[:50])
    slope = (log.tool[1:] - log.tool[:-1]) / PERIOD
    np.testing.assert_allclose(log.tool_velocity[:-1], slope, atol=1e-12)
    np.testing.assert_allclose(  # u(k) leads from v(k) to v(k + 1)
        log.tool_velocity[1:] - log.tool_velocity[:-1],
        PERIOD * (log.command - DAMPING * log.tool_velocity)[:-1],
        atol=1e-12,
    )
    assert log.status_counts() == {"solved": 50}
    assert (log.solve_time > 0).all()
    assert (log.cycle_time >= log.solve_time).all()
    assert (log.plant_time > 0).all()


def test_a_command_on_its_bound_counts_as_saturated():
    plant, bench = Springs(), Bench(cycles=300, steps=(SetpointStep(0.1, z=-30.0),))
    bench.run(plant)
    on_bound = (np.abs(bench.log.command) == BOUND).any(axis=1)
    assert np.array_equal(bench.log.command_saturated, on_bound)
    assert 0 < on_bound.sum() < 300


def test_it_stops_when_asked_and_says_so():
    plant, bench = Springs(), Bench()
    assert not bench.run(plant, stop=lambda: plant.k >= 321)
    assert bench.log.cycles == plant.k == 321
    assert bench.reports[-1][0] < 321
    assert bench.log.table().num_rows == 321


def test_progress_runs_from_nothing_to_all():
    bench = Bench()
    bench.run(Springs())
    done = [d for d, _ in bench.reports]
    assert done[0] == 0
    assert done[-1] == 1000
    assert done == sorted(done)
    assert len(done) > 3
    assert {total for _, total in bench.reports} == {1000}


def test_who_watches_sees_every_step_and_costs_the_cycle_no_time():
    bench, seen = Bench(cycles=12), []

    def watch(step):
        time.sleep(0.005)
        # While it watches, the problem still holds the vectors of this step.
        assert bench.controller.general.problem.q.any() == (bench.log.cycles > 1)
        seen.append((step, bench.log.cycles))

    plant = Springs(swing=1e-3)
    bench.run(plant, watch=watch)
    assert [cycles for _, cycles in seen] == list(range(1, 13))
    assert np.array_equal([step.command for step, _ in seen], bench.log.command)
    assert np.median(bench.log.cycle_time) < 0.005


def test_bounds_that_move_reach_the_controller_with_their_preview(monkeypatch):
    """Where they are due, and in cycles where nothing changes nobody is bothered."""
    steps = (
        BoundsStep(0.020, ramp=0.005, force=AxesChange(z=(-9.0, np.inf))),
        BoundsStep(0.040, velocity=(-0.01, 0.01)),
    )
    bench = Bench(cycles=60, bounds_steps=steps)
    moved, plant = [], Springs()
    move = bench.controller.move

    def note(name, lower, upper):
        moved.append((plant.k, name, lower.copy(), upper.copy()))
        move(name, lower, upper)

    monkeypatch.setattr(bench.controller, "move", note)
    bench.run(plant)
    due = np.flatnonzero(bench.schedule.due)
    assert [(k, name) for k, name, _, _ in moved] == [
        (k, name) for k in due for name in ("force", "velocity")
    ]
    for k, name, *sides in moved:
        for side, expected in zip(sides, bench.schedule.preview(name, k), strict=True):
            assert np.array_equal(side, expected)
    assert bench.log.force[26:, 2].min() > -9.0 - 1e-3
    assert np.abs(bench.log.tool_velocity[40:]).max() < 0.01 * (1 + 1e-3)


class Jointed(Springs):
    """Springs whose three joints are its axes, geared differently at every instant."""

    @staticmethod
    def ratio(k):
        return 10.0 + 5.0 * np.sin(0.03 * k)

    def joint_space(self, force, previous):
        self.asked = [*getattr(self, "asked", []), (self.k, force.copy(), previous.copy())]
        return self.space()

    def space(self):
        gear = np.vstack([np.eye(3), np.zeros((3, 3))]) * self.ratio(self.k)
        nothing, ones = np.zeros((6, 3)), np.ones(6)
        return JointSpace(gear, 0 * ones, nothing, nothing, nothing, 0 * ones, ones, ones)


def test_a_plant_that_knows_its_joints_is_asked_in_every_cycle_if_they_are_bounded():
    steps, plant = (SetpointStep(0.02, x=30.0, y=-20.0, z=-60.0),), Jointed()
    bench = Bench(
        cycles=120, steps=steps, bounds=BoundsConfig(joints=JointsConfig(speed=0.5)),
        joints=plant.space(),
    )  # fmt: skip
    bench.run(plant)
    assert [k for k, _, _ in plant.asked] == list(range(120))
    for k, force, previous in plant.asked:
        assert np.array_equal(force, bench.log.force_measured[k])
        assert np.array_equal(previous, bench.log.command[k - 1] if k else np.zeros(3))
    speed = np.abs(Jointed.ratio(np.arange(120))[:, None] * bench.log.tool_velocity)
    assert np.median(speed[30:60].max(axis=1)) > 0.49
    assert speed.max() < 0.51  # in one cycle the gear changes by 1.5 %


def test_a_plant_that_does_not_know_its_joints_is_refused_where_they_are_bounded():
    plant = Springs()
    bench = Bench(
        cycles=5, bounds=BoundsConfig(joints=JointsConfig(speed=0.5)), joints=Jointed().space()
    )
    with pytest.raises(ScenarioError, match="joints"):
        bench.run(plant)
    assert not plant.commands


def test_a_plant_that_knows_its_joints_is_not_asked_if_nothing_bounds_them():
    plant, bench = Jointed(), Bench(cycles=20)
    bench.run(plant)
    assert not hasattr(plant, "asked")


def test_watching_writes_the_force_and_commands_nothing():
    plant, force, reports = Springs(swing=1e-3), np.full((400, 3), np.nan), []
    assert watch_loop(
        plant, force, 400, progress=lambda *now: reports.append(now), stop=lambda: False
    )
    t = PERIOD * np.arange(400)
    expected = np.array([1.0, 2.0, -10.0]) - STIFFNESS * 1e-3 * np.sin(8.0 * t)[:, None]
    np.testing.assert_allclose(force, expected, atol=1e-9)
    assert not np.array(plant.commands).any()
    assert reports[-1] == (400, 400)


def test_watching_stops_when_asked():
    plant, force = Springs(), np.full((400, 3), np.nan)
    stopped = watch_loop(plant, force, 400, progress=lambda *_: None, stop=lambda: plant.k == 7)
    assert not stopped
    assert np.isfinite(force[:7]).all()
    assert np.isnan(force[7:]).all()


@pytest.mark.parametrize("enabled", [True, False])
@pytest.mark.parametrize("faulty_at", [None, 5])
def test_the_garbage_collector_is_left_as_it_was(enabled, faulty_at):
    bench, plant = Bench(cycles=20), Springs(faulty_at=faulty_at)
    seen = []
    was, frozen = gc.isenabled(), gc.get_freeze_count()
    (gc.enable if enabled else gc.disable)()
    try:
        if faulty_at is None:
            bench.run(plant, stop=lambda: seen.append(gc.isenabled()))
        else:
            with pytest.raises(RuntimeError, match="sensor lost"):
                bench.run(plant, stop=lambda: seen.append(gc.isenabled()))
        after = gc.isenabled(), gc.get_freeze_count()
    finally:
        (gc.enable if was else gc.disable)()
    assert after == (enabled, frozen)
    assert not any(seen)  # quiet while it ran
