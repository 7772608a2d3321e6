"""The multipliers of a strictly convex QP, by active sets in the space of the rows."""

from __future__ import annotations

from time import perf_counter

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dposv

from qpmpc.arrays import Array, Indices

Sides = NDArray[np.int8]
Point = tuple[Array, Array, Sides]
"""Multipliers, rows and sides, ``(m,)`` each."""

_SIGNED = 1e-6
"""Least multiplier from which a row is taken to be active."""
_HUGE = 1e9
"""Multiplier that no row has whose equations can be met."""
_REGULAR = 1e-12
"""Curvature, relative to the rows', that keeps dependent rows solvable."""
_LEAPS = 3
"""Times that all rows change sides at once: what goes well does so at once."""


class MultiplierSearch:
    """Finds the multipliers of a soft QP whose cost is strictly convex.

    A row is inside (side 0), at a bound (1: upper, -1: lower) or, soft, beyond it (2, -2). Given
    the sides, multipliers follow from linear equations. `leap` changes all rows at once that the
    result puts on another side; that ends after few equations, or goes in circles. `climb` changes
    one row at a time, so that the dual cost grows until no row is wrong.
    """

    def __init__(self, linear: Array, quadratic: Array, exact: float, met: float) -> None:
        """Take the constant part.

        Args:
            linear, quadratic: penalties of the rows, ``(m,)`` each, as in `QuadraticProgram`.
            exact: how far an answer may leave what it is to satisfy, relative to the rows' size.
            met: the same of the rows at a bound, where dependent rows keep it from better.
        """
        self._linear = linear
        self._firm = quadratic <= 0  # beyond its bound such a row pulls with its penalty, no more
        self._curved = not self._firm.all()
        self._half = np.zeros(linear.size)
        np.divide(0.5, quadratic, out=self._half, where=quadratic > 0)
        self._exact, self._met = exact, met
        self.steps, self._most, self._deadline = 0, 0, 0.0

    def allow(self, steps: int, deadline: float) -> None:
        """Set how many systems of equations may be solved, and until when by `perf_counter`."""
        self.steps, self._most, self._deadline = 0, steps, deadline

    def pay(self) -> bool:
        """Count one system of equations; whether it is still allowed."""
        if self.steps >= self._most or perf_counter() > self._deadline:
            return False
        self.steps += 1
        return True

    def replace_gram(self, gram: Array) -> None:
        """Take ``A H^-1 A'``, ``(m, m)``, with the Hessian ``H``."""
        self._gram = gram
        diagonal = np.diag(gram)
        self._curve = _REGULAR * float(diagonal.max(initial=1.0))
        self._stiff = 1.0 / np.maximum(diagonal, _REGULAR)

    def bound(self, l: Array, u: Array) -> None:  # noqa: E741
        """Take the bounds, ``(m,)`` each."""
        self._l, self._u = l, u
        self._level = l == u
        self._levelled = np.count_nonzero(self._level) > 0
        self._low = np.where(self._level, -self._linear, 0.0)

    def sides(self, y: Array, v: Array) -> Sides:
        """Return the sides on which rows ``v`` with multipliers ``y`` lie."""
        over = self._stiff * (v - self._u) + y
        under = self._stiff * (self._l - v) - y
        side = (over > 0).astype(np.int8)
        side -= under > 0
        side += over > self._linear
        side -= under > self._linear
        if self._levelled:
            side[self._level & (side == 0)] = 1
        return side

    def wrong(self, side: Sides, y: Array, v: Array) -> Array:
        """Return by how much each row is on the wrong side, ``(m,)``; not positive: the right."""
        size, pull = np.abs(side), y * np.sign(side)
        wrong = np.maximum(v - self._u, self._l - v)
        excess = np.maximum(self._low - pull, pull - self._linear)
        np.copyto(wrong, excess, where=size == 1)
        beyond = (size == 2).nonzero()[0]
        if beyond.size:
            inside = (self._bound(side, beyond) - v[beyond]) * np.sign(side[beyond])
            less = self._linear[beyond] - pull[beyond]
            wrong[beyond] = np.where(self._firm[beyond], inside, less)
        return wrong

    def equations(self, side: Sides, y: Array, v: Array) -> tuple[Indices, Array, Array]:
        """Return rows that multipliers are to bring where they belong, ``(k,)``.

        With them by how much they miss it, and the compliance of each in itself.
        """
        size = np.abs(side)
        at = size == 1
        if self._curved:
            at |= (size == 2) & ~self._firm
        held = at.nonzero()[0]
        lead = v[held] - self._bound(side, held)
        give = np.zeros(held.size)
        if not self._curved:
            return held, lead, give
        soft = (size[held] == 2).nonzero()[0]
        if soft.size:
            rows = held[soft]
            give[soft] = self._half[rows]
            lead[soft] -= give[soft] * (y[rows] - np.sign(side[rows]) * self._linear[rows])
        return held, lead, give

    def leap(self, side: Sides, y: Array, v: Array) -> Point | None:
        """Return the answer, or None where it went in circles.

        Args:
            side: a guess. y: multipliers. v: the rows there.
        """
        begin, y, side = y, y.copy(), side.copy()
        self._measure(v)
        for _ in range(_LEAPS):
            self._settle(side, y)
            step = self._step(side, y, v - self._gram @ (y - begin))
            if step is None:
                return None
            y[step[0]] += step[1]
            v_new = v - self._gram @ (y - begin)
            wrong = (self.wrong(side, y, v_new) > self._tolerance).nonzero()[0]
            if wrong.size:
                side[wrong] = self.sides(y, v_new)[wrong]
                self._before = np.inf
            elif (done := self._done(side, y, v_new)) is not None:
                return (y, v_new, side) if done else None
        return None

    def climb(self, y: Array, v: Array, steps: int) -> Point | None:
        """Return the answer, or None where it did not get there.

        Args:
            y: multipliers to start from. v: the rows there. steps: how many.
        """
        side = np.sign(y).astype(np.int8)
        side[np.abs(y) <= _SIGNED] = 0
        side[self._level & (side == 0)] = 1
        side[np.abs(y) >= self._linear * (1 - _SIGNED)] *= 2
        begin, y = y, y.copy()
        self._settle(side, y)
        self._measure(v)
        for _ in range(steps):
            step = self._step(side, y, v - self._gram @ (y - begin))
            if step is None:
                return None
            if self._blocked(side, y, *step):
                self._before = np.inf
                continue
            v_new = v - self._gram @ (y - begin)
            wrong = self.wrong(side, y, v_new)
            if wrong.max(initial=0.0) > self._tolerance:
                i = int(np.argmax(wrong))
                side[i] = np.sign(side[i]) if side[i] else 1 if v_new[i] > self._u[i] else -1
                self._before = np.inf
            elif (done := self._done(side, y, v_new)) is not None:
                return (y, v_new, side) if done else None
        return None

    def _measure(self, v: Array) -> None:
        self._reach = max(1.0, float(np.abs(v).max(initial=0.0)))
        self._tolerance = self._exact * self._reach
        self._before = np.inf

    def _done(self, side: Sides, y: Array, v: Array) -> bool | None:
        """Whether the equations hold, or contradict each other; None: solve them once more."""
        at = (np.abs(side) == 1).nonzero()[0]
        missed = float(np.abs(v[at] - self._bound(side, at)).max(initial=0.0))
        if not np.abs(y).max(initial=0.0) < _HUGE:
            return False
        if missed <= self._tolerance:
            return True
        if missed >= self._before:
            return missed <= self._met * self._reach
        self._before = missed
        return None

    def _bound(self, side: Sides, rows: Indices) -> Array:
        return np.where(side[rows] > 0, self._u[rows], self._l[rows])

    def _settle(self, side: Sides, y: Array) -> None:
        """Give ``y`` the values that take no equation."""
        y[side == 0] = 0.0
        fixed = ((np.abs(side) == 2) & self._firm).nonzero()[0]
        y[fixed] = np.sign(side[fixed]) * self._linear[fixed]

    def _step(self, side: Sides, y: Array, v: Array) -> tuple[Indices, Array] | None:
        """Return the held rows and the step of their multipliers that meets their equations."""
        if not self.pay():
            return None
        held, lead, give = self.equations(side, y, v)
        if not held.size:
            return held, lead
        K = self._gram[held[:, None], held]
        K.flat[:: held.size + 1] += give + self._curve
        _, step, info = dposv(K.T, lead, lower=1, overwrite_a=1)  # K.T: as LAPACK stores it
        return None if info else (held, step)

    def _blocked(self, side: Sides, y: Array, held: Indices, step: Array) -> bool:
        """Go along ``step``, at most to where a multiplier leaves its side; change that side."""
        if not held.size:
            return False
        sign, beyond = np.sign(side[held]), np.abs(side[held]) == 2
        linear = self._linear[held]
        pull, towards = y[held] * sign, step * sign
        low = np.where(beyond, linear, self._low[held])
        high = np.where(beyond, np.inf, linear)
        room = np.where(towards > 0, high - pull, low - pull)
        with np.errstate(divide="ignore", invalid="ignore"):
            reach = np.where(towards != 0, room / towards, np.inf)
        first = int(np.argmin(reach))
        if not reach[first] < 1.0:
            y[held] += step
            return False
        y[held] += max(reach[first], 0.0) * step
        i, up = held[first], towards[first] > 0
        y[i] = sign[first] * (high if up else low)[first]
        if up:
            side[i] = 2 * sign[first]
        elif beyond[first]:
            side[i] = sign[first]
        else:
            side[i] = -2 * sign[first] if self._level[i] else 0
        return True
