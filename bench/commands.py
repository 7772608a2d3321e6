"""The verbs of the command line: their arguments as records, and what they do."""

import sys
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal, Protocol

import tyro
from rich.console import Console

from bench.cli import INTERRUPTED
from bench.compare import compare
from bench.figures import draw_comparison, draw_forces
from bench.progress import Reporter, ctrl_c
from bench.table import (
    backend_table,
    comparison_lines,
    comparison_tables,
    force_table,
    scenario_table,
    timing_lines,
)
from qpmpc.backends import available, backend_class
from scenarios import (
    Experiment,
    Scenario,
    ScenarioError,
    load_scenario,
    run_experiment,
    shipped,
    summarise,
)
from scenarios.results import result_folder, to_json, write_run

FAILED = 1
_arg = tyro.conf.arg


class _Asked(Protocol):
    """The options that say which experiment is meant."""

    @property
    def scenario(self) -> str: ...
    @property
    def motion(self) -> Path | None: ...
    @property
    def beats(self) -> Path | None: ...
    @property
    def duration(self) -> float | None: ...
    @property
    def seed(self) -> int | None: ...
    @property
    def set(self) -> tuple[str, ...]: ...


def _load(asked: _Asked, **top: str | None) -> Scenario:
    keys = {"duration": asked.duration, "seed": asked.seed, **top}
    return load_scenario(
        asked.scenario,
        top={key: value for key, value in keys.items() if value is not None},
        motion=asked.motion,
        beats=asked.beats,
        settings=asked.set,
    )


def _now() -> str:
    return f"{datetime.now():%Y%m%d-%H%M%S}"


@dataclass(frozen=True)
class Run:
    """Run a scenario and write its results into a folder.

    For example, `pulsempc run paper --backend analytic --seed 3 --out runs/seed3`, or
    `pulsempc run my.toml --motion heart.csv --set cell.sensor.model=mini45`.
    """

    scenario: Annotated[tyro.conf.Positional[str], _arg(metavar="SCENARIO")] = "paper"
    """Name of a shipped scenario (see `pulsempc scenarios`) or path of a TOML file."""
    backend: Annotated[str | None, _arg(metavar="NAME")] = None
    """Solver, see `pulsempc backends`."""
    motion: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """A recorded motion in place of the generated one: columns t, x, y, z [s, m]."""
    beats: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """Times of heart beats that drive the generated motion: column t [s]."""
    duration: Annotated[float | None, _arg(metavar="S")] = None
    """Simulated time [s]."""
    seed: Annotated[int | None, _arg(metavar="N")] = None
    """Seed of motion and sensor noise."""
    set: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], _arg(metavar="KEY.PATH=VALUE")] = ()
    """Change keys of the scenario; values in TOML's notation."""
    out: Annotated[Path | None, _arg(metavar="DIR")] = None
    """Folder for the results, new or empty; runs/<scenario>-<time> if not given."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the summary as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Simulate, write, show; return the exit code."""
        scenario = _load(self, backend=self.backend)
        backend_class(scenario.backend)  # an unknown one is told before anything else is done
        folder = self.out or Path("runs") / f"{scenario.name}-{_now()}"
        with (
            result_folder(folder) as partial,
            Reporter(quiet=self.json) as reporter,
            ctrl_c() as interrupt,
        ):
            experiment = run_experiment(scenario, report=reporter, stop=interrupt)
            summary = summarise(experiment)
            write_run(experiment, summary, partial)
            draw_forces(experiment.log, partial / "forces.png")
        if self.json:
            sys.stdout.write(to_json(summary))
        else:
            console = Console()
            console.print(force_table(summary))
            for line in timing_lines(summary):
                console.print(line, highlight=False)
            console.print(f"results: {folder}", highlight=False, soft_wrap=True)
        if experiment.stopped is None:
            return 0
        print(
            f"pulsempc: {experiment.stopped} after {experiment.log.cycles} of {scenario.cycles} "
            f"controlled cycles; what was done until then is in {folder}",
            file=sys.stderr,
        )
        return INTERRUPTED if interrupt.pressed else FAILED


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
    motion: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """A recorded motion in place of the generated one: columns t, x, y, z [s, m]."""
    beats: Annotated[Path | None, _arg(metavar="FILE.csv")] = None
    """Times of heart beats that drive the generated motion: column t [s]."""
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
        scenario = _load(self)
        folder = self.out or Path("runs") / f"compare-{scenario.name}-{_now()}"
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


@dataclass(frozen=True)
class Scenarios:
    """List the scenarios that are shipped.

    For example, `pulsempc scenarios`.
    """

    def run(self) -> int:
        """Print the table; return the exit code."""
        Console().print(scenario_table(load_scenario(name) for name in shipped()))
        return 0


@dataclass(frozen=True)
class Backends:
    """List the solver backends: which are installed, which version, what installs the others.

    For example, `pulsempc backends`.
    """

    def run(self) -> int:
        """Print the table; return the exit code."""
        Console().print(backend_table(available()))
        return 0


Command = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Scenarios, tyro.conf.subcommand("scenarios")]
    | Annotated[Backends, tyro.conf.subcommand("backends")]
)
