"""``pulsempc compare``: one experiment under several backends, or several under controllers."""

import sys
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console
from rich.table import Table

from bench.cli import INTERRUPTED
from bench.compare import compare
from bench.compare_controllers import MOTIONS, contest
from bench.contest_report import contest_lines, contest_tables, draw_contest
from bench.figures import draw_comparison
from bench.progress import Reporter, ctrl_c
from bench.table import comparison_lines, comparison_tables
from bench.verbs._asked import FAILED, Options, load_named, now, report
from qpmpc.backends import backend_class
from qpmpc.controller import Compiled
from qpmpc.kinds import controller_kind
from scenarios import Experiment, Scenario, ScenarioError, summarise
from scenarios.experiment import require_backend
from scenarios.results import result_folder, to_json, write_run

_arg = tyro.conf.arg


@dataclass(frozen=True, kw_only=True)
class Compare(Options):
    """Run a scenario under several backends, or scenarios under several controllers.

    For example, `pulsempc compare constrained --backends analytic,daqp,osqp`, or
    `pulsempc compare paper --bounds off --json`, or
    `pulsempc compare --controllers pi,pi-ilc,aob,paper-law,mpc`, which takes every motion.
    """

    scenarios: Annotated[tyro.conf.Positional[tuple[str, ...]], _arg(metavar="SCENARIO")] = ()
    """Names of shipped scenarios (see `pulsempc scenarios`) or paths of TOML files: one for
    backends, `constrained` if not given; any number for controllers, every motion if not given."""
    backends: Annotated[str | None, _arg(metavar="A,B,C")] = None
    """Solvers, see `pulsempc backends`, separated by commas; if not given
    analytic,daqp,osqp,clarabel,piqp,casadi."""
    controllers: Annotated[str | None, _arg(metavar="A,B,C")] = None
    """Controllers to compare in place of solvers, see `pulsempc controllers`."""
    bounds: Literal["on", "off"] = "on"
    """Whether the controller knows the bounds; violations are counted in either case."""
    compiled: Compiled | None = None
    """Whether the controller's step is compiled C: where it can be, or not at all, or never."""
    out: Annotated[Path | None, _arg(metavar="DIR")] = None
    """Folder for the results, new or empty; runs/compare-<scenario>-<time> if not given."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the comparison as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Simulate, write, show; return the exit code."""
        if self.controllers is not None:
            return self._run_controllers(self.controllers)
        if len(self.scenarios) > 1:
            raise ScenarioError(
                f"{' '.join(self.scenarios)}: backends are compared on one scenario; "
                "several are for --controllers"
            )
        asked = _BACKENDS if self.backends is None else self.backends
        names = _names("--backends", asked)
        for name in names:
            backend_class(name)  # an unknown one is told before anything is done
        scenario = self._load(*(self.scenarios or ("constrained",)))
        require_backend(scenario, "--backends")
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
        tables, lines = comparison_tables(comparison.rows), comparison_lines(comparison.rows)
        self._show(text, tables, lines, folder)
        if comparison.whole and len(comparison.rows) == len(names):
            return 0
        for row in comparison.rows:
            if row["error"]:
                print(f"pulsempc: {row['backend']}: {row['error']}", file=sys.stderr)
        return INTERRUPTED if interrupt.pressed else FAILED

    def _run_controllers(self, asked: str) -> int:
        for option, given in (
            ("--backends", self.backends is not None), ("--bounds off", self.bounds == "off"),
        ):  # fmt: skip
            if given:
                raise ScenarioError(f"{option}: no effect beside --controllers")
        names = _names("--controllers", asked)
        for name in names:
            controller_kind(name)  # an unknown one is told before anything is done
        scenarios = [self._load(name) for name in self.scenarios or MOTIONS]
        titles = [scenario.name for scenario in scenarios]
        for title in titles:
            if titles.count(title) > 1:
                raise ScenarioError(f"{title}: more than one of the scenarios is called so")
        folder = self.out or Path("runs") / f"compare-controllers-{now()}"
        with (
            result_folder(folder) as partial,
            Reporter(quiet=self.json) as reporter,
            ctrl_c() as interrupt,
        ):

            def keep(experiment: Experiment) -> None:
                scenario = experiment.scenario
                own = partial / scenario.name / scenario.controller.kind
                own.mkdir(parents=True)
                write_run(experiment, summarise(experiment), own)

            found = contest(scenarios, names, report=reporter, stop=interrupt, keep=keep)
            text = to_json(found.summary())
            (partial / "compare.json").write_text(text, encoding="utf-8")
            draw_contest(found.rows, partial / "comparison.png")
        self._show(text, contest_tables(found.rows), contest_lines(found.rows), folder)
        if found.whole:
            return 0
        for row in found.rows:
            if row["error"]:
                where = f"{row['scenario']}, {row['controller']}"
                print(f"pulsempc: {where}: {row['error']}", file=sys.stderr)
        return INTERRUPTED if interrupt.pressed else FAILED

    def _load(self, name: str) -> Scenario:
        scenario = load_named(self, name, compiled=self.compiled)
        if scenario.setpoint.live is not None:
            raise ScenarioError("setpoint.live: is another one in every run, nothing to compare by")
        return scenario

    def _show(self, text: str, tables: Iterable[Table], lines: Iterable[str], folder: Path) -> None:
        if self.json:
            sys.stdout.write(text)
            return
        console = Console()
        for table in tables:
            console.print(table)
        for line in lines:
            console.print(line, highlight=False)
        console.print(f"results: {folder}", highlight=False, soft_wrap=True)


_BACKENDS = "analytic,daqp,osqp,clarabel,piqp,casadi"


def _names(option: str, text: str) -> list[str]:
    names = [name.strip() for name in text.split(",")]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ScenarioError(f"{option}: names {', '.join(twice)} more than once")
    return names
