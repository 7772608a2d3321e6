"""All critical regions that parameters within their bounds can reach, from one to its neighbours.

A region is a polyhedron in the space of the parameters. Across each of its facets lies another one,
which mostly differs by the row that the facet stands for (Tondel, Johansen, Bemporad, Automatica
39, 2003). A facet is real where a small quadratic program finds a point on it that keeps away from
all others; a step across tells what lies there.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Container
from dataclasses import dataclass
from typing import Any

import numpy as np

from qpmpc.arrays import Array
from qpmpc.explicit.regions import Family, Link, Region, Sides, change, region
from qpmpc.parametric import Parametric

Find = Callable[[Array, Array, Array], Sides | None]
"""From vectors q, l, u to the sides at the optimum, or None where there is none."""

THIN = 1e-5
"""Width, as a share of the parameters' range, below which a facet counts as none."""
STEPS = (2e-6, 1e-5, 5e-5, 3e-4)
"""How far beyond a facet is looked for the neighbour: farther where a tolerance hides it."""
_FLAT = 1e-9
"""Slope of an inequality, relative to its terms, that parameters do not move."""
_SAMPLES, _SEED = 2000, 1
"""How the covered share is estimated; the same numbers each time."""
_HELD = 2e-8
"""How far outside a region a point may lie by rounding; far less than a step across."""
_PARALLEL = 1e-7
"""Difference between two inequalities that are the same facet."""


@dataclass(frozen=True, eq=False)
class Enumeration:
    """What an enumeration found."""

    regions: list[Region]
    """In the order they were found, the middle of the parameters' range first."""
    links: list[Link]
    """What lies behind facets where that is not what a change of the one row gives."""
    complete: bool
    """Whether every facet of every region was crossed, and led somewhere."""
    lost: int
    """Facets behind which no region was found: their rows depend on each other there."""
    covered: float
    """Share of the parameters' range in which the optimum lies in one of the regions, by sampling;
    ties count for whichever region the solver names."""


def enumerate_regions(
    family: Family, parameters: Parametric, find: Find, *, most: int, programs: int
) -> Enumeration:
    """Return the regions that parameters within ``[-1, 1]^d`` reach, as far as limits allow.

    Nearest first: an enumeration that ends early holds what surrounds the middle of the range.

    Args:
        family: the QP. parameters: where its vectors come from.
        find: any solver, asked where a flip of one row is not what lies across a facet.
        most: regions after which it ends, not complete.
        programs: small quadratic programs after which it ends; each takes some 10 microseconds and
            more with many rows.
    """
    search = _Search(family, parameters, find)
    first = search.at(np.zeros(parameters.size))
    if first is None:
        return Enumeration([], [], complete=False, lost=1, covered=0.0)
    found, seen, queue, lost = [first], {first.key: 0}, [(0.0, 0)], 0
    links: list[Link] = []
    while queue and len(found) <= most and search.programs < programs:
        _, i = heapq.heappop(queue)
        for slots, key, point, outward in search.facets(found[i]):
            if key in seen:
                continue
            there = search.across(key, point, outward)
            if there is None:
                lost += 1
                continue
            j = seen.get(there.key)
            if j is None:
                j = seen[there.key] = len(found)
                found.append(there)
                heapq.heappush(queue, (float(np.linalg.norm(point)), j))
            if there.key != key:
                links += [(i, slot, j) for slot in slots]
    complete = not queue and not lost
    return Enumeration(found, links, complete, lost, search.share(seen))


class _Search:
    """The polyhedra in parameters, and what lies across their facets."""

    def __init__(self, family: Family, parameters: Parametric, find: Find) -> None:
        self._family, self._parameters, self._find = family, parameters, find
        d = parameters.size
        rows = family.rows @ parameters.gradient + parameters.offset
        level = family.rows @ parameters.q0
        # Rooms to the upper, then the lower bounds, as functions of (v, 1).
        self._room = np.vstack(
            [
                np.column_stack([-rows, parameters.u0 - level]),
                np.column_stack([rows, level - parameters.l0]),
            ]
        )
        self._bounded = np.isfinite(self._room[:, -1])
        self._room[~self._bounded, -1] = 0.0
        self._box = np.vstack([np.eye(d), -np.eye(d)])
        self.programs = 0
        """Small quadratic programs solved so far."""

    def share(self, keys: Container[bytes]) -> float:
        """Return the share of the parameters' range whose optimum has one of some active rows."""
        rng = np.random.default_rng(_SEED)
        inside = 0
        for v in rng.uniform(-1.0, 1.0, (_SAMPLES, self._parameters.size)):
            sides = self._find(*self._parameters.vectors(v))
            inside += sides is not None and sides.tobytes() in keys
        return inside / _SAMPLES

    def at(self, v: Array) -> Region | None:
        """Return the region that holds ``v``, by solving there."""
        sides = self._find(*self._parameters.vectors(v))
        return None if sides is None else self._holding(sides.tobytes(), v)

    def across(self, key: bytes | None, v: Array, outward: Array) -> Region | None:
        """Return the region behind a facet at ``v``, which is that of ``key`` if it holds."""
        for step in STEPS:
            beyond = v + step * outward
            there = None if key is None else self._holding(key, beyond)
            there = there or self.at(beyond)
            if there is not None:
                return there
        return None

    def _holding(self, key: bytes, v: Array) -> Region | None:
        there = region(self._family, key)
        if there is None:
            return None
        slope, level, _ = self._inequalities(there)
        return there if (slope @ v <= level + _HELD).all() else None

    def facets(self, here: Region) -> list[tuple[list[int], bytes | None, Array, Array]]:
        """Return for each facet its changes of rows, the key if it is one, a point, the normal."""
        import daqp  # noqa: PLC0415 - only this backend needs it

        slope, level, slots = self._inequalities(here)
        d, count = slope.shape[1], level.size
        if not count:
            return []
        A = np.ascontiguousarray(np.vstack([slope, self._box]))
        upper = np.append(level - THIN, np.ones(2 * d))
        lower = np.full(upper.size, -1e30)
        model: Any = daqp.Model()
        model.settings = {"primal_tol": 1e-9}
        flag, _ = model.setup(
            np.eye(d), np.zeros(d), A, upper, lower, np.zeros(upper.size, dtype=np.int32)
        )
        if flag < 0:
            return []
        result = []
        for i in range(count):
            same = np.flatnonzero(
                (np.abs(slope - slope[i]).max(axis=1) < _PARALLEL)
                & (np.abs(level - level[i]) < _PARALLEL)
            )
            if same[0] < i:
                continue  # the same facet stood before
            u, l = upper.copy(), lower.copy()  # noqa: E741
            u[same] += 2 * THIN
            u[i] = l[i] = level[i]
            model.update(bupper=u, blower=l, sense=np.zeros(upper.size, dtype=np.int32))
            v, _, flag, _ = model.solve()
            self.programs += 1
            if flag > 0:
                key = change(here.key, slots[i]) if same.size == 1 else None
                result.append(([slots[j] for j in same], key, v, slope[i]))
        return result

    def _inequalities(self, here: Region) -> tuple[Array, Array, list[int]]:
        """Return ``slope v <= level``, slopes of length one, and the slot of each."""
        family, m = self._family, self._family.m
        pull = -(here.inverse @ self._room[here.pick])
        pull[:, -1] += here.shift
        y = np.zeros((m, self._room.shape[1]))
        y[:, -1] = here.base
        y[here.held] = here.sign[:, None] * pull
        took = family.gram @ y
        gap = self._room + np.vstack([took, -took])
        if here.turn is not None:
            gap *= here.turn[:, None]
        bounded = self._bounded.copy()
        bounded[here.own] = False
        kept = np.flatnonzero(bounded)
        below = pull.copy()
        below[:, -1] -= here.low
        capped = np.flatnonzero(np.isfinite(here.high))
        above = -pull[capped]
        above[:, -1] += here.high[capped]
        at = np.flatnonzero(np.abs(here.sides[here.held]) == 1)
        terms = np.vstack([gap[kept], below[at], above])  # each to be >= 0, in (v, 1)
        inside = np.array(here.sides[kept % m] == 0) if m else kept == 0
        slot = np.concatenate(
            [
                2 * (kept % max(m, 1)) + (inside & (kept >= m)),
                2 * here.held[at],
                2 * here.held[capped] + 1,
            ]
        )
        length = np.linalg.norm(terms[:, :-1], axis=1)
        moved = length > _FLAT * (1.0 + np.abs(terms[:, -1]))
        terms, length = terms[moved], length[moved]
        return -terms[:, :-1] / length[:, None], terms[:, -1] / length, slot[moved].tolist()
