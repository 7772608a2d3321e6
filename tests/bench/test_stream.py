"""A recorded stream and its replay: the same cycles for everyone, and those that were run."""

from __future__ import annotations

import numpy as np
import pytest

from bench.latency.judge import Standard
from bench.stream import Replay, record
from scenarios import ScenarioError, load_scenario

MOVES = (
    "setpoint.steps=[]",
    "bounds_steps=[{time=0.04, ramp=0.02, force={z=[-9.0, inf]}}, {time=0.1, force=[-8.5, 8.5]}]",
)
CASES = {
    "bounds": ("latency", ()),
    "one axis": ("latency", ('axes=["z"]',)),
    "moving bounds": ("latency", MOVES),
    "joints": (
        "latency",
        ("controller.bounds.joints.speed=0.002", "controller.bounds.joints.torque=0.3"),
    ),
    "nothing known ahead": (
        "latency", ("setpoint.preview=false", "setpoint.steps=[{time=0.1, z=-11.0}]"),
    ),
    "absolute": ("latency", ('controller.decision="absolute"',)),
    "force alone": ("paper", ('controller.observer.disturbance="constant"',
                              "controller.bounds.velocity=[-inf, inf]")),
}  # fmt: skip


def recorded(name, settings, duration=0.15):
    scenario = load_scenario(name, top={"duration": duration}, settings=settings)
    stream = record(scenario, report=lambda *_: None, stop=lambda: False)
    assert stream is not None
    return stream


@pytest.mark.parametrize(("name", "settings"), CASES.values(), ids=CASES)
def test_a_replay_of_the_recorded_backend_gives_the_recorded_commands(name, settings):
    stream = recorded(name, settings)
    replay = Replay(stream, stream.scenario.controller.horizon, stream.scenario.backend)
    whole = dict(replay.steps(0, stream.cycles))
    assert list(whole) == list(range(150))
    commands = np.array([step.command for step in whole.values()])
    np.testing.assert_allclose(commands, stream.command, atol=1e-5)
    # A replay may begin anywhere.
    later = np.array([step.command for _, step in replay.steps(70, 130)])
    np.testing.assert_allclose(later, stream.command[70:130], atol=1e-5)
    assert np.ptp(stream.command, axis=0).min() > 0.1  # something happened


@pytest.mark.parametrize("case", ["moving bounds", "joints"])
def test_moved_bounds_and_maps_make_a_difference(case):
    """Or the test above would prove nothing about them."""
    name, settings = CASES[case]
    plain = recorded(name, ("setpoint.steps=[]",))
    assert np.abs(recorded(name, settings).command - plain.command).max() > 0.1


@pytest.fixture(scope="module")
def stream():
    return recorded("latency", ())


def test_every_horizon_and_backend_meets_the_same_cycles(stream):
    first = Replay(stream, 8, "daqp")
    for horizon, backend in ((3, "analytic"), (40, "daqp"), (8, "osqp")):
        other = Replay(stream, horizon, backend)
        np.testing.assert_array_equal(other.measurements, first.measurements)
        np.testing.assert_array_equal(other.previous, first.previous)
        np.testing.assert_allclose(other.states, first.states, atol=1e-12)
        assert all(preview.shape == (horizon + 1, 3) for preview in other.previews)
        # Whoever decides otherwise does not change what it meets next.
        general = other.controller.general
        for k, _ in other.steps(0, 30):
            np.testing.assert_array_equal(general.problem._parameters[-3:], other.previous[k])


def test_the_preview_looks_as_far_as_the_horizon(stream):
    settings = ("setpoint.steps=[{time=0.1, z=-11.0}]",)
    replay = Replay(recorded("latency", settings), 20, "analytic")
    ahead = [int((preview[:, 2] == -11.0).sum()) for preview in replay.previews]
    assert ahead[79] == 0
    assert ahead[80] == 1
    assert ahead[90] == 11
    assert ahead[149] == 21


def test_a_setpoint_that_is_sent_cannot_be_recorded():
    with pytest.raises(ScenarioError, match="nobody can send"):
        recorded("latency", ("setpoint.steps=[]", "setpoint.live={port=47801}"))


def test_a_stopped_recording_is_none():
    scenario = load_scenario("latency", top={"duration": 0.1})
    calls = iter(range(10**6))
    assert record(scenario, report=lambda *_: None, stop=lambda: next(calls) > 20) is None


def test_bounds_act_in_a_good_share_of_the_shipped_scenario():
    """The figure of the documents, on the first half of the run."""
    stream = recorded("latency", (), duration=2.5)
    standard = Standard(stream, 8)
    assert standard.certify(lambda: False)
    facts = standard.facts()
    assert facts.certified == facts.cycles == 2500
    assert 0.1 < facts.active_share < 0.6
    assert all(share > 0.02 for share in facts.active.values())
    assert set(facts.active) == {"command", "velocity", "force"}
