"""Tables for the terminal."""

from collections.abc import Iterable

from rich.box import SIMPLE_HEAD
from rich.table import Table

from qpmpc.backends import BackendInfo
from scenarios.config import Scenario
from scenarios.metrics import PAPER, Summary


def force_table(summary: Summary) -> Table:
    """The paper's table of results, and the paper's own figures beside it."""
    title = f"Contact force error [N], scenario {summary['scenario']}"
    table = Table(title=title, box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    table.add_column("axis", vertical="bottom")
    for heading in (
        "held still\nRMS",
        "\nmax",
        "\np-p",
        "controlled\nRMS",
        "\nmax",
        "\np-p",
        "reduction\nof the RMS",
        "in the\npaper",
    ):
        table.add_column(heading, justify="right", no_wrap=True)
    for axis, figures in summary["axes"].items():
        held, controlled = figures["uncompensated"], figures["compensated"]
        cells = [_number(held[key], ".2f") for key in ("rms", "max", "peak_to_peak")]
        cells += [_number(controlled[key], ".3f") for key in ("rms", "max", "peak_to_peak")]
        cells.append(_number(figures["reduction"]["rms"], ".2f", " %"))
        cells.append(f"{PAPER['reduction'][axis]['rms']:.0f} %")
        table.add_row(axis, *cells)
    return table


def timing_lines(summary: Summary) -> list[str]:
    """What the run cost and how it went, in a few lines."""
    timing, saturation = summary["timing"], summary["saturation"]
    lines = []
    for name, what in (("solve_us", "solve"), ("cycle_us", "control cycle")):
        p = timing[name]
        lines.append(
            f"{what}: median {_number(p['p50'], '.0f')} us, p99 {_number(p['p99'], '.0f')} us, "
            f"p99.9 {_number(p['p999'], '.0f')} us, max {_number(p['max'], '.0f')} us"
        )
    lines.append(
        f"cycles over their period: {timing['misses']} of {summary['cycles']}; simulated at "
        f"{_number(timing['real_time_factor']['compensated'], '.1f')} x real time"
    )
    lines.append(
        f"saturated cycles: torque {_number(saturation['torque'], '.2%')}, "
        f"command {_number(saturation['command'], '.2%')}; status: "
        + ", ".join(f"{name} {count}" for name, count in summary["status"].items())
    )
    return lines


def scenario_table(scenarios: Iterable[Scenario]) -> Table:
    """The shipped scenarios."""
    table = Table(
        "name", "axes", "duration", "backend", "what it is", title="Scenarios", box=SIMPLE_HEAD
    )
    for s in scenarios:
        table.add_row(s.name, "".join(s.axes), f"{s.duration:g} s", s.backend, s.description)
    return table


def backend_table(backends: Iterable[BackendInfo]) -> Table:
    """The backends, installed or not."""
    table = Table("name", "package", "installed", "what it is", title="Backends", box=SIMPLE_HEAD)
    for b in backends:
        table.add_row(b.name, b.package, b.version or f"no: {b.install}", b.summary)
    return table


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}}{unit}"
