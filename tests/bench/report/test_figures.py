"""What the figures of a report consist of, against the logs they are made of."""

from __future__ import annotations

import numpy as np
import pytest

from bench.report.distributions import error_histogram, error_spectrum
from bench.report.drawing import COLOURS, DASHES, series
from bench.report.runs import read_run
from bench.report.states import activity
from bench.report.tails import times_figure
from bench.report.timeline import Timeline


class Columns:
    """A payload that keeps what it is given."""

    def __init__(self):
        self.kept = []

    def add(self, values):
        for i, known in enumerate(self.kept):
            if known.dtype == values.dtype and np.array_equal(known, values, equal_nan=True):
                return i
        self.kept.append(np.array(values))
        return len(self.kept) - 1


def drawn(*runs):
    columns = Columns()
    timeline = Timeline(runs, columns)
    return {figure.id: figure for figure in timeline.figures()}, columns.kept, timeline


def lines(figure) -> dict:
    return {
        f"{panel.title.split(':')[0]} {line.name}": line
        for panel in figure.panels
        for line in panel.lines
    }


def test_lines_are_the_columns_of_the_log(make):
    run = read_run(make(), "run")
    figures, columns, timeline = drawn(run)
    assert timeline.widths == {}
    assert list(figures) == [
        "force", "error", "command", "velocity", "torque", "activity", "status", "cycle-time",
    ]  # fmt: skip
    force = lines(figures["force"])
    for axis in "xyz":
        for name, column in (
            ("held still", f"force_uncompensated_{axis}"),
            ("controlled", f"force_{axis}"),
            ("setpoint", f"setpoint_{axis}"),
        ):
            line = force[f"{axis} {name}"]
            np.testing.assert_array_equal(columns[line.y], run.values(column))
            assert (line.start, line.step) == (0.0, 1e-3)
        error = lines(figures["error"])[f"{axis} controlled"]
        expected = run.values(f"force_{axis}") - run.values(f"setpoint_{axis}")
        np.testing.assert_array_equal(columns[error.y], expected)
    assert len(lines(figures["torque"])) == 6


def test_bounds_are_drawn_as_they_move(make):
    moving = (
        "controller.bounds.force={z=[-12.0, inf]}",
        "bounds_steps=[{time=0.1, force={z=[-11.0, inf]}}]",
    )
    run = read_run(make(settings=moving), "run")
    figures, columns, _ = drawn(run)
    z = next(panel for panel in figures["force"].panels if panel.title.startswith("z"))
    (bound,) = [line for line in z.lines if line.name == "bound"]  # the infinite one is not drawn
    assert columns[bound.y].tolist() == [-12.0] * 100 + [-11.0] * 300


def test_what_runs_share_is_drawn_once(make):
    first = read_run(make("a"), "a")
    second = read_run(make("b", lambda log: log.force.__imul__(1.01)), "b")
    z = lines(drawn(first, second)[0]["force"])
    assert {"z a", "z b", "z held still", "z setpoint", "z bound"} <= set(z)
    assert z["z a"].style != z["z b"].style
    third = read_run(make("c", lambda log: log.setpoint.__imul__(0.9)), "c")
    assert {"z setpoint, a", "z setpoint, c"} <= set(lines(drawn(first, third)[0]["force"]))


def test_a_long_run_keeps_its_peaks(make):
    def peak(log):
        log.torque[31_234, 2] = 777.0
        log.touching[50_001] = False

    run = read_run(make(change=peak, cycles=70_000), "run")
    figures, columns, timeline = drawn(run)
    assert timeline.widths == {"run": 5}
    line = lines(figures["torque"])["joint 3 torque"]
    values = columns[line.y]
    assert len(values) <= 32_000
    assert values.max() == 777.0
    assert line.start + line.step * int(values.argmax()) == pytest.approx(31.234, abs=5e-3)
    contact = next(b for p in figures["status"].panels for b in p.bands if b.label == "contact")
    mask = columns[contact.mask]
    assert np.flatnonzero(mask & 1).tolist() == [2 * (50_001 // 5), 2 * (50_001 // 5) + 1]


def test_states_of_cycles_are_bits(make, changes):
    run = read_run(make(change=changes.troubled), "run")
    figures, columns, _ = drawn(run)
    bands = {b.label: b for f in figures.values() for p in f.panels for b in p.bands}

    def cycles(label, name):
        (state,) = [s for s in bands[label].states if s.name == name]
        return np.flatnonzero(columns[bands[label].mask] >> state.bit & 1).tolist()

    assert cycles("solve", "late") == [10]
    assert cycles("command from", "plan") == [10]
    assert cycles("period", "period passed") == [20]
    assert cycles("contact", "not touching") == [30, 31, 32]
    assert cycles("command on its bound", "command on its bound") == [40, 41, 42, 43]
    assert cycles("force", "the plan gave way") == [50]
    assert cycles("force", "passed") == [60]
    levels = {s.name: s.level for b in bands.values() for s in b.states}
    assert levels["late"] == "bad"
    assert levels["plan"] == "caution"
    assert levels["solved"] == levels["solution"] == levels["free"] == "good"
    told = " ".join(figures["status"].caption)
    assert "solved 399, late 1" in told
    assert "not touching" not in [s.name for s in bands["solve"].states]


def test_activity_against_brute_force(make):
    rng = np.random.default_rng(1)

    def random(log):
        log.force[:, 2] = rng.choice([-20.5, -20.0, -19.9, -15.0, -0.5, -0.4, -0.502], 400)
        log.slack[:, 2] = rng.choice([0.0, 1e-12, 1e-3, 0.1], 400)

    run = read_run(make(change=random), "run")
    mask, worst = activity(run, "force")
    assert worst == 0.1
    for k, force in enumerate(run.values("force_z").tolist()):
        near = force <= -20 * 0.99 or force >= -0.5 * 1.01
        passed = force < -20 or force > -0.5
        slack = run.values("slack_force")[k]
        gave = slack > 20 * 1e-4
        expected = 2 * near + 4 * gave + 8 * passed
        assert mask[k] == (expected or 1), (k, force, slack)


def test_after_a_trip_nothing_counts_as_passed(make, changes):
    def tripped(log):
        changes.trip(log)
        log.force[350, 2] = -25.0

    run = read_run(make(change=tripped), "run")
    mask, _ = activity(run, "force")
    assert not (mask & 8).any()
    assert run.error("z").size == run.counted == 301


def test_a_log_without_some_columns_has_fewer_figures(make):
    import pyarrow.parquet as pq  # noqa: PLC0415

    folder = make()
    log = pq.read_table(folder / "log.parquet")
    kept = [n for n in log.column_names if not n.startswith(("torque", "slack", "touch", "cycle"))]
    pq.write_table(log.select(kept), folder / "log.parquet")
    figures, _, _ = drawn(read_run(folder, "run"))
    assert "torque" not in figures
    assert "activity" not in figures
    assert {"force", "status"} <= set(figures)


def test_the_histogram_is_of_the_error(make):
    run = read_run(make(), "run")
    columns = Columns()
    figure = error_histogram([run], columns)
    assert [panel.title[0] for panel in figure.panels] == ["x", "y", "z"]
    (line,) = figure.panels[2].lines
    x, y = columns.kept[line.x], columns.kept[line.y]
    error = run.error("z")
    for low, high, share in zip(x[1:-1], x[2:], y[1:-1], strict=True):
        inside = (error >= low) & (error < high)
        assert share == pytest.approx(max(100 * inside.mean(), 50 / 400))
    assert x[0] < error.min()
    assert x[-1] > error.max()


def test_the_spectrum_shows_motion_and_residual(make):
    run = read_run(make(cycles=4000), "run")
    columns = Columns()
    figure = error_spectrum([run], columns)
    named = {line.name: line for line in figure.panels[2].lines}
    motion, residual = named["motion, tool held still"], named["residual, controlled"]
    f = columns.kept[motion.x]
    strongest = f[columns.kept[motion.y].argmax()]
    assert strongest == pytest.approx(40 / (2 * np.pi), rel=0.05)
    ratio = columns.kept[motion.y].max() / columns.kept[residual.y].max()
    assert ratio == pytest.approx(400, rel=0.05)  # 4 N against 0.01 N
    assert "52 dB smaller" in figure.caption[2]


def test_percentiles_end_at_the_slowest():
    columns = Columns()
    times = np.arange(1.0, 1001.0)
    figure = times_figure("id", "t", {"step": {"a": times, "none": []}}, columns, 990.0)
    (panel,) = figure.panels
    (line,) = panel.lines
    assert panel.limit == 990.0
    assert columns.kept[line.y][-1] == 1000.0
    assert columns.kept[line.x][-1] == 2000.0
    assert "slowest 1000 µs, beyond 990 µs: 1.00 %" in figure.caption[0]


def test_many_runs_look_different():
    styles = [series(i) for i in range(COLOURS * len(DASHES))]
    assert len({(style.colour, style.dash) for style in styles}) == len(styles)
    assert len({style.colour for style in styles[:COLOURS]}) == COLOURS
    assert len({style.dash for style in styles[:COLOURS]}) == COLOURS


@pytest.mark.parametrize("rows", [0, 1, 2, 20])
def test_a_run_of_few_cycles_is_drawn_as_far_as_it_went(rows, make, recwarn):
    folder = make(rows=rows, stopped="interrupted")
    run = read_run(folder, "run")
    figures, _columns, _ = drawn(run)
    assert ("force" in figures) == (rows > 0)
    error_histogram([run], Columns())
    error_spectrum([run], Columns())
    assert [str(warning.message) for warning in recwarn] == []
