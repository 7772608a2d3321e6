"""Tables for the terminal."""

from collections.abc import Iterable, Sequence
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from plant.interface import Cause, Trip
from qpmpc.backends import BackendInfo
from qpmpc.kinds import ControllerKind
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


def compiled_line(compiled: Summary) -> str:
    """Which path the steps took."""
    if not compiled["used"]:
        return f"step: interpreted ({compiled['reason']})"
    handed = compiled["interpreted_cycles"]
    return "step: compiled" + (
        f", {handed} cycles handed to the interpreted path" if handed else ""
    )


def timing_lines(summary: Summary) -> list[str]:
    """What the run cost and how it went, in a few lines."""
    timing, saturation = summary["timing"], summary["saturation"]
    lines = []
    for name, what in (
        ("solve_us", "solve"),
        ("cycle_us", "control cycle"),
        ("plant_us", "simulated cell"),
    ):
        p = timing[name]
        lines.append(
            f"{what}: median {_time(p['p50'])} us, p99 {_time(p['p99'])} us, "
            f"p99.9 {_time(p['p999'])} us, max {_time(p['max'])} us"
        )
    lines.append(
        f"cycles over their period: {timing['misses']} of {summary['cycles']}; simulated at "
        f"{_number(timing['real_time_factor']['compensated'], '.1f')} x real time"
    )
    lines.append(
        f"saturated cycles: torque {_number(saturation['torque'], '.2%')}, "
        f"command {_number(saturation['command'], '.2%')}; status: " + _counts(summary["status"])
    )
    lines.append(compiled_line(summary["compiled"]))
    fallbacks = {name: n for name, n in summary["source"].items() if name != "solution"}
    if any(fallbacks.values()):
        lines.append(f"cycles without a usable answer, command from: {_counts(fallbacks)}")
    if summary["live_setpoint"] is not None:
        lines.append(f"live setpoint: {_counts(summary['live_setpoint']) or 'nothing came'}")
    if summary["contact_loss"] is not None:
        lines.append(contact_line(summary["contact_loss"]))
    beyond = {name: v for name, v in summary["violations"].items() if v["count"]}
    if beyond:
        units = {"force": "N", "velocity": "m/s", "command": "m/s^2"}
        lines.append(
            "beyond the bounds: "
            + "; ".join(
                f"{name} in {v['count']} cycles, at worst by {v['worst']:.3g} {units[name]}"
                for name, v in beyond.items()
            )
        )
    return lines


def contact_line(loss: Summary) -> str:
    """How often the tool was off the tissue, and how it came back."""
    others = len(loss["events"]) - loss["count"]
    line = f"contact lost: {loss['count']} times, {loss['time']:.3g} s in all"
    if others:
        line += f"; off the tissue at the start or on purpose: {others} times"
    if loss["speed"] is not None:
        line += (
            f"; the tool came back at {loss['speed']:.3g} m/s and "
            f"{loss['force_peak']:.3g} N at most"
        )
    return line


def trip_line(trip: Trip) -> str:
    """What the protection tripped on, in one line."""
    found = f"{trip.value:.4g}, limit {trip.limit:.4g} {_TRIP_UNITS.get(trip.cause, '')}".rstrip()
    where = f" of joint {trip.joint}" if trip.joint else ""
    return (
        f"the protection tripped at t = {trip.time:.6g} s on cell.protection."
        f"{_TRIP_KEYS.get(trip.cause, trip.cause)}{where} ({found}); the tool was retracted"
    )


_TRIP_KEYS = {Cause.JOINT_RANGE: "joint_margin"}
_TRIP_UNITS = {
    Cause.HEARTBEAT: "cycles",
    Cause.JOINT_RANGE: "rad",
    Cause.JOINT_SPEED: "rad/s",
    Cause.TIP_SPEED: "m/s",
    Cause.TRACKING_VELOCITY: "m/s",
    Cause.TRACKING_ORIENTATION: "rad",
    Cause.TRACKING_HEART: "rad",
    Cause.FORCE: "N",
}


def comparison_tables(rows: Sequence[dict[str, Any]]) -> list[Table]:
    """What each backend made of the same run: force, bounds, solver."""
    rows = [row for row in rows if "axes" in row]
    axes = list(rows[0]["axes"]) if rows else []
    force = _table(
        "Contact force error [N]", *(f"{what}{axis}" for what in ("RMS ", "max ") for axis in axes)
    )
    bounds = _table(
        "Beyond the bounds: at worst [N, m/s, m/s^2], and in how many cycles",
        "force", "cycles", "velocity", "cycles", "command", "cycles",
    )  # fmt: skip
    solver = _table(
        "Solver: time [us], and largest error of the command [m/s^2]",
        "p50", "p99", "p99.9", "max", "build p50", "error",
    )  # fmt: skip
    for row in rows:
        force.add_row(
            row["backend"],
            *(_number(row["axes"][axis]["rms"], ".3f") for axis in axes),
            *(_number(row["axes"][axis]["max"], ".2f") for axis in axes),
        )
        found = row["violations"]
        bounds.add_row(
            row["backend"],
            *(
                cell
                for name, form in (("force", ".3f"), ("velocity", ".4f"), ("command", ".2f"))
                for cell in (_number(found[name]["worst"], form), str(found[name]["count"]))
            ),
        )
        built = row["build_us"]["p50"]
        solver.add_row(
            row["backend"],
            *(_time(row["solve_us"][key]) for key in ("p50", "p99", "p999", "max")),
            _time(built) if built else "",
            _number(row["command_error"], ".1e"),
        )
    return [force, bounds, solver]


def comparison_lines(rows: Sequence[dict[str, Any]]) -> list[str]:
    """How the solves of each backend ended, and what stood in where they gave nothing."""
    lines = []
    for row in rows:
        if "status" not in row:
            lines.append(f"{row['backend']}: refused the problem")
            continue
        path = "compiled" if row["compiled"]["used"] else "interpreted"
        line = f"{row['backend']} ({path}): {_counts(row['status'])}"
        fallbacks = {name: n for name, n in row["source"].items() if name != "solution"}
        if any(fallbacks.values()):
            line += f"; command from {_counts(fallbacks)}"
        if row["trip"]:
            line += f"; tripped at {row['trip']['time']:.6g} s on {row['trip']['cause']}"
        if row["without_reference"]:
            line += f"; no reference in {row['without_reference']} cycles"
        lines.append(line)
    return lines


def _table(title: str, *headings: str) -> Table:
    title = escape(title)  # units in brackets are no markup
    table = Table("backend", title=title, box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    for heading in headings:
        table.add_column(escape(heading), justify="right", no_wrap=True)
    return table


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items() if count)


def scenario_table(scenarios: Iterable[Scenario]) -> Table:
    """The shipped scenarios."""
    table = Table(
        "name", "axes", "duration", "backend", "what it is", title="Scenarios", box=SIMPLE_HEAD
    )
    for s in scenarios:
        table.add_row(s.name, "".join(s.axes), f"{s.duration:g} s", s.backend, s.description)
    return table


def controller_table(kinds: Iterable[ControllerKind]) -> Table:
    """The controllers, and where each comes from."""
    table = Table(title="Controllers", box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    table.add_column("name", no_wrap=True)
    for heading in ("what it is", "from", "keys"):
        table.add_column(heading)
    for kind in kinds:
        table.add_row(kind.name, kind.summary, escape(kind.source), kind.table)
    return table


def backend_table(backends: Iterable[BackendInfo]) -> Table:
    """The backends, installed or not."""
    table = Table(title="Backends", box=SIMPLE_HEAD, padding=(0, 1), collapse_padding=True)
    table.add_column("name", no_wrap=True)
    for heading in ("warm\nstart", "new\nrows", "limits"):
        table.add_column(heading, no_wrap=True)
    table.add_column("what it is", vertical="bottom")
    for b in backends:
        table.add_row(
            b.name,
            "yes" if b.warm_starts else "no",
            "taken" if b.replaces_rows else "rebuilt",
            ", ".join(_LIMITS[limit] for limit in sorted(b.limits)) or "none",
            f"{b.summary} ({f'{b.package} {b.version}' if b.version else escape(b.install)})",
        )
    return table


_LIMITS = {"iterations": "iter.", "time": "time"}


def _number(value: float | None, form: str, unit: str = "") -> str:
    return "-" if value is None else f"{value:{form}}{unit}"


def _time(value: float | None) -> str:
    """A time [us]: whole ones, but for those of a compiled step."""
    return _number(value, ".1f" if value is not None and value < 9.95 else ".0f")
