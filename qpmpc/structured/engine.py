"""What is done to one part in a cycle, in numpy: the reference that compiled code is held to."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from qpmpc.arrays import Array, Indices
from qpmpc.status import Status
from qpmpc.structured.activeset import ActiveSet
from qpmpc.structured.program import StagePart, StructuredProgram
from qpmpc.structured.recursion import recursion


class Engine(Protocol):
    """One part's share of vectors of the whole QP: variables ``(n,)``, rows ``(m,)``, outputs.

    Entries that belong to other parts are neither read nor written.
    """

    def forget(self) -> None:
        """Begin the next solve with no row active."""
        ...

    def solve(self, q: Array, l: Array, u: Array, x: Array, y: Array) -> tuple[Status, int]:  # noqa: E741
        """Write minimiser and multipliers; return how it went and the steps taken."""
        ...

    def minimise(self, q: Array, out: Array) -> None:
        """Write the minimiser without rows, ``-P^{-1} q``."""
        ...

    def outputs(self, x: Array, out: Array) -> None:
        """Write the outputs' response to the decision ``x``, ``Theta x``."""
        ...

    def output_gradient(self, error: Array, out: Array) -> None:
        """Write ``Theta' error``."""
        ...

    def rows(self, x: Array, out: Array) -> None:
        """Write ``A x``."""
        ...

    def gradient(self, x: Array, y: Array, out: Array) -> None:
        """Write ``P x + A' y``."""
        ...

    def whiten(self, g: Array, out: Array) -> None:
        """Write ``T' g`` for the T with ``T' P T = I`` that the recursion gives."""
        ...


class NumpyEngine:
    """The reference. A pass takes tens of microseconds a step here."""

    def __init__(self, program: StructuredProgram, part: StagePart, iterations: int | None) -> None:
        """Factor ``part`` of ``program``; ``iterations``: Newton steps of a solve at most."""
        self._part, self._factor = part, recursion(part)
        self._set = ActiveSet(part, iterations)
        self._variables: Indices = program.variables(part)
        self._outputs: Indices = program.outputs(part)
        self._there = part.rows >= 0
        self._rows = part.rows[self._there]
        self._root = np.zeros_like(self._factor.inverse)
        self._root[: part.moves] = np.linalg.cholesky(self._factor.inverse[: part.moves])

    def forget(self) -> None:
        """See `Engine`."""
        self._set.forget()

    def solve(self, q: Array, l: Array, u: Array, x: Array, y: Array) -> tuple[Status, int]:  # noqa: E741
        """See `Engine`."""
        low, high = np.full(self._there.shape, -np.inf), np.full(self._there.shape, np.inf)
        low[self._there], high[self._there] = l[self._rows], u[self._rows]
        mine = q[self._variables].reshape(self._part.moves, -1)
        status, decision, steps = self._set.solve(mine, low, high)
        x[self._variables] = decision.reshape(-1)
        y[self._rows] = self._set.multiplier[self._there]
        return status, steps

    def minimise(self, q: Array, out: Array) -> None:
        """See `Engine`."""
        mine = q[self._variables].reshape(self._part.moves, -1)
        found = self._set.passes.respond(mine, np.zeros(self._there.shape))
        out[self._variables] = found.decision.reshape(-1)

    def outputs(self, x: Array, out: Array) -> None:
        """See `Engine`."""
        out[self._outputs] = (self._states(x) @ self._part.output.T).reshape(-1)

    def output_gradient(self, error: Array, out: Array) -> None:
        """See `Engine`."""
        weights = error[self._outputs].reshape(self._part.horizon, -1)
        out[self._variables] = self._adjoint(weights @ self._part.output).reshape(-1)

    def rows(self, x: Array, out: Array) -> None:
        """See `Engine`."""
        out[self._rows] = (self._states(x) @ self._part.read.T)[self._there]

    def gradient(self, x: Array, y: Array, out: Array) -> None:
        """See `Engine`."""
        part = self._part
        price = np.zeros(self._there.shape)
        price[self._there] = y[self._rows]
        outputs = self._states(x) @ part.output.T
        slope = self._adjoint(2.0 * part.output_weight * outputs @ part.output + price @ part.read)
        slope += 2.0 * part.decision_weight * x[self._variables].reshape(slope.shape)
        out[self._variables] = slope.reshape(-1)

    def whiten(self, g: Array, out: Array) -> None:
        """See `Engine`."""
        part, factor = self._part, self._factor
        own = g[self._variables].reshape(part.moves, -1)
        result, p = np.zeros_like(own), np.zeros(part.n)
        for i in range(part.moves - 1, -1, -1):
            result[i] = (own[i] + p @ part.dynamics.G) @ self._root[i]
            p = p @ factor.closed[i] + own[i] @ factor.gain[i]
        out[self._variables] = result.reshape(-1)

    def _states(self, x: Array) -> Array:
        """Return s(1) ... s(N) under a decision, ``(N, n)``."""
        part, d = self._part, self._part.dynamics
        decision = x[self._variables].reshape(part.moves, -1)
        s, states = np.zeros(part.n), np.zeros((part.horizon, part.n))
        for i in range(part.horizon):
            s = d.F @ s + d.G @ decision[i] if i < part.moves else d.F_held @ s
            states[i] = s
        return states

    def _adjoint(self, weights: Array) -> Array:
        """Return what ``sum_i weights_i s(i)`` gains per unit of each decision, ``(N_u, m)``."""
        part, d = self._part, self._part.dynamics
        p, slope = np.zeros(part.n), np.zeros((part.moves, part.m))
        for i in range(part.horizon - 1, -1, -1):
            p = p + weights[i]
            if i < part.moves:
                slope[i] = p @ d.G
                p = p @ d.F
            else:
                p = p @ d.F_held
        return slope
