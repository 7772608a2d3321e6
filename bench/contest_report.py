"""What came of controllers against each other: tables, lines and a picture."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from bench.compare import Row
from bench.compare_controllers import ahead

_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#444444")


def contest_tables(rows: Sequence[Row]) -> list[Table]:
    """Force errors and efforts of every run; a run that tripped is marked and counts until then."""
    axes = list(rows[0]["axes"]) if rows else []
    first = _table(
        "Contact force error [N]",
        *(f"{what}{axis}" for what in ("RMS ", "max ") for axis in axes),
    )
    second = _table(
        "The same: 99th percentile of the magnitude, peak to peak [N]",
        *(f"{what}{axis}" for what in ("p99 ", "p-p ") for axis in axes),
    )
    third = _table(
        "Reduction of the RMS [%], torque, command",
        *axes, "dtau RMS [Nm]", "du RMS [m/s^2]", "sat. torque", "sat. command",
    )  # fmt: skip
    before = None
    for row in rows:
        names = [row["scenario"] if row["scenario"] != before else "", row["controller"]]
        if row["trip"]:
            names[1] += " (tripped)"
        before = row["scenario"]

        def cells(key: str, form: str, row: Row = row) -> list[str]:
            return [_number(row["axes"][axis][key], form) for axis in axes]

        first.add_row(*names, *cells("rms", ".4f"), *cells("max", ".3f"))
        second.add_row(*names, *cells("p99", ".3f"), *cells("peak_to_peak", ".3f"))
        increments = np.array(list(row["increment_rms"].values()), dtype=np.float64)
        third.add_row(
            *names,
            *cells("reduction_rms", ".2f"),
            _number(row["torque_increment_rms"], ".2f"),
            _number(float(np.sqrt(np.mean(increments**2))), ".2f"),
            *(_number(row["saturation"][what], ".2%") for what in ("torque", "command")),
        )
    return [first, second, third]


def contest_lines(rows: Sequence[Row]) -> list[str]:
    """Which runs tripped, and where someone is ahead of the last controller named."""
    lines = []
    for row in rows:
        where = f"{row['scenario']}, {row['controller']}"
        if row["trip"]:
            trip = row["trip"]
            lines.append(f"{where}: tripped at {trip['time']:.6g} s on {trip['cause']}")
        elif not row["complete"]:
            lines.append(f"{where}: {row['error']}")
    controllers = list(dict.fromkeys(row["controller"] for row in rows))
    if len(controllers) > 1:
        name = controllers[-1]
        for key in ("rms", "max"):
            better = {place: who for place, who in ahead(rows, name, key).items() if who}
            told = "; ".join(f"{place}: {', '.join(who)}" for place, who in better.items())
            lines.append(f"ahead of {name} by {key}: {told or 'nobody, on no scenario and axis'}")
    return lines


def draw_contest(rows: Sequence[Row], path: Path) -> None:
    """Draw RMS and maximum of each axis over the scenarios, one mark a controller."""
    rows = [row for row in rows if row["complete"]]
    axes = list(rows[0]["axes"]) if rows else ["x"]
    scenarios = list(dict.fromkeys(row["scenario"] for row in rows))
    controllers = list(dict.fromkeys(row["controller"] for row in rows))
    figure = Figure(figsize=(1.5 + 4.2 * len(axes), 7.5), layout="constrained", dpi=110)
    grid = figure.subplots(2, len(axes), sharex=True, squeeze=False)
    width = 0.8 / max(1, len(controllers))
    for panels, (key, what) in zip(grid, (("rms", "RMS"), ("max", "max")), strict=True):
        for panel, axis in zip(panels, axes, strict=True):
            for row in rows:
                i = controllers.index(row["controller"])
                panel.bar(
                    scenarios.index(row["scenario"]) + (i + 0.5) * width - 0.4,
                    row["axes"][axis][key],
                    width,
                    color=_COLOURS[i % len(_COLOURS)],
                    hatch="//" if row["trip"] else None,
                )
            panel.set_yscale("log")
            panel.set_title(f"{axis}, {what} of the force error [N]", fontsize=9)
            panel.set_xticks(range(len(scenarios)), scenarios, rotation=40, ha="right", fontsize=8)
            panel.grid(axis="y", which="both", alpha=0.3)
            panel.set_axisbelow(True)
    handles: list[Any] = [
        grid[0, 0].bar(0, 0, color=_COLOURS[i % len(_COLOURS)]) for i in range(len(controllers))
    ]
    if handles:
        figure.legend(handles, controllers, loc="outside upper center", ncols=len(controllers))
    figure.savefig(path)


def _table(title: str, *headings: str) -> Table:
    table = Table(title=escape(title), box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    for heading in ("scenario", "controller"):
        table.add_column(heading, no_wrap=True)
    for heading in headings:
        table.add_column(escape(heading), justify="right")
    return table


def _number(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"
