"""Runs that go by the wall clock, as one must that a person or another process takes part in."""

from bench.realtime import NS, Pacer, SystemClock
from scenarios.loop import Pace


def by_the_clock(period: float) -> Pace:
    """Return what releases a cycle every ``period`` [s], from its first call on."""
    pacer: Pacer | None = None

    def wait() -> None:
        nonlocal pacer
        if pacer is None:
            pacer = Pacer(SystemClock(), round(period * NS), spin=0)
            pacer.start()
        pacer.wait()

    return wait
