"""What is drawn over the views: arrows of force, the tissue's way, letters."""

import numpy as np
from PIL import Image

from scenarios.film.canvas import ALARM, FAINT, FORCE, INK, QUIET, SETPOINT, Canvas, Colour, arrow
from scenarios.film.layout import Box
from scenarios.film.record import Record
from scenarios.scene.arrows import force_arrow
from scenarios.scene.camera import Camera, directions
from scenarios.scene.meshes import Array

_TRAIL, _AHEAD = 1.0, 1.0
"""How much of the tissue's way is drawn, behind and ahead [s]."""
_BESIDE = 0.052
"""How far to the right of the tissue its way is drawn, where nothing hides it [m]."""
_ENLARGED = 3.0
"""How much, as it is a few millimetres."""
_SCALES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)


def arrow_scale(record: Record, height: float) -> float:
    """Length by force [m/N] with which a usual force of the run takes a height [m]."""
    sizes = np.linalg.norm(record.force, axis=1)
    known = sizes[np.isfinite(sizes)]
    usual = float(np.percentile(known, 90)) if known.size else 0.0
    return height / max(usual, 1.0)


class Overlay:
    """Draws over one view."""

    def __init__(self, record: Record, camera: Camera, box: Box, unit: float, scale: float) -> None:
        """Prepare.

        Args:
            record: of the run.
            camera: of the view.
            box: of the view; its size counts.
            unit: see `scenarios.film.layout.Layout`.
            scale: of the arrows [m/N].
        """
        self._record, self._camera, self._box = record, camera, box
        self._unit, self._scale = unit, scale
        self._middle = np.median(record.tissue, axis=0)

    def main(self, time: float, tip: Array, speed: float) -> Image.Image:
        """Over the view of both arms: arrows, name, time, what happened, what arrows mean."""
        u, record = self._unit, self._record
        canvas = Canvas(self._box.width, self._box.height)
        self._arrows(canvas, time, tip, 6.0 * u)
        edge = 24.0 * u
        canvas.text(
            edge, edge, record.name, 21.0 * u, INK, bold=True, room=self._box.width - 2 * edge
        )
        clock = f"{time:.2f} s"
        canvas.text(edge, edge + 32.0 * u, clock, 15.0 * u, INK)
        if speed != 1.0:
            x = edge + canvas.measure(clock, 15.0 * u) + 14.0 * u
            canvas.text(x, edge + 32.0 * u, f"speed {speed:g}", 15.0 * u, FAINT)
        y = edge + 62.0 * u
        if record.trip is not None and time >= record.trip[1]:
            cause, when = record.trip
            canvas.pill(edge, y, f"tripped on {cause} at {when:.3f} s", 13.0 * u, ALARM)
        elif not record.touching[record.cycle(time)]:
            canvas.pill(edge, y, "no contact", 13.0 * u, QUIET)
        self._legend(canvas, tip)
        return canvas.finished()

    def close(self, time: float, tip: Array) -> Image.Image:
        """Over the view of the contact: the tissue's way, arrows, a scale."""
        u = self._unit
        canvas = Canvas(self._box.width, self._box.height)
        self._way(canvas, time)
        self._arrows(canvas, time, tip, 6.5 * u)
        y = self._box.height - 18.0 * u
        length = self._pixels(tip, 0.01)
        x = self._box.width - 20.0 * u
        _bar(canvas, (x - length, x), y, u, "10 mm")
        x, y = 16.0 * u, 20.0 * u
        canvas.line(np.array([[x, y], [x + 18.0 * u, y]]), (255, 255, 255), 2.0 * u)
        canvas.text(
            x + 24.0 * u,
            y,
            f"tissue's motion, {_ENLARGED:g}:1",
            11.5 * u,
            INK,
            anchor="lm",
        )
        return canvas.finished()

    def _arrows(self, canvas: Canvas, time: float, tip: Array, width: float) -> None:
        k = self._record.cycle(time)
        force, wish = self._record.force[k], self._record.setpoint[k]
        wish = np.where(np.isfinite(wish), wish, force)
        tripped = self._record.trip is not None and time >= self._record.trip[1]
        for value, colour in ((wish, SETPOINT), (force, FORCE))[tripped:]:
            found = force_arrow(tip, value, self._scale)
            if found is None:
                continue
            start, end = self._project(np.stack([found.start, found.end]))
            corners = arrow(start, end, width)
            if colour == SETPOINT:  # a rim around the force where the two are the same
                canvas.rim(corners, colour, 0.65 * width)
            else:
                canvas.polygon(corners, colour)

    def _way(self, canvas: Canvas, time: float) -> None:
        record = self._record
        now = record.cycle(time)
        rows = np.arange(record.cycle(time - _TRAIL), record.cycle(time + _AHEAD) + 1)
        rows = rows[(rows - now) % max(1, len(rows) // 240) == 0]
        centre = self._middle + _BESIDE * directions(self._camera.view)[0]
        places = self._project(centre + _ENLARGED * (record.tissue[rows] - self._middle))
        ages = (record.time[rows] - record.time[now]) / _TRAIL
        for i in range(len(rows) - 1):
            share = 1.0 + ages[i] if ages[i] <= 0 else 0.28 * (1.0 - ages[i])
            colour: Colour = (255, 255, 255, round(225 * max(0.0, min(1.0, share))))
            canvas.line(places[i : i + 2], colour, 1.8 * self._unit)
        canvas.disc(places[np.searchsorted(rows, now)], 3.2 * self._unit, (255, 255, 255))

    def _legend(self, canvas: Canvas, tip: Array) -> None:
        u = self._unit
        x, y = 24.0 * u, self._box.height - 26.0 * u
        for name, colour in (("force on the tissue", FORCE), ("setpoint", SETPOINT)):
            mark = arrow(np.array([x, y]), np.array([x + 24.0 * u, y]), 4.5 * u)
            if colour == SETPOINT:
                canvas.rim(mark, colour, 2.0 * u)
            else:
                canvas.polygon(mark, colour)
            canvas.text(x + 32.0 * u, y, name, 12.5 * u, INK, anchor="lm")
            x += 32.0 * u + canvas.measure(name, 12.5 * u) + 24.0 * u
        room = 0.16 * self._box.width
        one = self._pixels(tip, self._scale)
        newtons = max((s for s in _SCALES if s * one <= room), default=_SCALES[0])
        _bar(canvas, (x, x + newtons * one), y, u, f"{newtons:g} N")

    def _pixels(self, at: Array, length: float) -> float:
        """How long a length [m] across the view is at a place [pixels]."""
        depth = float((at - self._camera.position) @ self._camera.forward)
        opening = 2.0 * float(np.tan(np.deg2rad(self._camera.opening) / 2.0))
        return length * self._box.height / (opening * depth)

    def _project(self, points: Array) -> Array:
        return self._camera.project(points, self._box.width, self._box.height)


def _bar(canvas: Canvas, span: tuple[float, float], y: float, u: float, name: str) -> None:
    """A scale: a bar with ends, its length above."""
    left, right = span
    canvas.line(np.array([[left, y], [right, y]]), INK, 1.6 * u)
    for x in (left, right):
        canvas.line(np.array([[x, y - 4.0 * u], [x, y + 4.0 * u]]), INK, 1.6 * u)
    canvas.text((left + right) / 2.0, y - 6.0 * u, name, 11.5 * u, INK, anchor="mb")
