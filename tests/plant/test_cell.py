"""The cell on the real physics: equilibrium, contact, delay, lag, brakes, records, errors."""

from __future__ import annotations

from dataclasses import fields, is_dataclass, replace
from typing import get_args, get_type_hints

import mujoco
import numpy as np
import pytest

from plant import BristleConfig, CellConfig, PlantError
from plant.config import ContactLaw
from plant.viper import CONTACT_POINT, VIPER_S650

PERIOD = 1e-3
FORCE = np.array([1.0, 2.0, -10.0])


def leaves(kind, path=()):
    """Paths of all plain fields below a record."""
    for field in fields(kind):
        inner = get_type_hints(kind)[field.name]
        here = (*path, field.name)
        yield from leaves(inner, here) if is_dataclass(inner) else [here]


def other(value, kind):
    """A value near to ``value`` and different from it."""
    if kind == ContactLaw:
        return "standard_linear_solid"
    if isinstance(value, str):
        return next(name for name in reversed(get_args(kind)) if name != value)
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + 1
    return 1.1 * value if value else 1.0


def altered(record, path):
    name, *rest = path
    value = getattr(record, name)
    if rest:
        return replace(record, **{name: altered(value, rest)})
    return replace(record, **{name: other(value, get_type_hints(type(record))[name])})


# --- start ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("force", [(0, 0, 0), (1, 2, -10), (-5, 3, -18)])
@pytest.mark.parametrize("damping", [0.0, 10.0])
def test_a_perfect_cell_starts_in_equilibrium(force, damping, perfect_run, still):
    trace = perfect_run(still(200), 0.0, force, damping=damping)
    np.testing.assert_allclose(trace.force, np.tile(force, (200, 1)), atol=1e-6)


def test_the_realistic_cell_starts_near_its_equilibrium(realistic, make_cell, still, drive):
    """A wrong model of inertia is a wrong model of weight: friction bears the difference."""
    trace = drive(make_cell(realistic(), still(200)), 0.0)
    np.testing.assert_allclose(trace.force, np.tile(FORCE, (200, 1)), atol=2e-3)


def test_the_start_is_the_first_sample_of_the_motion(perfect, make_cell, beating):
    motion = beating(5, phase=0.9)
    cell = make_cell(perfect(), motion)
    measurement, truth = cell.measure(), cell.truth()
    np.testing.assert_allclose(truth.tissue, CONTACT_POINT.si + motion.position[0], atol=1e-8)
    np.testing.assert_allclose(measurement.force, FORCE, atol=1e-5)
    np.testing.assert_allclose(measurement.velocity, 0.0, atol=1e-12)
    surface = surface_velocity(cell)
    np.testing.assert_allclose(surface, motion.velocity[0], atol=1e-8)
    assert measurement.time == 0.0
    assert np.abs(motion.velocity[0]).min() > 0.01


@pytest.mark.parametrize("delay", [0, 3])
def test_a_moved_tool_is_at_rest_in_its_new_place(delay, perfect, make_cell, still, drive):
    cell = make_cell(perfect(delay=delay), still(100))
    place = np.array([-1e-3, 1e-3, -2e-3])
    cell.move_tool(place)
    trace = drive(cell, 0.0, cycles=20)
    np.testing.assert_allclose(
        trace.position[:5] - CONTACT_POINT.si, np.tile(place, (5, 1)), atol=1e-7
    )
    assert np.abs(trace.velocity).max() < 1e-3


# --- contact -------------------------------------------------------------------------------------


def surface_velocity(cell) -> np.ndarray:
    velocity = np.zeros(6)
    site = cell.model.site("heart_surface").id
    mujoco.mj_objectVelocity(cell.model, cell.data, mujoco.mjtObj.mjOBJ_SITE, site, velocity, 0)
    return velocity[3:]


@pytest.mark.parametrize(("stiffness", "damping"), [(2500.0, 0.0), (600.0, 15.0)])
def test_the_contact_is_a_spring_and_a_damper_per_axis(
    stiffness, damping, realistic, make_cell, beating
):
    """y = K (x_tool - x_tissue) + D (v_tool - v_tissue), at the very instant of the measurement."""
    cell = make_cell(realistic(stiffness=stiffness, damping=damping, model="ideal"), beating(150))
    largest = 0.0
    for k in range(150):
        measurement, truth = cell.measure(), cell.truth()
        relative = measurement.velocity - surface_velocity(cell)
        expected = stiffness * (measurement.position - truth.tissue) + damping * relative
        np.testing.assert_allclose(truth.force, expected, atol=1e-9)
        assert np.array_equal(measurement.force, truth.force)  # an ideal sensor
        largest = max(largest, float(np.abs(damping * relative).max()))
        cell.apply(np.array([3.0, -2.0, 4.0]) * np.sin(0.1 * k))
    assert largest > 0.5 or damping == 0.0


@pytest.mark.parametrize("axis", range(3), ids="xyz")
def test_the_tool_presses_the_heart_away(axis, perfect, make_cell, still, drive):
    """With the tool locked, a heart that is pressed upon gives way along the force."""
    force = 10.0 * np.eye(3)[axis]
    cell = make_cell(perfect(), still(300), force=np.zeros(3))
    cell.move_tool(force / 2500.0)
    cell.close_brakes()
    trace = drive(cell, 0.0)
    sag = trace.tissue[-1, axis] - trace.tissue[0, axis]
    assert 5e-6 < sag < 2e-4


# --- delay and lag -------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0, 1, 2, 5])
@pytest.mark.parametrize("lag", [0.0, 0.002])
def test_a_command_arrives_after_the_delay_and_not_earlier(delay, lag, perfect_run, beating):
    sent, n = 7, 20
    flaws = {
        "delay": delay,
        "torque_lag": lag,
        "friction": 1.0,
        "friction_compensation": 0.8,
    }
    quiet = perfect_run(beating(n), 0.0, **flaws)
    pushed = perfect_run(beating(n), lambda k: 5.0 if k == sent else 0.0, **flaws)
    differs = (quiet.velocity != pushed.velocity).any(axis=1)
    # Measured at k + 1: the velocity that the torque of cycle k has caused.
    assert not differs[: sent + delay + 1].any()
    assert differs[sent + delay + 1]
    gained = np.abs(pushed.velocity - quiet.velocity)[sent + delay + 1]
    assert gained.max() > 1e-4


@pytest.mark.parametrize("lag", [0.001, 0.005])
def test_torque_follows_its_command_with_a_first_order_lag(lag, perfect, make_cell, still, drive):
    config = perfect(torque_lag=lag, velocity_damping=0.0, stiffness=1e-3)
    trace = drive(make_cell(config, still(20), force=np.zeros(3)), (1.0, -1.0, 1.0))
    t = PERIOD * np.arange(20)
    speed = t - lag * (1.0 - np.exp(-t / lag))
    np.testing.assert_allclose(trace.velocity, np.outer(speed, [1, -1, 1]), atol=1e-4)


# --- the motion ----------------------------------------------------------------------------------


def test_the_heart_follows_its_motion_under_load(realistic, make_cell, beating, drive):
    """Tool locked; 10 N on z to start with, and up to 22 N as the heart comes up."""
    motion = beating(700)
    cell = make_cell(realistic(), motion)
    cell.move_tool(FORCE / 2500.0)
    cell.close_brakes()
    trace = drive(cell, 0.0)
    error = trace.tissue - CONTACT_POINT.si - motion.position
    light = np.abs(trace.force[:, 2]) < 10.0
    assert np.abs(error).max() < 2e-4
    assert np.abs(error[light]).max() < 1.5e-4
    assert light.any()
    assert np.abs(trace.force[:, 2]).max() > 15.0


def test_brakes_hold_the_tool_while_the_heart_moves(realistic, make_cell, beating, drive):
    runs = []
    for command in (0.0, 10.0):
        cell = make_cell(realistic(), beating(300))
        cell.close_brakes()
        runs.append(drive(cell, command))
        assert np.ptp(runs[-1].position, axis=0).max() < 1e-6
        assert np.ptp(runs[-1].force, axis=0).min() > 3.0
    # Nothing that is commanded matters.
    np.testing.assert_allclose(runs[0].force, runs[1].force, atol=1e-3)


def test_without_brakes_the_same_command_moves_the_tool(realistic, make_cell, beating, drive):
    trace = drive(make_cell(realistic(), beating(300)), 10.0)
    assert np.ptp(trace.position, axis=0).min() > 1e-3


def test_the_end_of_the_motion_is_told(perfect, make_cell, still):
    cell = make_cell(perfect(), still(3))
    for _ in range(3):
        cell.measure()
        cell.apply(np.zeros(3))
    assert cell.measure().time == pytest.approx(3 * PERIOD)
    with pytest.raises(PlantError, match="motion ended after 3 cycles"):
        cell.apply(np.zeros(3))


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axis", range(3), ids="xyz")
def test_a_command_that_is_no_number_is_refused_and_moves_nothing(
    wrong, axis, perfect, make_cell, still
):
    """With protection it is no command but no error either: see test_protection."""
    cell = make_cell(perfect(enabled=False), still(3))
    before = cell.measure()
    with pytest.raises(PlantError, match=r"t = 0\.000 s"):
        cell.apply(np.where(np.arange(3) == axis, wrong, 0.0))
    assert np.array_equal(cell.measure().position, before.position)
    assert cell.measure().time == 0.0


# --- measurement and truth -----------------------------------------------------------------------


def test_a_measurement_keeps_its_arrays(realistic, make_cell, beating):
    cell = make_cell(realistic(), beating(20))
    first = cell.measure()
    truth = cell.truth()
    names = ("force", "position", "velocity")
    kept = {name: getattr(first, name).copy() for name in names}
    kept_truth = truth.force.copy(), truth.tissue.copy(), truth.torque.copy()
    for _ in range(10):
        cell.apply(np.ones(3))
        cell.measure()
    for name in names:
        assert np.array_equal(getattr(first, name), kept[name])
    for now, then in zip((truth.force, truth.tissue, truth.torque), kept_truth, strict=True):
        assert np.array_equal(now, then)


def test_the_truth_is_that_of_the_measurement_also_after_apply(realistic, make_cell, beating):
    cell = make_cell(realistic(model="ideal"), beating(20))
    for _ in range(20):
        measurement = cell.measure()
        before = cell.truth()
        cell.apply(np.ones(3))
        after = cell.truth()
        assert np.array_equal(before.force, after.force)
        assert np.array_equal(before.tissue, after.tissue)
        spring = 2500.0 * (measurement.position - after.tissue)
        np.testing.assert_allclose(after.force, spring, atol=1e-9)


def test_who_overwrites_a_measurement_does_not_touch_the_plant(
    realistic, make_cell, beating, drive
):
    honest = drive(make_cell(realistic(), beating(20)), 1.0)
    cell = make_cell(realistic(), beating(20))
    for k in range(20):
        measurement = cell.measure()
        assert np.array_equal(measurement.force, honest.read[k])
        assert np.array_equal(measurement.velocity, honest.velocity[k])
        for array in (measurement.force, measurement.position, measurement.velocity):
            array[:] = 99.0
        cell.apply(np.ones(3))


def test_velocity_is_that_of_the_positions(perfect, make_cell, still, drive):
    trace = drive(make_cell(perfect(), still(60)), lambda k: 3.0 * np.sin(0.05 * k) * np.ones(3))
    slope = (trace.position[2:] - trace.position[:-2]) / (2 * PERIOD)
    np.testing.assert_allclose(trace.velocity[1:-1], slope, atol=2.5e-4)  # a physics step


def test_time_counts_the_periods(realistic, make_cell, beating, drive):
    trace = drive(make_cell(realistic(), beating(5)), 0.0)
    assert [m.time for m in trace.measured] == pytest.approx([0, 1e-3, 2e-3, 3e-3, 4e-3])


def test_torques_are_cut_at_their_limits_and_it_is_told(perfect, make_cell, still, drive):
    limit = VIPER_S650.torque_limit.si
    gentle = drive(make_cell(perfect(), still(5)), 1.0)
    assert not gentle.saturated.any()
    assert (np.abs(gentle.torque) < limit).all()
    violent = drive(make_cell(perfect(enabled=False), still(5)), 300.0)
    assert violent.saturated.any()
    assert (np.abs(violent.torque) <= limit).all()
    on_limit = (np.abs(violent.torque) == limit).any(axis=1)
    assert np.array_equal(on_limit, violent.saturated)


def test_commands_reach_the_inner_loop_in_steps(perfect, make_cell, still, drive):
    cell = perfect(command_resolution=0.25)

    def run(command):
        return drive(make_cell(cell, still(20)), command)

    assert run(1.1).equals(run(1.0))
    assert run(-0.13).equals(run(-0.25))
    assert run(0.12).equals(run(0.0))
    assert not run(1.2).equals(run(1.0))
    assert not drive(make_cell(perfect(), still(20)), 1.1).equals(run(1.1))


# --- records and seeds ---------------------------------------------------------------------------


def excited(config, make_cell, beating, drive, seed=0):
    """Axes with and without force control, a moving heart, a command that reverses."""
    systole = np.linspace(0.0, 1.0, 40)
    cell = make_cell(config, beating(40), axes=["x", "z"], seed=seed, contraction=systole)
    return drive(cell, lambda k: np.array([6.0, 0.0, -8.0]) * np.cos(0.3 * k))


HUNT_CROSSLEY = {"law": "hunt_crossley", "unilateral": True}
BASE = {
    "relaxation": {"law": "standard_linear_solid"},
    "relaxation_time": {"law": "standard_linear_solid"},
    "exponent": HUNT_CROSSLEY,
    "reference_depth": HUNT_CROSSLEY,
    "dissipation": HUNT_CROSSLEY,
    "static": HUNT_CROSSLEY | {"bristles": BristleConfig(0.23, 0.2)},
    "kinetic": HUNT_CROSSLEY | {"bristles": BristleConfig(0.23, 0.2)},
    "stribeck_velocity": HUNT_CROSSLEY | {"bristles": BristleConfig(0.23, 0.2)},
    "break_away": HUNT_CROSSLEY | {"bristles": BristleConfig(0.26, 0.26, break_away=0.3)},
    "unilateral": {"stiffness": 1e5, "enabled": False},
    "gap": {"unilateral": True, "gap": 0.002},
    "spike_rate": {"spike_rate": 150.0},
    "spike_size": {"spike_rate": 150.0},
    "dropout_rate": {"dropout_rate": 100.0, "dropout_time": 0.002},
    "dropout_time": {"dropout_rate": 100.0, "dropout_time": 0.01},
    "stribeck_speed": {"stribeck": 0.5},
    "torque_limit": {"torque_limit": 0.2},
    "joint_frequency": {"joint_frequency": 20.0},
    "joint_damping": {"joint_frequency": 20.0},
    "delay_jitter": {"delay_jitter": 0.5},
    "tip_mass": {"tip_mass": 0.05},
}
"""Where a field needs more than the default for its effect, or has an end: here the tool lifts off,
there its motors saturate."""


CALM = [
    path
    for path in leaves(CellConfig)
    if path[0] not in ("protection", "arm") and not path[-1].startswith("posture")
]
"""All but what has an effect in distress only, see test_protection, and what is about other arms,
see test_own_arm and test_redundant."""


@pytest.mark.parametrize("path", CALM, ids=".".join)
def test_every_field_of_the_records_has_an_effect(path, realistic, make_cell, beating, drive):
    config = realistic(**BASE.get(path[-1], {}))
    usual = excited(config, make_cell, beating, drive)
    changed = excited(altered(config, path), make_cell, beating, drive)
    assert not usual.equals(changed)


def test_the_same_seed_gives_the_same_run_bit_for_bit(realistic, make_cell, beating, drive):
    first, again, another = (
        excited(realistic(), make_cell, beating, drive, seed) for seed in (4, 4, 5)
    )
    assert first.equals(again)
    assert not np.array_equal(first.read, another.read)
    assert not np.array_equal(first.position, another.position)
    assert np.array_equal(first.force[0], another.force[0])


def test_the_seed_only_concerns_the_sensor(perfect, make_cell, beating, drive):
    runs = [excited(perfect(), make_cell, beating, drive, seed) for seed in (4, 5)]
    assert runs[0].equals(runs[1])
