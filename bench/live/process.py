"""The experiment in a process of its own: the page can never hold it up.

The two share memory for what is shown, and have a pipe for commands and what comes of them. When
the other end of the pipe is gone, however it went, the experiment ends.
"""

import multiprocessing
import signal
import sys
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from bench.live.drive import Drive
from bench.realtime import SystemClock
from plant.errors import PlantError
from qpmpc.errors import QpmpcError
from scenarios.config import Scenario
from scenarios.errors import ScenarioError
from scenarios.livecell.commands import Command, Event
from scenarios.livecell.engine import Engine
from scenarios.livecell.ring import SIZE, Ring
from scenarios.loop import quiet_memory

_READY = "ready"
_SWITCH = 1e-4
"""How long the workshop's thread may hold the interpreter from the loop [s]."""
_PATIENCE = 15.0
"""What the end may take [s]; a recording is still written."""


class ExperimentDiedError(ScenarioError):
    """The experiment's process has gone without having been told to."""

    def __init__(self, code: int | None) -> None:
        super().__init__(f"the experiment's process ended by itself (exit code {code})")


class Remote:
    """An experiment that runs in a process of its own; a context that ends it."""

    def __init__(self, scenario: Scenario, out: Path) -> None:
        """Start it; returns when it runs.

        Raises:
            ScenarioError: what the scenario asks for cannot be had.
        """
        context = multiprocessing.get_context("spawn")
        memory = context.RawArray("d", SIZE)
        self.ring = Ring.over(memory)
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(scenario, out, memory, theirs), name="pulsempc-live", daemon=True
        )
        self._process.start()
        theirs.close()
        try:
            answer = self._pipe.recv()
        except EOFError:
            self._process.join(_PATIENCE)
            raise ExperimentDiedError(self._process.exitcode) from None
        if answer != _READY:
            self.close()
            raise ScenarioError(answer)

    def send(self, command: Command) -> None:
        """Ask for something.

        Raises:
            ExperimentDiedError: there is nobody left.
        """
        try:
            self._pipe.send(command)
        except OSError:
            raise ExperimentDiedError(self._process.exitcode) from None

    def events(self) -> list[tuple[Event, Scenario]]:
        """Return what has happened, each with the scenario as it was in force then.

        Raises:
            ExperimentDiedError: there is nobody left.
        """
        told = []
        try:
            while self._pipe.poll():
                told.append(self._pipe.recv())
        except (EOFError, OSError):
            self._process.join(1.0)
            raise ExperimentDiedError(self._process.exitcode) from None
        return told

    def close(self) -> None:
        """End it; what is being recorded is written."""
        self._pipe.close()
        self._process.join(_PATIENCE)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def _serve(scenario: Scenario, out: Path, memory: Any, pipe: Connection) -> None:
    """Run the experiment until the pipe is closed."""
    # Ctrl-C reaches both processes; the one with the page decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    sys.setswitchinterval(_SWITCH)
    ring = Ring.over(memory)
    try:
        engine = Engine(scenario, ring, out)
    except (ScenarioError, QpmpcError, PlantError) as error:
        pipe.send(str(error))
        return
    pipe.send(_READY)

    def look() -> bool:
        try:
            while pipe.poll():
                engine.take(pipe.recv())
            for event in engine.events():
                pipe.send((event, engine.scenario))
        except (EOFError, OSError):
            return False
        return True

    with quiet_memory():
        Drive(engine, ring, SystemClock(), look).run()
    engine.close()
