"""The paper's Figs. 6 and 7, and a comparison: drawn for any log, complete or not."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

from bench.compare import Comparison
from bench.figures import draw_comparison, draw_forces
from scenarios import Experiment, Log, Schedule, load_scenario


def log(axes=("x", "y", "z"), rows=200, held=200) -> Log:
    made = Log(200, axes, ())
    t = np.arange(200) * 1e-3
    made.time[:] = t
    made.setpoint[:] = [{"x": 1.0, "y": 2.0, "z": -10.0}[axis] for axis in axes]
    made.force[:] = np.array([1.0, 2.0, -10.0]) + 0.01 * np.sin(40 * t)[:, None]
    made.force_uncompensated[:held] = (
        np.array([1.0, 2.0, -10.0]) + np.outer(np.sin(40 * t), [1, 2, 4])
    )[:held]
    made.cycles = rows
    return made


@pytest.fixture
def saved(monkeypatch, tmp_path):
    """Draw something; return the figure, after a look at its pixels where asked for."""
    figures = []
    monkeypatch.setattr(Figure, "savefig", lambda figure, path: figures.append(figure))

    def draw(how, what, *, look=False) -> Figure:
        path = tmp_path / "picture.png"
        how(what, path)
        figure = figures[-1]
        if look:  # it costs a second
            monkeypatch.undo()
            figure.savefig(path)
            picture = matplotlib.image.imread(path)
            assert min(picture.shape[:2]) > 300
            assert np.ptp(picture) > 0.5  # not blank
        return figure

    return draw


@pytest.fixture
def drawn(saved):
    return lambda made: saved(draw_forces, made, look=made.cycles < 200)


@pytest.mark.parametrize("axes", [("x", "y", "z"), ("z", "x")])
def test_each_axis_has_its_column(axes, drawn):
    made = log(axes)
    panels = np.array(drawn(made).axes).reshape(3, len(axes))
    for j, axis in enumerate(axes):
        i = "xyz".index(axis)
        assert panels[0, j].get_title().startswith(f"{axis}, held still: error RMS")
        assert panels[1, j].get_title().startswith(f"{axis}, controlled: error RMS")
        held, controlled, error = (panel.lines[0].get_ydata() for panel in panels[:, j])
        assert np.array_equal(held, made.force_uncompensated[:, i])
        assert np.array_equal(controlled, made.force[:, i])
        np.testing.assert_allclose(error, made.force[:, i] - made.setpoint[:, j])
        assert panels[0, j].get_ylim() == panels[1, j].get_ylim()  # to be compared by eye
        assert panels[2, j].get_xlabel() == "time [s]"


@pytest.mark.parametrize(("rows", "held"), [(0, 0), (120, 0), (200, 80)])
def test_an_interrupted_run_is_drawn_as_far_as_it_went(rows, held, drawn):
    panels = np.array(drawn(log(rows=rows, held=held)).axes).reshape(3, 3)
    assert panels[1, 0].lines[0].get_ydata().size == rows
    assert "interrupted" in panels[0, 0].get_title()
    assert ("RMS" in panels[1, 0].get_title()) == (rows > 0)


# --- comparison ----------------------------------------------------------------------------------

CAPS = (
    "controller.bounds.force={z=[-12.0, inf]}",
    "controller.bounds.velocity=[-0.1, 0.1]",
    "bounds_steps=[{time=0.1, force={z=[-9.0, inf]}}]",
)


def comparison(*runs, settings=CAPS, axes=("x", "y", "z"), rows=200) -> Comparison:
    """Runs (backend, change of its log, cycles) of 200 ms beside one another."""
    scenario = load_scenario(
        "paper-1d", top={"duration": 0.2}, settings=[f"axes={list(axes)}", *settings]
    )
    made = Comparison(scenario, bounded=True)
    for name, change, cycles in runs:
        here = log(axes, rows=cycles)
        change(here)
        own = replace(scenario, backend=name)
        made.experiments.append(Experiment(own, here, Schedule(own), None, {}))
    return made


def nothing(_):
    pass


def too_hard(here):
    here.force[150, 2] = -14.0


def too_fast(here):
    here.tool_velocity[60, 1] = -0.3


def panels(figure) -> list:
    return [axes for axes in figure.axes if axes.get_xlabel() == "time [s]"]


def labelled(panel) -> dict:
    return {line.get_label(): line for line in panel.lines if line.get_label()[0] != "_"}


def test_the_worst_axis_and_instant_are_shown(saved):
    made = comparison(("analytic", too_hard, 200), ("daqp", too_fast, 200))
    force, near_force, velocity, near_velocity = panels(saved(draw_comparison, made))
    assert force.get_title().startswith("force on z")
    assert near_force.get_title() == "around t = 0.15 s"
    assert velocity.get_title().startswith("velocity on y")
    assert near_velocity.get_title() == "around t = 0.06 s"
    assert (force.get_ylabel(), velocity.get_ylabel()) == (
        "contact force [N]", "tool velocity [m/s]",
    )  # fmt: skip
    for panel, column, j in ((force, "force", 2), (velocity, "tool_velocity", 1)):
        lines = labelled(panel)
        assert list(lines) == ["analytic", "daqp"]
        for experiment, line in zip(made.experiments, lines.values(), strict=True):
            assert np.array_equal(line.get_ydata(), getattr(experiment.log, column)[:, j])
            assert np.array_equal(line.get_xdata(), experiment.log.time)
    low, high = near_force.get_xlim()
    assert low < 0.15 < high
    assert near_force.get_ylim()[0] < -14.0


def test_bounds_are_drawn_as_they_change_and_not_where_there_are_none(saved):
    force = panels(saved(draw_comparison, comparison(("daqp", too_hard, 200))))[0]
    lower, upper = (line.get_ydata() for line in force.lines if line.get_linestyle() == "--")
    assert lower.tolist() == [-12.0] * 100 + [-9.0] * 100
    assert (upper == np.inf).all() or np.isnan(upper).all()


@pytest.mark.parametrize(
    ("runs", "settings", "axes"),
    [
        ([("daqp", nothing, 200)], CAPS, ("x", "y", "z")),
        ([("daqp", too_hard, 200), ("osqp", nothing, 200)], CAPS, ("z",)),
        ([("daqp", nothing, 200)], (), ("z", "x")),
        ([("daqp", nothing, 200)], ("controller.bounds.velocity=[-inf, inf]",
                                    "controller.bounds.force=[-inf, inf]"), ("x", "y", "z")),
        ([("daqp", nothing, 1), ("osqp", too_fast, 200)], CAPS, ("x", "y", "z")),
        ([("daqp", too_fast, 200), ("osqp", nothing, 3), ("piqp", nothing, 0)], CAPS, ("z", "y")),
        ([(f"solver {i}", nothing, 200) for i in range(14)], CAPS, ("x", "y", "z")),
    ],
    ids=["one", "one axis", "two axes", "no bounds", "one cycle", "stopped", "many"],
)  # fmt: skip
def test_any_comparison_is_readable(runs, settings, axes, saved, recwarn):
    made = comparison(*runs, settings=settings, axes=axes)
    shown = panels(saved(draw_comparison, made, look=len(runs) == 1))
    assert len(shown) == 4
    names = [name for name, _, cycles in runs if cycles]
    for panel in shown:
        lines = labelled(panel)
        assert list(lines) == names
        assert len({(line.get_color(), line.get_linestyle()) for line in lines.values()}) == len(
            names
        )
        assert np.isfinite([*panel.get_xlim(), *panel.get_ylim()]).all()
        assert np.ptp(panel.get_ylim()) > 0
    legend = shown[0].get_legend()
    assert [text.get_text() for text in legend.get_texts()] == names
    assert [str(warning.message) for warning in recwarn] == []


@pytest.mark.parametrize("runs", [[], [("daqp", nothing, 0)]])
def test_a_comparison_without_a_cycle_is_an_empty_picture(runs, saved, recwarn):
    saved(draw_comparison, comparison(*runs), look=True)
    assert [str(warning.message) for warning in recwarn] == []


def test_a_backend_that_refused_has_no_line(saved):
    made = comparison(("daqp", nothing, 200))
    made.experiments.insert(0, None)
    assert list(labelled(panels(saved(draw_comparison, made))[0])) == ["daqp"]
