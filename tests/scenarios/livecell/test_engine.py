"""The running experiment without a page: commands, switches without a jump, refusals."""

from __future__ import annotations

import json

import numpy as np
import pytest

from scenarios import load_scenario
from scenarios.livecell.commands import SETTABLE, Act, Kind, Set
from scenarios.livecell.endless import early_beat, endless
from scenarios.livecell.engine import Engine
from scenarios.livecell.handover import PASSING, SETTLING
from scenarios.livecell.ring import COLUMNS, SIZE, Ring
from scenarios.livecell.workshop import Workshop
from scenarios.motion import load_motion

IN_SYSTOLE = 1550
"""A cycle in which the tissue moves fast."""
SWITCH = round(1e3 * (SETTLING + PASSING)) + 2


class Live:
    """An engine, its ring, and what it said."""

    def __init__(self, name, out, *settings, **top):
        scenario = load_scenario(name, top={"duration": 4.0, **top}, settings=settings)
        self.ring = Ring.over(bytearray(8 * SIZE))
        self.out = out
        self.engine = Engine(scenario, self.ring, out, workshop=Workshop(threaded=False))
        self.said = []

    def run(self, cycles):
        """Return the rows of so many cycles."""
        for _ in range(cycles):
            self.engine.cycle()
            self.said += self.engine.events()
        return self.ring.last(cycles)

    def ask(self, command, cycles=1):
        self.said = []
        self.engine.take(command)
        return self.run(cycles)

    @property
    def words(self):
        return [event.text for event in self.said]


@pytest.fixture
def live(tmp_path):
    return lambda name="paper", *settings, **top: Live(name, tmp_path, *settings, **top)


def column(rows, name):
    return rows[:, COLUMNS[name]]


def largest_change(rows):
    return np.abs(np.diff(column(rows, "command"), axis=0)).max()


def error(rows):
    return np.abs(column(rows, "force") - column(rows, "setpoint")).max()


@pytest.mark.parametrize(
    "asked",
    [Set("backend", "osqp"), Set("controller.increment_weight", 0.03),
     Set("controller.kind", "pi"), Set("controller.kind", "aob")],
    ids=lambda asked: str(asked.value),
)  # fmt: skip
def test_a_switch_makes_no_jump(live, asked):
    running = live()
    before = running.run(IN_SYSTOLE)[500:]
    during = running.ask(asked, SWITCH)
    assert any("in force" in word for word in running.words)
    after = running.run(800)
    alone = max(largest_change(before), largest_change(after))
    # Beside each controller's own changes, a hundredth of what they differ by in a cycle.
    assert largest_change(np.vstack([before[-1:], during])) < alone + 0.3
    assert error(during) < 1.2 * max(error(before), error(after))


def test_without_the_handover_there_would_be_a_jump(live, monkeypatch):
    monkeypatch.setattr("scenarios.livecell.handover.SETTLING", 0.0)
    monkeypatch.setattr("scenarios.livecell.handover.PASSING", 1e-3)
    running = live()
    before = running.run(IN_SYSTOLE)[500:]
    during = running.ask(Set("backend", "osqp"), SWITCH)
    assert error(during) > 5.0 * error(before)
    assert largest_change(during) > 2.0 * largest_change(before)


def test_the_force_follows_the_setpoint_at_a_bounded_rate(live):
    running = live()
    running.run(100)
    rows = running.ask(Set("setpoint.z", -5.0), 400)
    assert np.abs(np.diff(column(rows, "setpoint")[:, 2])).max() <= 0.1 + 1e-9
    assert rows[-1, COLUMNS["setpoint"]].tolist() == [1.0, 2.0, -5.0]
    assert column(rows, "force")[-1, 2] == pytest.approx(-5.0, abs=0.2)


def test_stiffness_changes_the_tissue_without_a_jump(live):
    running = live("paper", 'motion.axes=["x"]')
    running.run(50)
    rows = running.ask(Set("cell.contact.stiffness", 1500.0), 600)
    force = column(rows, "force")
    # Half a percent of 10 N in a cycle, as long as the controller has not noticed.
    assert 0.04 < np.abs(np.diff(force[:3, 2])).max() < 0.06
    depth = -np.diff(
        [running.engine._cell.data.site(s).xpos[2] for s in ("heart_surface", "tool_tip")]
    )
    assert -force[-1, 2] / depth == pytest.approx(1500.0, rel=0.02)


@pytest.mark.parametrize(
    ("asked", "word"),
    [
        (Set("backend", "nope"), "unknown backend 'nope'"),
        (Set("controller.kind", "nope"), "unknown controller 'nope'"),
        (Set("controller.force_weight", 0.0), "greater than 0"),
        (Set("controller.increment_weight", float("nan")), "greater than 0, got NaN"),
        (Set("controller.reference_time", -1.0), "greater than or equal to 0"),
        (Set("cell.contact.stiffness", -1.0), "greater than 0"),
        (Set("cell.contact.stiffness", "stiff"), "number"),
        (Set("controller.bounds.command", (2.0, 3.0)), "must contain 0"),
        (Set("controller.bounds.force.z", (-5.0, 0.0)), "outside"),
        (Set("setpoint.z", float("inf")), "finite"),
        (Set("seed", 3.0), "cannot be changed"),
        (Set("cell.arm.file", "/etc/passwd"), "cannot be changed"),
        (Act.STEP, "needs a pause"),
        (Act.KEEP, "nothing was recorded"),
    ],
)  # fmt: skip
def test_bad_values_are_refused_with_a_word(live, asked, word):
    running = live()
    before = running.engine.scenario
    running.ask(asked, 3)
    assert [event.kind for event in running.said] == [Kind.REFUSED]
    assert word in running.words[0]
    assert "\n" not in running.words[0]
    assert running.engine.scenario == before
    assert not running.engine.under_way


def test_a_setpoint_beyond_a_bound_is_refused(live):
    running = live()
    running.ask(Set("controller.bounds.force.z", (-12.0, float("inf"))), SWITCH)
    assert any("in force" in word for word in running.words)
    running.ask(Set("setpoint.z", -13.0))
    assert running.said[0].kind is Kind.REFUSED
    assert "controller.bounds.force.z" in running.words[0]


def test_every_key_that_can_be_set_is_one(live):
    scenario = live().engine.scenario
    for key in SETTABLE:
        value = scenario
        for part in key.split("."):
            value = getattr(value, part)


def test_no_answer_shows_plan_and_closed_form(live):
    running = live()
    running.run(200)
    rows = running.ask(Act.SOLVER_FAILURE, 150)
    sources = column(rows, "source").ravel()
    assert set(sources[:100]) == {1.0, 2.0}  # plan, analytic
    assert set(sources[100:]) == {0.0}


def test_the_sensor_falls_silent_and_the_force_is_held(live):
    running = live()
    running.run(500)
    rows = running.ask(Act.DROPOUT, 60)
    silent = np.isnan(column(rows, "measured")).all(axis=1)
    assert silent[:20].all()
    assert not silent[20:].any()
    assert error(rows) < 1.0


def test_an_early_beat_moves_the_tissue_once(live):
    running, still = live(), live()
    running.run(100)
    still.run(100)
    running.ask(Act.EARLY_BEAT)
    assert "early beat at" in running.words[0]
    rows, other = running.run(3200), still.run(3201)[1:]
    moved = np.abs(running.engine._programme.ctrl - still.engine._programme.ctrl).max()
    assert moved == 0.0  # the regular one is as it was
    assert error(rows) < 3.0 * error(other)
    assert running.engine._early is None
    assert np.abs(column(rows, "command") - column(other, "command")).max() > 1.0


def test_a_recorded_motion_tells_no_beats(live):
    running = live("recorded")
    running.ask(Act.EARLY_BEAT)
    assert "no beats" in running.words[0]


def test_the_motion_goes_on_over_its_end(live):
    running = live()
    rows = running.run(3600)  # the loop is three seconds long
    assert error(rows[2800:]) < 2.0 * error(rows[500:2800])


def test_an_endless_motion_has_no_jump():
    scenario = load_scenario("paper", top={"duration": 4.0})
    motion = load_motion(scenario.motion, 4.0, 1e-3, 0)
    loop = endless(motion)
    assert len(loop.time) == 3000
    for of, derivative in (("position", "velocity"), ("velocity", "acceleration")):
        twice, slope = (np.vstack([getattr(loop, name)] * 2) for name in (of, derivative))
        change = np.diff(twice, axis=0)
        mean = 0.5e-3 * (slope[1:] + slope[:-1])
        assert np.abs(change - mean).max() < 1e-3 * np.abs(change).max()


def test_an_early_beat_is_a_smooth_addition():
    from plant.cell import heart_programme  # noqa: PLC0415

    scenario = load_scenario("paper", top={"duration": 4.0})
    loop = endless(load_motion(scenario.motion, 4.0, 1e-3, 0))
    regular = heart_programme(scenario.cell, loop)
    beat = early_beat(scenario.cell, loop, regular, 2500)
    changed = np.abs(beat.programme.angles - regular.angles).max(axis=1)
    rows = np.arange(beat.begin, beat.end) % 3000
    assert changed[rows].max() > 1e-3
    assert changed[np.setdiff1d(np.arange(3000), rows)].max() == 0.0
    assert beat.begin > 2500
    path = beat.programme.angles
    assert (
        np.abs(np.diff(path, 2, axis=0)).max()
        < 3 * np.abs(np.diff(regular.angles, 2, axis=0)).max()
    )


def test_pause_step_reset(live):
    running = live()
    running.run(10)
    running.engine.take(Act.PAUSE)
    assert running.engine.resting
    running.engine.take(Act.STEP)
    assert not running.engine.resting
    running.run(1)
    assert running.engine.resting
    running.engine.take(Act.RESUME)
    assert not running.engine.resting
    first = live().run(20)
    again = running.ask(Act.RESET, 20)
    for name in ("time", "force", "command"):
        assert np.array_equal(column(first, name), column(again, name))


def test_a_recording_is_a_run(live, tmp_path):
    from bench.report import write_report  # noqa: PLC0415

    running = live()
    running.run(300)
    running.ask(Act.RECORD, 500)
    running.ask(Set("controller.kind", "pi"), 400)
    running.ask(Act.KEEP, 2)
    (folder,) = tmp_path.iterdir()
    assert running.words[-1] == f"recorded in {folder}"
    summary = json.loads((folder / "summary.json").read_text())
    assert summary["cycles"] == 900
    assert summary["axes"]["z"]["compensated"]["max"] < 2.0
    scenario = load_scenario(str(folder / "config.toml"))
    assert scenario.duration == pytest.approx(0.9)
    assert scenario.controller.kind == "mpc"
    changes = json.loads((folder / "live.json").read_text())["changes"]
    assert [change["what"] for change in changes] == ["pi comes", "pi in force"]
    assert changes[0]["time"] == pytest.approx(0.5)
    write_report([folder], tmp_path / "report.html")


def test_a_recording_that_cannot_be_written_is_told(live, tmp_path):
    running = live()
    running.engine._out = tmp_path / "file"
    (tmp_path / "file").write_text("")
    running.ask(Act.RECORD, 5)
    running.ask(Act.KEEP, 2)
    assert running.said[-1].kind is Kind.REFUSED
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_recording_ends_by_itself(live, monkeypatch, tmp_path):
    monkeypatch.setattr("scenarios.livecell.recording.LONGEST", 0.05)
    running = live()
    running.ask(Act.RECORD, 60)
    assert "recorded in" in running.words[-1]
    assert len(list(tmp_path.iterdir())) == 1
