"""What CasADi's ``conic`` solvers share: matrices and vectors in buffers that CasADi reads itself.

A call through CasADi's own matrices costs 16 to 22 us before the solver begins, one through a
buffer 0.4 to 0.7 us. Whether a solve succeeded is told by an exception: reading the statistics
costs 5 to 8 us, ``error_on_fail`` nothing where there is no error, and the answer is in the buffers
all the same. So the statistics are only read where a solver did not succeed.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout
from typing import Any, ClassVar

import numpy as np

from qpmpc.arrays import Array
from qpmpc.backends._casadi_forms import Form
from qpmpc.backends.base import Backend, Limits, RawSolution
from qpmpc.construction import Construction
from qpmpc.errors import BackendSetupError
from qpmpc.feasibility import bottomless, contradictory
from qpmpc.polish import Polish
from qpmpc.program import QuadraticProgram, SlackForm
from qpmpc.status import Status
from qpmpc.symbolic import CASADI

_COMMON = {"error_on_fail": True, "inputs_check": False, "print_time": False}
_WORDS = {
    "unbounded": Status.UNBOUNDED,
    "dual infeasible": Status.UNBOUNDED,
    "diverging": Status.UNBOUNDED,
    "infeasib": Status.INFEASIBLE,
    "max": Status.ITERATION_LIMIT,
    "limit": Status.ITERATION_LIMIT,
    "inaccurate": Status.INACCURATE,
    "acceptable": Status.INACCURATE,
}
"""What solvers say of how they ended, the first that fits."""
_HELD = 1e-6
"""How far a hard row of order one may be missed and still be no sign of contradiction."""
_NEAR = (Status.ITERATION_LIMIT, Status.INACCURATE)
_LOST = (*_NEAR, Status.FAILED)
"""What a polish may still mend."""
_EQUATIONS = 500
"""Systems of equations that a polish may solve."""
_ABSURD = 1e12
"""Size of a variable of order one that can only be what was in memory before."""


class _Nowhere(io.TextIOBase):
    """A stream that forgets what is written to it."""

    def write(self, text: str) -> int:
        return len(text)


_NOWHERE = _Nowhere()


@contextmanager
def _silence() -> Iterator[None]:
    """Drop what CasADi hands to Python's standard streams."""
    with redirect_stdout(_NOWHERE), redirect_stderr(_NOWHERE):
        yield


class ConicBackend(Backend):
    """A solver behind ``casadi.conic``; a subclass says which, how it is set, what it needs."""

    package: ClassVar[str] = "casadi"
    replaces_rows: ClassVar[bool] = True
    construction: ClassVar[Construction] = CASADI
    plugin: ClassVar[str]
    """What CasADi calls the solver."""
    words: ClassVar[dict[str, Status]] = _WORDS
    """What the solver says of how it ended."""
    prints: ClassVar[bool] = False
    """Whether it prints whatever it is told; CasADi hands that to Python's standard output."""
    exact: ClassVar[bool] = False
    """Whether it ends exactly or not at all: then its answers need no polish and its "infeasible"
    no proof."""

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Lay the buffers out, set the solver up and solve once.

        Raises:
            BackendSetupError: CasADi has no such solver here, or the solver refuses the problem.
        """
        self._limits = limits
        try:
            polish = Polish(qp)
        except np.linalg.LinAlgError as error:
            raise BackendSetupError(self.name, "P is not positive semidefinite") from error
        self._definite, self._plain = polish.definite, SlackForm(qp)
        self._polish, self._trusted = polish, self.exact and polish.definite
        self._form = form = self._formulate(qp)
        (m, n), self._n = form.A.shape, qp.n
        self._hard, self._A = np.flatnonzero(np.isinf(qp.linear)), np.array(qp.A)
        curved = (form.P != 0) | np.eye(n, dtype=np.bool_)
        self._curved = np.nonzero(curved.T)[::-1]  # rows and columns, column after column
        held = form.A != 0
        held[:, : qp.n] = True  # other rows may fill what is zero now
        self._held = np.nonzero(held.T)[::-1]
        self._h, self._a = form.P[self._curved], form.A[self._held]
        self._moving = self._a[: m * qp.n].reshape(qp.n, m)
        self._upper, self._x, self._lam = np.full(n, np.inf), np.zeros(n), np.zeros(m)
        self._lam_x, self._x0 = np.zeros(n), np.zeros(n)
        self._lam_x0, self._lam0 = np.zeros(n), np.zeros(m)
        self._y = np.zeros(qp.m)
        self._answer = RawSolution(Status.SOLVED, self._x[: qp.n], self._y, 0)
        self._open()
        self.solve(np.zeros(qp.n), np.full(qp.m, -1.0), np.full(qp.m, 1.0))

    def _formulate(self, qp: QuadraticProgram) -> Form:
        """Return the hard QP that the solver gets."""
        raise NotImplementedError

    def _options(self) -> dict[str, Any]:
        """Return the solver's settings."""
        raise NotImplementedError

    def _open(self) -> None:
        """Make the solver and hand it the buffers; it knows nothing of earlier solves."""
        import casadi as ca  # noqa: PLC0415 - only these backends need it

        form = self._form
        (m, n), (h_rows, h_columns), (a_rows, a_columns) = form.A.shape, self._curved, self._held
        shapes = {
            "h": ca.Sparsity.triplet(n, n, h_rows.tolist(), h_columns.tolist()),
            "a": ca.Sparsity.triplet(m, n, a_rows.tolist(), a_columns.tolist()),
        }
        if not ca.has_conic(self.plugin):
            raise BackendSetupError(self.name, f"this build of CasADi has no '{self.plugin}'")
        try:
            with _silence() if self.prints else nullcontext():
                solver = ca.conic("qp", self.plugin, shapes, _COMMON | self._options())
                made: Any = solver.buffer()
        except RuntimeError as error:
            raise BackendSetupError(self.name, str(error).splitlines()[-1]) from error
        self._buffer, self._run = made
        if self.prints:
            run = self._run

            def quietly() -> None:
                with _silence():
                    run()

            self._run = quietly
        given = {
            "h": self._h, "g": form.q, "a": self._a, "lba": form.l, "uba": form.u,
            "lbx": form.lower, "ubx": self._upper,
            "x0": self._x0, "lam_x0": self._lam_x0, "lam_a0": self._lam0,
        }  # fmt: skip
        for name, array in given.items():
            self._buffer.set_arg(solver.index_in(name), array.data)
        for name, array in (("x", self._x), ("lam_x", self._lam_x), ("lam_a", self._lam)):
            self._buffer.set_res(solver.index_out(name), array.data)

    def replace_rows(self, A: Array) -> None:
        """Write other rows into the buffer that the next solve reads."""
        np.copyto(self._A, A)
        self._form.replace_rows(A)
        self._plain.replace_rows(A)
        self._polish.replace_rows(self._A)
        self._fill()

    def _fill(self) -> None:
        """Write the form's rows into the solver's buffer."""
        np.copyto(self._moving, self._form.A[:, : self._n].T)

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Write the vectors into the buffers and solve. CasADi tells no iterations: always 0."""
        answer, form = self._answer, self._form
        form.update(q, l, u)
        np.maximum(form.l, form.u, out=form.u)  # crossed by rounding, some solvers throw or print
        self._adapt()
        try:
            self._run()
            status = Status.SOLVED
        except RuntimeError:
            status = self._said()
        y = form.multipliers(self._lam, self._y)
        answer.status = self._settle(status, q, l, u)
        y[(y > 0) & (u == np.inf) | (y < 0) & (l == -np.inf)] = 0.0  # no bound, no price
        return answer

    def _adapt(self) -> None:
        """Change what the solver cannot take in the vectors just written."""
        return

    def _settle(self, status: Status, q: Array, l: Array, u: Array) -> Status:  # noqa: E741
        """Return the status of the answer, given what the solver says; may better the answer."""
        if status is Status.SOLVED:
            if not self._trusted and not self._better(q, l, u) and self._endless(q, l, u):
                status = Status.UNBOUNDED
        elif status in _LOST and self._better(q, l, u):
            status = Status.SOLVED
        elif not (status is Status.INFEASIBLE and self._trusted):
            status = self._reason(status, q, l, u)
        return status

    def _reason(self, status: Status, q: Array, l: Array, u: Array) -> Status:  # noqa: E741
        """Return the status where a solver says that it did not succeed."""
        A, low, high = self._A[self._hard], l[self._hard], u[self._hard]
        if status in _NEAR:
            if not self._sane():  # DAQP, stopped before its first step
                self._x.fill(0.0)
            value = A @ self._answer.x
            if np.maximum(value - high, low - value).max(initial=0.0) <= _HELD:
                return Status.UNBOUNDED if self._endless(q, l, u) else status
        if contradictory(A, low, high):
            return Status.INFEASIBLE
        if status is Status.INFEASIBLE:  # it is not
            return Status.SOLVED if self._better(q, l, u) else Status.FAILED
        if status is Status.UNBOUNDED and self._definite:
            return Status.FAILED
        return status

    def _endless(self, q: Array, l: Array, u: Array) -> bool:  # noqa: E741
        """Whether it was no limit of the user's that was met, but a cost without a lower end."""
        if self._definite or self._limits != Limits():
            return False
        form = self._plain
        form.update(q, l, u)
        return bottomless(form.P, form.q, form.A, form.l, form.u)

    def _better(self, q: Array, l: Array, u: Array) -> bool:  # noqa: E741
        """Polish the answer of a solver that is not exact; whether it is exact now."""
        answer, polish, limits = self._answer, self._polish, self._limits
        if (limits != Limits() and not self._sane()) or limits.time is not None:
            return False
        if not self._sane():
            self._x.fill(0.0)
            answer.y.fill(0.0)
        polish.allow(limits.iterations or _EQUATIONS, np.inf)
        if not polish(q, l, u, answer.x, answer.y):
            return False
        np.copyto(answer.x, polish.x)
        np.copyto(answer.y, polish.y)
        return True

    def _sane(self) -> bool:
        """Whether the answer can be one: neither NaN nor absurd."""
        return bool(np.abs(self._x).max() < _ABSURD)

    def _said(self) -> Status:
        """Return what the solver says of how it ended."""
        try:
            statistics = self._buffer.stats()
        except RuntimeError:  # it did not come so far
            return Status.FAILED
        statistics = statistics.get("solver_stats", statistics)
        said = str(statistics.get("return_status", "")).lower().replace("_", " ")
        return next((status for word, status in self.words.items() if word in said), Status.FAILED)
