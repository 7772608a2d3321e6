"""The walk from region to region in C, compiled once on the user's machine."""

from __future__ import annotations

import ctypes
from pathlib import Path
from typing import ClassVar

import numpy as np

from qpmpc.arrays import Array
from qpmpc.explicit.law import EXACT, Tally
from qpmpc.explicit.regions import FAR, Family, Link, Region
from qpmpc.native import compile_library

_SOURCE = Path(__file__).with_name("walk.c")
_STEPS = 32
"""Regions that a search tries at most."""
_int, _long, _double, _pointer = ctypes.c_int32, ctypes.c_int64, ctypes.c_double, ctypes.c_void_p


class _Region(ctypes.Structure):
    _fields_ = (
        ("k", _int), ("fixed", _int), ("side", _pointer), ("held", _pointer), ("pick", _pointer),
        ("sign", _pointer), ("low", _pointer), ("high", _pointer), ("shift", _pointer),
        ("inverse", _pointer), ("base", _pointer), ("link", _pointer),
    )  # fmt: skip


class _Law(ctypes.Structure):
    _fields_ = (
        ("n", _int), ("m", _int), ("steps", _int), ("last", _int), ("begun", _int),
        ("stuck_at", _int), ("stuck_slot", _int), ("unused", _int),
        ("same", _long), ("walked", _long), ("missed", _long), ("tried", _long), ("longest", _long),
        ("exact", _double), ("far", _double),
        ("minimiser", _pointer), ("rows", _pointer), ("response", _pointer), ("gram", _pointer),
        ("linear", _pointer), ("regions", _pointer),
        ("q", _pointer), ("l", _pointer), ("u", _pointer), ("x", _pointer), ("y", _pointer),
        ("begin", _pointer), ("end", _pointer), ("gap_begin", _pointer), ("gap_end", _pointer),
        ("pull_begin", _pointer), ("pull", _pointer),
    )  # fmt: skip


class CompiledWalk:
    """What `InterpretedWalk` does, at the price of one call."""

    language: ClassVar[str] = "C"

    def __init__(self, family: Family, most: int | None = None) -> None:
        """Compile, or load what was compiled before, and prepare for the regions of ``family``.

        A search tries ``most`` regions at most, if that is fewer than it would.

        Raises:
            CompilerUnavailableError, CompilationError, CacheError: see `compile_library`.
        """
        library = compile_library(_SOURCE.read_text(encoding="utf-8"), name="walk").handle
        self._search, self._stand = library.walk_search, library.walk_stand
        self._search.argtypes, self._search.restype = (_pointer,), _int
        self._stand.argtypes, self._stand.restype = (_pointer, _int), None
        self._family, self.steps = family, min(_STEPS, most or _STEPS)
        n, m = family.n, family.m
        self.x, self.y = np.zeros(n), np.zeros(m)
        self._q, self._l, self._u = np.zeros(n), np.zeros(m), np.zeros(m)
        self._work = np.zeros((10, m))  # four of 2 m, two of m
        law = self._law = _Law(n=n, m=m, steps=self.steps, exact=EXACT, far=FAR)
        law.q, law.l, law.u, law.x, law.y, law.linear = (
            a.ctypes.data for a in (self._q, self._l, self._u, self.x, self.y, family.linear)
        )
        law.begin, law.end, law.gap_begin, law.gap_end = (
            self._work[i : i + 2].ctypes.data for i in (0, 2, 4, 6)
        )
        law.pull_begin, law.pull = (self._work[i].ctypes.data for i in (8, 9))
        self._address = _pointer(ctypes.addressof(law))
        self.clear()

    def clear(self) -> None:
        """Forget all regions, and take the family's rows as they are now."""
        family, law = self._family, self._law
        self._response = np.ascontiguousarray(family.response.T)
        law.minimiser, law.rows, law.response, law.gram = (
            a.ctypes.data for a in (family.minimiser, family.rows, self._response, family.gram)
        )
        self._count, self._kept = 0, list[tuple[np.ndarray, ...]]()
        self._table = (_Region * 64)()
        law.regions = ctypes.addressof(self._table)
        law.stuck_at = -1
        self.forget()

    def add(self, new: Region) -> None:
        """Take one more region."""
        if self._count == len(self._table):
            larger = (_Region * (2 * self._count))()
            ctypes.memmove(larger, self._table, ctypes.sizeof(self._table))
            self._table = larger
            self._law.regions = ctypes.addressof(larger)
        fixed = np.flatnonzero(new.base)
        arrays = (
            np.array(new.sides), np.append(new.held, fixed).astype(np.int32),
            new.pick.astype(np.int32), new.sign, new.low, new.high, new.shift, new.inverse,
            new.base, np.full(2 * self._family.m, -1, dtype=np.int32),
        )  # fmt: skip
        self._kept.append(arrays)
        self._table[self._count] = _Region(
            new.held.size, fixed.size, *(a.ctypes.data for a in arrays)
        )
        self._count += 1

    def link(self, link: Link) -> None:
        """Take what lies behind a change of one row."""
        self._kept[link[0]][-1][link[1]] = link[2]

    @property
    def stuck(self) -> tuple[int, int] | None:
        """Region and slot behind which the last search knew of nothing; None if not for that."""
        law = self._law
        return (law.stuck_at, law.stuck_slot) if law.stuck_at >= 0 <= law.stuck_slot else None

    @property
    def tally(self) -> Tally:
        """How searches ended so far."""
        law = self._law
        return Tally(law.same, law.walked, law.missed, law.tried, law.longest)

    def stand(self, index: int) -> None:
        """Begin the next search in a region that holds the vectors of the last one."""
        self._stand(self._address, index)

    def forget(self) -> None:
        """Begin the next search in the region without active rows."""
        self._law.last = self._law.begun = 0

    def search(self, q: Array, l: Array, u: Array) -> int:  # noqa: E741
        """Return how many regions were tried, the last of which holds; negative if none does."""
        self._q[:], self._l[:], self._u[:] = q, l, u
        found: int = self._search(self._address)
        return found
