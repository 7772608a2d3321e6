"""``pulsempc bench``: the family of verbs that measure time."""

from dataclasses import dataclass
from typing import Annotated

import tyro

from bench.verbs.deadline import Deadline
from bench.verbs.latency import Latency
from bench.verbs.latency_compare import CompareLatency
from bench.verbs.steady import SteadyMemory

_Measurement = (
    Annotated[Latency, tyro.conf.subcommand("latency")]
    | Annotated[Deadline, tyro.conf.subcommand("deadline")]
    | Annotated[CompareLatency, tyro.conf.subcommand("compare")]
    | Annotated[SteadyMemory, tyro.conf.subcommand("steady")]
)


@dataclass(frozen=True)
class Bench:
    """Measure time: of solvers on recorded cycles, of whole cycles against their deadline.

    For example, `pulsempc bench latency --backends analytic,daqp`,
    `pulsempc bench deadline --realtime`, or `pulsempc bench compare before.json after.json`.
    """

    verb: Annotated[_Measurement, tyro.conf.arg(name="")]

    def run(self) -> int:
        """Do what the verb says; return the exit code."""
        return self.verb.run()
