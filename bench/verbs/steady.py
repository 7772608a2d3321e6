"""``pulsempc bench steady``: whether the compiled step leaves the memory alone."""

import sys
from dataclasses import asdict, dataclass
from typing import Annotated

import tyro
from annotated_types import Ge
from rich.console import Console

from bench.cli import INTERRUPTED
from bench.progress import Reporter, ctrl_c
from bench.steady import Steady, watch
from bench.stream import record
from qpmpc.backends import backend_class
from scenarios import load_scenario
from scenarios.results import to_json

_arg = tyro.conf.arg


@dataclass(frozen=True)
class SteadyMemory:
    """Let a compiled step decide over and over and look at the memory of the process.

    For example, `pulsempc bench steady`, or `pulsempc bench steady --cycles 100000 --json`.
    """

    scenario: Annotated[tyro.conf.Positional[str], _arg(metavar="SCENARIO")] = "latency"
    """Name of a shipped scenario (see `pulsempc scenarios`) or path of a TOML file."""
    backend: Annotated[str, _arg(metavar="NAME")] = "daqp"
    """Solver with a compiled form."""
    cycles: Annotated[int, Ge(1), _arg(metavar="N")] = 1_000_000
    """Steps in all."""
    recorded: Annotated[float, _arg(metavar="S")] = 2.0
    """How much of the closed loop is recorded, to be met again and again [s]."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the figures as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Record, go on, show; return the exit code."""
        backend_class(self.backend)
        scenario = load_scenario(self.scenario, top={"duration": self.recorded})
        with Reporter(quiet=self.json) as reporter, ctrl_c() as interrupt:
            stream = record(scenario, report=reporter, stop=interrupt)
            found = (
                None if stream is None else watch(stream, self.backend, self.cycles, stop=interrupt)
            )
        if found is None:
            return INTERRUPTED
        if self.json:
            sys.stdout.write(to_json(asdict(found)))
        else:
            for line in _lines(found):
                Console().print(line, highlight=False, soft_wrap=True)
        return 0


def _lines(found: Steady) -> list[str]:
    def grown(held: tuple[int, ...]) -> str:
        return f"{held[0] / 1024:.0f} KiB before, {(held[-1] - held[0]) / 1024:+.1f} KiB after"

    return [
        f"{found.backend}: {found.cycles} compiled steps, {found.interpreted_cycles} of them "
        "interpreted, each followed by its prepare",
        f"Python's memory: {grown(found.python_bytes)}; at most "
        f"{max(found.python_bytes) - found.python_bytes[0]} bytes more in between",
        f"resident memory: {grown(found.resident_bytes)}; pages got from the system: "
        f"{found.page_faults}",
    ]
