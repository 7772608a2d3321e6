"""The explicit law: critical regions enumerated before, the right one found by a short search."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import ClassVar

import numpy as np

from qpmpc.arrays import Array
from qpmpc.backends._registry import register
from qpmpc.backends.base import Backend, Fact, LimitKind, Limits, RawSolution
from qpmpc.backends.daqp import DaqpBackend
from qpmpc.errors import BackendSetupError
from qpmpc.explicit import archive
from qpmpc.explicit.compiled import CompiledWalk
from qpmpc.explicit.enumeration import Enumeration, enumerate_regions
from qpmpc.explicit.interpreted import InterpretedWalk
from qpmpc.explicit.law import Law, Walk
from qpmpc.explicit.regions import Family, Sides
from qpmpc.multipliers import MultiplierSearch
from qpmpc.native.errors import CacheError, CompilationError, CompilerUnavailableError
from qpmpc.parametric import Parametric
from qpmpc.program import QuadraticProgram
from qpmpc.status import Status

REGIONS = 4000
"""Regions after which an enumeration ends."""
PROGRAMS = 400_000
"""Small quadratic programs after which it ends: seconds, once for each problem."""
LEARNED = 1000
"""Regions that are added to them while solving."""
_EXACT = 1e-9


@register
class ExplicitBackend(Backend):
    """Looks for the region that holds the vectors; solves by DAQP where none is stored.

    A region's inequalities are the optimality conditions, so an answer of the law is the optimum.
    What DAQP had to solve is learned: its active rows become a region between two solves.
    """

    name: ClassVar[str] = "explicit"
    package: ClassVar[str] = "daqp"
    summary: ClassVar[str] = (
        "explicit law: regions enumerated before, a short search; DAQP elsewhere"
    )
    warm_starts: ClassVar[bool] = True
    replaces_rows: ClassVar[bool] = True
    limits: ClassVar[frozenset[LimitKind]] = frozenset(("iterations", "time"))
    smallest_part: ClassVar[int] = 1  # regions of two problems in one multiply
    takes_parameters: ClassVar[bool] = True

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Set DAQP and an empty law up.

        Raises:
            BackendSetupError: the Hessian is not positive definite, or DAQP refuses the problem.
        """
        try:
            self._family = Family(qp)
        except np.linalg.LinAlgError as error:
            raise BackendSetupError(self.name, "P is not positive definite") from error
        self._qp, self._daqp = qp, DaqpBackend(qp, limits)
        self._walk = walk = _walk(self._family, limits.iterations)
        self._law = Law(self._family, walk, LEARNED)
        self._sides = MultiplierSearch(self._family.linear, np.array(qp.quadratic), _EXACT, _EXACT)
        self._sides.replace_gram(self._family.gram)
        self._enumeration = Enumeration([], [], complete=False, lost=0, covered=0.0)
        self._missed: Sides | None = None
        self._steady = True
        self._answer = RawSolution(Status.SOLVED, walk.x, walk.y, 0)

    def expect(self, parameters: Parametric) -> None:
        """Enumerate the regions that the parameters reach, or load them from the cache."""
        limits = (REGIONS, PROGRAMS)
        name = archive.name_of(self._qp, parameters, limits)
        try:
            found = archive.load(name, self._family)
        except CacheError:
            found = None
        if found is None:
            found = enumerate_regions(
                self._family, parameters, self._find, most=REGIONS, programs=PROGRAMS
            )
            with suppress(CacheError):  # the next time takes as long
                archive.save(name, found, self._qp.m)
        self._enumeration = found
        self._law.restart(found.regions, found.links)

    def _find(self, q: Array, l: Array, u: Array) -> Sides | None:  # noqa: E741
        answer = self._daqp.solve(q, l, u)
        return self._active(answer, q, l, u) if answer.status is Status.SOLVED else None

    def _active(self, answer: RawSolution, q: Array, l: Array, u: Array) -> Sides:  # noqa: E741
        y, level = answer.y, 1.0 + float(np.abs(q).max())
        self._sides.bound(l, u)
        sides = self._sides.sides(y, self._family.rows @ q - self._family.gram @ y)
        sides[(np.abs(sides) == 1) & (np.abs(y) <= _EXACT * level)] = 0  # it only touches
        return sides

    def replace_rows(self, A: Array) -> None:
        """Take other rows, for which no region is known: DAQP's, until they stay."""
        self._daqp.replace_rows(A)
        self._family.replace_rows(A)
        self._sides.replace_gram(self._family.gram)
        self._enumeration = Enumeration([], [], complete=False, lost=0, covered=0.0)
        self._law.restart()
        # Rows that change in every cycle: what is learned from one would be gone at the next.
        self._missed, self._steady = None, False

    def forget(self) -> None:
        """Begin the next search where no row is active, and DAQP without an active set."""
        self._missed = None
        self._walk.forget()
        self._daqp.forget()

    def prepare(self) -> None:
        """Make a region of what the last solve had to leave to DAQP."""
        if self._missed is not None:
            self._law.learn(self._missed)
            self._missed = None

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Search from the last region on, else solve by DAQP."""
        if self._missed is not None:
            self.prepare()
        answer = self._answer
        answer.iterations = self._walk.search(q, l, u)
        if answer.iterations < 0:
            return self._beside(q, l, u)
        return answer

    def _beside(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Solve what no region holds."""
        other = self._daqp.solve(q, l, u)
        if self._steady and other.status is Status.SOLVED:
            self._missed = self._active(other, q, l, u)
        self._steady = True
        other.iterations -= self._answer.iterations
        return other

    def facts(self) -> Mapping[str, Fact]:
        """Return sizes of the law, its bound on a search, and how searches have ended."""
        law, found, tally = self._law, self._enumeration, self._walk.tally
        return {
            "regions": len(law),
            "regions_enumerated": len(found.regions),
            "complete": found.complete,
            "covered": found.covered,
            "memory_bytes": law.nbytes,
            "language": self._walk.language,
            "most_tried": self._walk.steps,
            "most_operations": law.operations,
            "found_at_once": tally.same,
            "found_elsewhere": tally.walked,
            "left_to_daqp": tally.missed,
            "tried": tally.tried,
            "longest_search": tally.longest,
        }


def _walk(family: Family, most: int | None) -> Walk:
    """Return the walk in C, or in numpy where it cannot be compiled."""
    try:
        return CompiledWalk(family, most)
    except (CompilerUnavailableError, CompilationError, CacheError):
        return InterpretedWalk(family, most)
