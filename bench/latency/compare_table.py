"""A comparison of two measurements in the terminal."""

from __future__ import annotations

from rich.box import SIMPLE_HEAD
from rich.table import Table

from bench.latency.compare import DRIFT, LatencyComparison
from bench.latency.table import number


def comparison_table(comparison: LatencyComparison) -> Table:
    """One line a row that both results have: B over A."""
    table = Table(
        title="Step, the second measurement over the first",
        box=SIMPLE_HEAD,
        padding=(0, 1),
        collapse_padding=True,
    )
    table.add_column("backend", vertical="bottom", min_width=8, overflow="fold")
    for heading in (
        "N", "axes", "mode", "A: p50\nus", "B: p50\nus", "B / A\np50", "\np99.9", "\nfloor",
        "noise", "",
    ):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True)
    for pair in comparison.pairs:
        name = pair.backend if pair.path == "interpreted" else f"{pair.backend} ({pair.path})"
        table.add_row(
            name,
            str(pair.horizon),
            pair.axes.replace(",", ""),
            pair.mode,
            *(number(value) for value in pair.p50_us),
            *(_ratio(r) for r in (pair.ratio_p50, pair.ratio_p999, pair.ratio_floor_p50)),
            f"{pair.noise:.0%}",
            "" if pair.verdict == "not told apart" else pair.verdict,
        )
    return table


def comparison_lines(comparison: LatencyComparison) -> list[str]:
    """What is not in the table: what else differs, and rows without a partner."""
    lines = [
        "noise: how far the passes of one measurement differ. 'faster' and 'slower' are said only "
        "where every pass and the least times (floor) agree on it, and from "
        f"{DRIFT:.0%} on."
    ]
    lines += [
        f"not the same: {name}: {mine} in A, {theirs} in B"
        for name, (mine, theirs) in comparison.differences.items()
    ]
    for which, keys in (("A", comparison.only_first), ("B", comparison.only_second)):
        groups: dict[str, list[str]] = {}
        for backend, path, horizon, axes, mode in keys:
            name = backend if path == "interpreted" else f"{backend} ({path})"
            groups.setdefault(f"N = {horizon}, {axes}, {mode}", []).append(name)
        lines += [f"only in {which}: {group}: {', '.join(n)}" for group, n in groups.items()]
    return lines


def _ratio(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
