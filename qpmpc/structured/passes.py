"""Passes over the horizon, each linear in N: to the decision under multipliers, and to multipliers.

The minimiser of a QP whose active rows are equations is the most likely path of a Gauss-Markov
process that was observed: P is the inverse covariance of the decisions, the closed loop of the
recursion makes the process, and each active row is an observation of its states. So a Kalman
filter forwards and its adjoint backwards solve ``(A P^{-1} A' + noise) y = r`` for any number of
active rows at a cost that does not depend on their number (Bryson and Frazier's smoother).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from qpmpc.arrays import Array
from qpmpc.structured.program import StagePart
from qpmpc.structured.recursion import recursion

Mask = NDArray[np.bool_]

_NOISE = 1e-14
"""Variance of the noise of an exact observation beside that of the row itself. It makes rows that
depend on each other harmless: the equations are solved to a proximal point, and solved again."""


class Response(NamedTuple):
    """What multipliers lead to."""

    decision: Array
    """z, ``(N_u, m)``."""
    value: Array
    """What each row reads, ``(N, k)``."""


class Passes:
    """The passes over one part."""

    def __init__(self, part: StagePart) -> None:
        """Factor the part."""
        self.part, self.factor = part, recursion(part)
        spread = np.einsum("ka,iab,kb->ik", part.read, self.factor.covariance, part.read)
        self.noise = _NOISE * np.maximum(spread, 0.0) + np.finfo(float).tiny
        """Of exact observations, ``(N, k)``."""

    def respond(self, q: Array, price: Array) -> Response:
        """Return the minimiser of ``1/2 z' P z + q' z + price' A z``.

        Args:
            q: ``(N_u, m)``. price: multipliers, ``(N, k)``, 0 where there is no row.
        """
        part, f = self.part, self.factor
        G, read, N, M = part.dynamics.G, part.read, part.horizon, part.moves
        feed, p = np.zeros((N, part.m)), np.zeros(part.n)
        for i in range(N - 1, -1, -1):
            p += price[i] @ read
            if i < M:
                feed[i] = -f.inverse[i] @ (p @ G + q[i])
                p = p @ f.closed[i] + q[i] @ f.gain[i]
            else:
                p = p @ f.closed[i]
        s = np.zeros(part.n)
        decision, value = np.zeros((M, part.m)), np.zeros((N, len(read)))
        for i in range(N):
            if i < M:
                decision[i] = f.gain[i] @ s + feed[i]
            s = f.closed[i] @ s + G @ feed[i]
            value[i] = read @ s
        return Response(decision, value)

    def equalise(self, held: Mask, r: Array, give: Array) -> Array:
        """Solve ``(A P^{-1} A' + noise + give) y = r`` over the rows that are held.

        Args:
            held: which, ``(N, k)``. r: right-hand side, ``(N, k)``.
            give: what a row may give way per unit of its multiplier, ``(N, k)``.

        Returns:
            ``y``, ``(N, k)``, 0 where a row is not held.
        """
        f, read = self.factor, self.part.read
        y = np.zeros(held.shape)
        steps = np.flatnonzero(held.any(axis=1))
        if not steps.size:
            return y
        first, last = int(steps[0]), int(steps[-1])
        # Before the first observation the process is what it is without any.
        covariance, mean = f.covariance[first].copy(), np.zeros(self.part.n)
        seen: list[tuple[int, int, Array, float]] = []
        for i in range(first, last + 1):
            if i > first:
                mean = f.closed[i] @ mean
                covariance = f.closed[i] @ covariance @ f.closed[i].T + f.noise[i]
            for j in np.flatnonzero(held[i]).tolist():
                reach = covariance @ read[j]
                spread = max(float(read[j] @ reach), 0.0) + self.noise[i, j] + give[i, j]
                gain = reach / spread
                surprise = r[i, j] - float(read[j] @ mean)
                mean = mean + gain * surprise
                covariance = covariance - np.outer(gain, reach)
                seen.append((i, j, gain, surprise / spread))
        adjoint, at = np.zeros(self.part.n), last
        for i, j, gain, weighted in reversed(seen):
            while at > i:
                adjoint = adjoint @ f.closed[at]
                at -= 1
            y[i, j] = weighted - float(gain @ adjoint)
            adjoint = adjoint + read[j] * y[i, j]
        return y
