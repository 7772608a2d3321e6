"""A setpoint from another process: what is taken, what is refused; nothing else suffers."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys

import numpy as np
import pytest

from bench.pace import by_the_clock
from scenarios import ScenarioError, load_scenario, run_experiment, summarise
from scenarios.config import LiveConfig
from scenarios.live import ADDRESS, LAYOUT, LiveSetpoint, Source, encode

LOW, HIGH = np.array([-8.0, -20.0]), np.array([8.0, -0.5])
PERIOD = 1e-3


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((ADDRESS, 0))
        return int(probe.getsockname()[1])


class Rig:
    """A live setpoint on x and z whose clock is the test's, and a sender."""

    def __init__(self, **config: float) -> None:
        self.port, self.now, self.cycle = free_port(), 100.0, 0
        self.setpoint = LiveSetpoint(
            LiveConfig(self.port, **config), np.array([1.0, 2.0, -10.0]), (LOW, HIGH), ("x", "z"),
            cycles=2000, horizon=3, period=PERIOD, clock=lambda: self.now,
        )  # fmt: skip
        self.sender = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def send(self, data: bytes) -> None:
        self.sender.sendto(data, (ADDRESS, self.port))

    def wish(self, number: int, x: float, z: float, y: float = 0.0) -> None:
        self.send(encode(number, (x, y, z)))

    def step(self, cycles: int = 1) -> list[float]:
        for _ in range(cycles):
            preview = self.setpoint.preview(self.cycle)
            assert preview.shape == (4, 2)
            assert (preview == preview[0]).all()
            assert np.array_equal(self.setpoint.force[self.cycle], preview[0])
            self.cycle += 1
            self.now += PERIOD
        return [float(value) for value in preview[0]]

    @property
    def source(self) -> Source:
        return Source(self.setpoint.source[self.cycle - 1])


@pytest.fixture
def rig(request):
    made = Rig(**getattr(request, "param", {"largest_rate": 1e5}))
    yield made
    made.setpoint.close()
    made.sender.close()


def test_until_something_comes_it_is_where_it_starts(rig):
    assert rig.step(5) == [1.0, -10.0]
    assert rig.source is Source.WAITING
    assert rig.setpoint.counts.waiting_cycles == 5


def test_what_is_sent_is_followed_and_axes_without_control_are_not_looked_at(rig):
    rig.wish(7, 2.0, -12.0, y=999.0)
    assert rig.step() == [2.0, -12.0]
    assert rig.source is Source.LIVE
    rig.wish(8, 3.0, -11.0)
    rig.wish(9, 4.0, -13.0)  # of several the last counts
    assert rig.step() == [4.0, -13.0]
    assert rig.setpoint.summary()["received"] == 3


@pytest.mark.parametrize("rig", [{"largest_rate": 50.0}], indirect=True)
def test_it_follows_at_its_rate(rig):
    rig.wish(1, 1.2, -9.0)
    path = np.array([rig.step() for _ in range(25)])
    np.testing.assert_allclose(path[:4, 0], [1.05, 1.1, 1.15, 1.2], atol=1e-12)
    np.testing.assert_allclose(np.diff(path[:20, 1]), 0.05, atol=1e-12)
    assert path[-1].tolist() == pytest.approx([1.2, -9.0])
    assert 18 <= rig.setpoint.counts.limited_cycles <= 20


@pytest.mark.parametrize("rig", [{"largest_rate": 10.0, "stale_after": 0.0505}], indirect=True)
def test_silence_leaves_it_where_it_is(rig):
    rig.wish(1, 5.0, -10.0)
    rig.step(51)
    assert rig.source is Source.LIVE
    held = rig.step()
    assert rig.source is Source.STALE
    assert held[0] == pytest.approx(1.0 + 0.01 * 51)  # on its way, and no farther
    assert rig.step(30) == held
    assert rig.setpoint.counts.stale_cycles == 31
    rig.wish(1, 5.0, -10.0)  # a sender that begins anew, at an old number
    assert rig.step()[0] > held[0]
    assert rig.source is Source.LIVE


GARBAGE = {
    "nothing": b"",
    "one byte": b"p",
    "text": b"set the force to 5 newtons, please",
    "short": encode(5, (2.0, 0.0, -5.0))[:-1],
    "long": encode(5, (2.0, 0.0, -5.0)) + b"\0",
    "very long": encode(5, (2.0, 0.0, -5.0)) * 1000,
    "another mark": b"pmS2" + encode(5, (2.0, 0.0, -5.0))[4:],
    "big-endian": b"pmS1" + bytes(reversed(encode(5, (2.0, 0.0, -5.0))[4:])),
}


@pytest.mark.parametrize("data", GARBAGE.values(), ids=GARBAGE)
def test_another_form_is_refused(data, rig):
    rig.send(data)
    assert rig.step() == [1.0, -10.0]
    counts = rig.setpoint.counts
    # What does not even fit into the system's queue never arrives.
    assert counts.refused_form + counts.refused_value == counts.received <= 1
    assert rig.source is Source.WAITING


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e308, -0.4, -20.01, 5e-324])
def test_a_value_that_is_none_or_out_of_bounds_is_refused_whole(value, rig):
    rig.wish(1, 2.0, -9.0)
    rig.step()
    rig.wish(2, 7.0, value)
    assert rig.step() == [2.0, -9.0]
    assert rig.setpoint.counts.refused_value == 1


def test_old_numbers_are_refused_and_wrapping_is_none(rig):
    rig.wish(2**32 - 2, 2.0, -9.0)
    rig.step()
    for number in (2**32 - 2, 2**32 - 3, 2**31):
        rig.wish(number, 7.0, -5.0)
    assert rig.step() == [2.0, -9.0]
    assert rig.setpoint.counts.refused_number == 3
    rig.wish(1, 3.0, -8.0)
    assert rig.step() == [3.0, -8.0]


def test_a_flood_costs_a_cycle_a_bounded_number_of_looks(rig):
    for number in range(20_000):
        rig.wish(number, 2.0, -9.0)
    rig.step()
    assert 1 <= rig.setpoint.counts.received <= 64
    rig.step(50)
    assert rig.setpoint.counts.received <= 51 * 64


def test_a_port_in_use_is_one_line_and_a_closed_one_is_free_again():
    def another() -> LiveSetpoint:
        return LiveSetpoint(
            LiveConfig(first.port), np.zeros(3), (LOW, HIGH), ("x", "z"),
            cycles=1, horizon=1, period=PERIOD,
        )  # fmt: skip

    first = Rig()
    first.sender.close()
    with pytest.raises(ScenarioError, match=r"setpoint\.live\.port.*in use") as caught:
        another()
    assert "\n" not in str(caught.value)
    first.setpoint.close()
    another().close()


def test_it_listens_on_this_machine_only(rig):
    assert rig.setpoint._socket.getsockname()[0] == "127.0.0.1"


def test_the_layout_is_as_documented():
    assert LAYOUT.size == 32
    assert encode(3, (1.0, 2.0, -10.0))[:8] == b"pmS1\x03\x00\x00\x00"


# --- a run, and another process ------------------------------------------------------------------

SENDER = """
import os, socket, struct, sys, time
port, kind = int(sys.argv[1]), sys.argv[2]
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
number, begin = 0, time.monotonic()
while True:
    number += 1
    if kind == "garbage":
        data = os.urandom(number % 64)
    else:
        data = struct.pack("<4sI3d", b"pmS1", number, 1.0, 2.0, -11.0)
    try:
        out.sendto(data, ("127.0.0.1", port))
    except OSError:
        pass
    if kind != "flood":
        time.sleep(0.002)
"""


@pytest.fixture
def senders():
    started = []

    def start(port, kind):
        started.append(subprocess.Popen([sys.executable, "-c", SENDER, str(port), kind]))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.wait()


def live_run(port, duration, progress=lambda *_: None):
    scenario = load_scenario(
        "ideal", top={"duration": duration}, settings=[f"setpoint.live={{port={port}}}"]
    )
    return run_experiment(
        scenario, report=progress, stop=lambda: False, held=np.zeros((scenario.cycles, 3)),
        pace=by_the_clock(PERIOD),
    )  # fmt: skip


@pytest.mark.parametrize("company", ["alone", "garbage", "killed"])
def test_a_run_follows_another_process(company, senders):
    port = free_port()
    driver = senders(port, "wish")
    if company == "garbage":
        senders(port, "garbage")

    def progress(stage, done, total):
        if company == "killed" and stage == "compensated" and done >= 1000:
            os.kill(driver.pid, signal.SIGKILL)

    experiment = live_run(port, 1.5, progress)
    log, summary = experiment.log, summarise(experiment)
    counts = summary["live_setpoint"]
    assert log.cycles == 1500
    assert summary["status"] == {"solved": 1500}
    assert counts["received"] > 20
    assert log.setpoint[-1] == pytest.approx([1.0, 2.0, -11.0])
    assert log.force[-1] == pytest.approx([1.0, 2.0, -11.0], abs=0.1)
    assert np.abs(log.force - log.setpoint).max() < 1.2  # the step, which nobody knew ahead
    assert (counts["refused_form"] > 20) == (company == "garbage")
    silent = np.flatnonzero(log.setpoint_source == Source.STALE)
    if company == "killed":
        assert (log.setpoint_source[-200:] == Source.STALE).all()
        assert silent.min() > 1000


def test_a_flood_changes_nothing_but_what_is_counted(senders):
    port = free_port()
    senders(port, "flood")
    experiment = live_run(port, 0.4)
    summary = summarise(experiment)
    assert summary["status"] == {"solved": 400}
    assert summary["live_setpoint"]["received"] <= 400 * 64
    assert np.abs(experiment.log.force - experiment.log.setpoint).max() < 1.2
