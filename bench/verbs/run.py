"""``pulsempc run``: one experiment, its files, its table."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from bench.cli import INTERRUPTED
from bench.figures import draw_forces
from bench.pace import by_the_clock
from bench.progress import Reporter, ctrl_c
from bench.table import force_table, timing_lines, trip_line
from bench.verbs._asked import FAILED, Asked, load, now, report
from qpmpc.backends import backend_class
from qpmpc.controller import Compiled
from scenarios import run_experiment, summarise
from scenarios.experiment import require_backend
from scenarios.results import result_folder, to_json, write_run

_arg = tyro.conf.arg


@dataclass(frozen=True, kw_only=True)
class Run(Asked):
    """Run a scenario and write its results into a folder.

    For example, `pulsempc run paper --backend analytic --seed 3 --out runs/seed3`, or
    `pulsempc run my.toml --motion heart.csv --set cell.sensor.model=mini45`.
    """

    controller: Annotated[str | None, _arg(metavar="NAME")] = None
    """Which controller, see `pulsempc controllers`; the predictive one if nothing says another."""
    backend: Annotated[str | None, _arg(metavar="NAME")] = None
    """Solver, see `pulsempc backends`."""
    compiled: Compiled | None = None
    """Whether the controller's step is compiled C: where it can be, or not at all, or never."""
    out: Annotated[Path | None, _arg(metavar="DIR")] = None
    """Folder for the results, new or empty; runs/<scenario>-<time> if not given."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the summary as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Simulate, write, show; return the exit code."""
        scenario = load(
            self,
            backend=self.backend,
            compiled=self.compiled,
            controller=self.controller,
        )
        if self.backend is not None:
            require_backend(scenario, f"--backend {self.backend}")
        backend_class(scenario.backend)  # an unknown one is told before anything else is done
        folder = self.out or Path("runs") / f"{scenario.name}-{now()}"
        with (
            result_folder(folder) as partial,
            Reporter(quiet=self.json) as reporter,
            ctrl_c() as interrupt,
        ):
            live = scenario.setpoint.live is not None
            experiment = run_experiment(
                scenario,
                report=reporter,
                stop=interrupt,
                pace=by_the_clock(scenario.cell.period) if live else None,
            )
            summary = summarise(experiment)
            write_run(experiment, summary, partial)
            draw_forces(experiment.log, partial / "forces.png")
        report(folder)
        if self.json:
            sys.stdout.write(to_json(summary))
        else:
            console = Console()
            console.print(force_table(summary))
            for line in timing_lines(summary):
                console.print(line, highlight=False)
            console.print(f"results: {folder}", highlight=False, soft_wrap=True)
        trip = experiment.log.trip
        if trip is not None:
            print(f"pulsempc: {trip_line(trip)}", file=sys.stderr)
        if experiment.stopped is None:
            return FAILED if trip else 0
        print(
            f"pulsempc: {experiment.stopped} after {experiment.log.cycles} of {scenario.cycles} "
            f"controlled cycles; what was done until then is in {folder}",
            file=sys.stderr,
        )
        return INTERRUPTED if interrupt.pressed else FAILED
