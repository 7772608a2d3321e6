"""``pulsempc bench compare``: two measurements, row by row."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console

from bench.latency.compare import compare_results
from bench.latency.compare_table import comparison_lines, comparison_table
from bench.latency.result import read_result
from scenarios import ScenarioError
from scenarios.results import to_json


@dataclass(frozen=True)
class CompareLatency:
    """Compare two results of `pulsempc bench latency`, row by row.

    For example, `pulsempc bench compare before/latency.json after/latency.json`.
    """

    first: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="A.json")]
    """What the ratios refer to."""
    second: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="B.json")]
    """What is compared with it."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the comparison as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Pair and show; return the exit code."""
        comparison = compare_results(read_result(self.first), read_result(self.second))
        if not comparison.pairs:
            raise ScenarioError(f"{self.first} and {self.second} have no row in common")
        if self.json:
            sys.stdout.write(to_json(comparison.summary()))
            return 0
        console = Console()
        console.print(comparison_table(comparison))
        for line in comparison_lines(comparison):
            console.print(line, highlight=False, markup=False)
        return 0
