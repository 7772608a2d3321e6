"""``pulsempc bench deadline``: whole cycles in closed loop against a deadline."""

import sys
import time
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from bench.cli import INTERRUPTED
from bench.deadline import cycles_in_all, enter, run
from bench.deadline_report import deadline_tables, draw, machine_lines, summary, write_histograms
from bench.machine import Facts, machine
from bench.progress import Reporter, ctrl_c
from bench.realtime import Measures, SkippingClock, SystemClock, real_time
from bench.verbs._asked import Asked, load, report
from qpmpc.backends import available, backend_class
from scenarios import ScenarioError, dump_scenario
from scenarios.loop import quiet_memory
from scenarios.results import result_folder, to_json

FAILED = 1
PROOF = 60_000
"""Cycles of a paced run: a minute at 1 kHz, six beyond p99.99."""
_LONGEST = 3600.0
_arg = tyro.conf.arg


@dataclass(frozen=True, kw_only=True)
class Deadline(Asked):
    """Run whole control cycles in closed loop with the cell against a deadline.

    For example, `pulsempc bench deadline paper --backends analytic,daqp`, or, paced by the wall
    clock under what real-time measures the system permits, `pulsempc bench deadline --realtime`.
    """

    scenario: Annotated[tyro.conf.Positional[str], _arg(metavar="SCENARIO")] = "latency"
    """Name of a shipped scenario (see `pulsempc scenarios`) or path of a TOML file."""
    backends: Annotated[str, _arg(metavar="A,B,C")] = "analytic,daqp,osqp,clarabel,piqp,casadi"
    """Solvers, see `pulsempc backends`, separated by commas; `all`: every one that is installed."""
    realtime: tyro.conf.FlagCreatePairsOff[bool] = False
    """Pace by the wall clock, and ask for one core, SCHED_FIFO, locked memory and the rest; what
    is refused is told. Without: as fast as it goes, waits left out."""
    cycles: Annotated[int | None, _arg(metavar="N")] = None
    """Cycles of each backend that count; with --realtime 60,000, else as long as the scenario."""
    deadline: Annotated[float | None, _arg(metavar="S")] = None
    """From the intended release to the command [s]; the control period if not given."""
    cpu: Annotated[int | None, _arg(metavar="N")] = None
    """With --realtime: core to stay on; the last one if not given."""
    priority: Annotated[int, _arg(metavar="1..99")] = 80
    """With --realtime: priority under SCHED_FIFO; 0 leaves the scheduler alone."""
    spin: Annotated[float, _arg(metavar="S")] = 100e-6
    """With --realtime: how long before a release the sleep ends and the clock is watched [s]."""
    out: Annotated[Path | None, _arg(metavar="DIR")] = None
    """Folder for the results, new or empty; runs/deadline-<scenario>-<time> if not given."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the result as JSON, and nothing else, on standard output."""
    setpoint: tyro.conf.Suppress[Path | None] = None
    duration: tyro.conf.Suppress[float | None] = None

    def run(self) -> int:
        """Run, write, show; return the exit code."""
        names = _names(self.backends)
        self._check_options()
        scenario = load(self)
        period = scenario.cell.period
        cycles = self.cycles or (PROOF if self.realtime else scenario.cycles)
        longest = int(_LONGEST / period)
        if cycles_in_all(cycles) > longest:
            raise ScenarioError(
                f"--cycles: {cycles} take more than {_LONGEST:g} s at this period, with those that "
                f"are not counted; the longest run is {_LONGEST:g} s"
            )
        deadline = self.deadline or period
        folder = self.out or Path("runs") / (
            f"deadline-{scenario.name}-{datetime.now():%Y%m%d-%H%M%S}"
        )
        clock = SystemClock() if self.realtime else SkippingClock()
        spin = self.spin if self.realtime else 0.0
        facts: Facts = {}
        with (
            result_folder(folder) as partial,
            Reporter(quiet=self.json, own_thread=False) as reporter,
            ctrl_c() as interrupt,
        ):
            race = enter(scenario, names, cycles, deadline, reporter)
            with ExitStack() as conditions:
                refused = {}
                if self.realtime:
                    asked = Measures(cpu=self.cpu, priority=self.priority)
                    refused = conditions.enter_context(real_time(asked))
                else:
                    conditions.enter_context(quiet_memory())
                started, begin = time.time(), time.monotonic()
                run(
                    race,
                    clock,
                    spin=spin,
                    report=reporter,
                    stop=interrupt,
                    ready=lambda: facts.update(machine(refused)),
                )
                seconds = time.monotonic() - begin
                facts = facts or machine(refused)
            told = summary(
                race, paced=self.realtime, spin=spin, sleeps_by=clock.sleeps_by, machine=facts
            )
            text = to_json(told)
            (partial / "deadline.json").write_text(text, encoding="utf-8")
            (partial / "config.toml").write_text(dump_scenario(race.scenario), encoding="utf-8")
            write_histograms(race, partial, start=started, seconds=seconds)
            draw(race, told, partial / "percentiles.png")
        report(folder)
        if self.json:
            sys.stdout.write(text)
        else:
            console = Console()
            for table in deadline_tables(told):
                console.print(table)
            for line in machine_lines(facts):
                console.print(line, highlight=False)
            console.print(f"results: {folder}", highlight=False, soft_wrap=True)
        for row in told["rows"]:
            if row["error"]:
                print(f"pulsempc: {row['name']}: {row['error']}", file=sys.stderr)
        if interrupt.pressed:
            done = min(entry.cycles.count for entry in race.entries)
            print(
                f"pulsempc: interrupted after {done} of {cycles} cycles; what was done until then "
                f"is in {folder}",
                file=sys.stderr,
            )
            return INTERRUPTED
        return 0 if race.complete else FAILED

    def _check_options(self) -> None:
        """Refuse what cannot be, before anything is done."""
        if self.cycles is not None and self.cycles < 1:
            raise ScenarioError(f"--cycles: must be at least 1, got {self.cycles}")
        if self.deadline is not None and not 0 < self.deadline < _LONGEST:
            raise ScenarioError(f"--deadline: must be a positive time in s, got {self.deadline:g}")
        if not 0 <= self.priority <= 99:
            raise ScenarioError(f"--priority: must be from 0 to 99, got {self.priority}")
        if not 0 <= self.spin <= 0.1:
            raise ScenarioError(f"--spin: must be from 0 to 0.1 s, got {self.spin:g}")
        if self.cpu is not None and self.cpu < 0:
            raise ScenarioError(f"--cpu: must be the number of a core, got {self.cpu}")


def _names(asked: str) -> list[str]:
    if asked == "all":
        return [info.name for info in available() if info.version is not None]
    names = [name.strip() for name in asked.split(",")]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ScenarioError(f"--backends: names {', '.join(twice)} more than once")
    for name in names:
        backend_class(name)  # an unknown one is told before anything is done
    return names
