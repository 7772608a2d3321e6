"""Solvers behind qpsolvers (Caron et al.): ``qpsolvers:<name>``, each solve built from nothing.

qpsolvers keeps no solver between calls, so each solve is a cold start on a problem that is built
anew; what the building takes is told apart from the solve. A solver that has a backend of its own
is faster through that.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping
from functools import cache
from time import perf_counter
from typing import Any, ClassVar, cast

import numpy as np
from scipy import sparse

from qpmpc.backends._cold import Attempt, ColdBackend, Setup
from qpmpc.backends._layout import Layout
from qpmpc.backends._qpsolvers_table import VARIANTS
from qpmpc.backends._registry import register_family, version
from qpmpc.backends.base import Backend, BackendInfo, LimitKind, Limits
from qpmpc.errors import BackendSetupError, BackendUnavailableError, UnknownNameError
from qpmpc.program import QuadraticProgram, SlackForm
from qpmpc.status import Status

_CHOICE = ("quadprog", "daqp", "piqp", "clarabel")
"""What plain ``qpsolvers`` means: the first of these that is installed."""
_CURVATURE = 1e-6
"""Curvature of slack where a solver wants one and the penalty has none; the polish takes its effect
out again."""
_DEFINITE = 1e-10
"""Least eigenvalue of a definite P, relative to the largest."""
_IDLE = 1.0
"""Bound of the row that bounds nothing."""


class QpsolversBackend(ColdBackend):
    """A solver behind qpsolvers; a subclass for each variant."""

    variant: ClassVar[str]
    """qpsolvers' name of the solver."""

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Prepare the constant part, and find out which settings the solver takes.

        Raises:
            BackendSetupError: P is not semidefinite, or not definite where the solver wants that;
                the solver does not take a limit, or cannot be imported.
        """
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import qpsolvers  # noqa: PLC0415 - only this backend needs it

        if self.variant not in qpsolvers.available_solvers:
            raise BackendSetupError(self.name, "qpsolvers cannot import it")
        self._call, it = _Call(self.variant, _accepted(self.variant)), VARIANTS[self.variant]
        for name, value in ((it.iterations, limits.iterations), (it.time, limits.time)):
            if value is not None:
                self._call.options[name] = value
        if not self._call.works():
            raise BackendSetupError(self.name, "the installed version does not take its limits")
        P = SlackForm(qp).P
        if it.definite:
            eigenvalues = np.linalg.eigvalsh(qp.P)
            if not eigenvalues[0] > _DEFINITE * eigenvalues[-1]:
                raise BackendSetupError(self.name, "wants a positive definite P")
            slack = np.arange(qp.n, P.shape[0])
            P[slack, slack] = np.maximum(P[slack, slack], _CURVATURE)
        self._P = self._call.matrix(P)
        super().__init__(qp, limits)

    def _setup(self, layout: Layout) -> Setup:
        return _Setup(self._call, self._P, self._form, layout)


class _Call:
    """Calls of one solver, none of which is to be heard."""

    def __init__(self, variant: str, options: Mapping[str, Any]) -> None:
        import qpsolvers  # noqa: PLC0415 - only this family needs it

        self._qpsolvers: Any = qpsolvers
        self._variant, self.options = variant, dict(options)
        dense = variant in qpsolvers.dense_solvers
        self.matrix: Any = np.ascontiguousarray if dense else sparse.csc_matrix

    def __call__(self, *problem: Any) -> Any:
        """Build the problem from ``P, q, G, h, A, b``, solve it, and return qpsolvers' answer."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return self._qpsolvers.solve_problem(
                self._qpsolvers.Problem(*problem), self._variant, **self.options
            )

    def works(self) -> bool:
        """Whether a small problem is solved without an error."""
        one = self.matrix(np.eye(1))
        try:
            self(one, np.zeros(1), one, np.ones(1))
        except Exception:  # whatever it raises: it does not work
            return False
        return True


@cache
def _accepted(variant: str) -> Mapping[str, Any]:
    """Return the settings that the installed version of the solver takes."""
    call = _Call(variant, {})
    for name, value in VARIANTS[variant].options.items():
        call.options[name] = value
        if not call.works():
            del call.options[name]
    return call.options


class _Setup:
    """Matrices of qpsolvers' form for one layout."""

    def __init__(self, call: _Call, P: Any, form: SlackForm, layout: Layout) -> None:
        self._call, self._P, self._form, self._layout = call, P, form, layout
        self._y = np.zeros(form.l.size)
        self._build()

    def run(self) -> Attempt:
        """Build the problem and solve it."""
        form, layout, begin = self._form, self._layout, perf_counter()
        if self.stale:
            self._build()
        h = np.concatenate([-form.l[layout.lower], form.u[layout.upper]])
        b = None if self._A is None else form.u[layout.equal]
        build = perf_counter() - begin
        x, y = np.full(form.q.size, np.nan), self._y
        try:
            found = self._call(
                self._P, form.q.copy(), self._G, h if h.size else np.full(1, _IDLE), self._A, b
            )
        except Exception:  # twenty solvers, each with errors of its own
            return Attempt(Status.INACCURATE, x, y, 0, build)
        if found.x is not None:
            x = np.array(found.x, dtype=float)
        z = np.zeros(h.size) if found.z is None else np.array(found.z, dtype=float)[: h.size]
        equal = np.zeros(layout.equal.size) if b is None or found.y is None else found.y
        return Attempt(
            Status.SOLVED if found.found else _why(found.extras),
            x,
            layout.multipliers(equal, z, y),
            _iterations(found.extras),
            build + (found.build_time or 0.0),
        )

    def _build(self) -> None:
        form, layout, matrix = self._form, self._layout, self._call.matrix
        G = np.vstack([-form.A[layout.lower], form.A[layout.upper]])
        # Not every solver takes a problem without inequalities: then one that bounds nothing.
        self._G = matrix(G if G.size else np.zeros((1, form.q.size)))
        self._A = matrix(form.A[layout.equal]) if layout.equal.size else None
        self.stale = False


def _why(extras: dict[str, Any]) -> Status:
    """Return whether a limit stopped the solver, FAILED where qpsolvers does not hand on its word.

    Nothing else is believed: several call rows contradictory that are not.
    """
    info = extras.get("info", extras.get("sip_output"))
    words = [extras.get("status"), extras.get("infostring")]
    words += [getattr(info, "status", None), getattr(info, "exit_status", None)]
    said = "".join(str(word) for word in words if word not in (None, "unknown"))
    said = said.lower().replace(" ", "").replace("_", "")
    if not said:
        return Status.FAILED
    return Status.ITERATION_LIMIT if "iter" in said or "time" in said else Status.INACCURATE


def _iterations(extras: dict[str, Any]) -> int:
    """Return how many iterations it took, 0 where qpsolvers does not hand it on."""
    info = extras.get("info", extras.get("sip_output"))
    for name in ("iter", "iterations", "num_iterations", "iter_num"):
        count = extras.get(name, getattr(info, name, None))
        if count is not None:
            return int(np.max(count))
    return 0


class QpsolversFamily:
    """The solvers that pip installs as extras of qpsolvers."""

    name = "qpsolvers"

    def variants(self) -> Iterable[BackendInfo]:
        """Return every variant, with its own package's version where both are installed."""
        for variant in VARIANTS:
            kind = _kind(variant)
            yield BackendInfo(
                kind.name,
                kind.summary,
                kind.package,
                version(kind.package) if version(self.name) else None,
                _install(variant),
                kind.warm_starts,
                kind.replaces_rows,
                kind.limits,
            )

    def backend(self, variant: str) -> type[Backend]:
        """Return the class of a variant; for an empty one that of the best that is installed.

        Raises:
            UnknownNameError: there is none. BackendUnavailableError: it is not installed.
        """
        if not variant:
            installed = [name for name in _CHOICE if version(VARIANTS[name].package)]
            variant = (installed or _CHOICE)[0]
        if variant not in VARIANTS:
            valid = [f"{self.name}:{name}" for name in VARIANTS]
            raise UnknownNameError("backend", f"{self.name}:{variant}", valid)
        kind = _kind(variant)
        if version(self.name) is None or version(kind.package) is None:
            raise BackendUnavailableError(kind.name, _install(variant))
        return kind


def _install(variant: str) -> str:
    return f"pip install qpsolvers[{VARIANTS[variant].extra or variant}]"


@cache
def _kind(variant: str) -> type[QpsolversBackend]:
    it = VARIANTS[variant]
    has: dict[LimitKind, str] = {"iterations": it.iterations, "time": it.time}
    body = {
        "__doc__": f"{it.summary}, behind qpsolvers.",
        "__module__": __name__,
        "name": f"qpsolvers:{variant}",
        "package": it.package,
        "summary": f"{it.summary}; behind qpsolvers, built anew each time",
        "limits": frozenset(kind for kind, name in has.items() if name),
        "variant": variant,
    }
    name = f"Qpsolvers{variant.title().replace('_', '')}Backend"
    return cast(type[QpsolversBackend], type(name, (QpsolversBackend,), body))


register_family(QpsolversFamily())
