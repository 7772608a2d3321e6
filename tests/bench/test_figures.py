"""The paper's Figs. 6 and 7: drawn for any log, complete or not."""

from __future__ import annotations

import matplotlib.image
import numpy as np
import pytest
from matplotlib.figure import Figure

from bench.figures import draw_forces
from scenarios import Log


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
def drawn(monkeypatch, tmp_path):
    """Draw a log; return the figure that was saved."""
    figures = []
    save = Figure.savefig
    monkeypatch.setattr(
        Figure, "savefig", lambda figure, path: (figures.append(figure), save(figure, path))[1]
    )

    def draw(made) -> Figure:
        path = tmp_path / "forces.png"
        draw_forces(made, path)
        picture = matplotlib.image.imread(path)
        assert min(picture.shape[:2]) > 300
        assert np.ptp(picture) > 0.5  # not blank
        return figures[-1]

    return draw


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
