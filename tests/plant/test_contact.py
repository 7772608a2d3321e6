"""The unilateral contact on the real physics: approach, touch-down, stick, slip, lift-off."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from plant import Cell, ContactConfig, PlantError
from plant.contact import Contact
from plant.memory import layout
from plant.tissue import GRIP
from plant.viper import CONTACT_POINT

K = 2500.0
GAP = 0.002
DOWN = np.array([0.0, 0.0, -2.0])


def offset(trace) -> np.ndarray:
    """Of the tool from the tissue."""
    return trace.position - trace.tissue


def journey(k: int) -> np.ndarray:
    """Down while drifting aside, aside in contact, up, aside, straight down, aside again."""
    if k < 60:
        return np.array([0.6, -0.5, -2.0])
    if k < 120:
        return np.array([-0.6, 0.5, 0.0])
    if k < 240:
        return np.array([0.0, 0.0, 1.5])
    if k < 300:
        return np.array([1.0, 0.3, 0.0])
    if k < 460:
        return np.array([0.0, 0.0, -1.2])
    return np.array([-0.6, 0.3, 0.0])


@pytest.fixture(scope="module")
def travelled(perfect, make_cell, still, drive):
    config = perfect(unilateral=True, gap=GAP, model="ideal")
    return drive(make_cell(config, still(520)), journey)


# --- start ---------------------------------------------------------------------------------------


def test_a_gap_is_a_tool_at_rest_above_the_tissue(perfect, make_cell, beating):
    motion = beating(5, phase=0.9)
    cell = make_cell(perfect(unilateral=True, gap=GAP), motion)
    measurement, truth = cell.measure(), cell.truth()
    np.testing.assert_allclose(
        measurement.position, CONTACT_POINT.si + motion.position[0] + [0, 0, GAP], atol=1e-8
    )
    assert not truth.touching
    assert not truth.force.any()
    assert not measurement.velocity.any()


def test_nothing_leans_or_falls_without_contact(perfect, make_cell, still, drive):
    trace = drive(make_cell(perfect(unilateral=True, gap=GAP), still(200)), 0.0)
    assert not trace.touching.any()
    assert np.ptp(trace.tissue, axis=0).max() < 1e-9
    assert np.ptp(trace.position, axis=0).max() < 1e-6


@pytest.mark.parametrize("damping", [0.0, 10.0])
def test_in_contact_it_starts_and_goes_on_as_a_bilateral_one(
    damping, realistic, make_cell, beating, drive
):
    runs = [
        drive(
            make_cell(realistic(unilateral=unilateral, damping=damping), beating(200, scale=0.4)),
            lambda k: 2.0 * np.array([1.0, -1.0, 1.0]) * np.sin(0.1 * k),
        )
        for unilateral in (False, True)
    ]
    np.testing.assert_allclose(runs[0].force, runs[1].force, rtol=0, atol=1e-9)
    assert runs[0].touching.all()
    assert runs[1].touching.all()
    assert np.ptp(runs[0].force, axis=0).min() > 1.0


@pytest.mark.parametrize(
    ("contact", "force", "message"),
    [
        ({"gap": GAP}, (0, 0, -10), "needs cell.contact.unilateral"),
        ({"unilateral": True}, (0, 0, 5), "it only pushes"),
        ({"unilateral": True}, (6, 6, -7), "sideways"),
    ],
)
def test_an_impossible_start_is_refused(contact, force, message, perfect, still):
    with pytest.raises(PlantError, match=message):
        Cell(perfect(**contact), still(5), force=np.array(force, dtype=float), seed=0)


def test_with_a_gap_the_force_is_not_asked_for(perfect, make_cell, still):
    cell = make_cell(perfect(unilateral=True, gap=GAP), still(5), force=np.array([0, 0, 5.0]))
    assert not cell.measure().force.any()


# --- approach and retreat ------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.0, 10.0])
def test_no_force_before_the_surface_and_a_spring_below_it(
    damping, perfect, make_cell, still, drive
):
    config = perfect(unilateral=True, gap=GAP, damping=damping)
    trace = drive(make_cell(config, still(160)), DOWN)
    depth = -offset(trace)[:, 2]
    below = depth > 0
    assert 20 < np.argmax(below) < 100
    assert below[np.argmax(below) :].all()
    assert np.array_equal(trace.touching, below)
    assert not trace.force[~below].any()
    spring = K * depth[below]
    damper = damping * -trace.velocity[below, 2]
    expected = spring + np.minimum(damper, spring)
    # The tissue gives way a little, at a speed that is not looked at here.
    np.testing.assert_allclose(-trace.force[below, 2], expected, atol=2e-3 * damping + 1e-5)
    assert spring[-1] > 10.0


def test_a_retreating_tool_is_not_pulled(perfect, make_cell, still, drive):
    config = perfect(unilateral=True, damping=20.0)
    trace = drive(make_cell(config, still(150)), (0.0, 0.0, 20.0))
    assert not trace.force[~trace.touching].any()
    assert (~trace.touching)[-50:].all()
    assert (trace.force[:, 2] <= 0.0).all()
    # At the end the damper alone would have pulled.
    pulls = K * offset(trace)[:, 2] + 20.0 * trace.velocity[:, 2] > 0.5
    assert (pulls & trace.touching).any()


# --- sideways ------------------------------------------------------------------------------------


def stretches(touching) -> list[np.ndarray]:
    """Cycles of each time in contact."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], touching, [0]]).astype(int)))
    return [np.arange(a, b) for a, b in edges.reshape(-1, 2)]


def test_each_touch_down_is_a_new_anchor(travelled):
    """The lateral force is K times the way from where the tool touched, zero at first."""
    place = offset(travelled)[:, :2]
    first, second = stretches(travelled.touching)
    anchors = []
    for cycles in (first, second):
        sideways = travelled.force[cycles, :2]
        sticks = np.hypot(*sideways.T) < 0.9 * GRIP * -travelled.force[cycles, 2]
        leaves = np.flatnonzero(~sticks)
        stuck = cycles[: leaves[0] if leaves.size else None]
        assert stuck.size > 50
        anchor = place[stuck] - travelled.force[stuck, :2] / K
        assert np.ptp(anchor, axis=0).max() < 1e-7  # it turns with the surface
        before, after = place[cycles[0] - 1], place[cycles[0]]
        here, there = offset(travelled)[[cycles[0] - 1, cycles[0]], 2]
        share = (anchor[0] - before) / (after - before)  # of the cycle before it touches
        assert (np.abs(share - here / (here - there)) < 0.15).all()  # a physics step is 0.125
        assert np.abs(travelled.force[stuck, :2]).max() > 0.5
        anchors.append(anchor[0])
    assert np.abs(anchors[1] - anchors[0]).min() > 5e-4
    between = np.arange(first[-1] + 1, second[0])
    assert between.size > 50
    assert not travelled.force[between].any()


@pytest.mark.parametrize("damping", [0.0, 10.0])
def test_every_force_starts_and_ends_at_zero(damping, perfect, make_cell, beating, drive):
    """Bounded by a multiple of the depth, in all states and whatever the way of the tool."""
    config = perfect(unilateral=True, gap=1e-4, damping=damping)
    speed = np.array([[0.15], [0.1], [-0.2]]) * np.sin([[0.09], [0.05], [0.07]] * np.arange(501.0))
    push = (np.diff(speed) / 1e-3 + 20.0 * speed[:, 1:]).T
    trace = drive(make_cell(config, beating(500, scale=0.5)), lambda k: push[k])
    normal, sideways = -trace.force[:, 2], np.hypot(*trace.force[:, :2].T)
    depth = np.maximum(-offset(trace)[:, 2], 0.0)
    turned = 1e-3 * normal  # the surface turns a little under load
    assert (normal >= 0.0).all()
    assert (normal <= 2.0 * K * depth + 1e-9 + turned).all()
    assert (sideways <= GRIP * normal + 1e-9 + turned).all()
    assert len(stretches(trace.touching)) >= 3
    assert sideways.max() > 5.0


def test_a_tool_that_asks_for_more_drags_its_anchor(perfect, make_cell, still, drive):
    """It slips at the grip's force, and sticks again where it has come to."""
    config = perfect(unilateral=True)
    force = np.array([0.0, 0.0, -2.0])
    trace = drive(
        make_cell(config, still(200), force=force),
        lambda k: (1.0, 0.0, 0.0) if k < 100 else (-1.0, 0.0, 0.0),
    )
    sideways, place = trace.force[:, 0], offset(trace)[:, 0]
    farthest = int(np.argmax(place))
    slipping = np.arange(70, farthest)
    np.testing.assert_allclose(sideways[slipping], GRIP * -trace.force[slipping, 2], rtol=2e-3)
    assert place[farthest] > 2.0 * sideways[farthest] / K
    back = np.arange(farthest + 1, farthest + 20)
    anchor = place[back] - sideways[back] / K
    assert np.ptp(anchor) < 1e-6
    assert anchor[0] > 5e-4
    assert np.ptp(place[back]) > 1e-5


# --- the physics ---------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.0, 10.0])
def test_the_physics_applies_what_is_measured_to_both_arms(
    damping, perfect, make_cell, beating, check_force_on_both_arms
):
    """In the air, sticking, slipping, and with the damper at its limit."""
    cell = make_cell(perfect(unilateral=True, gap=1e-4, damping=damping), beating(300))
    seen = dict.fromkeys(("free", "sticks", "slips", "yields"), 0)
    data = cell.data
    for k in range(300):
        cell.measure()
        local = check_force_on_both_arms(cell)
        depth, into = -data.actuator_length[14], -data.actuator_velocity[14]
        sideways, normal = np.hypot(*local[:2]), -local[2]
        seen["free"] += depth <= 0
        seen["slips"] += bool(depth > 0 and sideways > GRIP * normal * (1 - 1e-9))
        seen["sticks"] += bool(depth > 0 and sideways < GRIP * normal * (1 - 1e-6))
        seen["yields"] += bool(depth > 0 and damping * abs(into) > K * depth)
        cell.apply(np.array([15.0, 5.0, 20.0]) * np.sin(0.1 * k) - [0.0, 0.0, 2.0])
    least = {"free": 20, "sticks": 20, "slips": 5, "yields": 1 if damping else 0}
    assert all(seen[state] >= n for state, n in least.items()), seen


@pytest.mark.parametrize("damping", [0.0, 5.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_round_trip_costs_energy(seed, damping):
    """Whatever closed path the tool takes from the air and back, the contact gives none away."""
    n, dt = 6000, 1e-4
    rng = np.random.default_rng(seed)
    t = 2.0 * np.pi * np.arange(n + 1)[:, None] / n
    waves = rng.normal(0.0, 1e-3, (2, 6, 3))
    path = sum(
        a * np.sin(i * t) + b * (np.cos(i * t) - 1.0)
        for i, (a, b) in enumerate(zip(*waves, strict=True), start=1)
    )
    path[:, 2] += 1e-5 - path[0, 2]
    speed = np.gradient(path, dt, axis=0)
    length, rate, law = np.zeros(15), np.zeros(15), np.zeros((15, 10))
    law[12:, 1], law[12:, 2] = -K, -damping
    site = SimpleNamespace(xmat=np.eye(3).ravel())
    contact = Contact(
        np.zeros((), layout(6)),
        SimpleNamespace(actuator_biasprm=law, actuator=lambda name: SimpleNamespace(id=12)),
        SimpleNamespace(actuator_length=length, actuator_velocity=rate, site=lambda name: site),
        ContactConfig(stiffness=K, damping=damping, unilateral=True),
    )
    length[12:], rate[12:] = path[0], speed[0]
    contact.begin(1.0)
    force = np.zeros((n + 1, 3))
    for k in range(n + 1):
        length[12:], rate[12:] = path[k], speed[k]
        contact.follow(1)
        contact.force(force[k])
    done = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(path, axis=0), axis=1)
    assert np.abs(done).sum() > 0.01
    assert done.sum() > 1e-3  # it slips on the way
    stored = 0.5 * K * np.minimum(path[1:, 2], 0.0) ** 2
    assert (np.cumsum(done) > stored - 1e-4).all()


def test_the_heart_leans_against_a_tool_that_is_moved_into_contact(
    perfect, make_cell, still, drive
):
    cell = make_cell(perfect(unilateral=True, gap=GAP), still(100))
    force = np.array([1.0, 2.0, -10.0])
    cell.move_tool(force / K)
    cell.close_brakes()
    trace = drive(cell, 0.0)
    np.testing.assert_allclose(trace.force, np.tile(force, (100, 1)), atol=1e-5)


def test_a_held_tool_loses_the_tissue_and_starts_in_contact_despite_the_gap(
    realistic, make_cell, beating, drive
):
    runs = []
    for gap in (0.0, GAP):
        cell = make_cell(realistic(unilateral=True, gap=gap), beating(300, scale=1.4, phase=2.6))
        cell.move_tool(np.array([1.0, 2.0, -10.0]) / K)
        cell.close_brakes()
        runs.append(drive(cell, 0.0))
    trace = runs[0]
    assert trace.touching[0]
    assert 20 < np.count_nonzero(~trace.touching) < 280
    assert not trace.force[~trace.touching].any()
    assert np.ptp(trace.position, axis=0).max() < 1e-5
    # The same but for the noise that was drawn at the start.
    np.testing.assert_allclose(runs[1].force, trace.force, rtol=0, atol=1e-3)
