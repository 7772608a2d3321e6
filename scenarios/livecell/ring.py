"""What a running experiment shows of itself: a ring of rows in memory that others may look at."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ROWS = 8192
"""Rows that are kept, one a cycle."""
_NAMES: Sequence[tuple[str, int]] = (
    ("time", 1),
    ("setpoint", 3),
    ("force", 3),
    ("measured", 3),
    ("command", 3),
    ("cycle_time", 1),
    ("solve_time", 1),
    ("late", 1),
    ("status", 1),
    ("source", 1),
    ("contact", 1),
    ("share", 1),
)
"""Columns: s, N, N, N, m/s^2, s, s, s; codes of the log; share of a controller that comes."""
_HEAD = (
    "count", "time", "speed", "lost", "paused", "recording", "tripped", "touching", "joints",
)  # fmt: skip
_JOINTS = 32


def _columns() -> dict[str, slice]:
    found, start = {}, 0
    for name, width in _NAMES:
        found[name] = slice(start, start + width)
        start += width
    return found


COLUMNS = _columns()
WIDTH = sum(width for _, width in _NAMES)
HEAD = {name: i for i, name in enumerate(_HEAD)}
SIZE = len(HEAD) + _JOINTS + ROWS * WIDTH
"""Doubles that a ring takes."""


@dataclass(frozen=True, eq=False)
class Ring:
    """Views into the memory; one writes, any number read."""

    head: Array
    """See ``HEAD``."""
    joint_angle: Array
    """Of all joints, Robot_Heart's first [rad]; as many count as ``joints`` says."""
    rows: Array
    """``(ROWS, WIDTH)``, see ``COLUMNS``; NaN on axes that are not controlled."""

    @classmethod
    def over(cls, memory: Any) -> "Ring":
        """Lay a ring over memory of `SIZE` doubles."""
        whole = np.frombuffer(memory, dtype=np.float64, count=SIZE)
        a, b = len(HEAD), len(HEAD) + _JOINTS
        return cls(whole[:a], whole[a:b], whole[b:].reshape(ROWS, WIDTH))

    def tell(self, **values: float) -> None:
        """Write figures of the head."""
        for name, value in values.items():
            self.head[HEAD[name]] = value

    def told(self, name: str) -> float:
        """Return a figure of the head."""
        return float(self.head[HEAD[name]])

    def next_row(self) -> Array:
        """Return the row to be written, which `seal` then shows."""
        row: Array = self.rows[int(self.head[0]) % ROWS]
        return row

    def seal(self) -> None:
        """Count the row that was written."""
        self.head[0] += 1

    def last(self, rows: int) -> Array:
        """Return a copy of the last rows, ``(n, WIDTH)``, n at most ``rows`` and half the ring."""
        count = int(self.head[0])
        n = min(rows, count, ROWS // 2)
        return np.asarray(self.rows[np.arange(count - n, count) % ROWS])
