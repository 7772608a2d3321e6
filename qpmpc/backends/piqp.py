"""PIQP: a proximal interior-point method (Schwan et al., CDC 2023), always from cold.

PIQP takes ``A x = b`` apart from ``h_l <= G x <= h_u``, and empties for good a row of ``G`` that is
free on both sides. So rows that nothing bounds are left out, and rows with equal bounds go to
``A``; while the bounds keep their layout, a solve updates vectors only.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from qpmpc.arrays import Array, Indices
from qpmpc.backends._cold import Attempt, ColdBackend, Setup
from qpmpc.backends._layout import Layout
from qpmpc.backends._registry import register
from qpmpc.backends.base import LimitKind, Limits
from qpmpc.program import QuadraticProgram, SlackForm
from qpmpc.status import Status

_SETTINGS = {
    "verbose": False,
    "eps_abs": 1e-10,
    "eps_rel": 1e-13,
    "eps_duality_gap_abs": 1e-11,
    "eps_duality_gap_rel": 1e-13,
    "preconditioner_reuse_on_update": True,
}


@register
class PiqpBackend(ColdBackend):
    """PIQP's dense solver, persistent, each solve from cold; it has no limit of time."""

    name: ClassVar[str] = "piqp"
    package: ClassVar[str] = "piqp"
    summary: ClassVar[str] = "PIQP, proximal interior point, each solve from cold; all bounds"
    limits: ClassVar[frozenset[LimitKind]] = frozenset(("iterations",))

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Set the solver up for the bounds that ``qp`` has.

        Raises:
            BackendSetupError: P is not positive semidefinite.
        """
        import piqp  # noqa: PLC0415 - only this backend needs it

        self._piqp: Any = piqp
        self._settings: dict[str, Any] = dict(_SETTINGS)
        if limits.iterations is not None:
            self._settings["max_iter"] = limits.iterations
        super().__init__(qp, limits)

    def _setup(self, layout: Layout) -> Setup:
        return _Setup(self._piqp, self._settings, self._form, layout)


class _Setup:
    """PIQP for one layout."""

    def __init__(
        self, piqp: Any, settings: dict[str, Any], form: SlackForm, layout: Layout
    ) -> None:
        self._status = {
            piqp.PIQP_SOLVED: Status.SOLVED,
            piqp.PIQP_MAX_ITER_REACHED: Status.ITERATION_LIMIT,
            piqp.PIQP_PRIMAL_INFEASIBLE: Status.INFEASIBLE,
            piqp.PIQP_DUAL_INFEASIBLE: Status.UNBOUNDED,
        }
        self._form, self._equal = form, layout.equal
        self._lower, self._upper = layout.lower, layout.upper
        self._between = np.union1d(layout.lower, layout.upper)
        self._l, self._u = np.full(form.l.size, -np.inf), np.full(form.l.size, np.inf)
        self._y = np.zeros(form.l.size)
        self.stale = False
        self._solver = piqp.DenseSolver()
        for name, value in settings.items():
            setattr(self._solver.settings, name, value)
        self._solver.setup(
            np.asfortranarray(form.P), form.q,
            self._rows(self._equal), form.u[self._equal],
            self._rows(self._between), *self._bounds(),
        )  # fmt: skip

    def run(self) -> Attempt:
        """Hand PIQP the form's vectors, and its rows where they are stale."""
        form, equal, between, y = self._form, self._equal, self._between, self._y
        if self.stale:
            self._solver.update(A=self._rows(equal), G=self._rows(between))
            self.stale = False
        low, high = self._bounds()
        self._solver.update(c=form.q, b=form.u[equal], h_l=low, h_u=high)
        status = self._status.get(self._solver.solve(), Status.INACCURATE)
        result = self._solver.result
        y[equal] = result.y
        y[between] = result.z_u
        y[between] -= result.z_l
        return Attempt(status, result.x.copy(), y, result.info.iter)

    def _bounds(self) -> tuple[Array, Array]:
        """Return the bounds of the inequalities, without those that the layout leaves out."""
        self._l[self._lower] = self._form.l[self._lower]
        self._u[self._upper] = self._form.u[self._upper]
        return self._l[self._between], self._u[self._between]

    def _rows(self, which: Indices) -> Array:
        return np.asfortranarray(self._form.A[which])
