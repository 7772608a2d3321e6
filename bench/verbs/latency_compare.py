"""``pulsempc bench compare``: two measurements, row by row."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from scenarios import ScenarioError


@dataclass(frozen=True)
class CompareLatency:
    """Compare two results of `pulsempc bench latency`, row by row.

    For example, `pulsempc bench compare before.json after.json`.
    """

    before: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="A.json")]
    """What the ratios refer to."""
    after: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="B.json")]
    """What is compared with it."""

    def run(self) -> int:
        """Pair, show; return the exit code."""
        raise ScenarioError("bench compare: being written")
