"""The pacer by a clock that the test holds, the clocks, and measures that come and go."""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import time

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench import realtime
from bench.machine import measures
from bench.realtime import Measures, Pacer, SkippingClock, SystemClock, real_time

from .clocks import FakeClock

PERIOD = 1_000_000
NAMES = {
    "affinity", "scheduler", "memory_locked", "garbage_collection", "timer_slack", "idle_latency",
}  # fmt: skip


# ---- the pacer


@settings(max_examples=60, deadline=None)
@given(work=st.lists(st.integers(0, 5 * PERIOD), min_size=1, max_size=60))
def test_releases_stay_on_the_grid_whatever_the_cycles_take(work: list[int]) -> None:
    """Brute force: a cycle begins at its release, or when the one before is over."""
    clock = FakeClock()
    pacer = Pacer(clock, PERIOD, 0)
    origin = pacer.start()
    free = 0
    for k, takes in enumerate(work):
        release, late = pacer.wait()
        assert release == origin + k * PERIOD
        assert late == max(0, free - release)
        clock.spend(takes)
        free = release + late + takes


def test_a_stall_of_ten_periods_makes_ten_late_releases() -> None:
    clock = FakeClock()
    pacer = Pacer(clock, PERIOD, 0)
    pacer.start()
    pacer.wait()
    clock.spend(10 * PERIOD + 7)
    late = [pacer.wait()[1] for _ in range(12)]
    assert late == [k * PERIOD + 7 for k in range(9, -1, -1)] + [0, 0]


def test_nothing_drifts_in_many_cycles_that_oversleep() -> None:
    clock = FakeClock(oversleep=60_000)
    pacer = Pacer(clock, PERIOD, 0)
    origin = pacer.start()
    for _ in range(100_000):
        release, late = pacer.wait()
    assert release == origin + 99_999 * PERIOD
    assert late == 60_000
    assert pacer.timer == 60_000


def test_sleep_ends_before_the_release_and_the_clock_is_watched() -> None:
    clock = FakeClock(tick=10, oversleep=30_000)
    pacer = Pacer(clock, PERIOD, 100_000)
    release = pacer.start()
    assert pacer.wait()[0] == release
    assert clock.slept == [release - 100_000]
    assert 0 <= clock.time - release <= 10
    assert 30_000 <= pacer.timer <= 30_020


def test_without_time_to_sleep_there_is_no_timer_to_be_late() -> None:
    clock = FakeClock(tick=1)
    pacer = Pacer(clock, PERIOD, 100_000)
    pacer.start()
    release, _ = pacer.wait()
    clock.time = release + PERIOD + 5
    assert pacer.wait()[1] == 6
    assert pacer.timer == -1
    assert len(clock.slept) == 1


def test_a_new_start_leaves_the_past_behind_and_a_lead_is_waited() -> None:
    clock = FakeClock()
    pacer = Pacer(clock, PERIOD, 0)
    pacer.start()
    pacer.wait()
    clock.spend(50 * PERIOD)
    assert pacer.start(lead=3) == clock.time + PERIOD + 3
    assert pacer.wait()[1] == 0


def test_what_is_put_off_moves_every_release_to_come() -> None:
    clock = FakeClock()
    pacer = Pacer(clock, PERIOD, 0)
    origin = pacer.start()
    pacer.wait()
    pacer.put_off(300)
    assert [pacer.wait()[0] for _ in range(2)] == [origin + PERIOD + 300, origin + 2 * PERIOD + 300]


# ---- clocks


def test_system_clock_sleeps_to_an_instant() -> None:
    clock = SystemClock()
    instant = clock.now() + 5_000_000
    clock.sleep_until(instant)
    assert clock.now() >= instant
    clock.sleep_until(instant)  # has passed: no sleep


def test_a_signal_does_not_end_a_sleep() -> None:
    seen = []
    before = signal.signal(signal.SIGALRM, lambda *_: seen.append(time.monotonic_ns()))
    try:
        clock = SystemClock()
        instant = clock.now() + 60_000_000
        signal.setitimer(signal.ITIMER_REAL, 0.01)
        clock.sleep_until(instant)
        assert clock.now() >= instant
        assert len(seen) == 1
        assert seen[0] < instant
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)


def test_where_there_is_no_such_call_pythons_sleep_stands_in(monkeypatch) -> None:
    monkeypatch.setattr(ctypes, "CDLL", lambda *_, **__: object())
    clock = SystemClock()
    assert clock.sleeps_by == "time.sleep"
    instant = clock.now() + 2_000_000
    clock.sleep_until(instant)
    assert clock.now() >= instant


def test_skipping_clock_costs_no_waits() -> None:
    clock = SkippingClock()
    begin, real = clock.now(), time.monotonic_ns()
    hour = 3600 * 10**9
    clock.sleep_until(begin + hour)
    after = clock.now()
    assert begin + hour <= after <= begin + hour + (time.monotonic_ns() - real)
    clock.sleep_until(begin)  # has passed: time does not go back
    assert clock.now() >= after


# ---- measures


@pytest.fixture
def untouched():
    """What a process has before it asks, and must have again after."""

    def state():
        return (
            os.sched_getaffinity(0), os.sched_getscheduler(0), os.sched_getparam(0).sched_priority,
            gc.isenabled(), gc.get_freeze_count(), measures()["timer_slack"]["value"],
            measures()["memory_locked"]["value"]["locked_kib"],
            measures()["idle_latency"]["value"],
        )  # fmt: skip

    before = state()
    yield
    assert state() == before


def test_what_was_not_refused_is_in_force_and_all_is_undone(untouched) -> None:
    with real_time(Measures(heap=2**20)) as refused:
        found = measures(refused)
        assert set(refused) <= NAMES
        assert set(found) == NAMES
        for name, measure in found.items():
            assert measure["in_force"] == (name not in refused), (name, measure)
            assert measure["reason"] == refused.get(name)
        assert "affinity" not in refused  # needs no privilege
        assert "garbage_collection" not in refused


def test_all_is_undone_where_the_run_fails(untouched) -> None:
    with pytest.raises(RuntimeError, match="the run"), real_time(Measures(heap=2**20)):
        raise RuntimeError("the run")


def test_what_is_refused_is_told_and_the_rest_goes_on(untouched, monkeypatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    monkeypatch.setattr(realtime, "_LATENCY_REQUEST", realtime.Path("/nowhere/at/all"))
    with real_time(Measures(heap=2**20)) as refused:
        assert refused["scheduler"] == "Operation not permitted"
        assert refused["idle_latency"] == "No such file or directory"
        found = measures(refused)
        assert not found["scheduler"]["in_force"]
        assert found["scheduler"]["reason"] == "Operation not permitted"
        assert found["affinity"]["in_force"]


def test_core_and_priority_are_those_asked_for(untouched) -> None:
    core = min(os.sched_getaffinity(0))
    with real_time(Measures(cpu=core, priority=7, heap=2**20)) as refused:
        found = measures(refused)
        assert found["affinity"]["value"] == [core]
        if "scheduler" not in refused:
            assert found["scheduler"]["value"] == {"policy": "SCHED_FIFO", "priority": 7}


def test_a_core_that_is_not_allowed_and_no_priority_are_reasons(untouched) -> None:
    with real_time(Measures(cpu=4711, priority=0, heap=2**20)) as refused:
        assert "core 4711 is not among the allowed ones" in refused["affinity"]
        assert refused["scheduler"] == "not asked for"
