"""``pulsempc bench latency``: what a cycle costs under each backend."""

import json
import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from bench.cli import INTERRUPTED
from bench.latency.measure import Settings
from bench.latency.result import LeftOut, Way
from bench.latency.session import run_session
from bench.latency.table import latency_lines, latency_tables
from bench.progress import Reporter, ctrl_c
from bench.realtime import SystemClock
from bench.verbs._asked import FAILED, Asked, load, now, report
from plant.errors import UnstableSimulationError
from qpmpc.backends import available, backend_class
from scenarios import Scenario, ScenarioError, ScenarioKeyError
from scenarios.results import result_folder

_arg = tyro.conf.arg
_PATHS: dict[str, tuple[Way, ...]] = {
    "both": ("interpreted", "compiled"),
    "on": ("compiled",),
    "off": ("interpreted",),
}


@dataclass(frozen=True, kw_only=True)
class Latency(Asked):
    """Record cycles of a closed loop and let every backend solve them, hot and paced at 1 kHz.

    For example, `pulsempc bench latency --backends daqp,osqp --horizon 8,32`, or
    `pulsempc bench latency constrained --backends all --axes x,y,z z --json`.
    """

    scenario: Annotated[tyro.conf.Positional[str], _arg(metavar="SCENARIO")] = "latency"
    """Name of a shipped scenario (see `pulsempc scenarios`) or path of a TOML file."""
    backends: Annotated[str, _arg(metavar="A,B,C")] = "daqp,osqp,clarabel,piqp,casadi"
    """Solvers, see `pulsempc backends`, separated by commas, or all; the closed form is always
    measured beside them."""
    horizon: Annotated[str | None, _arg(metavar="N,N,N")] = None
    """Horizons, separated by commas; the scenario's own if not given."""
    axes: Annotated[tuple[str, ...], _arg(metavar="X,Y,Z")] = ()
    """Sets of axes under control, each recorded in a run of its own; the scenario's own if not
    given."""
    compiled: Literal["both", "on", "off"] = "both"
    """Whether to time the compiled step, the interpreted one, or both."""
    cycles: Annotated[int | None, _arg(metavar="N")] = None
    """Cycles to record; the scenario's duration if not given."""
    passes: Annotated[int, _arg(metavar="N")] = 3
    """Times that every backend goes through the cycles."""
    paced: Literal["on", "off"] = "on"
    """Whether to measure at 1 kHz, too."""
    paced_cycles: Annotated[int, _arg(metavar="N")] = 3000
    """Cycles of each paced pass, at most."""
    budget: Annotated[float, _arg(metavar="S")] = 20.0
    """Time for the hot passes of one backend [s]; slower ones get fewer cycles, and the row says
    so."""
    out: Annotated[Path | None, _arg(metavar="DIR")] = None
    """Folder for the results, new or empty; runs/latency-<scenario>-<time> if not given."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the result as JSON, and nothing else, on standard output."""
    duration: tyro.conf.Suppress[float | None] = None

    def run(self) -> int:
        """Record, measure, write, show; return the exit code."""
        self._check()
        names, left_out = self._backends()
        scenarios, horizons = self._scenarios(), self._horizons()
        settings = Settings(
            names,
            _PATHS[self.compiled],
            self.passes,
            self.paced == "on",
            self.paced_cycles,
            self.budget,
        )
        folder = self.out or Path("runs") / f"latency-{scenarios[0].name}-{now()}"
        try:
            with (
                result_folder(folder) as partial,
                Reporter(quiet=self.json, own_thread=False) as reporter,
                ctrl_c() as interrupt,
            ):
                result = run_session(
                    scenarios,
                    horizons,
                    settings,
                    left_out,
                    clock=SystemClock(),
                    report=reporter,
                    stop=interrupt,
                    folder=partial,
                )
                if not result.rows and interrupt.pressed:
                    raise KeyboardInterrupt  # nothing is whole yet, nothing is left
                text = result.to_json()
                (partial / "latency.json").write_text(text, encoding="utf-8")
        except UnstableSimulationError as error:
            print(f"pulsempc: {error}; nothing was written", file=sys.stderr)
            return FAILED
        report(folder)
        if self.json:
            sys.stdout.write(text)
        else:
            console = Console()
            for table in latency_tables(result):
                console.print(table)
            for line in latency_lines(result):
                console.print(line, highlight=False, markup=False)
            console.print(f"results: {folder}", highlight=False, soft_wrap=True)
        if result.complete:
            return 0
        print(
            f"pulsempc: interrupted; what was measured until then is in {folder}", file=sys.stderr
        )
        return INTERRUPTED

    def _check(self) -> None:
        for option, value in (
            ("--cycles", self.cycles),
            ("--passes", self.passes),
            ("--paced-cycles", self.paced_cycles),
        ):
            if value is not None and value < 1:
                raise ScenarioError(f"{option}: must be at least 1, got {value}")
        if not 0 < self.budget < math.inf:
            raise ScenarioError(
                f"--budget: must be a positive number of seconds, got {self.budget}"
            )

    def _backends(self) -> tuple[list[str], list[LeftOut]]:
        """Return the names to measure, and what `all` means that is not installed."""
        if self.backends.strip() == "all":
            known = available()
            missing = [
                LeftOut(info.name, None, None, None, None, f"not installed: {info.install}")
                for info in known
                if info.version is None
            ]
            return [info.name for info in known if info.version is not None], missing
        names = _list("--backends", self.backends)
        for name in names:
            backend_class(name)  # an unknown one is told before anything is done
        return names, []

    def _scenarios(self) -> list[Scenario]:
        """Return the scenario with each set of axes."""
        length: tuple[str, ...] = ()
        if self.cycles is not None:
            length = (f"duration={self.cycles * load(self).cell.period!r}",)
            self._with(f"--cycles {self.cycles}, in seconds", "duration", *length)
        found = [
            self._with(f"--axes {','.join(axes)}", "axes", *length, f"axes={json.dumps(axes)}")
            for axes in (_list("--axes", text) for text in self.axes)
        ] or [self._with("", "", *length)]
        if len({scenario.axes for scenario in found}) < len(found):
            raise ScenarioError("--axes: names a set of axes more than once")
        return found

    def _horizons(self) -> list[int]:
        """Return the horizons, each checked against the scenario's other keys."""
        if self.horizon is None:
            return [load(self).controller.horizon]
        found = []
        for text in _list("--horizon", self.horizon):
            if not text.isascii() or not text.isdecimal():
                raise ScenarioError(f"--horizon: '{text}' is not a whole number")
            key = "controller.horizon"
            loaded = self._with(f"--horizon {text}", key, f"{key}={int(text)}")
            found.append(loaded.controller.horizon)
        return found

    def _with(self, option: str, key: str, *settings: str) -> Scenario:
        """Load with more settings; what is wrong with ``key`` is the option's fault."""
        try:
            return load(replace(self, set=(*self.set, *settings)))
        except ScenarioKeyError as error:
            if error.key == key or error.key.startswith(f"{key}."):
                raise ScenarioError(f"{option}: {error.reason}") from None
            raise


def _list(option: str, text: str) -> list[str]:
    """Split at commas; refuse what is named twice, or nothing."""
    names = [name.strip() for name in text.split(",")]
    if not all(names):
        raise ScenarioError(f"{option}: expected names separated by commas, got '{text}'")
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ScenarioError(f"{option}: names {', '.join(twice)} more than once")
    return names
