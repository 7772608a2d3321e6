"""``pulsempc bench latency``: what a cycle costs under each backend."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from scenarios import ScenarioError

_arg = tyro.conf.arg


@dataclass(frozen=True)
class Latency:
    """Record cycles of a closed loop and let every backend solve them, hot and paced at 1 kHz.

    For example, `pulsempc bench latency --backends analytic,daqp --horizon 8,32`.
    """

    scenario: Annotated[tyro.conf.Positional[str], _arg(metavar="SCENARIO")] = "latency"
    """Name of a shipped scenario (see `pulsempc scenarios`) or path of a TOML file."""

    def run(self) -> int:
        """Record, measure, write, show; return the exit code."""
        raise ScenarioError("bench latency: being written")
