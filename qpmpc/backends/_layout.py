"""Which bounds of which rows are there: what solvers see that do not know infinite bounds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from qpmpc.arrays import Array, Indices

_KEPT = 8
"""How many set-ups are kept: bounds that come and go mostly do so between a few layouts."""
_LOWER, _UPPER, _EQUAL = 1, 2, 4
S = TypeVar("S")


class Layout:
    """Rows ``l <= A x <= u`` as equations and one-sided inequalities, infinite bounds left out."""

    def __init__(self, code: NDArray[np.int64]) -> None:
        self.equal: Indices = np.flatnonzero(code == _EQUAL)
        """Rows whose bounds are the same."""
        self.lower: Indices = np.flatnonzero((code == _LOWER) | (code == _LOWER + _UPPER))
        """Other rows with a lower bound."""
        self.upper: Indices = np.flatnonzero((code == _UPPER) | (code == _LOWER + _UPPER))
        """Other rows with an upper bound."""

    def multipliers(self, equal: Array, inequalities: Array, out: Array) -> Array:
        """Write multipliers of the rows into ``out (m,)``, positive at upper bounds.

        Args:
            equal: those of the equations. inequalities: those of ``-A x <= -l`` for the rows with a
                lower bound, then those of ``A x <= u``, none negative.
            out: where to.
        """
        at = self.lower.size
        out.fill(0.0)
        out[self.equal] = equal
        out[self.upper] = inequalities[at:]
        out[self.lower] -= inequalities[:at]
        return out


class Setups(Generic[S]):
    """A solver set up once for each layout that the bounds take, the latest few kept."""

    def __init__(self, make: Callable[[Layout], S]) -> None:
        self._make = make
        self._kept: dict[bytes, S] = {}
        self._key: bytes | None = None

    def __call__(self, l: Array, u: Array, far: float) -> tuple[S, float]:  # noqa: E741
        """Return the solver for bounds ``l``, ``u (m,)`` and the time it took to set it up [s].

        Args:
            l, u: the bounds.
            far: from where on a bound counts as infinite.
        """
        code = (l > -far) * _LOWER + (u < far) * _UPPER
        code[l == u] = _EQUAL
        key = code.tobytes()
        if key == self._key:
            return self._kept[key], 0.0
        spent, found = 0.0, self._kept.pop(key, None)
        if found is None:
            begin = perf_counter()
            found = self._make(Layout(code))
            spent = perf_counter() - begin
            if len(self._kept) == _KEPT:
                del self._kept[next(iter(self._kept))]
        self._kept[key] = found  # the dictionary is in the order of last use
        self._key = key
        return found, spent

    def __iter__(self) -> Iterator[S]:
        return iter(self._kept.values())
