"""A running experiment by the clock."""

from collections.abc import Callable

from bench.realtime import NS, Clock, Pacer
from scenarios.livecell.engine import Engine
from scenarios.livecell.ring import Ring

BEHIND = 0.25
"""How far the experiment may fall behind the clock before it lets the time go [s]."""
_REST = 10_000_000
"""Between two looks for a command where no cycle is run [ns]."""
_MEASURED = 1.0
"""Time over which the speed is measured [s]."""
_EVERY = 4
"""Cycles between two looks for a command."""


class Drive:
    """Releases cycles when their time has come; what is lost is told, not made up for at a rush."""

    def __init__(self, engine: Engine, ring: Ring, clock: Clock, look: Callable[[], bool]) -> None:
        """Prepare.

        Args:
            engine: runs the cycles.
            ring: told speed and lost time.
            clock: see `bench.realtime`.
            look: takes commands in and tells events; returns whether to go on.
        """
        self._engine, self._ring, self._clock, self._look = engine, ring, clock, look
        self._period = round(engine.period * NS)
        self._pacer = Pacer(clock, self._period, spin=0)
        self._lost = 0
        self._restart()

    def run(self) -> None:
        """Go on until there is no need to."""
        cycles = 0
        while cycles % _EVERY or self._look():
            if self._engine.resting:
                cycles = 0
                self._engine.idle()
                self._clock.sleep_until(self._clock.now() + _REST)
                self._restart()
                continue
            _, late = self._pacer.wait()
            if late > BEHIND * NS:
                self._pacer.put_off(late)
                self._lost += late
                self._ring.tell(lost=self._lost / NS)
            self._engine.cycle(late / NS)
            cycles += 1
            self._measure()

    def _restart(self) -> None:
        self._pacer.start()
        self._since, self._done = self._clock.now(), 0

    def _measure(self) -> None:
        self._done += 1
        if self._done * self._period >= _MEASURED * NS:
            now = self._clock.now()
            self._ring.tell(speed=self._done * self._period / max(now - self._since, 1))
            self._since, self._done = now, 0
