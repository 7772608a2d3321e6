"""The measurement in the terminal."""

from __future__ import annotations

from collections.abc import Iterable

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from bench.latency.result import LeftOut, Result, Row, Stream

_MODES = {"hot": "one cycle after the other", "paced": "each cycle at its own time"}


def latency_tables(result: Result) -> list[Table]:
    """One table for each set of axes, horizon and mode."""
    tables = []
    for stream in result.streams:
        for mode, meaning in _MODES.items():
            rows = [
                row
                for row in result.rows
                if (row.axes, row.horizon, row.mode) == (stream.axes, stream.horizon, mode)
            ]
            if rows:
                title = f"{stream.axes}, N = {stream.horizon}, {mode}: {meaning}; step [us]"
                tables.append(_table(title, rows))
    return tables


def _table(title: str, rows: Iterable[Row]) -> Table:
    table = Table(title=escape(title), box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    table.add_column("backend", vertical="bottom", min_width=10, overflow="fold")
    for heading in (
        "p50", "p99.9", "max", "floor\np99.9", "solve\np50", "x closed\nform",
        "misses", "error\nm/s^2",
    ):  # fmt: skip
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        step = row.step_us
        table.add_row(
            called(row) + ("*" if row.cut else ""),
            *(number(value) for value in (step.p50, step.p999, step.max)),
            number(step.floor_p999),
            number(row.solve_us.p50),
            "-" if row.ratio_to_analytic is None else f"{row.ratio_to_analytic:.2f}",
            str(row.misses),
            "-" if row.error is None else f"{row.error:.0e}",
        )
    return table


def latency_lines(result: Result) -> list[str]:
    """What the tables do not say: the streams, cuts, what was left out, the clock."""
    lines = [_stream_line(stream) for stream in result.streams]
    cuts: dict[str, list[str]] = {}
    for row in result.rows:
        if row.cut:
            cuts.setdefault(f"N = {row.horizon}, {row.axes}, {row.mode}: {row.cut}", []).append(
                called(row)
            )
    lines += [f"* {', '.join(names)}: {cut}" for cut, names in cuts.items()]
    lines += [left_out_line(left) for left in result.left_out]
    timer, load = result.timer, result.machine.get("load_average")
    lines.append(
        f"clock: {timer.clock}, a reading costs {timer.cost_p50_ns:.0f} ns, in the figures; "
        f"load average {load}"
    )
    return lines


def left_out_line(left: LeftOut) -> str:
    """Say what was left out and why."""
    name = left.backend if left.path in (None, "interpreted") else f"{left.backend} ({left.path})"
    where = [
        *([f"N = {left.horizon}"] if left.horizon is not None else []),
        *([left.axes] if left.axes is not None else []),
        *([left.mode] if left.mode is not None else []),
    ]
    return f"left out: {', '.join([name, *where])}: {left.reason}"


def called(row: Row) -> str:
    """Return a backend's name, with its path where that is not the usual one."""
    return row.backend if row.path == "interpreted" else f"{row.backend} ({row.path})"


def number(value: float | None) -> str:
    """Return microseconds with three digits that matter."""
    if value is None:
        return "-"
    return f"{value:.0f}" if value >= 100 else f"{value:.1f}" if value >= 10 else f"{value:.2f}"


def _stream_line(stream: Stream) -> str:
    if stream.active_share is None:
        return f"{stream.axes}, N = {stream.horizon}: no cycle has a certified answer"
    kinds = ", ".join(f"{name} {share:.1%}" for name, share in stream.active.items())
    return (
        f"{stream.axes}, N = {stream.horizon}: bounds act in {stream.active_share:.1%} of "
        f"{stream.cycles} cycles ({kinds}); certified answers: {stream.certified}"
    )
