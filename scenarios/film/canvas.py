"""Drawing with smooth edges: twice as large as it is shown, then reduced."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import matplotlib as mpl
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from scenarios.scene.meshes import Array

Colour = tuple[int, int, int] | tuple[int, int, int, int]
_FINER = 2
_LEAST_TEXT = 7.0
_FONTS = Path(mpl.get_data_path()) / "fonts" / "ttf"

PANEL: Colour = (17, 21, 27)
INK: Colour = (226, 232, 240)
FAINT: Colour = (134, 146, 160)
RULE: Colour = (44, 52, 62)
# Told apart by everyone, and by lightness too.
FORCE: Colour = (86, 180, 233)
SETPOINT: Colour = (240, 200, 70)
HELD: Colour = (176, 88, 40)
ALARM: Colour = (213, 62, 48)
QUIET: Colour = (70, 82, 96)
INTERFACE = (PANEL, INK, FAINT, RULE, FORCE, SETPOINT, HELD, ALARM, QUIET)
"""All colours that pictures have in common."""


class Canvas:
    """A layer to draw on; places and lengths are in pixels of the finished picture."""

    def __init__(self, width: int, height: int, ground: Colour = (0, 0, 0, 0)) -> None:
        self.width, self.height = width, height
        self._image = Image.new("RGBA", (_FINER * width, _FINER * height), (*ground, 255)[:4])
        self._draw = ImageDraw.Draw(self._image)

    def line(self, points: Array, colour: Colour, width: float) -> None:
        """Draw a line through points, ``(n, 2)``."""
        if len(points) > 1:
            self._draw.line(
                _flat(points), fill=colour, width=max(1, round(_FINER * width)), joint="curve"
            )

    def dashes(self, points: Array, colour: Colour, width: float, dash: float) -> None:
        """Draw a dashed line through points, ``(n, 2)``, that go to the right."""
        along = np.arange(points[0, 0], points[-1, 0], dash)
        heights = np.interp(along, points[:, 0], points[:, 1])
        steps = np.column_stack([along, heights])
        for i in range(0, len(steps) - 1, 2):
            self.line(steps[i : i + 2], colour, width)

    def polygon(self, points: Array, colour: Colour) -> None:
        """Fill a polygon with corners ``(n, 2)``."""
        self._draw.polygon(_flat(points), fill=colour)

    def rim(self, points: Array, colour: Colour, width: float) -> None:
        """Draw the edge of a polygon with corners ``(n, 2)``."""
        self.line(np.concatenate([points, points[:2]]), colour, width)

    def disc(self, centre: Array, radius: float, colour: Colour) -> None:
        """Fill a circle."""
        self._draw.circle(
            (_FINER * float(centre[0]), _FINER * float(centre[1])), _FINER * radius, fill=colour
        )

    def pill(self, left: float, top: float, text: str, size: float, colour: Colour) -> None:
        """Write on a rounded ground."""
        width = self.measure(text, size, bold=True)
        box = [left, top, left + width + 1.4 * size, top + 1.9 * size]
        self._draw.rounded_rectangle(
            [_FINER * v for v in box], radius=_FINER * 0.5 * size, fill=colour
        )
        self.text(left + 0.7 * size, top + 0.95 * size, text, size, INK, anchor="lm", bold=True)

    def text(
        self, x: float, y: float, text: str, size: float, colour: Colour, *,
        anchor: str = "la", bold: bool = False, room: float | None = None,
    ) -> None:  # fmt: skip
        """Write one line, cut where its room ends; anchors are Pillow's."""
        shown = plain(text)
        if room is not None:
            whole = shown
            while shown and self.measure(shown, size, bold=bold) > room:
                whole = whole[:-1]
                shown = whole + "…" if whole else ""
        self._draw.text(
            (_FINER * x, _FINER * y), shown, font=_font(_size(size), bold), fill=colour,
            anchor=anchor,
        )  # fmt: skip

    def measure(self, text: str, size: float, *, bold: bool = False) -> float:
        """Return the width of a line."""
        return _font(_size(size), bold).getlength(plain(text)) / _FINER

    def finished(self) -> Image.Image:
        """Return what was drawn, in its final size; RGBA."""
        return self._image.convert("RGBa").reduce(_FINER).convert("RGBA")


def mixed(colour: Colour, ground: Colour, share: float) -> Colour:
    """Return what a colour looks like that covers a share of its ground."""
    r, g, b = (
        round(share * c + (1.0 - share) * d) for c, d in zip(colour[:3], ground[:3], strict=True)
    )
    return r, g, b


def plain(text: str) -> str:
    """Return a text as one line of what can be shown, however it came."""
    return "".join(letter if letter.isprintable() else " " for letter in text[:200])


def arrow(start: Array, end: Array, width: float) -> Array:
    """Corners of an arrow between two points ``(2,)``, ``(7, 2)``.

    The head is as long as the arrow where that is short, so that the tip is always at the end.
    """
    along = end - start
    length = float(np.hypot(*along))
    if length < 1e-9:
        return np.tile(end, (7, 1))
    direction = along / length
    across = np.array([-direction[1], direction[0]])
    head = min(3.4 * width, length)
    neck = end - head * direction
    half, wing = 0.5 * width * across, 1.55 * width * min(1.0, length / (3.4 * width)) * across
    return np.array(
        [start + half, neck + half, neck + wing, end, neck - wing, neck - half, start - half]
    )


def _flat(points: Array) -> Sequence[float]:
    flat: list[float] = (_FINER * np.asarray(points, dtype=np.float64)).ravel().tolist()
    return flat


def _size(size: float) -> int:
    return round(_FINER * max(size, _LEAST_TEXT))


@cache
def _font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(str(_FONTS / name), size)
