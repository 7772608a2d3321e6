"""Plots of a run, each drawn into an Axes that the caller brings."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import AxesImage

from scenarios.log import Array, Log
from scenarios.motion.config import Axis

# Okabe and Ito's palette: told apart by everyone.
HELD, CONTROLLED, SETPOINT = "#D55E00", "#0072B2", "#222222"


def force(ax: Axes, log: Log, axis: Axis, *, held: bool = False) -> None:
    """Draw the true contact force on an axis, and what it should be.

    Args:
        ax: drawn into.
        log: of the run.
        axis: one that is under control.
        held: the run with the brakes closed, instead of the controlled one.
    """
    j, time = log.axes.index(axis), log.time[: log.cycles]
    colour, what = (HELD, "held still") if held else (CONTROLLED, "controlled")
    values = _force(log, axis, held=held)
    setpoint = log.setpoint[: log.cycles, j]
    ax.plot(time, values, color=colour, linewidth=0.8, label=what)
    ax.plot(time, setpoint, color=SETPOINT, linewidth=0.8, linestyle="--", label="setpoint")
    error = values - log.setpoint[0, j] if held else force_error(log, axis)
    ax.set_title(f"{axis}, {what}: error {_figures(error)}", fontsize=9)
    if not held:
        _mark_trip(ax, log)


def error(ax: Axes, log: Log, axis: Axis) -> None:
    """Draw the error of the controlled force on an axis [N]."""
    j, time = log.axes.index(axis), log.time[: log.cycles]
    values = _force(log, axis, held=False) - log.setpoint[: log.cycles, j]
    ax.plot(time, values, color=CONTROLLED, linewidth=0.6)
    ax.set_title(f"{axis}, error of the controlled force, enlarged", fontsize=9)
    _mark_trip(ax, log)


def spectrum(ax: Axes, log: Log, axis: Axis, *, held: bool = False) -> None:
    """Draw the amplitude spectrum of the force error on an axis, as the paper's Fig. 5 does.

    A Hann window, and its gain taken out: a sine of 1 N is a peak of 1 N.

    Args:
        ax: drawn into, both scales logarithmic.
        log: of the run, one second at least.
        axis: one that is under control.
        held: the run with the brakes closed, instead of the controlled one.
    """
    values = force_error(log, axis, held=held)
    values = values - values.mean()
    window = np.hanning(values.size)
    amplitude = 2.0 * np.abs(np.fft.rfft(window * values)) / window.sum()
    period = float(log.time[1] - log.time[0])
    colour, what = (HELD, "held still") if held else (CONTROLLED, "controlled")
    frequency = np.fft.rfftfreq(values.size, period)
    ax.loglog(frequency[1:], amplitude[1:], color=colour, linewidth=0.8, label=what)
    ax.set_xlabel("frequency [Hz]")
    ax.set_ylabel("amplitude of the error [N]")


def matrix(ax: Axes, values: Array, title: str) -> AxesImage:
    """Draw a matrix, zero in white, for instance one of Psi, Upsilon, Theta.

    Returns:
        the image, for a colour bar.
    """
    most = float(np.abs(values).max()) or 1.0
    image = ax.imshow(values, cmap="RdBu_r", vmin=-most, vmax=most, aspect="auto")
    ax.set_title(f"{title}  ({values.shape[0]} x {values.shape[1]})", fontsize=9)
    return image


def force_error(log: Log, axis: Axis, *, held: bool = False) -> Array:
    """Return the error of the true force in the cycles that count, ``(cycles,)`` [N].

    Held still, it is from the setpoint at the start, with which the tool was put into its place.
    """
    wanted = log.setpoint[:, log.axes.index(axis)]
    values = _force(log, axis, held=held)[: log.counted]
    return values - (wanted[0] if held else wanted[: values.size])


def _force(log: Log, axis: Axis, *, held: bool) -> Array:
    i = "xyz".index(axis)
    values: Array = (log.force_uncompensated if held else log.force)[: log.cycles, i]
    return values


def _mark_trip(ax: Axes, log: Log) -> None:
    if log.trip is not None:
        ax.axvline(log.trip.time, color=SETPOINT, linestyle=":", linewidth=1.0)
        ax.set_title(f"{ax.get_title()}, tripped: {log.trip.cause}", fontsize=9)


def _figures(error: Array) -> str:
    if not error.size or np.isnan(error).any():
        return "not known, the run was interrupted"
    return f"RMS {np.sqrt(np.mean(error**2)):.3f} N, max {np.abs(error).max():.2f} N"
