"""A recording that needs no cell, a clock that needs no time, and backends that stall."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

from bench.latency.measure import Settings, measure
from bench.stream import Stream
from qpmpc.backends import _registry
from qpmpc.backends.analytic import AnalyticBackend
from qpmpc.backends.daqp import DaqpBackend
from scenarios import load_scenario

NO_JOINTS = SimpleNamespace(speed_gain=np.zeros((6, 3)), speed_offset=np.zeros(6))
US, MS = 1_000, 1_000_000


class FakeClock:
    """Time that passes only where somebody waits or says so."""

    def __init__(self) -> None:
        self.time = 0

    def now(self) -> int:
        return self.time

    def sleep_until(self, instant: int) -> None:
        self.time = max(self.time, instant)


@dataclass
class _Work:
    """What the artificial backend does: a usual time, and a stall every so many cycles."""

    usual: int = 0
    stall: int = 0
    every: int = 500
    spend: object = None
    """Called with nanoseconds."""


class Stalling(AnalyticBackend):
    """The closed form with work beside it; counts its cycles from where it was told to forget."""

    name: ClassVar[str] = "stalling"
    smallest_part: ClassVar[int] = 64
    work: ClassVar[_Work] = _Work()
    begun: ClassVar[list[str]] = []

    def __init__(self, qp, limits):
        super().__init__(qp, limits)
        self._cycle = 0

    def forget(self):
        self._cycle = 0
        self.begun.append(self.name)

    def solve(self, q, l, u):  # noqa: E741
        self._cycle += 1
        work = self.work
        if work.spend is not None:
            stalls = work.stall and self._cycle % work.every == 0
            work.spend(work.stall if stalls else work.usual)
        return super().solve(q, l, u)


class Off(DaqpBackend):
    """DAQP whose plan is shifted by a little, which a check does not mind."""

    name: ClassVar[str] = "off"
    warm_starts: ClassVar[bool] = False
    by = 1e-6

    def solve(self, q, l, u):  # noqa: E741
        raw = super().solve(q, l, u)
        raw.x = raw.x + self.by
        return raw


def _registered(monkeypatch):
    monkeypatch.setitem(_registry._table, "stalling", Stalling)
    monkeypatch.setitem(_registry._table, "off", Off)
    monkeypatch.setattr(Stalling, "begun", [])

    def set_(**work):
        monkeypatch.setattr(Stalling, "work", _Work(**work))
        return Stalling

    return set_


@pytest.fixture
def stalling(monkeypatch):
    """Register the artificial backends; return how to set the one that stalls."""
    return _registered(monkeypatch)


@pytest.fixture
def off(monkeypatch):
    """Register the artificial backends; return the one that is off."""
    _registered(monkeypatch)
    return Off


@pytest.fixture
def clock():
    return FakeClock()


@pytest.fixture(scope="module")
def stalled():
    """A stall of 2 ms every 500 of 1500 cycles that usually take 50 us: the group."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        clock = FakeClock()

        def spend(nanoseconds):
            clock.time += nanoseconds

        _registered(monkeypatch)(usual=50 * US, stall=2 * MS, spend=spend)
        return _measured(_stream(1500), "stalling", clock=clock)


def _stream(cycles, settings=(), axes=("z",)):
    """Measurements about the setpoint, now and then so far off that bounds act."""
    scenario = load_scenario(
        "latency",
        top={"duration": cycles * 1e-3, "axes": list(axes)},
        settings=("setpoint.steps=[]", *settings),
    )
    rng = np.random.default_rng(3)
    index = ["xyz".index(axis) for axis in axes]
    rough = np.where(rng.random((cycles, 1)) < 0.3, 0.5, 0.01)
    force = np.array([1.0, 2.0, -10.0])[index] + rough * rng.normal(0.0, 1.0, (cycles, len(axes)))
    velocity = 0.01 * rng.normal(0.0, 1.0, (cycles, len(axes)))
    command = np.clip(rng.normal(0.0, 1.0, (cycles, len(axes))), -6.0, 6.0)
    return Stream(scenario, force, velocity, command, (NO_JOINTS,))


@pytest.fixture(scope="session")
def make_stream():
    """A recording out of random numbers: ``(cycles, settings, axes)``."""
    return _stream


def _measured(stream, *backends, clock, horizon=8, stop=lambda: False, **changes):
    settings = {
        "backends": backends, "paths": ("interpreted",), "passes": 3, "paced": True,
        "paced_instances": 10**6, "budget": 1e3,
    } | changes  # fmt: skip
    return measure(
        stream, horizon, Settings(**settings), clock=clock, report=lambda *_: None, stop=stop
    )


@pytest.fixture
def run(clock):
    """Measure under the fake clock or another; returns the group."""

    def measured(stream, *backends, **changes):
        return _measured(stream, *backends, **{"clock": clock} | changes)

    return measured
