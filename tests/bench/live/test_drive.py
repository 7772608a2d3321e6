"""The running experiment by a clock that the test holds."""

from __future__ import annotations

import importlib.util
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest

from bench.live.drive import BEHIND, Drive
from scenarios.livecell.ring import SIZE, Ring

_SPEC = importlib.util.spec_from_file_location("clocks", Path(__file__).parents[1] / "clocks.py")
_CLOCKS = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(_CLOCKS)
MS = 1_000_000


class Cycles:
    """Stands in for an engine: each cycle takes what the test says."""

    period = 1e-3

    def __init__(self, clock, takes):
        self.clock, self.takes, self.resting = clock, takes, False
        self.begun: list[int] = []
        self.late: list[float] = []
        self.idled = 0

    def cycle(self, late):
        self.begun.append(self.clock.time)
        self.late.append(late)
        self.clock.spend(self.takes(len(self.begun)))

    def idle(self):
        self.idled += 1


@pytest.fixture
def driven():
    def drive(cycles, takes, look=None):
        clock = _CLOCKS.FakeClock()
        engine, ring = Cycles(clock, takes), Ring.over(bytearray(8 * SIZE))
        looks = look or (lambda engine: len(engine.begun) < cycles)
        Drive(engine, ring, clock, lambda: looks(engine)).run()
        return SimpleNamespace(engine=engine, ring=ring, clock=clock)

    return drive


def test_cycles_begin_a_period_apart(driven):
    run = driven(3000, lambda _: MS // 3)
    begun = run.engine.begun
    assert {b - a for a, b in pairwise(begun)} == {MS}
    assert run.ring.told("speed") == pytest.approx(1.0, abs=2e-3)
    assert run.ring.told("lost") == 0.0


def test_a_short_stall_is_caught_up(driven):
    run = driven(2000, lambda k: 100 * MS if k == 500 else MS // 3)
    begun = run.engine.begun
    assert begun[1999] - begun[0] == 1999 * MS
    assert run.ring.told("lost") == 0.0
    assert max(run.engine.late) == pytest.approx(0.099)


def test_time_that_is_lost_is_let_go_and_told(driven):
    run = driven(2000, lambda k: 2000 * MS if k == 500 else MS // 3)
    assert run.ring.told("lost") == pytest.approx(1.999)
    late = run.engine.late
    assert max(late) > BEHIND
    assert max(late[502:]) == 0.0  # no rush afterwards


def test_what_is_too_slow_is_told(driven):
    run = driven(4000, lambda _: 2 * MS)
    assert run.ring.told("speed") == pytest.approx(0.5, abs=0.01)


def test_a_pause_is_not_made_up_for(driven):
    def look(engine):
        looks.append(None)
        engine.resting = 100 < len(looks) < 200
        return len(engine.begun) < 2000

    looks: list[None] = []
    run = driven(2000, lambda _: MS // 3, look)
    assert run.engine.idled > 50
    assert max(run.engine.late) == 0.0
    assert run.ring.told("lost") == 0.0
