"""``pulsempc compare``: one experiment under several backends."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from bench.cli import INTERRUPTED
from bench.compare import compare
from bench.figures import draw_comparison
from bench.progress import Reporter, ctrl_c
from bench.table import comparison_lines, comparison_tables
from bench.verbs._asked import FAILED, load, now, report
from qpmpc.backends import backend_class
from qpmpc.controller import Compiled
from scenarios import Experiment, ScenarioError, summarise
from scenarios.results import result_folder, to_json, write_run

_arg = tyro.conf.arg


@dataclass(frozen=True)
class Compare:
    """Run a scenario under several backends and compare what came of it.

    For example, `pulsempc compare constrained --backends analytic,daqp,osqp`, or
    `pulsempc compare paper --bounds off --json`.
    """

    scenario: Annotated[tyro.conf.Positional[str], _arg(metavar="SCENARIO")] = "constrained"
    """Name of a shipped scenario (see `pulsempc scenarios`) or path of a TOML file."""
    backends: Annotated[str, _arg(metavar="A,B,C")] = "analytic,daqp,osqp,clarabel,piqp,casadi"
    """Solvers, see `pulsempc backends`, separated by commas."""
    bounds: Literal["on", "off"] = "on"
    """Whether the controller knows the bounds; violations are counted in either case."""
    compiled: Compiled | None = None
    """Whether the controller's step is compiled C: where it can be, or not at all, or never."""
    motion: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """A recorded motion in place of the generated one: columns t, x, y, z [s, m]."""
    beats: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """Times of heart beats that drive the generated motion: column t [s]."""
    setpoint: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """A recorded wish in place of the scenario's: columns t, x, y, z [s, N]."""
    duration: Annotated[float | None, _arg(metavar="S")] = None
    """Simulated time [s]."""
    seed: Annotated[int | None, _arg(metavar="N")] = None
    """Seed of motion and sensor noise."""
    set: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], _arg(metavar="KEY.PATH=VALUE")] = ()
    """Change keys of the scenario; values in TOML's notation."""
    out: Annotated[Path | None, _arg(metavar="DIR")] = None
    """Folder for the results, new or empty; runs/compare-<scenario>-<time> if not given."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the comparison as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Simulate, write, show; return the exit code."""
        names = [name.strip() for name in self.backends.split(",")]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ScenarioError(f"--backends: names {', '.join(twice)} more than once")
        for name in names:
            backend_class(name)  # an unknown one is told before anything is done
        scenario = load(self, compiled=self.compiled)
        if scenario.setpoint.live is not None:
            raise ScenarioError("setpoint.live: is another one in every run, nothing to compare by")
        folder = self.out or Path("runs") / f"compare-{scenario.name}-{now()}"
        with (
            result_folder(folder) as partial,
            Reporter(quiet=self.json) as reporter,
            ctrl_c() as interrupt,
        ):

            def keep(backend: str, experiment: Experiment) -> None:
                own = partial / backend.replace(":", "-")
                own.mkdir()
                write_run(experiment, summarise(experiment), own)

            comparison = compare(
                scenario,
                names,
                bounded=self.bounds == "on",
                report=reporter,
                stop=interrupt,
                keep=keep,
            )
            text = to_json(comparison.summary())
            (partial / "compare.json").write_text(text, encoding="utf-8")
            draw_comparison(comparison, partial / "comparison.png")
        if any(comparison.experiments):
            report(folder)
        if self.json:
            sys.stdout.write(text)
        else:
            console = Console()
            for table in comparison_tables(comparison.rows):
                console.print(table)
            for line in comparison_lines(comparison.rows):
                console.print(line, highlight=False)
            console.print(f"results: {folder}", highlight=False, soft_wrap=True)
        if comparison.whole and len(comparison.rows) == len(names):
            return 0
        for row in comparison.rows:
            if row["error"]:
                print(f"pulsempc: {row['backend']}: {row['error']}", file=sys.stderr)
        return INTERRUPTED if interrupt.pressed else FAILED
