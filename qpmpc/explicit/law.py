"""The explicit law: stored regions, and the one in which the present vectors lie."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar, Protocol

from qpmpc.arrays import Array
from qpmpc.explicit.regions import Family, Link, Region, Sides, back, change, region

EXACT = 1e-10
"""How far, beside the size of gradient and multipliers, vectors may lie outside their region."""


@dataclass(slots=True)
class Tally:
    """How searches ended."""

    same: int = 0
    """In the region of the search before."""
    walked: int = 0
    """In another one."""
    missed: int = 0
    """In none that is stored."""
    tried: int = 0
    """Regions tried in all."""
    longest: int = 0
    """Regions tried in one search at most."""

    def note(self, tried: int, *, found: bool) -> None:
        """Count one search."""
        self.same += found and tried == 1
        self.walked += found and tried > 1
        self.missed += not found
        self.tried += tried
        self.longest = max(self.longest, tried)


class Walk(Protocol):
    """A search over the regions of a law, in one language or another."""

    language: ClassVar[str]
    """What it is written in."""
    steps: int
    """Regions that a search tries at most."""
    x: Array
    """Minimiser where a region was found, ``(n,)``."""
    y: Array
    """Multipliers there, ``(m,)``."""

    def __init__(self, family: Family, most: int | None = None) -> None:
        """Prepare for the regions of ``family``; a search tries ``most`` of them at most."""
        ...

    def clear(self) -> None:
        """Forget all regions, and take the family's rows as they are now."""
        ...

    def add(self, new: Region) -> None:
        """Take one more region."""
        ...

    def link(self, link: Link) -> None:
        """Take what lies behind a change of one row."""
        ...

    @property
    def tally(self) -> Tally:
        """How searches ended so far."""
        ...

    @property
    def stuck(self) -> tuple[int, int] | None:
        """Region and slot behind which the last search knew of nothing; None if not for that."""
        ...

    def search(self, q: Array, l: Array, u: Array) -> int:  # noqa: E741
        """Return how many regions were tried, the last of which holds; negative if none does."""
        ...

    def stand(self, index: int) -> None:
        """Begin the next search in a region that holds the vectors of the last one."""
        ...

    def forget(self) -> None:
        """Begin the next search in the region without active rows."""
        ...


class Law:
    """Regions of one family, by their active rows; the first is the one that has none."""

    def __init__(self, family: Family, walk: Walk, most: int) -> None:
        """Begin with the region that has no active row; up to ``most`` can be learned."""
        self.family, self.walk, self._most = family, walk, most
        self.restart()

    def restart(self, regions: Iterable[Region] = (), links: Iterable[Link] = ()) -> None:
        """Hold other regions: after new rows, those of the old ones mean nothing.

        Args:
            regions: to begin with.
            links: what lies behind changes of rows that give no region by themselves; indices are
                those of ``regions``.
        """
        self.walk.clear()
        self._index: dict[bytes, int] = {}
        self._widest = 0
        self.nbytes = self.family.nbytes
        """Memory that the regions take, and what they share [bytes]."""
        free = region(self.family, bytes(self.family.m))
        assert free is not None  # an empty system of equations
        self._store(free)
        place: list[int] = []
        for each in regions:
            known = self._index.get(each.key)
            place.append(self._store(each) if known is None else known)
        keys = list(self._index)
        for at, slot, to in links:
            if change(keys[place[at]], slot) not in self._index:
                self.walk.link((place[at], slot, place[to]))
        self._full = len(self._index) + self._most

    def __len__(self) -> int:
        return len(self._index)

    @property
    def operations(self) -> int:
        """Multiplications of the longest search there can be, its answer included."""
        n, m, k = self.family.n, self.family.m, self._widest
        once = k * k + m * k + 2 * m  # pulls, what they take from the rows, the comparisons
        return n * m + 2 * self.walk.steps * once + n * n + n * k

    def learn(self, sides: Sides) -> None:
        """Begin the next search in the region that holds the vectors of the last one.

        It is stored if it is new and there is room.
        """
        index = self._index.get(sides.tobytes())
        if index is None and len(self._index) < self._full:
            new = region(self.family, sides.tobytes())
            if new is not None:
                index = self._store(new)
        if index is not None:
            if self.walk.stuck is not None:
                self.walk.link((*self.walk.stuck, index))
            self.walk.stand(index)

    def _store(self, new: Region) -> int:
        index = self._index[new.key] = len(self._index)
        self.walk.add(new)
        self._widest = max(self._widest, new.held.size)
        self.nbytes += new.nbytes + _LINK * 2 * self.family.m
        for slot in range(2 * self.family.m):
            key = change(new.key, slot)
            there = None if key is None else self._index.get(key)
            if there is not None:
                self.walk.link((index, slot, there))
                self.walk.link((there, back(new.key, slot), index))
        return index


_LINK = 4
"""Bytes of a link."""
