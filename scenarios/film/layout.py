"""Where the parts of a picture lie."""

from dataclasses import dataclass

_WIDE = 1.25
"""Width by height from which the panel stands beside the view; below, it is under it."""


@dataclass(frozen=True)
class Box:
    """A rectangle of pixels."""

    left: int
    top: int
    width: int
    height: int

    @property
    def aspect(self) -> float:
        """Width by height."""
        return self.width / self.height


@dataclass(frozen=True)
class Layout:
    """The parts of a picture."""

    view: Box
    """Both arms."""
    close: Box
    """The contact."""
    plots: Box
    """The forces."""
    unit: float
    """One pixel of a picture of 1280x720, by which letters and lines are scaled."""


def lay_out(width: int, height: int) -> Layout:
    """Divide a picture of a size [pixels]."""
    unit = (width * height / (1280 * 720)) ** 0.5
    if width >= _WIDE * height:
        side = round(0.36 * width)
        upper = round(0.40 * height)
        return Layout(
            Box(0, 0, width - side, height),
            Box(width - side, 0, side, upper),
            Box(width - side, upper, side, height - upper),
            unit,
        )
    upper, side = round(0.52 * height), round(0.44 * width)
    return Layout(
        Box(0, 0, width, upper),
        Box(0, upper, side, height - upper),
        Box(side, upper, width - side, height - upper),
        unit,
    )
