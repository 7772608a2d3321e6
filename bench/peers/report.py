"""What the measurement of peers leaves: one table, one sentence, one JSON."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table

from bench.instances import Instances

SCHEMA = "pulsempc.peers/1"
EQUAL = 0.999
"""Share of instances that must come out right for a row to count as at equal accuracy."""
EASIER = 0.95
"""The same for peers whose task is easier: hard bounds have no answer where soft ones give way."""


def summary(rows: Sequence[dict[str, Any]], instances: Instances, passes: int) -> dict[str, Any]:
    """Return what goes into the JSON."""
    active = instances.active
    return {
        "format": SCHEMA,
        "instances": {
            "scenario": instances.scenario,
            "axes": instances.axes,
            "horizon": instances.horizon,
            "count": instances.cycles,
            "rows": int(active.shape[1]),
            "active_share": float(active.any(axis=1).mean()),
        },
        "passes": passes,
        "rows": list(rows),
        "ratio": {"equal": ratio(rows, EQUAL), "easier": ratio(rows, EASIER)},
        "machine": {
            "cpu": _cpu(),
            "cores": os.cpu_count(),
            "system": platform.platform(),
            "load": os.getloadavg()[0],
        },
    }


def ratio(rows: Sequence[dict[str, Any]], share: float) -> dict[str, Any] | None:
    """Compare our fastest row at equal accuracy with the fastest peers that agree in ``share``.

    Each figure is compared with the peer that is best at it. None where either side has no row.
    """
    measured = [row for row in rows if row["us"]]
    ours = [row for row in measured if row["ours"] and row["agreed"] >= EQUAL]
    peers = [row for row in measured if not row["ours"] and row["agreed"] >= share]
    if not ours or not peers:
        return None
    result: dict[str, Any] = {}
    for key, of, quantile in (
        ("median", "us", "p50"), ("floor_median", "floor_us", "p50"),
        ("p999", "us", "p999"), ("floor_p999", "floor_us", "p999"),
    ):  # fmt: skip
        mine = min(ours, key=lambda row: row[of][quantile])
        best = min(peers, key=lambda row: row[of][quantile])
        result[key] = {
            "ours": _name(mine),
            "peer": _name(best),
            "factor": best[of][quantile] / mine[of][quantile],
        }
    return result


def table(rows: Sequence[dict[str, Any]]) -> Table:
    """Return the one table, ours first, then peers by what they take; the absent at the end."""
    result = Table(
        title="Peers on the same instances: microseconds a cycle, and the first increment",
        box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True,
    )  # fmt: skip
    result.add_column("package")
    for heading in (
        "median", "p99.9", "floor\nmedian", "\np99.9", "answered", "same\noptimum", "error\np99.9",
    ):  # fmt: skip
        result.add_column(heading, justify="right", no_wrap=True, vertical="bottom")
    result.add_column("what it solves")
    for row in sorted(rows, key=_order):
        if row["us"] is None:
            continue
        error = row["error"]
        result.add_row(
            _name(row),
            *(f"{row[of][q]:.1f}" for of in ("us", "floor_us") for q in ("p50", "p999")),
            f"{row['answered']:.2%}",
            f"{row['agreed']:.2%}",
            f"{error['p999']:.0e}" if error else "-",
            row["solves"] or "",
        )
    return result


def lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Return what is said below the table: what is absent and why, and the comparison."""
    said = [f"no figures: {_name(row)}: {row['reason']}" for row in rows if row["us"] is None]
    for share in (EQUAL, EASIER):
        found = ratio(rows, share)
        if found is None:
            said.append(f"no comparison: no row of ours and peer agree in {share:.1%} of instances")
            continue
        said.append(f"against the fastest peers that agree in {share:.1%} of the instances:")
        for key, words in (
            ("median", "median"), ("p999", "p99.9"),
            ("floor_median", "floor, median"), ("floor_p999", "floor, p99.9"),
        ):  # fmt: skip
            entry = found[key]
            said.append(f"  {words}: {entry['ours']}, {entry['factor']:.1f} x {entry['peer']}")
    return said


def _order(row: dict[str, Any]) -> tuple[bool, float]:
    return not row["ours"], row["floor_us"]["p50"] if row["floor_us"] else float("inf")


def _name(row: dict[str, Any]) -> str:
    version = next(iter(row["versions"].values()), "") if not row["ours"] else ""
    name = f"{row['peer']} {version}".strip()
    return f"{name}, {row['variant']}" if row["variant"] else name


def _cpu() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or "unknown"
