"""The verbs of the command line; each is a record of its arguments that knows how to run."""

from typing import Annotated

import tyro

from bench.verbs.bench import Bench
from bench.verbs.compare import Compare
from bench.verbs.lists import Backends, Controllers, Scenarios
from bench.verbs.run import Run

Command = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[Scenarios, tyro.conf.subcommand("scenarios")]
    | Annotated[Controllers, tyro.conf.subcommand("controllers")]
    | Annotated[Backends, tyro.conf.subcommand("backends")]
)
