"""``pulsempc bench``: the family of verbs that measure time."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from bench.verbs.deadline import Deadline
from bench.verbs.latency import Latency
from bench.verbs.latency_compare import CompareLatency

_Measurement = (
    Annotated[Latency, tyro.conf.subcommand("latency")]
    | Annotated[Deadline, tyro.conf.subcommand("deadline")]
    | Annotated[CompareLatency, tyro.conf.subcommand("compare")]
)


@dataclass(frozen=True)
class Bench:
    """Measure time: of the solvers on recorded cycles, and of two such measurements together.

    For example, `pulsempc bench latency --backends analytic,daqp`, or
    `pulsempc bench compare before.json after.json`.
    """

    verb: Annotated[_Measurement, tyro.conf.arg(name="")]

    def run(self) -> int:
        """Do what the verb says; return the exit code."""
        return self.verb.run()
