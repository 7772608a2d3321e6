"""Clarabel: an interior-point method (Goulart, Chen, arXiv:2405.12762, 2024), always from cold.

Clarabel takes ``A x + s = b`` with ``s`` in cones. A bound at infinity spoils its steps whatever
number stands for it, and a row whose two bounds are the same, written as two inequalities, leaves
it no interior. So the first are left out and the second go to the zero cone; while the bounds keep
their layout, a solve updates vectors only.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from scipy import sparse

from qpmpc.arrays import Array
from qpmpc.backends._cold import Attempt, ColdBackend, Setup
from qpmpc.backends._layout import Layout
from qpmpc.backends._registry import register
from qpmpc.backends.base import LimitKind, Limits
from qpmpc.program import QuadraticProgram, SlackForm
from qpmpc.status import Status

_SETTINGS = {
    "verbose": False,
    "presolve_enable": False,  # no update is possible where it took something out
    "max_threads": 1,
    "tol_feas": 1e-10,
    "tol_gap_abs": 1e-12,
    "tol_gap_rel": 1e-12,
    "tol_infeas_rel": 1e-12,  # at 1e-8 a soft row far out of reach counts as a contradiction
}


@register
class ClarabelBackend(ColdBackend):
    """Clarabel, persistent, each solve from cold."""

    name: ClassVar[str] = "clarabel"
    package: ClassVar[str] = "clarabel"
    summary: ClassVar[str] = "Clarabel, interior point, each solve from cold; all bounds"
    limits: ClassVar[frozenset[LimitKind]] = frozenset(("iterations", "time"))
    smallest_part: ClassVar[int] = 24  # it works on what is not zero: a block more costs little

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Set the solver up for the bounds that ``qp`` has.

        Raises:
            BackendSetupError: P is not positive semidefinite.
        """
        import clarabel  # noqa: PLC0415 - only this backend needs it

        self._clarabel: Any = clarabel
        self._settings = clarabel.DefaultSettings()
        given = {"max_iter": limits.iterations, "time_limit": limits.time}
        for name, value in (_SETTINGS | given).items():
            if value is not None:
                setattr(self._settings, name, value)
        super().__init__(qp, limits)

    def _setup(self, layout: Layout) -> Setup:
        return _Setup(self._clarabel, self._settings, self._form, layout)


class _Setup:
    """Clarabel for one layout: rows with equal bounds, then lower bounds, then upper ones."""

    def __init__(self, clarabel: Any, settings: Any, form: SlackForm, layout: Layout) -> None:
        outcome = clarabel.SolverStatus
        self._status = {
            outcome.Solved: Status.SOLVED,
            outcome.PrimalInfeasible: Status.INFEASIBLE,
            outcome.DualInfeasible: Status.UNBOUNDED,
            outcome.AlmostDualInfeasible: Status.UNBOUNDED,
            outcome.MaxIterations: Status.ITERATION_LIMIT,
            outcome.MaxTime: Status.ITERATION_LIMIT,
        }
        self._clarabel, self._settings = clarabel, settings
        self._form, self._layout = form, layout
        self._parts = (layout.equal, layout.lower, layout.upper)
        sizes = [part.size for part in self._parts]
        at = np.cumsum([0, *sizes])
        self._slices = [slice(at[i], at[i + 1]) for i in range(3)]
        self._rows, self._sign = np.concatenate(self._parts), np.repeat([1.0, -1.0, 1.0], sizes)
        self._filled = np.zeros((self._rows.size, form.q.size), dtype=np.bool_)
        self._b, self._y = np.zeros(self._rows.size), np.zeros(form.l.size)
        self.stale = False
        self._build()

    def run(self) -> Attempt:
        """Hand Clarabel the form's vectors, and its rows where they are stale."""
        if self.stale:
            self._replace()
        self._solver.update(q=self._form.q, b=self._bounds())
        result = self._solver.solve()
        z, n_equal = np.array(result.z), self._layout.equal.size
        return Attempt(
            self._status.get(result.status, Status.INACCURATE),
            np.array(result.x),
            self._layout.multipliers(z[:n_equal], z[n_equal:], self._y),
            result.iterations,
        )

    def _build(self) -> None:
        """Set Clarabel up; entries that once were other than zero may be so again."""
        self._filled |= self._form.A[self._rows] != 0
        column, row = np.nonzero(self._filled.T)
        self._entries, self._signs = (self._rows[row], column), self._sign[row]
        n = self._form.q.size
        starts = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=n))])
        A = sparse.csc_matrix((self._values(), row, starts), (self._rows.size, n))
        n_equal = self._layout.equal.size
        cones = [
            self._clarabel.ZeroConeT(n_equal),
            self._clarabel.NonnegativeConeT(self._rows.size - n_equal),
        ]
        self._solver = self._clarabel.DefaultSolver(
            sparse.csc_matrix(np.triu(self._form.P)),
            self._form.q, A, self._bounds(), cones, self._settings,
        )  # fmt: skip

    def _replace(self) -> None:
        """Take the form's rows: in place, where no new entry is other than zero."""
        if ((self._form.A[self._rows] != 0) > self._filled).any():
            self._build()
        else:
            self._solver.update(A=self._values())
        self.stale = False

    def _values(self) -> Array:
        values: Array = self._signs * self._form.A[self._entries]
        return values

    def _bounds(self) -> Array:
        b, form = self._b, self._form
        for bound, part, where in zip(
            (form.u, form.l, form.u), self._parts, self._slices, strict=True
        ):
            np.take(bound, part, out=b[where])
        np.negative(b[self._slices[1]], out=b[self._slices[1]])
        return b
