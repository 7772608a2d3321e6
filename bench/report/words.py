"""Numbers as they stand in sentences and tables."""

import math
from collections.abc import Sequence
from typing import Any

NOTHING = "\N{EN DASH}"
"""Of a figure that does not exist."""
UNITS = {
    "force": "N",
    "tangential": "N",
    "velocity": "m/s",
    "command": "m/s²",
    "rate": "m/s²",
    "joint_speed": "rad/s",
    "joint_torque": "N m",
}
"""Of the bounds."""


def newton(value: float) -> str:
    """Return a force to a millinewton, or to what is seen of a large one."""
    return f"{value:.3f}" if abs(value) < 9.9995 else f"{value:.2f}"


def figure_of(value: float) -> str:
    """Return a number to four digits."""
    return f"{value:.4g}"


def percent(share: float) -> str:
    """Return a share; what is more than nothing does not read as nothing."""
    value = 100.0 * share
    if value in {0.0, 100.0}:
        return f"{value:.0f} %"
    if value < 0.01:
        return "< 0.01 %"
    return "> 99.99 %" if value > 99.99 else f"{value:.2f} %"


def plural(count: int, what: str) -> str:
    """Return a count with its noun."""
    return f"{count:,} {what}" if count == 1 else f"{count:,} {what}s"


def named(names: Sequence[str], name: str, text: str) -> str:
    """Return a sentence about one of several, with its name where there are others."""
    return text if len(names) == 1 else f"{name}, {text}"


def cell(value: Any) -> str:
    """Return a value of a summary as it stands in a table."""
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}"
    if isinstance(value, float):
        return NOTHING if math.isnan(value) else figure_of(value)
    return str(value)
