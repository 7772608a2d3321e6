"""The forces beside the view: a window of time that moves along with the run."""

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from scenarios.film.canvas import (
    FAINT,
    FORCE,
    HELD,
    INK,
    PANEL,
    RULE,
    SETPOINT,
    Canvas,
    Colour,
    mixed,
)
from scenarios.film.layout import Box
from scenarios.film.record import Record
from scenarios.scene.meshes import Array

_WINDOW = 6.0
"""Longest time that is shown at once [s]."""
_CURSOR = 0.72
"""Where in the window the present is, away from both ends of the run."""
_COMING = mixed(FORCE, PANEL, 0.45)
_DETAIL = 1.5
"""Points of a curve for each pixel across."""
MINUS = "\N{MINUS SIGN}"
_STEPS = (1.0, 2.0, 5.0)


class ForcePlots:
    """One plot for each axis under force control."""

    def __init__(self, record: Record, box: Box, unit: float, first: float, last: float) -> None:
        """Choose scales.

        Args:
            record: of the run.
            box: what may be drawn on; its size counts.
            unit: see `scenarios.film.layout.Layout`.
            first, last: of the film [s].
        """
        self._record, self._box, self._unit = record, box, unit
        self._window = min(_WINDOW, record.end - record.start)
        part = slice(record.cycle(first - self._window), record.cycle(last + self._window) + 1)
        self._ranges = {axis: _range(record, axis, part) for axis in record.axes}

    def draw(self, time: float) -> Image.Image:
        """Return the plots at an instant [s]."""
        u, box, record = self._unit, self._box, self._record
        canvas = Canvas(box.width, box.height, PANEL)
        left, right = 46.0 * u, box.width - 18.0 * u
        foot = 52.0 * u
        each = (box.height - foot) / len(record.axes)
        begin = float(np.clip(time - _CURSOR * self._window, record.start,
                              max(record.start, record.end - self._window)))  # fmt: skip
        for i, axis in enumerate(record.axes):
            top = i * each + 30.0 * u
            self._plot(canvas, axis, time, begin, (left, top, right, (i + 1) * each - 6.0 * u))
        self._feet(canvas, begin, left, right, box.height - foot)
        return canvas.finished()

    def _plot(
        self, canvas: Canvas, axis: int, time: float, begin: float,
        frame: tuple[float, float, float, float],
    ) -> None:  # fmt: skip
        u, record = self._unit, self._record
        left, top, right, bottom = frame
        low, high = self._ranges[axis]
        now = record.cycle(time)
        force, wish = record.force[now, axis], record.setpoint[now, axis]
        letters = 13.0 * u
        line = top - 16.0 * u
        canvas.text(left, line, f"force {'xyz'[axis]}", letters, INK, anchor="lm", bold=True)
        canvas.text(right, line, signed(force), letters, FORCE, anchor="rm", bold=True)
        canvas.text(
            right - 84.0 * u, line, f"error {signed(force - wish)}", letters, FAINT, anchor="rm"
        )
        for value in _ticks(low, high, 5):
            y = bottom - (value - low) / (high - low) * (bottom - top)
            canvas.line(np.array([[left, y], [right, y]]), RULE, 1.0 * u)
            canvas.text(
                left - 7.0 * u, y, f"{value:g}".replace("-", MINUS), 11.0 * u, FAINT, anchor="rm"
            )
        first, last = record.cycle(begin), record.cycle(begin + self._window)
        stride = max(1, int((last - first) / (_DETAIL * (right - left))))
        rows = np.arange(-(-first // stride) * stride, last + 1, stride)

        def points(values: Array, rows: NDArray[np.integer]) -> Array:
            x = left + (record.time[rows] - begin) / self._window * (right - left)
            y = bottom - (values[rows] - low) / (high - low) * (bottom - top)
            return np.column_stack([x, np.clip(y, top, bottom)])

        def curve(values: Array, colour: Colour, width: float) -> None:
            shown = rows[np.isfinite(values[rows])]
            canvas.line(points(values, shown), colour, width)

        curve(record.held[:, axis], HELD, 1.0 * u)
        canvas.line(points(record.force[:, axis], rows[rows >= now]), _COMING, 2.0 * u)
        canvas.line(points(record.force[:, axis], rows[rows <= now]), FORCE, 2.4 * u)
        canvas.dashes(points(record.setpoint[:, axis], rows), SETPOINT, 1.0 * u, 6.0 * u)
        x = left + (time - begin) / self._window * (right - left)
        canvas.line(np.array([[x, top], [x, bottom]]), FAINT, 1.0 * u)
        canvas.disc(points(record.force[:, axis], np.array([now]))[0], 4.0 * u, FORCE)

    def _feet(self, canvas: Canvas, begin: float, left: float, right: float, top: float) -> None:
        u = self._unit
        for second in _ticks(begin, begin + self._window, 6):
            x = left + (second - begin) / self._window * (right - left)
            x = min(x, right - 8.0 * u)
            canvas.text(x, top + 4.0 * u, f"{second:g} s", 11.0 * u, FAINT, anchor="ma")
        x, y = left, top + 36.0 * u
        named: list[tuple[str, Colour]] = [("force", FORCE), ("setpoint", SETPOINT)]
        if np.isfinite(self._record.held).any():
            named.append(("with the tool held still", HELD))
        for name, colour in named:
            mark = np.array([[x, y], [x + 18.0 * u, y]])
            if colour == SETPOINT:
                canvas.dashes(mark, colour, 2.5 * u, 4.0 * u)
            else:
                canvas.line(mark, colour, 2.5 * u)
            canvas.text(x + 24.0 * u, y, name, 11.5 * u, FAINT, anchor="lm")
            x += 24.0 * u + canvas.measure(name, 11.5 * u) + 22.0 * u


def signed(force: float) -> str:
    """Return a force [N] as it is read: always with its sign, so that letters do not jump."""
    return f"{force:+.2f} N".replace("-", MINUS)


def _range(record: Record, axis: int, part: slice) -> tuple[float, float]:
    """Least and largest force to be shown, a little room included."""
    values = [record.force[part, axis], record.setpoint[part, axis], record.held[part, axis]]
    shown = np.concatenate([v[np.isfinite(v)] for v in values])
    low, high = (float(shown.min()), float(shown.max())) if shown.size else (-1.0, 1.0)
    room = max(0.08 * (high - low), 0.1)
    return low - room, high + room


def _ticks(low: float, high: float, most: int) -> list[float]:
    """Round numbers inside an interval, no more than a number of them."""
    raw = (high - low) / most
    power = 10.0 ** np.floor(np.log10(raw))
    step = next((s * power for s in _STEPS if s * power >= raw), 10.0 * power)
    inside = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    return [float(round(value, 9)) + 0.0 for value in inside]
