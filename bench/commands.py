"""The verbs of the command line; each is a record of its arguments that knows how to run."""

from typing import Annotated

import tyro

from bench.verbs.bench import Bench
from bench.verbs.compare import Compare
from bench.verbs.lists import Backends, Controllers, Scenarios
from bench.verbs.live import Live
from bench.verbs.margins import Margins, Tune
from bench.verbs.render import Render
from bench.verbs.report import Report
from bench.verbs.run import Run
from bench.verbs.sweep import Sweep
from bench.verbs.view import View

Command = (
    Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Compare, tyro.conf.subcommand("compare")]
    | Annotated[Report, tyro.conf.subcommand("report")]
    | Annotated[Render, tyro.conf.subcommand("render")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Live, tyro.conf.subcommand("live")]
    | Annotated[Sweep, tyro.conf.subcommand("sweep")]
    | Annotated[Margins, tyro.conf.subcommand("margins")]
    | Annotated[Tune, tyro.conf.subcommand("tune")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
    | Annotated[Scenarios, tyro.conf.subcommand("scenarios")]
    | Annotated[Controllers, tyro.conf.subcommand("controllers")]
    | Annotated[Backends, tyro.conf.subcommand("backends")]
)
