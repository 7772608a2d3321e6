"""``pulsempc sweep``: one scenario, keys that take one value after the other, one table."""

import json
import sys
from dataclasses import dataclass, replace
from typing import Annotated, Any

import tyro
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from bench.cli import INTERRUPTED
from bench.progress import Reporter, ctrl_c
from bench.sweep import Row, combinations, parse, sweep
from bench.verbs._asked import FAILED, Asked, load
from scenarios import Scenario, ScenarioError
from scenarios.results import to_json

_arg = tyro.conf.arg


@dataclass(frozen=True, kw_only=True)
class Sweep(Asked):
    """Run a scenario once for each value of keys that change, and tell what came of it.

    For example, `pulsempc sweep paper --over 'cell.contact.stiffness=[625, 2500, 10000]'`, or
    `pulsempc sweep paper --over 'cell.sensor.dropout_time=[0.01, 0.02]' --duration 5 --json`.
    Nothing is written.
    """

    over: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], _arg(metavar="KEY[+KEY]=[V,V,...]")]
    """Keys and the values that they take together; several ranges give every combination."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the rows as JSON, and nothing else, on standard output."""

    def run(self) -> int:
        """Run all and show; return the exit code: 1 where a run was not to its end, or tripped."""
        if not self.over:
            raise ScenarioError("--over: at least one KEY=[V, V, ...] is needed")
        chosen = combinations([parse(text) for text in self.over])
        if load(self).setpoint.live is not None:
            raise ScenarioError("setpoint.live: is another one in every run, nothing to compare by")
        made = [(changed, self._with(changed)) for changed in chosen]  # all errors come first
        with Reporter(quiet=self.json) as reporter, ctrl_c() as interrupt:
            rows = list(sweep(made, reporter, interrupt))
        if self.json:
            scenario = made[0][1]
            told = {"scenario": scenario.name, "cycles": scenario.cycles, "rows": rows}
            sys.stdout.write(to_json(told))
        elif rows:
            Console().print(_table(rows))
        if interrupt.pressed:
            print(f"pulsempc: interrupted after {len(rows)} of {len(made)} runs", file=sys.stderr)
            return INTERRUPTED
        return FAILED if any(row["stopped"] or row["trip"] for row in rows) else 0

    def _with(self, changed: dict[str, Any]) -> Scenario:
        settings = (f"{key}={_toml(value)}" for key, value in changed.items())
        return load(replace(self, set=(*self.set, *settings)))


def _toml(value: Any) -> str:
    """Return a value in TOML's notation; JSON's is the same for what is not a table."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(_toml(each) for each in value) + "]"
    return json.dumps(value) if isinstance(value, str | bool) else repr(value)


def _table(rows: list[Row]) -> Table:
    keys, axes = list(rows[0]["changed"]), list(rows[0]["axes"])
    table = Table(box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True, pad_edge=False)
    for key in keys:
        table.add_column(escape(key.rpartition(".")[2]), justify="right", vertical="bottom")
    names = "/".join(axes)
    headings = (
        f"reduction of\nRMS {names} [%]",
        f"largest error\n{names} [N]",
        "u on its\nbound",
        "tripped",
    )
    for heading in headings:
        table.add_column(escape(heading), justify="right", no_wrap=True)
    for row in rows:
        figures = row["axes"].values()
        cells = [
            " / ".join("-" if f[name] is None else f"{f[name]:{form}}" for f in figures)
            for name, form in (("reduction_rms", ".1f"), ("max", ".2f"))
        ]
        share = row["saturation"]["command"]
        trip = row["trip"]["cause"] if row["trip"] else row["stopped"] or ""
        table.add_row(
            *(str(row["changed"][key]) for key in keys),
            *cells,
            "-" if share is None else f"{100 * share:.1f} %",
            trip,
        )
    return table
