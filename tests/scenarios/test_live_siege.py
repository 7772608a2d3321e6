"""A setpoint from another process for a minute: what others do to the port changes the status only.

A device sends wishes 500 times a second. Meanwhile it is killed and started anew, others flood the
port as fast as they can, and send garbage and absurd wishes. Then the same cell is run again with
nothing but the setpoint that came of it: the forces must be the same, bit for bit.

``make test-live`` runs a minute; the suite a few seconds of the same.
"""

from __future__ import annotations

import itertools
import socket
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from bench.pace import by_the_clock
from scenarios import Schedule, control_loop, load_scenario, run_experiment, summarise
from scenarios.experiment import assemble
from scenarios.live import ADDRESS, Source

PERIOD, RATE = 1e-3, 100.0
MIDDLE, SWING = -10.0, 2.0
AGES: dict[str, tuple[float, list[str]]] = {
    "the device alone": (0.2, ["device"]),
    "killed": (0.1, []),
    "started anew": (0.1, ["device"]),
    "flooded": (0.2, ["device", "flood"]),
    "garbage and absurd wishes": (0.1, ["device", "garbage", "absurd"]),
    "killed, and flooded": (0.1, ["flood"]),
    "the device again": (0.2, ["device"]),
}
"""What goes on: for which share of the run, and who sends."""

SENDER = r"""
import itertools, math, os, random, socket, struct, sys, time

port, kind = int(sys.argv[1]), sys.argv[2]
out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
dice = random.Random(kind)

def wish(n, z, x=1.0):
    return struct.pack("<4sI3d", b"pmS1", n % 2**32, x, 2.0, z)

def absurd(n):
    value = dice.choice([math.nan, math.inf, -math.inf, 1e308, -1e308, 5.0, -21.0, 0.0, -0.49])
    return wish(n, -9.0, value) if dice.random() < 0.3 and abs(value) > 8 else wish(n, value)

def garbage(n):
    size = dice.choice([0, 1, 31, 32, 33, 64, 1400])
    head = b"pmS1" if dice.random() < 0.3 and size != 32 else b""
    return (head + os.urandom(size))[: max(size, 0)]

flood = [dice.choice([garbage, absurd])(dice.randrange(2**32)) for _ in range(2000)]
print("ready", flush=True)
sys.stdin.readline()
begin = time.monotonic()
for n in itertools.count(1):
    t = time.monotonic() - begin
    if kind == "device":
        data = wish(n, -10.0 + 2.0 * math.sin(2.0 * math.pi * 0.5 * t))
    elif kind == "garbage":
        data = garbage(n)
    elif kind == "absurd":
        data = absurd(dice.randrange(2**32))
    else:
        data = flood[n % 2000]  # made before, to be as fast as can be
    try:
        out.sendto(data, ("127.0.0.1", port))
    except OSError:
        pass
    if kind != "flood":
        time.sleep(max(0.0, begin + 0.002 * n - time.monotonic()))
"""


class Siege:
    """The processes around the port, told by the cycle of the run.

    All are there from the start, and wait for their word to begin.
    """

    def __init__(self, port: int, cycles: int) -> None:
        self.ends = np.round(np.cumsum([share for share, _ in AGES.values()]) * cycles).astype(int)
        self._sending: dict[str, subprocess.Popen[str]] = {}
        self._waiting: list[dict[str, subprocess.Popen[str]]] = []
        before: list[str] = []
        for _, kinds in AGES.values():
            new = [kind for kind in kinds if kind not in before]
            self._waiting.append({kind: self._start(port, kind) for kind in new})
            before = kinds
        for process in self._all():
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"

    def watch(self, cycle: int) -> None:
        """Kill and let begin what is due in a cycle."""
        age = len(AGES) - len(self._waiting)
        if not self._waiting or cycle < [0, *self.ends][age]:
            return
        _, kinds = list(AGES.values())[age]
        for kind in [k for k in self._sending if k not in kinds]:
            self._end(self._sending.pop(kind))
        for kind, process in self._waiting.pop(0).items():
            assert process.stdin is not None
            process.stdin.write("go\n")
            process.stdin.flush()
            self._sending[kind] = process

    def close(self) -> None:
        for process in self._all():
            self._end(process)

    def _all(self) -> list[subprocess.Popen[str]]:
        waiting = [process for age in self._waiting for process in age.values()]
        return [*self._sending.values(), *waiting]

    @staticmethod
    def _start(port: int, kind: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-c", SENDER, str(port), kind],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
        )  # fmt: skip

    @staticmethod
    def _end(process: subprocess.Popen[str]) -> None:
        process.kill()
        process.communicate()


class Replay:
    """A setpoint that is what another one was, and is not known ahead either."""

    def __init__(self, start: Any, force: Any, horizon: int) -> None:
        self.start, self.force = start, force
        self._preview = np.zeros((horizon + 1, force.shape[1]))

    def preview(self, k: int) -> Any:
        self._preview[:] = self.force[k]
        return self._preview


def besieged(duration: float, *, alone: bool) -> None:
    """Run it and check everything; print what came of it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((ADDRESS, 0))
        port = int(probe.getsockname()[1])
    scenario = load_scenario(
        "paper", top={"duration": duration}, settings=[f"setpoint.live.port={port}"]
    )
    siege, wait, cycle = Siege(port, scenario.cycles), by_the_clock(PERIOD), itertools.count()

    def pace() -> None:
        siege.watch(next(cycle))
        wait()

    try:
        experiment = run_experiment(
            scenario, report=lambda *_: None, stop=lambda: False,
            held=np.zeros((scenario.cycles, 3)), pace=pace,
        )  # fmt: skip
    finally:
        siege.close()
    log, summary = experiment.log, summarise(experiment)
    counts, source = summary["live_setpoint"], log.setpoint_source
    cycles, z = scenario.cycles, log.setpoint[:, 2]

    # The run itself: whole, every problem solved, nothing tripped.
    assert log.cycles == cycles
    assert summary["status"] == {"solved": cycles}
    assert log.trip is None

    # The setpoint: what the device wished, no faster than allowed, still while it is stale.
    assert np.isin(log.setpoint[:, :2], [1.0, 2.0]).all()
    assert MIDDLE - SWING - 1e-9 <= z.min() < MIDDLE - 0.9 * SWING
    assert MIDDLE + SWING + 1e-9 >= z.max() > MIDDLE + 0.9 * SWING
    assert np.abs(np.diff(z)).max() <= RATE * PERIOD + 1e-9
    stale = np.flatnonzero(source[1:] == Source.STALE) + 1
    assert np.array_equal(z[stale], z[stale - 1])

    # The status: live with the device, stale without, and everything else counted.
    ages = dict(zip(AGES, np.split(np.arange(cycles), siege.ends[:-1]), strict=True))
    shares = {age: float((source[k] == Source.LIVE).mean()) for age, k in ages.items()}
    late = {age: source[k[-len(k) // 3 :]] for age, k in ages.items()}  # when it is felt
    for age, (_, kinds) in AGES.items():
        if age == "flooded" and not alone:
            continue  # who gets into the socket's buffer is up to who gets the processor
        if "device" in kinds:
            assert (late[age] == Source.LIVE).mean() > 0.5, age
        else:
            assert (late[age] == Source.STALE).all(), age
    assert counts["refused_form"] > 50 * duration * 0.1
    assert counts["refused_value"] > 50 * duration * 0.1
    assert counts["received"] <= 64 * cycles
    assert counts["stale_cycles"] == int((source == Source.STALE).sum())

    # And the forces: those of the same cell with that setpoint and no port at all.
    alone = replace(scenario, setpoint=replace(scenario.setpoint, live=None))
    made = assemble(alone, lambda *_: None)
    replay = Replay(made.setpoint.start, log.setpoint, alone.controller.horizon)
    control_loop(
        made.cell, made.controller, replay, made.log, cycles,  # type: ignore[arg-type]
        schedule=Schedule(alone), progress=lambda *_: None, stop=lambda: False,
    )  # fmt: skip
    for name in ("force", "force_measured", "command", "torque", "tool"):
        assert np.array_equal(getattr(made.log, name), getattr(log, name)), name

    error = log.force - log.setpoint
    refused = {key: n for key, n in counts.items() if key.startswith("refused")}
    taken = counts["received"] - sum(refused.values())
    print(f"{duration:g} s, {summary['timing']['misses']} cycles took more than their millisecond")
    print(f"{counts['received']} datagrams looked at, {taken} taken, {refused}")
    for age, k in ages.items():
        rms = ", ".join(f"{x:.3f}" for x in np.sqrt(np.mean(error[k] ** 2, axis=0)))
        most = np.abs(error[k]).max()
        print(f"{age:26}  live in {shares[age]:4.0%}  RMS {rms} N  largest {most:.2f} N")


def test_a_siege_of_a_few_seconds_changes_nothing_but_the_status():
    besieged(4.0, alone=False)


@pytest.mark.minute
def test_a_siege_of_a_minute_changes_nothing_but_the_status():
    besieged(60.0, alone=True)
