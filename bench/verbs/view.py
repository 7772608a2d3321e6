"""``pulsempc view``: a running experiment in MuJoCo's viewer."""

import sys
from dataclasses import dataclass
from typing import Annotated

import tyro

from bench.cli import INTERRUPTED
from bench.pace import by_the_clock
from bench.progress import Reporter, ctrl_c
from bench.table import trip_line
from bench.verbs._asked import FAILED, Asked, load
from scenarios.errors import ScenarioError
from scenarios.viewer import view

_arg = tyro.conf.arg


@dataclass(frozen=True, kw_only=True)
class View(Asked):
    """Run a scenario by the clock and watch it in a window; nothing is written.

    Needs a desktop. Turn with the left button of the mouse, move with the right, zoom with the
    wheel.
    """

    backend: Annotated[str | None, _arg(metavar="NAME")] = None
    """Solver, see `pulsempc backends`."""
    speed: Annotated[float, _arg(metavar="X")] = 1.0
    """Simulated seconds a second; below 1 is slow motion."""

    def run(self) -> int:
        """Simulate and show; return the exit code."""
        scenario = load(self, backend=self.backend)
        if not 0.01 <= self.speed <= 100.0:
            raise ScenarioError(f"--speed: {self.speed:g} is not between 0.01 and 100")
        with Reporter(quiet=False) as reporter, ctrl_c() as interrupt:
            log = view(
                scenario,
                report=reporter,
                stop=interrupt,
                pace=by_the_clock(scenario.cell.period / self.speed),
                waiting=lambda: print("the run is over; close the window", file=sys.stderr),
            )
        if log.trip is not None:
            print(f"pulsempc: {trip_line(log.trip)}", file=sys.stderr)
        if interrupt.pressed:
            return INTERRUPTED
        return FAILED if log.trip else 0
