"""Figures over everything but time: sizes of errors, and spectra."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.report.drawing import Figure, Line, Panel, Scale, Style, series
from bench.report.payload import Payload
from bench.report.reduce import histogram, smooth, spectrum
from bench.report.runs import Run
from bench.report.words import named, newton

Array = NDArray[np.float64]
_BINS = 120
_SLOW = 5.0
"""Below this frequency lies most of the motion of heart and breath [Hz]."""


def error_histogram(runs: Sequence[Run], payload: Payload) -> Figure:
    """Return how often the force error had which size: a panel an axis, a line a run."""
    names, panels, caption = [run.name for run in runs], [], []
    for axis in _axes(runs):
        found = [(i, run, e) for i, run in enumerate(runs) if (e := run.error(axis)) is not None]
        found = [(i, run, error) for i, run, error in found if error.size]
        if not found:
            continue
        edges = _edges([error for _, _, error in found])
        x = payload.add(np.concatenate([edges[:1], edges]))
        lines = []
        for i, run, error in found:
            # half a cycle stands for none, which a logarithmic scale has no place for
            least = 50.0 / error.size
            outline = np.full(edges.size + 1, least)
            outline[1:-1] = np.maximum(histogram(error, edges), least)
            lines.append(
                Line(run.name, payload.add(outline), series(i, 1.5), x=x, shape="hv", wave=False)
            )
            size = np.abs(error)
            half, most = np.percentile(size, (50, 99)).tolist()
            text = (
                f"{axis}: half of the cycles within {newton(half)} N, 99 % within "
                f"{newton(most)} N, all within {newton(size.max())} N."
            )
            caption.append(named(names, run.name, text))
        title = f"{axis}: share of the cycles [%]"
        panels.append(Panel(title, tuple(lines), height=140, log=True, unit="%"))
    title, scale = "Distribution of the force error", Scale("force error [N]", unit="N")
    return Figure("histogram", title, tuple(panels), tuple(caption), scale, shared=False)


def error_spectrum(runs: Sequence[Run], payload: Payload) -> Figure:
    """Return spectra of the force that the motion causes, and of the error that is left.

    The first is that on a tool held still, and has no line where it is not known.
    """
    names, panels, caption = [run.name for run in runs], [], []
    for axis in _axes(runs):
        lines: list[Line] = []
        for i, run in enumerate(runs):
            error, held = run.error(axis), run.held(axis)
            f, residual = spectrum(error if error is not None else np.zeros(0), run.period)
            if held is not None:
                at, moving = spectrum(held, run.period)
                motion = _spectrum_line("motion, tool held still", at, moving, payload)
                if motion.y not in {line.y for line in lines} and moving.size:
                    lines.append(motion)
                if f.size and moving.size == residual.size:
                    text = f"{axis}: {_suppression(f, moving, residual)}"
                    caption.append(named(names, run.name, text))
            if f.size:
                name = "residual, controlled" if len(runs) == 1 else run.name
                lines.append(_spectrum_line(name, f, residual, payload, series(i, 1.0)))
        title = f"{axis}: force, amplitude density [N/√Hz]"
        panels.append(Panel(title, tuple(lines), height=160, log=True, unit="N/√Hz"))
    title, scale = "Spectrum of motion and residual", Scale("frequency [Hz]", log=True, unit="Hz")
    some = tuple(panel for panel in panels if panel.lines)
    return Figure("spectrum", title, some, tuple(caption), scale)


def _axes(runs: Sequence[Run]) -> list[str]:
    return [axis for axis in "xyz" if any(axis in run.axes for run in runs)]


def _edges(errors: Sequence[Array]) -> Array:
    """Edges of bins from the least error of any run to the largest."""
    low, high = min(e.min() for e in errors), max(e.max() for e in errors)
    room = max(high - low, 1e-6) * 0.01
    return np.linspace(low - room, high + room, _BINS + 1)


def _spectrum_line(
    name: str, f: Array, density: Array, payload: Payload, style: Style | None = None
) -> Line:
    x, y = smooth(f, density)
    return Line(
        name, payload.add(y), style or Style("held", width=1.0), x=payload.add(x), wave=False
    )


def _suppression(f: Array, moving: Array, residual: Array) -> str:
    strongest = int(moving.argmax())
    slow = f <= _SLOW
    at = residual[strongest] / max(float(moving[strongest]), 1e-30)
    below = np.sqrt((residual[slow] ** 2).sum() / max((moving[slow] ** 2).sum(), 1e-30))
    return (
        f"the motion is strongest at {f[strongest]:.2f} Hz, where the residual is {_decibel(at)} "
        f"dB smaller; up to {_SLOW:g} Hz in all {_decibel(below)} dB."
    )


def _decibel(ratio: float) -> str:
    return f"{-20 * np.log10(max(ratio, 1e-12)):.0f}"
