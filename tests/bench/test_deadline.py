# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""The deadline harness itself: stalls are found, counted and not hidden; late answers are left."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console

from bench import deadline as deadline_module
from bench.cycles import NONE, SOURCES, STATUSES, Cycles, longest_run
from bench.deadline import BLOCK, LEAD_IN, WARM_UP, Entry, Race, cycles_in_all, enter, run
from bench.deadline_report import deadline_tables, machine_lines, summary, write_histograms
from bench.machine import machine
from bench.realtime import Clock, SystemClock
from bench.subjects import Controlled, Empty
from plant import PlantError
from qpmpc import Source, Status
from qpmpc import controller as controller_module
from qpmpc import solver as solver_module
from qpmpc.backends import _registry
from qpmpc.backends.daqp import DaqpBackend
from scenarios import cycle as cycle_module
from scenarios import load_scenario

from .clocks import FakeClock

MS = 1_000_000
QUICK = 100_000


class Timed(Empty):
    """A controller that takes what it is told, cycle by cycle of its own count."""

    kind = "backend"
    status, source = STATUSES.index(Status.SOLVED), SOURCES.index(Source.SOLUTION)

    def __init__(self, clock: Any, takes: Callable[[int], int], plant: Callable[[int], int]):
        self.clock, self.takes, self.plant, self.n = clock, takes, plant, 0
        self.name, self.path, self.left = "timed", "interpreted", []

    def respond(self, left: float) -> None:
        self.left.append(left)
        self.solve = self.takes(self.n)
        self.clock.spend(self.solve)

    def advance(self) -> None:
        self.clock.spend(self.plant(self.n))
        self.n += 1

    def errors(self) -> np.ndarray:
        return np.zeros((self.n, 3))


def race(*subjects: Any, cycles: int, period: int = MS, deadline: int = MS) -> Race:
    entries = [Entry(subject, Cycles(cycles, period, deadline)) for subject in subjects]
    return Race(load_scenario("paper"), entries, [], deadline / 1e9, cycles)


def go(made: Race, clock: Clock, **given_: Any) -> Race:
    options: dict[str, Any] = {
        "spin": 0.0, "report": lambda *_: None, "stop": lambda: False, "ready": lambda: None,
    }  # fmt: skip
    run(made, clock, **(options | given_))
    return made


def timed(
    takes: Callable[[int], int], plant: Callable[[int], int] = lambda _: 0, *, cycles: int
) -> tuple[Cycles, Timed]:
    clock = FakeClock()
    subject = Timed(clock, takes, plant)
    made = go(race(subject, cycles=cycles), clock)
    assert made.complete
    return made.entries[0].cycles, subject


# ---- stalls


def test_a_stall_of_2_ms_every_500_cycles_is_found_and_counted_exactly() -> None:
    stalls = lambda n: n % 500 == 250  # noqa: E731
    cycles, _ = timed(lambda n: QUICK + 2 * MS * stalls(n), cycles=10 * BLOCK)
    first = WARM_UP + LEAD_IN
    numbers = np.concatenate(
        [first + turn * (BLOCK + LEAD_IN) + np.arange(BLOCK) for turn in range(10)]
    )
    at = np.flatnonzero(stalls(numbers))
    assert len(at) == 40
    # The cycle itself, and the one that was released while it lasted.
    assert sorted(np.flatnonzero(cycles.missed)) == sorted([*at, *(at + 1)])
    assert set(cycles.response[at]) == {2 * MS + QUICK}
    assert set(cycles.response[at + 1]) == {MS + 2 * QUICK}
    assert set(cycles.response[at + 2]) == {3 * QUICK}
    told = summary_of(race_of(cycles))
    row = told["rows"][0]
    assert (row["misses"], row["longest_run"], row["solve_misses"]) == (80, 2, 40)
    figures = row["response_us"]
    assert (figures["p50"], figures["p99"]) == (100.0, 100.0)
    assert (figures["p999"], figures["p9999"], figures["max"]) == (2100.0, 2100.0, 2100.0)


def race_of(cycles: Cycles) -> Race:
    subject = Timed(FakeClock(), lambda _: 0, lambda _: 0)
    return Race(load_scenario("paper"), [Entry(subject, cycles)], [], 1e-3, cycles.count)


def summary_of(made: Race) -> dict[str, Any]:
    return summary(made, paced=True, spin=0.0, sleeps_by="the test", machine=machine())


def test_cycles_released_during_a_stall_show_their_full_delay() -> None:
    start = WARM_UP + LEAD_IN
    cycles, subject = timed(lambda n: 10 * MS if n == start + 5 else QUICK, cycles=30)
    expected = [QUICK] * 5 + [10 * MS]
    while expected[-1] > MS:
        expected.append(expected[-1] - MS + QUICK)
    np.testing.assert_array_equal(cycles.response[: len(expected)], expected)
    np.testing.assert_array_equal(cycles.response[len(expected) :], QUICK)
    # Measured from where each cycle really began, one miss would be all there is to see.
    assert int((cycles.compute > MS).sum()) == 1
    assert int(cycles.missed.sum()) == longest_run(cycles.missed) == 10
    # What was left to each of them was told.
    left = np.array(subject.left[start:]) * 1e9
    np.testing.assert_allclose(left[:30], MS - cycles.wake, atol=1)
    assert left.min() <= -8 * MS


def test_a_real_stall_on_a_real_clock() -> None:
    """Whatever the machine does besides, it can only add."""

    class Busy:
        def spend(self, time: int) -> None:
            until = clock.now() + time
            while clock.now() < until:
                pass

    clock = SystemClock()
    start = WARM_UP + LEAD_IN
    subject = Timed(Busy(), lambda n: 4 * MS if n == start + 100 else 0, lambda _: 0)
    cycles = go(race(subject, cycles=200), clock).entries[0].cycles
    assert cycles.count == 200
    assert cycles.response[100] >= 4 * MS
    for k in range(1, 4):
        assert cycles.response[100 + k] >= (4 - k) * MS
    assert cycles.missed[100:103].all()
    assert (cycles.wake >= 0).all()


# ---- the plant


def test_what_a_plant_takes_ordinarily_is_put_off_and_told() -> None:
    """0.4 ms of controller and 0.9 ms of plant: nobody is late but the simulation."""
    cycles, _ = timed(lambda _: 4 * QUICK, lambda _: 9 * QUICK, cycles=50)
    assert set(cycles.response) == {4 * QUICK}
    assert cycles.overran.all()
    assert set(cycles.put_off) == {9 * QUICK}
    assert not cycles.missed.any()
    row = summary_of(race_of(cycles))["rows"][0]
    assert row["plant_overruns"] == 50
    assert row["put_off_us"] == pytest.approx(50 * 900)


def test_what_a_plant_takes_beyond_that_delays_the_next_cycle() -> None:
    at = WARM_UP + LEAD_IN + 10
    cycles, _ = timed(lambda _: QUICK, lambda n: 5 * MS if n == at else 2 * QUICK, cycles=30)
    assert cycles.put_off[10] == 2 * QUICK
    assert cycles.put_off.sum() == cycles.put_off[10] + cycles.put_off[11:16].sum()
    # 0.1 + 5 ms from its release, of which 0.2 ms are put off.
    assert cycles.wake[11] == QUICK + 5 * MS - MS - 2 * QUICK
    assert cycles.missed[11]
    assert cycles.behind[11]
    assert cycles.overran[10]


def test_a_slow_controller_is_not_excused_by_its_plant() -> None:
    cycles, _ = timed(lambda _: 12 * QUICK, lambda _: 3 * QUICK, cycles=20)
    assert cycles.missed.all()
    assert not cycles.overran.any()
    # It falls behind by its own 0.2 ms a cycle, the plant's 0.3 ms are not its fault.
    assert set(np.diff(cycles.response)) == {2 * QUICK}


@settings(max_examples=40, deadline=None)
@given(
    work=st.lists(
        st.tuples(st.integers(0, 3 * MS), st.integers(0, 2 * MS)), min_size=1, max_size=50
    ),
    ordinary=st.integers(0, MS // 2),
)
def test_figures_are_those_of_the_recursion(work: list[tuple[int, int]], ordinary: int) -> None:
    """Brute force over random controllers and plants, after a warm-up that tells the ordinary."""
    first = WARM_UP + LEAD_IN

    def part(i: int, before: int) -> Callable[[int], int]:
        return lambda n: work[n - first][i] if n >= first else before

    cycles, _ = timed(part(0, 0), part(1, ordinary), cycles=len(work))
    release = free = 0
    for k, (takes, plant) in enumerate(work):
        begin = max(release, free)
        done, free = begin + takes, begin + takes + plant
        assert cycles.wake[k] == begin - release
        assert cycles.response[k] == done - release
        assert cycles.missed[k] == (done - release > MS)
        put_off = min(plant, ordinary) if free > release + MS else 0
        assert cycles.put_off[k] == put_off
        assert cycles.overran[k] == (done <= release + MS < free)
        release += MS + put_off


# ---- turns


def test_all_run_by_turns_and_each_all_its_cycles() -> None:
    clock, order = FakeClock(), []

    class Noted(Timed):
        def respond(self, left: float) -> None:
            if not order or order[-1] != self.name:
                order.append(self.name)
            super().respond(left)

    subjects = [Noted(clock, lambda _: 0, lambda _: 0) for _ in range(3)]
    for subject, name in zip(subjects, "abc", strict=True):
        subject.name = name
    cycles = 2 * BLOCK + 77
    made = go(race(*subjects, cycles=cycles), clock)
    assert "".join(order) == "abc" + "abc" + "bca" + "cab"
    assert [entry.cycles.count for entry in made.entries] == [cycles] * 3
    assert {subject.n for subject in subjects} == {cycles_in_all(cycles)}


def test_who_fails_is_told_and_the_others_go_on() -> None:
    clock = FakeClock()

    class Breaks(Timed):
        def advance(self) -> None:
            super().advance()
            if self.n == WARM_UP + LEAD_IN + 40:
                raise PlantError("it broke")

    made = go(
        race(Breaks(clock, lambda _: 0, lambda _: 0), Timed(clock, lambda _: 0, lambda _: 0),
             cycles=100),
        clock,
    )  # fmt: skip
    broken, whole = made.entries
    assert broken.stopped == "it broke (cycle 39)"
    assert (broken.cycles.count, whole.cycles.count) == (39, 100)
    assert not made.complete
    rows = summary_of(made)["rows"]
    assert [row["error"] for row in rows] == ["it broke (cycle 39)", None]


@pytest.mark.parametrize("after", [0, WARM_UP - 1, WARM_UP + LEAD_IN + 3])
def test_what_was_done_until_a_stop_is_valid(after: int, tmp_path) -> None:
    clock, asked = FakeClock(), iter(range(10**9))
    subjects = [Timed(clock, lambda _: QUICK, lambda _: 0) for _ in range(2)]
    subjects[1].name = "other"
    made = go(race(*subjects, cycles=100), clock, stop=lambda: next(asked) >= after + WARM_UP)
    assert not made.complete
    told = summary_of(made)
    check(told)
    write_histograms(made, tmp_path, start=0.0, seconds=1.0)
    deadline_tables(told)


# ---- what is kept of the cycles


@given(flags=st.lists(st.booleans(), max_size=60))
def test_longest_run(flags: list[bool]) -> None:
    best = run_ = 0
    for flag in flags:
        run_ = run_ + 1 if flag else 0
        best = max(best, run_)
    assert longest_run(np.array(flags, dtype=bool)) == best


def test_cycles_without_sleep_or_solve_are_left_out_of_those_figures() -> None:
    cycles = Cycles(3, MS, MS)
    for late, timer, solve in ((0, 5, 7), (9, NONE, NONE), (0, 6, NONE)):
        cycles.note(
            late=late, timer=timer, begin=100 + late, done=200, settled=250, ended=300,
            solve=solve, status=NONE, source=NONE, behind=False, put_off=0,
        )  # fmt: skip
    assert cycles.timer.tolist() == [5, 6]
    assert cycles.solve.tolist() == [7]
    assert cycles.response.tolist() == [100, 100, 100]
    assert cycles.compute.tolist() == [150, 141, 150]
    assert cycles.plant.tolist() == [50, 50, 50]


# ---- on the cell


@dataclass
class Setting:
    """A backend that is slow in some of its solves, by the test's clock."""

    clock: FakeClock
    slow: dict[int, int] = field(default_factory=dict)


@pytest.fixture
def setting(monkeypatch):
    made = Setting(FakeClock())

    class Slow(DaqpBackend):
        """DAQP, whose n-th solve in the loop takes what it is told."""

        name = "slow"
        smallest_part = 1000

        def __init__(self, qp, limits):
            self.n = None
            super().__init__(qp, limits)
            self.n = 0

        def solve(self, q, l, u):
            raw = super().solve(q, l, u)
            if self.n is not None:
                made.clock.spend(made.slow.get(self.n, QUICK))
                self.n += 1
            return raw

    monkeypatch.setitem(_registry._table, "slow", Slow)
    for module in (controller_module, cycle_module, solver_module):
        monkeypatch.setattr(module, "perf_counter", lambda: made.clock.time / 1e9)
    return made


def on_the_cell(setting: Setting, cycles: int) -> tuple[Race, dict[str, Any]]:
    made = enter(load_scenario("paper"), ["slow", "daqp"], cycles, 1e-3, lambda *_: None)
    go(made, setting.clock)
    assert made.complete
    return made, summary_of(made)


def test_late_answers_are_left_the_plan_goes_on_and_the_loop_recovers(setting) -> None:
    """One solve of 5.05 ms: its cycle is late, and so are those that were released meanwhile."""
    at = WARM_UP + LEAD_IN + 100
    setting.slow[at] = 5 * MS + QUICK // 2
    made, told = on_the_cell(setting, 400)
    empty, plant, slow, prompt = told["rows"]
    assert [row["kind"] for row in told["rows"]] == ["empty", "plant", "backend", "backend"]
    cycles = made.entries[2].cycles
    late = np.flatnonzero(cycles.status == STATUSES.index(Status.LATE))
    assert late.tolist() == [100, 101, 102, 103, 104]
    assert slow["late"] == {
        "count": 5, "longest_run": 5, "actions": {"plan": 5, "analytic": 0, "hold": 0},
    }  # fmt: skip
    assert slow["solve_misses"] == 1
    # Without time left no solve was begun: those cycles are not solves.
    assert len(cycles.solve) == 400 - 4
    assert cycles.missed[:105].sum() == 5
    assert slow["miss_actions"]["plan"] == 5
    assert slow["status"] == {"solved": 395, "late": 5}
    for axis in "xyz":
        assert slow["force_error"][axis]["max"] < prompt["force_error"][axis]["max"] + 0.5
    errors = [np.abs(e.subject.errors()) for e in made.entries[2:]]
    assert np.array_equal(errors[0][:at], errors[1][:at])
    assert not np.array_equal(errors[0], errors[1])
    np.testing.assert_allclose(errors[0][at + 150 :], errors[1][at + 150 :], atol=0.05)
    assert (empty["misses"], plant["misses"], prompt["misses"]) == (0, 0, 0)
    assert empty["late"] is plant["status"] is None
    assert plant["plant_us"]["max"] == 0.0
    check(told)


def test_a_backend_that_never_makes_it_is_the_closed_form(setting) -> None:
    setting.slow = dict.fromkeys(range(10**4), 3 * MS)
    _, told = on_the_cell(setting, 60)
    slow = told["rows"][2]
    assert slow["late"]["count"] == slow["late"]["actions"]["analytic"] == 60
    assert slow["source"]["solution"] == 0
    assert all(error["max"] < 0.5 for error in slow["force_error"].values())


def check(told: dict[str, Any]) -> None:
    schema = json.loads(
        (Path(deadline_module.__file__).parent / "deadline.schema.json").read_text()
    )
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads(json.dumps(told, allow_nan=False)), schema)


def test_tables_fit_a_terminal_and_tell_what_is_not_in_force() -> None:
    clock = FakeClock()
    told = summary_of(
        go(race(Empty(), Timed(clock, lambda _: QUICK, lambda _: 0), cycles=9), clock)
    )
    console = Console(width=80, file=io.StringIO())
    for table in deadline_tables(told):
        console.print(table)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    for word in ("timed", "empty", "p99.99", "misses", "closed", " 100 "):
        assert word in text
    assert "…" not in text
    lines = "\n".join(machine_lines(told["machine"]))
    assert "not in force: real-time scheduler: not asked for" in lines


def test_a_controlled_cycle_is_that_of_the_ordinary_loop(setting) -> None:
    """The same commands as `control_loop` gives, when nothing is late."""
    from scenarios import run_experiment  # noqa: PLC0415

    made, _ = on_the_cell(setting, 60)
    subject = made.entries[3].subject
    assert isinstance(subject, Controlled)
    still = np.zeros((made.scenario.cycles, 3))
    ordinary = run_experiment(
        made.scenario, report=lambda *_: None, stop=lambda: False, held=still
    ).log
    assert np.array_equal(subject.errors(), (ordinary.force - ordinary.setpoint)[: subject._k])
