"""A QP in its connected components: three axes that nothing couples cost three small problems.

Two variables are connected where the Hessian or a row holds both. Each component gets a solver of
its own; components too small to be worth one are packed together.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from qpmpc.arrays import Array, Indices
from qpmpc.backends import Backend, Fact, Limits, RawSolution
from qpmpc.parametric import Parametric
from qpmpc.program import QuadraticProgram
from qpmpc.status import Status

Pattern = NDArray[np.bool_]

_EMPTY = 1e-9
"""How far zero may lie outside the bounds of a hard row that touches no variable."""
_SEVERITY = {
    status: rank
    for rank, status in enumerate(
        (
            Status.SOLVED,
            Status.INACCURATE,
            Status.ITERATION_LIMIT,
            Status.FAILED,
            Status.UNBOUNDED,
            Status.INFEASIBLE,
        )
    )
}


def worst(one: Status, other: Status) -> Status:
    """Return the graver of what two parts say."""
    return one if _SEVERITY[one] >= _SEVERITY[other] else other


def components(P: Pattern, A: Pattern, smallest: int) -> list[tuple[Indices, Indices]]:
    """Return variables and rows of each component, packed, in the order of their variables.

    Args:
        P: where the Hessian may be other than zero, ``(n, n)``.
        A: the same of the rows, ``(m, n)``. Rows that touch no variable are in no component.
        smallest: variables that make a component worth a solver call; it is packed with others
            below.
    """
    rows = csr_matrix(A.astype(np.int64))
    graph = csr_matrix(P.astype(np.int64)) + rows.T @ rows
    count, label = connected_components(graph, directed=False)
    sizes = np.bincount(label, minlength=count)
    pack, room = np.zeros(count, dtype=np.intp), 0
    for i in range(count):  # labels are in the order of the first variable of each
        if i and room <= 0:
            pack[i:] += 1
            room = 0
        room = (room or smallest) - sizes[i]
    label = pack[label]
    touched = A.any(axis=1)
    of_row = np.where(touched, label[A.argmax(axis=1)] if A.size else -1, -1)
    return [
        (np.flatnonzero(label == i), np.flatnonzero(of_row == i)) for i in range(int(pack[-1]) + 1)
    ]


class _Part:
    """One component: its share of the QP and its solver."""

    def __init__(
        self,
        kind: type[Backend],
        qp: QuadraticProgram,
        limits: Limits,
        variables: Indices,
        rows: Indices,
        *,
        parameters: Parametric | None,
    ) -> None:
        self.kind, self.limits, self.variables, self.rows = kind, limits, variables, rows
        self.qp = QuadraticProgram(
            qp.P[np.ix_(variables, variables)], qp.q[variables],
            qp.A[np.ix_(rows, variables)], qp.l[rows], qp.u[rows],
            qp.linear[rows], qp.quadratic[rows],
        )  # fmt: skip
        self.backend = kind(self.qp, limits)
        if parameters is not None:
            self.backend.expect(parameters.part(variables, rows))

    def replace_rows(self, A: Array) -> None:
        mine = A
        if A.shape != (self.qp.m, self.qp.n):
            mine = np.ascontiguousarray(A[np.ix_(self.rows, self.variables)])
        if self.kind.replaces_rows:
            self.backend.replace_rows(mine)
        else:
            self.backend = self.kind(replace(self.qp, A=mine), self.limits)


class Parts:
    """The solvers of a QP's components, which answer together."""

    def __init__(
        self,
        kind: type[Backend],
        qp: QuadraticProgram,
        limits: Limits,
        *,
        patterns: tuple[Pattern, Pattern],
        smallest: int | None,
        parameters: Parametric | None = None,
    ) -> None:
        """Split ``qp`` and set one ``kind`` up for each component.

        Args:
            kind, qp: the backend and the scaled program.
            limits: of the whole; time is shared out.
            patterns: where the Hessian, ``(n, n)``, and the rows, ``(m, n)``, may ever be other
                than zero, before scaling: that mixes variables, but those of one component only.
            smallest: part worth a call, see `components`; the backend's own figure if not given.
            parameters: what is known of the vectors to come, scaled; for backends that take it.

        Raises:
            BackendSetupError: the solver refuses a component.
        """
        found = components(*patterns, smallest or kind.smallest_part)
        share = Limits(limits.iterations, limits.time and limits.time / len(found))
        self._parts = [_Part(kind, qp, share, *indices, parameters=parameters) for indices in found]
        self._order = np.concatenate([part.variables for part in self._parts])
        self._row_order = np.concatenate([part.rows for part in self._parts])
        self._empty = np.setdiff1d(np.arange(qp.m), self._row_order)
        self._whole = len(self._parts) == 1 and not self._empty.size
        self._linear, self._quadratic = qp.linear[self._empty], qp.quadratic[self._empty]
        self._q, self._l, self._u = (
            np.zeros(k.size) for k in (self._order, *[self._row_order] * 2)
        )
        self._slices = []
        at = row = 0
        for part in self._parts:
            n, m = part.variables.size, part.rows.size
            self._slices.append((slice(at, at + n), slice(row, row + m)))
            at, row = at + n, row + m
        self._answer = RawSolution(Status.SOLVED, np.zeros(qp.n), np.zeros(qp.m), 0)

    def __len__(self) -> int:
        return len(self._parts)

    def replace_rows(self, A: Array) -> None:
        """Take other rows ``(m, n)``, within the pattern."""
        for part in self._parts:
            part.replace_rows(A)

    def forget(self) -> None:
        """Forget what the next solve would start from, in each component."""
        for part in self._parts:
            part.backend.forget()

    def prepare(self) -> None:
        """Do what can be done between two solves, in each component."""
        for part in self._parts:
            part.backend.prepare()

    def facts(self) -> list[Mapping[str, Fact]]:
        """Return what the backend tells of each component."""
        return [part.backend.facts() for part in self._parts]

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Solve all components; the status is the worst of theirs."""
        if self._whole:
            return self._parts[0].backend.solve(q, l, u)
        answer = self._answer
        np.take(q, self._order, out=self._q)
        np.take(l, self._row_order, out=self._l)
        np.take(u, self._row_order, out=self._u)
        answer.status, answer.iterations, answer.build_time = Status.SOLVED, 0, 0.0
        for part, (variables, rows) in zip(self._parts, self._slices, strict=True):
            raw = part.backend.solve(self._q[variables], self._l[rows], self._u[rows])
            answer.x[part.variables] = raw.x
            answer.y[part.rows] = raw.y
            answer.iterations += raw.iterations
            answer.build_time += raw.build_time
            answer.status = worst(answer.status, raw.status)
        if self._empty.size:
            self._settle_empty(l[self._empty], u[self._empty])
        return answer

    def _settle_empty(self, l: Array, u: Array) -> None:  # noqa: E741
        """Answer for rows without a variable: hard ones hold or do not, soft ones give way."""
        answer, hard = self._answer, np.isinf(self._linear)
        give = np.maximum(np.maximum(l, -u), 0.0)
        if (give[hard] > _EMPTY).any():
            answer.status = Status.INFEASIBLE
        price = np.where(hard, 0.0, self._linear) + 2.0 * self._quadratic * give
        answer.y[self._empty] = np.where(give > 0, np.where(u < 0, price, -price), 0.0)
