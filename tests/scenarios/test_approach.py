"""Lost contact: how it is seen, what is told of it, and that the tool comes back gently."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.table import contact_line
from plant import Measurement
from qpmpc import ForceController
from qpmpc.config import ModelConfig
from scenarios import load_scenario, run_experiment, summarise
from scenarios.approach import (
    Approach,
    ContactState,
    ContactWatch,
    Recovery,
    recovery,
    touch_down_cap,
)
from scenarios.config import ApproachConfig
from scenarios.schedule import Schedule

PRESSING, DOUBTFUL, LOST = ContactState
UNILATERAL = "cell.contact.unilateral=true"
STRAIGHT = ("setpoint.x=0.0", "setpoint.y=0.0")


# --- seeing it -----------------------------------------------------------------------------------


def states(pressures, *, wish=-5.0, lost_after=4, found_after=2, known=True):
    watch = ContactWatch(0.1, 0.2, lost_after=lost_after, found_after=found_after)
    if known:
        watch.look(-1, 5.0, wish)
    return [watch.look(k, p, wish) for k, p in enumerate(pressures)], watch


def test_it_takes_patience_to_lose_contact_and_to_find_it():
    seen, watch = states([0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.5, 0.5])
    assert seen == [DOUBTFUL] * 3 + [LOST] * 3 + [PRESSING] * 2
    (event,) = watch.events
    assert (event.lost, event.found, event.meant) == (0, 6, False)


def test_between_the_thresholds_nothing_changes():
    seen, _ = states([0.15] * 5)
    assert seen == [PRESSING] * 5
    seen, _ = states([0.0] * 4 + [0.15] * 20)
    assert seen[3:] == [LOST] * 21
    seen, _ = states([0.0] * 4 + [0.5, 0.15] * 10)
    assert seen[-1] is LOST  # found in a row only


def test_a_single_wrong_reading_is_no_loss_and_no_contact():
    seen, watch = states([5.0, -3.0, 5.0, 0.0, 0.0, 0.0, 5.0])
    assert LOST not in seen
    assert not watch.events
    seen, watch = states([0.0] * 4 + [9.0, 0.0, -9.0, 0.0])
    assert seen[3:] == [LOST] * 5


def test_a_sensor_that_is_silent_tells_nothing():
    seen, _ = states([math.nan] * 9)
    assert seen == [PRESSING] * 9
    seen, _ = states([0.0] * 4 + [math.nan] * 9 + [0.5, math.nan, 0.5])
    assert seen[4:-1] == [LOST] * 11
    assert seen[-1] is PRESSING


def test_a_start_in_the_air_is_known_at_once():
    seen, watch = states([0.0], known=False)
    assert seen == [LOST]
    assert watch.events[0].lost == 0
    seen, watch = states([math.nan, 0.0], known=False)
    assert seen == [PRESSING, LOST]
    assert watch.events[0].lost == 0


@pytest.mark.parametrize(("wish", "meant"), [(-5.0, False), (-0.2, True), (0.0, True), (3.0, True)])
def test_a_loss_that_was_asked_for_is_told_apart(wish, meant):
    _, watch = states([0.0] * 9, wish=wish)
    assert watch.events[0].meant is meant


@settings(max_examples=50, deadline=None)
@given(seed=st.integers(0, 10**6), noise=st.sampled_from([0.003, 0.2]))
def test_noise_neither_loses_a_contact_nor_finds_one(seed, noise):
    rng = np.random.default_rng(seed)
    limit = 5.0 * noise
    in_contact = ContactWatch(limit, 2.0 * limit, lost_after=5, found_after=2)
    in_air = ContactWatch(limit, 2.0 * limit, lost_after=5, found_after=2)
    for k, e in enumerate(rng.normal(0.0, noise, 3000)):
        assert in_contact.look(k, 16.0 * noise + e, -5.0) is PRESSING
        assert in_air.look(k, e, -5.0) is LOST


@pytest.mark.parametrize(("sensor", "least"), [("nano17", 0.015), ("mini45", 1.0)])
def test_the_threshold_goes_with_the_sensors_noise(sensor, least):
    scenario = load_scenario("paper", settings=[f"cell.sensor.model={sensor}"])
    assert scenario.contact_lost_below == pytest.approx(least, rel=0.1)
    scenario = load_scenario("paper", settings=["approach.threshold=0.3"])
    assert scenario.contact_lost_below == 0.3
    assert scenario.contact_found_above == 0.6


# --- the law -------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(
    start=st.floats(-0.5, 0.5),
    late=st.tuples(st.integers(0, 5), st.floats(0.0, 0.004)),
    scale=st.floats(0.75, 1.35),
    load=st.floats(-3.0, 3.0),
    speed=st.floats(0.01, 0.2),
)
def test_the_velocity_is_taken_on_and_hardly_passed(start, late, scale, load, speed):
    """On a unit mass that is not quite one, late, under a load; the aim is below the bound."""
    delay, lag = late
    model = ModelConfig(delay=delay, lag=lag)
    law = Approach(ApproachConfig(speed=speed), model, 1e-3, 0, 1)
    low, high = np.array([-20.0]), np.array([20.0])
    v, acting, queue, seen = start, 0.0, [0.0] * delay, []
    law.begin(np.array([v]))
    for _ in range(1500):
        queue.append(float(law.command(np.array([v]), low, high, approach=True, speed=9.0)[0]))
        u = queue.pop(0)
        for _ in range(10):
            acting += 1e-4 * (u - acting) / lag if lag > 1e-4 else u - acting
            v += 1e-4 * (scale * (acting - 20.0 * v) + load)
        seen.append(v)
    assert seen[-1] == pytest.approx(-0.9 * speed, rel=0.02, abs=1e-4)
    # A load of 3 m/s^2 that comes from nowhere is taken up within a few times the bandwidth.
    late = seen[400:]
    assert min(late) > -1.0 * speed - 1e-3


def test_without_a_wish_it_stops_where_it_is():
    law = Approach(ApproachConfig(), ModelConfig(), 1e-3, 2, 3)
    v = np.array([0.1, -0.2, -0.3])
    law.begin(v)
    for _ in range(600):
        u = law.command(v, np.full(3, -20.0), np.full(3, 20.0), approach=False, speed=1.0)
        v = v + 1e-3 * (u - 20.0 * v)
    assert np.abs(v).max() < 1e-4


def test_what_is_beyond_the_bounds_is_not_gathered():
    law = Approach(ApproachConfig(), ModelConfig(), 1e-3, 0, 1)
    law.begin(np.zeros(1))
    for _ in range(5000):  # stuck
        u = law.command(np.zeros(1), np.full(1, -0.5), np.full(1, 0.5), approach=True, speed=1.0)
    assert u == -0.5
    assert abs(law._sum[0]) < 0.5


# --- what the controller is told ---


def world(*changes, start=-5.0):
    """A controller of z alone with its recovery, a tool that moves as told, and their cycle."""
    scenario = load_scenario(
        "paper-1d", settings=["cell.contact.unilateral=true", f"setpoint.z={start}", *changes]
    )
    controller = ForceController(scenario.controller, ("z",), 1e-3, "daqp")
    looking_after = Recovery(scenario, Schedule(scenario))
    place, applied = np.zeros(3), np.zeros(1)

    def cycle(k, force, velocity):
        nonlocal applied
        place[2] += 1e-3 * velocity
        seen = Measurement(
            1e-3 * k, np.array([0, 0, force]), place.copy(), np.array([0, 0, velocity])
        )
        wish = np.full((9, 1), start)
        shown = looking_after.measured(k, seen, seen.force[2:], wish[0], controller)
        step = controller.step(shown, seen.velocity[2:], wish)
        applied = looking_after.command(k, step.command, applied, controller)
        controller.prepare()
        return step, applied

    return cycle, looking_after


@pytest.mark.parametrize("force", [-0.1, -0.6])
@pytest.mark.parametrize("disturbance", ["fused", "constant"])
def test_at_touch_down_the_model_believes_in_the_force_and_in_tissue_at_rest(force, disturbance):
    """The next force is the measured one and what the tool's way adds to it."""
    cycle, looking_after = world(f"controller.observer.disturbance={disturbance}")
    for k in range(300):
        cycle(k, 0.0, -0.04)
    assert looking_after.watch.state is LOST
    cycle(300, force, -0.04)
    step, _ = cycle(301, force, -0.04)
    assert looking_after.watch.state is PRESSING
    assert step.predicted[0, 0] == pytest.approx(force - 2500.0 * 0.04 * 1e-3, abs=0.03)


def test_in_doubt_the_command_is_kept_from_coming_fast():
    """Five newtons that are missing would have the closed bound; the speed allows less."""
    cycle, looking_after = world("approach.lost_after=0.05", "approach.speed=0.02")
    cycle(0, -5.0, 0.0)
    for k in range(1, 20):
        step, applied = cycle(k, 0.0, -0.015)
        assert looking_after.watch.state is DOUBTFUL
        assert applied[0] >= -20.0 * 0.015 - 100.0 * 0.005
    assert step.command[0] < -5.0


# --- in closed loop ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lost(simulate):
    return simulate("lost-contact", still=False, duration=1.6)


def test_the_shipped_scenario_loses_contact_and_finds_it(lost):
    loss = lost.summary["contact_loss"]
    assert loss["count"] >= 2
    first, *others = loss["events"]
    assert first["at_start"]
    assert not others[0]["at_start"]
    assert lost.summary["trip"] is None
    assert lost.summary["status"] == {"solved": 1600}
    assert loss["time"] == pytest.approx(sum(e["duration"] for e in others), abs=1e-9)
    for event in loss["events"]:
        assert event["found"] is not None
        assert 0.0 < event["speed"] <= lost.scenario.approach.speed
        assert event["force_peak"] < 3.0
    assert contact_line(loss).startswith(f"contact lost: {loss['count']} times, 0.")


def test_what_is_seen_is_what_is_so(lost):
    """By the force alone, and within its patience: a few cycles after it happens."""
    log = lost.log
    seen = log.contact[: log.cycles] == LOST
    for k in np.flatnonzero(np.diff(seen.astype(int)) == 1):
        assert not log.touching[k - 1 : k + 2].any()  # the last of the force is below the threshold
    for k in np.flatnonzero(np.diff(seen.astype(int)) == -1):
        assert log.touching[k - 1 : k + 1].all()
        assert not log.touching[k - 8 : k + 1].all()
    column = log.table()["contact"].to_pylist()
    assert set(column) == {"pressing", "doubtful", "lost"}
    assert column.count("lost") == seen.sum()


def test_the_log_has_the_command_that_was_applied(lost):
    """Off the tissue that is the approach's, which the tool's acceleration shows."""
    log, k = lost.log, slice(20, 80)
    assert (log.contact[k] == LOST).all()
    fall = np.diff(log.tool_velocity[:, 2])[k] / 1e-3
    expected = (log.command[:, 2] - 20.0 * log.tool_velocity[:, 2])[19:79]
    assert np.sqrt(np.mean((fall - expected) ** 2)) < 3.0
    assert np.abs(log.command[k]).max() < 10.0


def test_after_touch_down_the_controller_goes_on_without_a_bump(lost):
    """The command does not jump as it is handed over, and the setpoint is there in time."""
    log = lost.log
    for event in log.contact_events:
        if event.found is None or event.found + 150 > log.cycles:
            continue
        k = event.found
        assert np.abs(np.diff(log.command[k - 1 : k + 1, 2])).max() < 4.0
        assert (log.command[k : k + 3, 2] < 0.0).all()  # on and on into the tissue
        settled = log.force[k + 90 : k + 110, 2]
        assert np.abs(settled + 2.5).max() < 1.0


def run_with(name, *changes, duration=1.0, **top):
    scenario = load_scenario(name, top={"duration": duration, **top}, settings=changes)
    experiment = run_experiment(
        scenario,
        report=lambda *_: None,
        stop=lambda: False,
        held=np.zeros((scenario.cycles, 3)),
    )
    assert experiment.stopped is None
    return experiment.log, summarise(experiment)


@pytest.mark.parametrize("backend", ["analytic", "daqp", "osqp"])
@pytest.mark.parametrize("disturbance", ["fused", "none"])
def test_the_first_touch_is_gentle_whichever_backend_and_observer(backend, disturbance):
    """From 4 mm above; the closed form knows no bound, and comes no faster for it."""
    log, summary = run_with(
        "paper", UNILATERAL, *STRAIGHT, "cell.contact.gap=0.004", "setpoint.z=-3.0",
        f"controller.observer.disturbance={disturbance}", backend=backend, duration=0.35,
    )  # fmt: skip
    (event,) = summary["contact_loss"]["events"]
    assert event["at_start"]
    assert 0.03 < event["speed"] <= 0.05
    touch = int(np.flatnonzero(log.touching)[0])
    assert np.abs(log.tool_velocity[: touch + 1, 2]).max() <= 0.05
    assert np.abs(log.tool_velocity[: touch + 1, :2]).max() < 5e-3  # straight down
    # The model without a disturbance overshoots by itself, in contact too.
    assert event["force_peak"] < (3.3 if disturbance == "fused" else 4.5)
    assert log.force[-1, 2] == pytest.approx(-3.0, abs=0.5)


def test_sideways_setpoints_wait_until_the_tool_touches():
    log, _ = run_with("paper", UNILATERAL, "cell.contact.gap=0.004", duration=0.35)
    touch = int(np.flatnonzero(log.touching)[0])
    assert np.abs(log.tool[touch, :2] - log.tool[0, :2]).max() < 3e-4
    assert log.force[-1] == pytest.approx([1.0, 2.0, -10.0], abs=0.3)


def test_switched_off_the_controller_leads_the_tool_itself_and_loss_is_still_told():
    changes = ("cell.contact.gap=0.004", UNILATERAL, *STRAIGHT, "approach.enabled=false")
    log, summary = run_with("paper", *changes, duration=0.2, backend="analytic")
    assert np.abs(log.tool_velocity[:, 2]).max() > 0.2
    (event,) = summary["contact_loss"]["events"]
    assert event["found"] is not None


@pytest.mark.parametrize(
    ("change", "least", "most"),
    [
        ("approach.speed=0.02", 0.017, 0.02),
        ("approach.speed=0.08", 0.06, 0.08),
        ("controller.bounds.velocity=[-0.03, 0.03]", 0.025, 0.03),
    ],
)
def test_its_speed_is_a_key_and_never_beyond_the_bound_on_velocity(change, least, most):
    _, summary = run_with(
        "paper", UNILATERAL, *STRAIGHT, "cell.contact.gap=0.006", "setpoint.z=-3.0", change,
        duration=0.5,
    )  # fmt: skip
    assert least < summary["contact_loss"]["speed"] <= most


def test_the_other_keys_have_their_effect():
    base = (UNILATERAL, *STRAIGHT, "cell.contact.gap=0.004", "setpoint.z=-3.0")
    usual, _ = run_with("paper", *base, duration=0.2)
    slower, _ = run_with("paper", *base, "approach.acceleration=0.5", duration=0.2)
    quick = [int(np.argmax(log.tool_velocity[:, 2] < -0.03)) for log in (usual, slower)]
    assert 5 < quick[0] < 20
    assert quick[1] > 55  # 0.03 m/s at 0.5 m/s^2
    later, _ = run_with("paper", *base, "approach.found_after=0.02", duration=0.2)
    deaf, _ = run_with("paper", *base, "approach.threshold=1.0", duration=0.2)
    first = [int(np.flatnonzero(log.contact == PRESSING)[0]) for log in (usual, later, deaf)]
    assert first[1] == first[0] + 18
    assert first[2] > first[0] + 2


def test_patience_decides_what_counts_as_lost(simulate):
    patient = simulate("lost-contact", "approach.lost_after=1.0", still=False, duration=0.8)
    assert patient.summary["contact_loss"]["count"] == 0


def test_a_bonded_tool_has_nothing_to_look_after(simulate):
    run = simulate("paper", still=False, duration=0.05)
    assert run.summary["contact_loss"] is None
    assert set(run.log.table()["contact"].to_pylist()) == {"pressing"}
    scenario = load_scenario("paper")
    assert recovery(scenario, Schedule(scenario)) is None


def test_lifted_by_its_setpoint_the_tool_waits_in_the_air():
    """And is led back when the wish presses again."""
    log, summary = run_with(
        "paper", UNILATERAL, *STRAIGHT, "setpoint.z=-3.0", "motion.axes=['x']".replace("'", '"'),
        "setpoint.steps=[{time=0.1, z=0.5}, {time=0.5, z=-3.0}]",
        "controller.bounds.force={z=[-20.0, inf]}", duration=0.9,
    )  # fmt: skip
    events = summary["contact_loss"]["events"]
    assert events[0]["meant"]
    assert summary["contact_loss"]["count"] == 0
    waiting = slice(300, 500)
    assert (log.contact[waiting] == LOST).all()
    assert np.abs(log.tool_velocity[waiting]).max() < 2e-3
    assert events[-1]["speed"] <= 0.05
    assert log.force[-1, 2] == pytest.approx(-3.0, abs=0.2)


def test_axes_without_the_normal_are_watched_but_not_led():
    log, summary = run_with(
        "paper", UNILATERAL, 'axes=["x"]', 'motion.axes=["z"]', "setpoint.y=0.0",
        "controller.bounds.force={}", "setpoint.z=-1.0", "setpoint.x=0.1", duration=0.8,
    )  # fmt: skip
    assert np.count_nonzero(~log.touching) > 20
    assert summary["contact_loss"]["count"] >= 1


# --- whatever the motion -------------------------------------------------------------------------


def leap(rng: np.random.Generator) -> tuple[np.ndarray, float]:
    """A surface that leaps away and comes back, at up to 0.4 m/s."""
    t, z = np.arange(0.0, 1.1, 0.002), 0.0
    for _ in range(4):
        width = rng.uniform(0.015, 0.05)
        z = z + rng.uniform(-1, 1) * 0.5 * width * np.exp(
            -0.5 * ((t - rng.uniform(0.25, 0.95)) / width) ** 2
        )
    speed = float(np.abs(np.gradient(z, t)).max())
    scale = min(1.0, 0.4 / speed)
    return np.column_stack([t, 0 * t, 0 * t, scale * z]), scale * speed


@pytest.mark.parametrize("seed", range(8))
def test_whatever_the_motion_touch_down_is_slow_and_the_force_below_its_cap(seed, tmp_path):
    """Random leaps, laws, backends and setpoints, with an arm too weak to follow."""
    rng = np.random.default_rng(seed)
    rows, tissue_speed = leap(rng)
    path = tmp_path / "leap.csv"
    np.savetxt(path, rows, delimiter=",", header="t,x,y,z", comments="")
    law = ("kelvin_voigt", "standard_linear_solid", "hunt_crossley")[seed % 3]
    wish, braking = float(rng.uniform(0.8, 4.0)), 6.0
    changes = [
        f"cell.contact.law={law}", UNILATERAL, *STRAIGHT, f"setpoint.z={-wish}",
        "controller.bounds.force={z=[-28.0, inf]}",
        f"controller.bounds.command=[-{braking}, {braking}]",
    ]  # fmt: skip
    scenario = load_scenario(
        "paper",
        top={"duration": 1.0, "backend": ("daqp", "analytic")[seed % 2]},
        motion=path,
        settings=changes,
    )
    experiment = run_experiment(
        scenario, report=lambda *_: None, stop=lambda: False, held=np.zeros((1000, 3))
    )
    log, summary = experiment.log, summarise(experiment)
    assert summary["trip"] is None
    limit = scenario.approach.speed
    cap = summary["contact_loss"]["touch_down_cap"]
    assert cap == pytest.approx(touch_down_cap(scenario, tissue_speed), rel=0.2)
    for event in summary["contact_loss"]["events"]:
        if event["found"] is None:
            continue
        k = round(event["lost"] * 1e3)
        towards = max(0.0, -float(log.tool_velocity[k, 2]))
        # Braking takes its time, from however fast the tissue was followed when it was lost.
        slowing = towards / braking + 0.03
        allowed = limit if event["duration"] > slowing else max(limit, towards + 0.03)
        assert event["speed"] <= allowed, event
        assert event["closing_speed"] <= allowed + tissue_speed, event
        if event["duration"] > slowing:
            assert event["force_peak"] <= max(cap, wish + 0.5), (event, cap)


def test_random_leaps_do_lose_contact(tmp_path):
    """That the property above is about something."""
    found = 0
    for seed in range(0, 8, 2):
        rows, _ = leap(np.random.default_rng(seed))
        path = tmp_path / f"{seed}.csv"
        np.savetxt(path, rows, delimiter=",", header="t,x,y,z", comments="")
        scenario = load_scenario(
            "paper", top={"duration": 1.0}, motion=path,
            settings=[UNILATERAL, *STRAIGHT, "setpoint.z=-1.5",
                      "controller.bounds.force={z=[-28.0, inf]}",
                      "controller.bounds.command=[-6.0, 6.0]"],
        )  # fmt: skip
        experiment = run_experiment(
            scenario, report=lambda *_: None, stop=lambda: False, held=np.zeros((1000, 3))
        )
        found += summarise(experiment)["contact_loss"]["count"]
    assert found >= 2
