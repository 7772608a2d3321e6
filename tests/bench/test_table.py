"""The tables of a comparison: what is in them, and that they fit a terminal."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from bench.table import comparison_lines, comparison_tables, timing_lines, trip_line
from plant import Cause, Trip

TIMES = {"p50": 1234.4, "p99": 12345.0, "p999": 123456.0, "max": 1234567.0}
BEYOND = {
    "force": {"count": 15000, "worst": 12.3456, "integral": 1.0},
    "velocity": {"count": 234, "worst": 0.45678, "integral": 1.0},
    "command": {"count": 0, "worst": 0.0, "integral": 0.0},
}
SOLVED = {"solution": 1000, "plan": 0, "analytic": 0, "hold": 0}


def errors(axes):
    return {
        axis: {"rms": 1.2344 + i, "max": 12.344 + i, "reduction_rms": 98.7}
        for i, axis in enumerate(axes)
    }


PATH = {"used": False, "reason": "switched off", "interpreted_cycles": 0}


def row(backend="daqp", **changes):
    return {
        "backend": backend,
        "axes": errors("xyz"),
        "violations": BEYOND,
        "build_us": dict.fromkeys(TIMES, 0.0),
        "solve_us": TIMES,
        "command_error": 1.2e-9,
        "status": {"solved": 1000},
        "source": SOLVED,
        "compiled": PATH,
        "without_reference": 0,
        "trip": None,
    } | changes


REFUSED = {"backend": "piqp", "controller": "mpc", "complete": False, "error": "has no limit"}
STOPPED = row(
    command_error=None,
    solve_us=dict.fromkeys(TIMES),
    build_us=dict.fromkeys(TIMES),
    axes={"z": dict.fromkeys(("rms", "max", "reduction_rms"))},
    status={},
    source=dict.fromkeys(SOLVED, 0),
)


def shown(rows, width=80) -> str:
    console = Console(width=width, file=io.StringIO())
    for table in comparison_tables(rows):
        console.print(table)
    return console.file.getvalue()


def test_every_figure_is_in_its_place():
    force, bounds, solver = comparison_tables([row("analytic"), row("osqp", build_us=TIMES)])
    cells = [[list(column.cells) for column in table.columns] for table in (force, bounds, solver)]
    first = [[column[0] for column in table] for table in cells]
    assert first[0] == ["analytic", "1.234", "2.234", "3.234", "12.34", "13.34", "14.34"]
    assert first[1] == ["analytic", "12.346", "15000", "0.4568", "234", "0.00", "0"]
    assert first[2] == ["analytic", "1234", "12345", "123456", "1234567", "", "1.2e-09"]
    assert cells[2][5][1] == "1234"


@pytest.mark.parametrize("axes", ["xyz", "z"])
@pytest.mark.parametrize("backend", ["analytic", "clarabel"])
def test_eighty_columns_are_enough(backend, axes):
    text = shown([row(backend, axes=errors(axes)), row(axes=errors(axes))])
    assert max(len(line) for line in text.splitlines()) <= 80
    assert "…" not in text
    assert text.count(backend) == 3
    for unit in ("error [N]", "[N, m/s, m/s^2]", "time [us]", "command [m/s^2]"):
        assert unit in text


def test_eighty_columns_are_enough_for_a_backend_of_a_family():
    text = shown([row("qpsolvers:quadprog"), row("qpsolvers:quadprog2")])
    assert "…" not in text
    assert max(len(line) for line in text.splitlines()) <= 80


@pytest.mark.parametrize("rows", [[], [REFUSED], [STOPPED], [REFUSED, row()], [row(), REFUSED]])
def test_whatever_there_is_can_be_shown(rows):
    text = shown(rows)
    assert "None" not in text
    assert "nan" not in text
    assert ("daqp" in text) == any("axes" in r for r in rows)


def test_lines_say_how_the_solves_ended_and_what_stood_in():
    lines = comparison_lines(
        [
            row("daqp", compiled=PATH | {"used": True}),
            row(
                "osqp",
                status={"solved": 990, "iteration_limit": 10},
                source={"solution": 990, "plan": 7, "analytic": 0, "hold": 3},
                without_reference=4,
            ),
            REFUSED,
        ]
    )
    assert lines == [
        "daqp (compiled): solved 1000",
        "osqp (interpreted): solved 990, iteration_limit 10; command from plan 7, hold 3; "
        "no reference in 4 cycles",
        "piqp: refused the problem",
    ]


def test_a_trip_is_told_with_cause_key_time_and_figures():
    assert trip_line(Trip(Cause.FORCE, 0.032375, 30.0134, 30.0)) == (
        "the protection tripped at t = 0.032375 s on cell.protection.force (30.01, limit 30 N); "
        "the tool was retracted"
    )
    told = trip_line(Trip(Cause.JOINT_RANGE, 1.5, 1.8, 1.7, joint=5))
    assert "cell.protection.joint_margin of joint 5 (1.8, limit 1.7 rad)" in told
    (line,) = comparison_lines([row(trip={"cause": "tip_speed", "time": 0.25})])
    assert line == "daqp (interpreted): solved 1000; tripped at 0.25 s on tip_speed"


@pytest.mark.parametrize("cause", list(Cause))
def test_every_cause_has_its_unit(cause):
    told = trip_line(Trip(cause, 0.1, 2.0, 1.0))
    assert told.split("limit 1 ")[1].split(")")[0] in {"cycles", "rad", "rad/s", "m/s", "N"}


def summary(**changes):
    return {
        "timing": {
            "solve_us": TIMES,
            "cycle_us": TIMES,
            "plant_us": TIMES,
            "misses": 2,
            "real_time_factor": {"compensated": 2.5, "uncompensated": None},
        },
        "cycles": 1000,
        "saturation": {"torque": 0.0, "command": 0.125},
        "status": {"solved": 1000},
        "source": SOLVED,
        "compiled": {"used": True, "reason": None, "interpreted_cycles": 0},
        "live_setpoint": None,
        "contact_loss": None,
        "violations": {name: {"count": 0, "worst": 0.0, "integral": 0.0} for name in BEYOND},
    } | changes


def test_a_run_without_incident_says_nothing_of_fallbacks_and_bounds():
    text = "\n".join(timing_lines(summary()))
    assert "without a usable answer" not in text
    assert "beyond the bounds" not in text


def test_a_run_says_which_path_its_steps_took():
    assert "step: compiled" in timing_lines(summary())
    handed = {"used": True, "reason": None, "interpreted_cycles": 3}
    told = timing_lines(summary(compiled=handed))
    assert "step: compiled, 3 cycles handed to the interpreted path" in told
    assert "step: interpreted (switched off)" in timing_lines(summary(compiled=PATH))


def test_a_run_says_what_stood_in_and_what_was_passed():
    told = timing_lines(
        summary(source={"solution": 990, "plan": 7, "analytic": 0, "hold": 3}, violations=BEYOND)
    )
    assert "cycles without a usable answer, command from: plan 7, hold 3" in told
    assert told[-1] == (
        "beyond the bounds: force in 15000 cycles, at worst by 12.3 N; "
        "velocity in 234 cycles, at worst by 0.457 m/s"
    )


def test_times_of_a_compiled_step_are_told_to_a_tenth():
    short = {"p50": 1.81, "p99": 6.44, "p999": 9.96, "max": 48.2}
    timing = summary()["timing"] | {"solve_us": short}
    told = timing_lines(summary(timing=timing))
    assert told[0] == "solve: median 1.8 us, p99 6.4 us, p99.9 10 us, max 48 us"
