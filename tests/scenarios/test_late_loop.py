# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""An artificially slow backend on the cell: late answers are left, the plan goes on, it recovers.

The clock is the test's: it stands still but where a solve is slow, so that no machine is too slow
for these tests and none too quick.
"""

from __future__ import annotations

import numpy as np
import pytest

from qpmpc import controller as controller_module
from qpmpc.backends import _registry
from qpmpc.backends.daqp import DaqpBackend
from qpmpc.fallback import Source

SOURCES = [str(source) for source in Source]
BEAT = range(420, 700)
"""Cycles in which the heart moves fast."""
WITH_DEADLINE = ("controller.bounds.force.z=[-10.2, -0.5]", "controller.solver.deadline=0.001")
SLOW = 0.005


class Slow(DaqpBackend):
    """DAQP, some of whose solves last 5 ms."""

    name = "slow"
    smallest_part = 1000  # one call a cycle
    late: object
    clock: list[float]

    def __init__(self, qp, limits):
        self._solves = None
        super().__init__(qp, limits)
        self._solves = 0

    def solve(self, q, l, u):
        raw = super().solve(q, l, u)
        if self._solves is not None:
            if self._solves in self.late:
                self.clock[0] += SLOW
            self._solves += 1
        return raw


@pytest.fixture
def slowed(monkeypatch, simulate):
    """Run `paper` with a solver that is slow in some cycles."""

    def run(late, settings=WITH_DEADLINE, duration=0.7):
        clock = [0.0]
        kind = type("Slow", (Slow,), {"late": late, "clock": clock})
        monkeypatch.setitem(_registry._table, "slow", kind)
        monkeypatch.setattr(controller_module, "perf_counter", lambda: clock[0])
        return simulate("paper", *settings, still=False, backend="slow", duration=duration)

    return run


@pytest.fixture(scope="module")
def prompt(simulate):
    """The same path as `Slow`, which is no compiled one: commands agree to the last bit."""
    settings = (WITH_DEADLINE[0], "controller.solver.compiled=off")
    return simulate("paper", *settings, still=False, duration=0.7)


def error(run, cycles) -> float:
    log = run.log
    return float(np.abs(log.force - log.setpoint)[cycles.start : cycles.stop].max())


def sources(run) -> list[str]:
    return [SOURCES[code] for code in run.log.source]


def test_late_cycles_take_the_plan_and_the_loop_recovers(slowed, prompt):
    late = range(450, 455)
    run = slowed(late)
    assert run.summary["status"]["late"] == 5
    assert run.summary["source"] == {"solution": 695, "plan": 5, "analytic": 0, "hold": 0}
    assert [k for k, source in enumerate(sources(run)) if source == "plan"] == list(late)
    assert np.array_equal(run.log.command[:450], prompt.log.command[:450])
    assert not np.array_equal(run.log.command[450], prompt.log.command[450])
    assert error(run, BEAT) < 1.0
    assert error(run, range(540, 700)) < 2 * error(prompt, range(540, 700)) + 0.02


def test_every_other_solve_late_is_held_by_plans(slowed, prompt):
    run = slowed(range(1, 700, 2))
    assert run.summary["source"] == {"solution": 350, "plan": 350, "analytic": 0, "hold": 0}
    assert error(run, range(700)) < 2 * error(prompt, range(700)) + 0.05


def test_a_backend_that_is_always_late_leaves_the_closed_form(slowed):
    run = slowed(range(10**6), duration=0.3)
    assert run.summary["status"] == {"late": 300}
    assert run.summary["source"] == {"solution": 0, "plan": 0, "analytic": 300, "hold": 0}
    assert error(run, range(300)) < 0.3


def test_without_a_deadline_the_same_backend_is_waited_for(slowed, prompt):
    run = slowed(range(10**6), settings=WITH_DEADLINE[:1])
    assert run.summary["source"]["solution"] == 700
    assert np.array_equal(run.log.command, prompt.log.command)


def test_real_time_decides_where_the_deadline_is_real(simulate):
    """No answer comes within a nanosecond; within an hour, every one."""
    hasty = simulate("paper", "controller.solver.deadline=1e-9", still=False, duration=0.02)
    assert hasty.summary["status"] == {"late": 20}
    patient = simulate("paper", "controller.solver.deadline=3600", still=False, duration=0.02)
    assert patient.summary["status"] == {"solved": 20}
