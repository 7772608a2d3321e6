"""The walk from region to region in numpy: what is done where there is no compiler."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from qpmpc.arrays import Array
from qpmpc.explicit.law import EXACT, Tally
from qpmpc.explicit.regions import FAR, Family, Link, Region

_STEPS = 12
"""Regions that a search tries at most."""


class InterpretedWalk:
    """Goes straight from the last vectors to the new ones, through the regions in between.

    Along that line every inequality of a region is linear: the first that fails on the way names
    the row to change, and with it the region behind. This is a parametric active-set method whose
    matrices were inverted before (Ferreau, Bock, Diehl, Int. J. Robust Nonlinear Control 18, 2008).
    """

    language: ClassVar[str] = "numpy"

    def __init__(self, family: Family, most: int | None = None) -> None:
        """Prepare for the regions of ``family``; a search tries ``most`` of them at most."""
        self._family, self.steps = family, min(_STEPS, most or _STEPS)
        n, m = family.n, family.m
        self.x, self.y = np.zeros(n), np.zeros(m)
        # Begin and end of the way, side by side: rooms, and what is left of them.
        self._room, self._gap = np.ones((2 * m, 2)), np.empty((2 * m, 2))
        self._low = np.zeros((m, 1))
        self.tally = Tally()
        self.clear()

    def clear(self) -> None:
        """Forget all regions."""
        self._regions: list[Region] = []
        self._links: list[dict[int, int]] = []
        self.stuck: tuple[int, int] | None = None
        self.forget()

    def add(self, new: Region) -> None:
        """Take one more region."""
        self._regions.append(new)
        self._links.append({})

    def link(self, link: Link) -> None:
        """Take what lies behind a change of one row."""
        self._links[link[0]][link[1]] = link[2]

    def stand(self, index: int) -> None:
        """Begin the next search in a region that holds the vectors of the last one."""
        self._last, self._begun = index, True
        self._room[:, 0] = self._room[:, 1]

    def forget(self) -> None:
        """Begin the next search in the region without active rows."""
        self._last, self._begun = 0, False

    def search(self, q: Array, l: Array, u: Array) -> int:  # noqa: E741
        """Return how many regions were tried, the last of which holds; negative if none does."""
        found = self._walk(q, l, u)
        self.tally.note(abs(found), found=found > 0)
        return found

    def _walk(self, q: Array, l: Array, u: Array) -> int:  # noqa: E741
        family, room, m = self._family, self._room, self._family.m
        r = np.dot(family.rows, q)
        np.subtract(u, r, out=room[:m, 1])
        np.subtract(r, l, out=room[m:, 1])
        np.minimum(room[:, 1], FAR, out=room[:, 1])
        if not self._begun:  # anything with room on all sides lies in the first region
            room[:, 0] = np.minimum(np.abs(room[:, 1]) + 1.0, FAR)
        exact = EXACT * (1.0 + float(np.abs(q).max()))
        equal = l == u
        level = bool(np.count_nonzero(equal))
        if level:
            self._low[:, 0] = np.where(equal, -family.linear, 0.0)
        index, way, self.stuck = self._last, 0.0, None
        for tried in range(1, self.steps + 1):
            here = self._regions[index]
            under, over, pull = self._measure(here, level=level)
            ends = np.concatenate([self._gap, under, over])
            if ends[:, 1].min(initial=0.0) >= -exact:
                self._answer(here, q, pull[:, 1])
                self.stand(index)
                return tried
            way, slot = self._first(here, ends, way, exact)
            following = self._links[index].get(slot)
            if following is None:
                self.stuck = index, slot
                return -tried
            index = following
        return -self.steps

    def _measure(self, here: Region, *, level: bool) -> tuple[Array, Array, Array]:
        """Write what is left of each room in ``here`` and return what is left of each pull."""
        m, room, gap = self._family.m, self._room, self._gap
        pull = here.shift[:, None] - np.dot(here.inverse, room[here.pick])
        y = np.empty((m, 2))
        y[:] = here.base[:, None]
        y[here.held] = here.sign[:, None] * pull
        took = np.dot(self._family.gram, y)
        np.add(room[:m], took, out=gap[:m])
        np.subtract(room[m:], took, out=gap[m:])
        if here.turn is not None:
            gap *= here.turn[:, None]
        gap[here.own] = 0.0  # held there by construction
        low = here.low[:, None]
        if level:
            low = np.where(here.low[:, None] > 0, low, self._low[here.held])
        return pull - low, here.high[:, None] - pull, pull

    def _first(self, here: Region, ends: Array, way: float, exact: float) -> tuple[float, int]:
        """Return how far the way leads in ``here``, and the change of a row there."""
        failing = (~(ends[:, 1] >= -exact)).nonzero()[0]  # NaN fails
        begin, end = ends[failing, 0], ends[failing, 1]
        falling = begin > end
        reach = np.where(falling, begin, 0.0) / np.where(falling, begin - end, 1.0)
        np.maximum(reach, way, out=reach)
        first = int(np.argmin(reach))
        j, m, k = int(failing[first]), self._family.m, here.held.size
        if j < 2 * m:
            inside = here.key[j % m] == 0
            slot = 2 * (j % m) + (inside and j >= m)
        elif j < 2 * m + k:
            slot = 2 * int(here.held[j - 2 * m])
        else:
            slot = 2 * int(here.held[j - 2 * m - k]) + 1
        return float(reach[first]), slot

    def _answer(self, here: Region, q: Array, pull: Array) -> None:
        self.y[:] = here.base
        self.y[here.held] = here.sign * pull
        np.dot(self._family.minimiser, q, out=self.x)
        self.x -= np.dot(self._family.response, self.y)
