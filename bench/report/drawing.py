"""What a figure consists of; the page's script makes Plotly's traces of it."""

from dataclasses import dataclass, field
from typing import Literal

Level = Literal["good", "caution", "bad"]
"""How a state of a band is to be taken: as it should be, something stood in, something failed."""
DASHES = ("solid", "dash", "dot", "dashdot", "longdash", "longdashdot")
TITLE, GAP, TICKS, BOTTOM = 22, 12, 20, 44
"""Pixels above a panel with a title, below each, below one with an x of its own, below the last."""
COLOURS = 6
"""Colours of series in the style sheet, ``--series-0`` and on."""


@dataclass(frozen=True)
class Style:
    """How a line looks."""

    colour: str
    """Name of a colour of the style sheet, without ``--``."""
    dash: str = "solid"
    width: float = 1.2


@dataclass(frozen=True)
class Line:
    """A line. Its ordinates are a column of the payload; so are its abscissae, or they are even."""

    name: str
    y: int
    style: Style
    x: int | None = None
    start: float = 0.0
    step: float = 1.0
    shape: Literal["linear", "hv"] = "linear"
    wave: bool = True
    """Whether it is fine-grained: reduced to the extremes of what a pixel shows."""


@dataclass(frozen=True)
class State:
    """A state in a band: the bit of the mask that stands for it."""

    bit: int
    name: str
    level: Level
    colour: str


@dataclass(frozen=True)
class Band:
    """A row that shows in which state each cycle was; several where a pixel stands for many."""

    label: str
    mask: int
    """Column of bits."""
    start: float
    step: float
    states: tuple[State, ...]


@dataclass(frozen=True)
class Panel:
    """One coordinate system of a figure; panels stand on top of each other over the same x."""

    title: str
    lines: tuple[Line, ...] = ()
    bands: tuple[Band, ...] = ()
    height: int = 150
    """Pixels."""
    log: bool = False
    limit: float | None = None
    """A value that is not to be passed."""
    unit: str = ""


@dataclass(frozen=True)
class Scale:
    """The common x of a figure."""

    title: str
    log: bool = False
    ticks: dict[str, float] = field(default_factory=dict)
    """Labels and where they stand; chosen by Plotly if empty."""
    range: tuple[float, float] | None = None
    unit: str = ""


@dataclass(frozen=True)
class Figure:
    """A figure with its title and its words."""

    id: str
    title: str
    panels: tuple[Panel, ...]
    caption: tuple[str, ...]
    """Sentences with what there is to see, in numbers."""
    x: Scale
    time: bool = False
    """Whether x is the time of the run, common to all such figures."""
    shared: bool = True
    """Whether its panels have the same range of x."""

    @property
    def height(self) -> int:
        """Pixels of the whole drawing."""
        own = 0 if self.shared else TICKS * (len(self.panels) - 1)
        return own + BOTTOM + sum(p.height + GAP + TITLE * bool(p.title) for p in self.panels)


def series(index: int, width: float = 1.2) -> Style:
    """Return the style of the run, or curve, of this number."""
    dash = DASHES[(index + index // COLOURS) % len(DASHES)]
    return Style(f"series-{index % COLOURS}", dash, width)
