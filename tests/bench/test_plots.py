"""Plots for an Axes that the caller brings."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from bench import plots
from scenarios import Log

CYCLES, PERIOD = 4000, 1e-3


@pytest.fixture
def ax():
    return Figure().subplots()


@pytest.fixture
def log():
    made = Log(CYCLES, ("z", "x"), ())
    made.time[:] = PERIOD * np.arange(CYCLES)
    made.setpoint[:] = [-10.0, 1.0]
    made.force[:] = [1.0, 2.0, -10.0]
    made.force_uncompensated[:] = made.force
    made.cycles = CYCLES
    return made


def test_a_force_is_drawn_beside_its_setpoint(ax, log):
    plots.force(ax, log, "x")
    force, setpoint = (line.get_ydata() for line in ax.get_lines())
    np.testing.assert_array_equal(force, log.force[:, 0])
    np.testing.assert_array_equal(setpoint, log.setpoint[:, 1])
    assert "RMS 0.000" in ax.get_title()


def test_an_error_is_from_the_setpoint_of_its_cycle(ax, log):
    log.setpoint[2000:, 0] = -12.0
    plots.error(ax, log, "z")
    (line,) = ax.get_lines()
    np.testing.assert_array_equal(line.get_ydata(), np.repeat([0.0, 2.0], 2000))
    assert plots.force_error(log, "z", held=True) == pytest.approx(0.0)


@pytest.mark.parametrize("held", [False, True])
def test_a_sine_of_one_newton_is_a_peak_of_one_newton(ax, log, held):
    values = log.force_uncompensated if held else log.force
    values[:, 2] += np.sin(2 * np.pi * 5.0 * log.time) + 0.3
    plots.spectrum(ax, log, "z", held=held)
    (line,) = ax.get_lines()
    frequency, amplitude = line.get_data()
    assert frequency[amplitude.argmax()] == pytest.approx(5.0)
    assert amplitude.max() == pytest.approx(1.0, rel=1e-3)
    assert amplitude[frequency > 6].max() < 1e-3
    assert frequency[-1] == pytest.approx(500.0)


def test_the_spectrum_ends_where_a_run_stopped(ax, log):
    log.cycles = 2000
    plots.spectrum(ax, log, "x")
    assert ax.get_lines()[0].get_xdata().size == 1000


def test_zero_of_a_matrix_is_white(ax):
    image = plots.matrix(ax, np.array([[0.0, -2.0], [1.0, 0.0]]), "Theta")
    assert image.norm(0.0) == 0.5
    assert ax.get_title() == "Theta  (2 x 2)"
    assert plots.matrix(ax, np.zeros((2, 3)), "nothing").norm(0.0) == 0.5
