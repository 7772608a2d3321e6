"""The active-set method on the dual, whose linear algebra is a few passes over the horizon.

The dual of a QP with soft rows is a QP in the multipliers with bounds alone: a hard row's
multiplier is not negative, that of a soft row does not exceed its price either. This is an
active-set method on that box, which climbs: each Newton step on the multipliers that are free is
clipped to the box, and taken if the dual cost rises; else it ends where the first multiplier
meets the box. At the top of the free multipliers, the worst row of each run of violated rows
becomes free, and so does a price that is too high. No active set comes twice, as the dual cost
only rises.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from qpmpc.arrays import Array
from qpmpc.status import Status
from qpmpc.structured.passes import Mask, Passes, Response
from qpmpc.structured.program import StagePart

States = NDArray[np.int8]

FREE: Final = 0
"""Of a row that is away from its bounds: the multiplier is 0."""
HELD: Final = 1
"""At its upper bound; -1: at its lower one."""
GIVING: Final = 2
"""Beyond its upper bound, at its price; -2: beyond its lower one."""

TOLERANCE: Final = 1e-12
"""How far a row may be from its bound, beside the size of all rows, and still be on it."""
LOOSEST: Final = 1e-7
"""What that is raised to, where rounding does not allow better."""
EQUAL: Final = 1e-12
"""Room between bounds, beside their size, that is none."""
LINEAR: Final = 0.9
"""Share of the slope's promise that a step keeps where no curvature stops it: no row can stop it
either, and the dual cost has no upper end."""
ITERATIONS: Final = 1000
"""Newton steps, where no other limit is given."""


class ActiveSet:
    """Solves the QPs of one part, each from where the last one ended, one step later."""

    def __init__(self, part: StagePart, iterations: int | None) -> None:
        """Factor the part.

        Args:
            part: scaled to order one. iterations: Newton steps at most.
        """
        self.passes = Passes(part)
        self._there: Mask = part.rows >= 0
        shape = part.rows.shape
        self._price = np.broadcast_to(part.linear, shape)
        self._soft: Mask = np.isfinite(self._price)
        curve = np.broadcast_to(part.quadratic, shape)
        self._curved: Mask = self._soft & (curve > 0)
        self._kink = np.where(self._curved, self._price, 0.0)
        self._give = np.where(self._curved, 0.5 / np.where(curve > 0, curve, 1.0), 0.0)
        self._limit = iterations or ITERATIONS
        self.state: States = np.zeros(shape, dtype=np.int8)
        self.multiplier = np.zeros(shape)
        self.forget()

    def forget(self) -> None:
        """Begin the next solve with no row active."""
        self.state[:] = FREE
        self.multiplier[:] = 0.0

    def solve(self, q: Array, l: Array, u: Array) -> tuple[Status, Array, int]:  # noqa: E741
        """Return how it went, the decision ``(N_u, m)`` and the number of Newton steps.

        Args:
            q: gradient, ``(N_u, m)``.
            l, u: bounds of each row, ``(N, k)``, infinite where there is none.
        """
        self._equal: Mask = u - l <= EQUAL * (1.0 + np.abs(np.where(np.isfinite(u), u, 0.0)))
        self._resume(l, u)
        there = self.passes.respond(q, self.multiplier)
        tolerance = TOLERANCE * (1.0 + float(np.abs(there.value).max(initial=0.0)))
        loosest = tolerance * LOOSEST / TOLERANCE
        climbed, last, stuck = np.inf, np.inf, 0
        for steps in range(self._limit):
            slope = self._slope(there, l, u)
            worst = float(np.abs(slope).max(initial=0.0))
            if worst <= tolerance:
                if climbed <= 0.0 and steps:  # what was freed went back: rounding
                    tolerance = min(10.0 * tolerance, loosest)
                if not self._release(there, l, u, tolerance):
                    return Status.SOLVED, there.decision, steps
                slope = self._slope(there, l, u)
                climbed, last, stuck = 0.0, np.inf, 0
            elif stuck >= 2:
                if worst > loosest:
                    return Status.FAILED, there.decision, steps
                tolerance, stuck = 2.0 * worst, 0
                continue
            there, gain, whole, promise = self._climb(q, slope, l, u)
            climbed += max(gain, 0.0)
            stuck = stuck + 1 if whole and worst > 0.5 * last else 0
            last = worst
            if whole and gain > LINEAR * promise and worst > loosest:
                return Status.INFEASIBLE, there.decision, steps + 1
        return Status.ITERATION_LIMIT, there.decision, self._limit

    def _resume(self, l: Array, u: Array) -> None:  # noqa: E741
        """Take the last active set for this one, one step later, as far as it fits the bounds."""
        state, y = self.state, self.multiplier
        state[:-1], y[:-1] = state[1:].copy(), y[1:].copy()
        lost = ~self._there | ((state > 0) & np.isinf(u)) | ((state < 0) & np.isinf(l))
        wrong = (np.abs(state) == HELD) & (y * state < 0) & ~self._equal
        state[lost | wrong] = FREE
        low, high = self._box()
        np.clip(y, low, high, out=y)

    def _box(self) -> tuple[Array, Array]:
        """Return the range of each multiplier in its present state."""
        state, price, equal = self.state, self._price, self._equal
        low, high = np.zeros(state.shape), np.zeros(state.shape)
        up, down = state == HELD, state == -HELD
        high[up | (down & equal)] = price[up | (down & equal)]
        low[down | (up & equal)] = -price[down | (up & equal)]
        over, under = state == GIVING, state == -GIVING
        low[over], high[over] = price[over], np.where(self._curved, np.inf, price)[over]
        low[under], high[under] = np.where(self._curved, -np.inf, -price)[under], -price[under]
        return low, high

    def _moves(self) -> Mask:
        """Which multipliers are free to move."""
        size = np.abs(self.state)
        return np.asarray((size == HELD) | ((size == GIVING) & self._curved), dtype=np.bool_)

    def _slope(self, there: Response, l: Array, u: Array) -> Array:  # noqa: E741
        """Return the slope of the dual cost in the multipliers that are free, 0 in the others."""
        state, moves = self.state, self._moves()
        bound = np.where(state > 0, u, l)
        beyond = np.where(np.abs(state) == GIVING, self.multiplier - np.sign(state) * self._kink, 0)
        slope = np.zeros(state.shape)
        slope[moves] = (there.value - bound - beyond * self._give)[moves]
        return slope

    def _release(self, there: Response, l: Array, u: Array, tolerance: float) -> bool:  # noqa: E741
        """Free the worst row of each run of rows that should be; return whether there is any."""
        state, value = self.state, there.value
        flat = (np.abs(state) == GIVING) & ~self._curved
        excess = np.full(state.shape, -np.inf)
        away = self._there & (state == FREE)
        excess[away] = np.maximum(value - u, l - value)[away]
        excess[flat] = np.where(state > 0, u - value, value - l)[flat]
        found = False
        for column in range(state.shape[1]):
            for begin, end in _runs(excess[:, column] > tolerance):
                i = begin + int(np.argmax(excess[begin:end, column]))
                found = True
                if state[i, column] == FREE:
                    state[i, column] = HELD if value[i, column] > u[i, column] else -HELD
                else:
                    state[i, column] //= GIVING
        return found

    def _climb(
        self,
        q: Array,
        slope: Array,
        l: Array,  # noqa: E741
        u: Array,
    ) -> tuple[Response, float, bool, float]:
        """Take one step.

        Returns:
            Where it leads, by how much the dual cost rose, whether no multiplier met the box, and
            what the slope alone would have made of the step.
        """
        y, moves = self.multiplier, self._moves()
        give = np.where(np.abs(self.state) == GIVING, self._give, 0.0)
        step = self.passes.equalise(moves, slope, give)
        low, high = self._box()
        whole = y + step
        clipped = np.where(moves, np.clip(whole, low, high), y)
        before = y.copy()
        y[:] = clipped
        found = self.passes.respond(q, y)
        # The dual cost is quadratic: the mean of the slopes at both ends is exact.
        after = self._slope(found, l, u)
        promise = float(np.vdot(slope, y - before))
        gain = 0.5 * (promise + float(np.vdot(after, y - before)))
        met = moves & (clipped != whole)
        if met.any() and gain <= 0.0:
            room = np.where(step > 0, high - before, before - low)
            share = np.full(step.shape, np.inf)
            np.divide(room, np.abs(step), out=share, where=met)
            least = float(share.min())
            y[:] = before + np.where(moves, least * step, 0.0)
            met &= share <= least
            y[met] = np.where(step > 0, high, low)[met]
            found = self.passes.respond(q, y)
            after = self._slope(found, l, u)
            gain = 0.5 * float(np.vdot(slope + after, y - before))
        self._settle(met)
        return found, gain, not met.any(), promise

    def _settle(self, met: Mask) -> None:
        """Change the state of rows whose multipliers met the end of their range."""
        state, y = self.state, self.multiplier
        for i, j in zip(*np.nonzero(met), strict=True):
            if abs(state[i, j]) == GIVING:  # curved: back to its price
                state[i, j] //= GIVING
            elif y[i, j] == 0.0 and not self._equal[i, j]:
                state[i, j] = FREE
            else:
                state[i, j] = GIVING if y[i, j] > 0 else -GIVING


def _runs(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return begin and end of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
