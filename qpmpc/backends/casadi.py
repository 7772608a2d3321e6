"""Solvers behind CasADi: ``casadi`` is DAQP, ``casadi:<plugin>`` another one that its wheel ships.

The force controller's matrices come from CasADi's differentiation too (`qpmpc.symbolic`). Of the
plugins in the wheel these are left out: clp and cbc, which want a linear program; superscs, which
gives no multipliers; fatrop, which prints past every redirection; hpipm, which runs into its limit
of iterations on problems of one stage. Some of the others fail now and then, and say so in their
summary; the library's check sees it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, ClassVar

import numpy as np

from qpmpc.arrays import Array
from qpmpc.backends._casadi_conic import ConicBackend
from qpmpc.backends._casadi_forms import Form, OneSlack, TwoSlacks
from qpmpc.backends._registry import describe, register_family, version
from qpmpc.backends.base import Backend, BackendInfo, LimitKind
from qpmpc.errors import BackendUnavailableError, UnknownNameError
from qpmpc.program import QuadraticProgram
from qpmpc.status import Status

_ITERATIONS: frozenset[LimitKind] = frozenset(("iterations",))
_PATIENCE = 10
"""DAQP's limit of iterations for each variable and row, where none is given. Proximal steps count
together; what they have not ended by then, the polish mends."""
_FLAT = 1e-6
"""Least eigenvalue of the Hessian below which DAQP needs proximal steps."""
_PROXIMAL = 0.005
"""Curvature of these steps. Less takes fewer of them and rounds worse, more the other way."""
_STILL = 2e-10
"""Length of a proximal step that ends them, as far as rounding lets steps become so short."""
_CLOSE = 1e-8
"""Tolerance of solvers whose answers are polished. Nowhere a relative one: beside a cost full of
penalties it would be wide."""


class CasadiDaqp(ConicBackend):
    """DAQP, set up anew at each solve by CasADi."""

    name: ClassVar[str] = "casadi"
    summary: ClassVar[str] = "DAQP behind CasADi, dual active set, cold; exact; all bounds"
    limits: ClassVar[frozenset[LimitKind]] = _ITERATIONS
    plugin: ClassVar[str] = "daqp"
    words: ClassVar[dict[str, Status]] = {
        "-1": Status.INFEASIBLE,
        "-3": Status.UNBOUNDED,
        "-4": Status.ITERATION_LIMIT,
    }
    exact: ClassVar[bool] = True

    def _formulate(self, qp: QuadraticProgram) -> Form:
        return OneSlack(qp)

    def _options(self) -> dict[str, Any]:
        form, eps = self._form, np.finfo(np.float64).eps
        patience = _PATIENCE * sum(form.A.shape)
        settings = {"primal_tol": 1e-9, "iter_limit": self._limits.iterations or patience}
        if np.linalg.eigvalsh(form.P)[0] < _FLAT:
            # A step is made of gradients over the curvature, and cannot be more exact than they.
            rounding = 64.0 * eps * float(np.abs(form.q).max()) / _PROXIMAL
            settings |= {"eps_prox": _PROXIMAL, "eta_prox": max(_STILL, rounding)}
        return {"daqp": settings}


class CasadiQpoases(ConicBackend):
    """qpOASES, hot-started from the last active set in a memory of its own."""

    name: ClassVar[str] = "casadi:qpoases"
    summary: ClassVar[str] = "qpOASES behind CasADi, parametric active set, hot-started; exact"
    warm_starts: ClassVar[bool] = True
    limits: ClassVar[frozenset[LimitKind]] = _ITERATIONS  # it passes over its limit of time
    plugin: ClassVar[str] = "qpoases"
    exact: ClassVar[bool] = True
    prints: ClassVar[bool] = True  # its licence, and its limits when it meets them

    def _formulate(self, qp: QuadraticProgram) -> Form:
        return OneSlack(qp)

    def _options(self) -> dict[str, Any]:
        options: dict[str, Any] = {"printLevel": "none"}
        if self._limits.iterations:
            options["nWSR"] = self._limits.iterations
        return options

    def forget(self) -> None:
        """Make the solver anew: the active set is in it."""
        self._open()


class CasadiProxqp(ConicBackend):
    """ProxQP on sparse matrices."""

    name: ClassVar[str] = "casadi:proxqp"
    summary: ClassVar[str] = "ProxQP behind CasADi, polished; now and then fails on long horizons"
    limits: ClassVar[frozenset[LimitKind]] = _ITERATIONS
    plugin: ClassVar[str] = "proxqp"

    def _formulate(self, qp: QuadraticProgram) -> Form:
        return TwoSlacks(qp)

    def _options(self) -> dict[str, Any]:
        settings = {"eps_abs": _CLOSE, "eps_rel": 0.0, "max_iter": self._limits.iterations or 200}
        return {"proxqp": settings | {"verbose": False, "backend": "sparse"}}

    def _adapt(self) -> None:
        # CasADi mixes up the multipliers of equations and inequalities: no row is an equation.
        np.nextafter(self._form.u, np.inf, out=self._form.u)


class CasadiPiqp(ConicBackend):
    """PIQP on dense matrices."""

    name: ClassVar[str] = "casadi:piqp"
    summary: ClassVar[str] = "PIQP behind CasADi, proximal interior point, cold, polished"
    limits: ClassVar[frozenset[LimitKind]] = _ITERATIONS
    plugin: ClassVar[str] = "piqp"

    def _formulate(self, qp: QuadraticProgram) -> Form:
        self._free = np.zeros(qp.m, dtype=np.bool_)
        return TwoSlacks(qp)

    def _options(self) -> dict[str, Any]:
        settings = {
            "eps_abs": _CLOSE, "eps_rel": 0.0,
            "eps_duality_gap_abs": _CLOSE, "eps_duality_gap_rel": 0.0,
            "max_iter": self._limits.iterations or 100,
        }  # fmt: skip
        return {"piqp": settings | {"verbose": False, "kkt_solver": "dense_cholesky"}}

    def _fill(self) -> None:
        super()._fill()
        self._moving[:, self._free] = 0.0

    def _adapt(self) -> None:
        # To rows without a bound PIQP does the same itself, and prints that it does.
        form = self._form
        free = (form.l == -np.inf) & (form.u == np.inf)
        if not np.array_equal(free, self._free):
            self._free = free
            self._fill()
        form.l[free], form.u[free] = -1.0, 1.0


class CasadiOsqp(ConicBackend):
    """OSQP, warm-started; CasADi has it factor its matrix anew at each solve."""

    name: ClassVar[str] = "casadi:osqp"
    summary: ClassVar[str] = "OSQP behind CasADi, operator splitting, warm, polished"
    warm_starts: ClassVar[bool] = True
    limits: ClassVar[frozenset[LimitKind]] = _ITERATIONS
    plugin: ClassVar[str] = "osqp"

    def _formulate(self, qp: QuadraticProgram) -> Form:
        return TwoSlacks(qp)

    def _options(self) -> dict[str, Any]:
        settings = {
            "eps_abs": 1e-5, "eps_rel": 0.0, "max_iter": self._limits.iterations or 500,
            "adaptive_rho_interval": 25, "check_termination": 25,
        }  # fmt: skip
        return {"osqp": settings | {"verbose": False}}

    def forget(self) -> None:
        """Start the next solve from zero."""
        for array in (self._x0, self._lam_x0, self._lam0):
            array.fill(0.0)

    def _settle(self, status: Status, q: Array, l: Array, u: Array) -> Status:  # noqa: E741
        if status in (Status.SOLVED, Status.INACCURATE, Status.ITERATION_LIMIT):
            np.copyto(self._x0, self._x)
            np.copyto(self._lam_x0, self._lam_x)
            np.copyto(self._lam0, self._lam)
        return super()._settle(status, q, l, u)


class _CasadisOwn(ConicBackend):
    """What CasADi's own two solvers have in common."""

    limits: ClassVar[frozenset[LimitKind]] = _ITERATIONS
    prints: ClassVar[bool] = True

    def _formulate(self, qp: QuadraticProgram) -> Form:
        return TwoSlacks(qp)

    def _options(self) -> dict[str, Any]:
        quiet = {"print_iter": False, "print_header": False, "print_info": False}
        return quiet | {"max_iter": self._limits.iterations or 200}


class CasadiQrqp(_CasadisOwn):
    """CasADi's own active-set solver, from cold: from warm it goes astray."""

    name: ClassVar[str] = "casadi:qrqp"
    summary: ClassVar[str] = "CasADi's own active set, cold, polished; fails at times"
    plugin: ClassVar[str] = "qrqp"


class CasadiIpqp(_CasadisOwn):
    """CasADi's own interior-point solver."""

    name: ClassVar[str] = "casadi:ipqp"
    summary: ClassVar[str] = "CasADi's own interior point, cold, polished; fails at times"
    plugin: ClassVar[str] = "ipqp"


class CasadiHighs(ConicBackend):
    """HiGHS' active-set solver."""

    name: ClassVar[str] = "casadi:highs"
    summary: ClassVar[str] = (
        "HiGHS behind CasADi, active set, cold, polished; takes ms, fails at times"
    )
    limits: ClassVar[frozenset[LimitKind]] = _ITERATIONS
    plugin: ClassVar[str] = "highs"
    prints: ClassVar[bool] = True

    def _formulate(self, qp: QuadraticProgram) -> Form:
        return TwoSlacks(qp)

    def _options(self) -> dict[str, Any]:
        # No limit of time: HiGHS counts it over all solves of an object.
        iterations = self._limits.iterations or 2000
        return {"highs": {"output_flag": False, "qp_iteration_limit": iterations}}


class CasadiIpopt(ConicBackend):
    """IPOPT, through CasADi's way of handing a QP to a solver of nonlinear programs."""

    name: ClassVar[str] = "casadi:nlpsol"
    summary: ClassVar[str] = "IPOPT behind CasADi, polished; slow: ten milliseconds and more"
    limits: ClassVar[frozenset[LimitKind]] = frozenset(("iterations", "time"))
    plugin: ClassVar[str] = "nlpsol"

    def _formulate(self, qp: QuadraticProgram) -> Form:
        return TwoSlacks(qp)

    def _options(self) -> dict[str, Any]:
        settings: dict[str, Any] = {
            "tol": _CLOSE, "max_iter": self._limits.iterations or 200, "mu_strategy": "adaptive",
            "jac_c_constant": "yes", "jac_d_constant": "yes", "hessian_constant": "yes",
            "print_level": 0, "sb": "yes",
        }  # fmt: skip
        if self._limits.time:
            settings["max_wall_time"] = self._limits.time
        quiet = {"print_time": False, "show_eval_warnings": False}
        return {"nlpsol": "ipopt", "nlpsol_options": quiet | {"ipopt": settings}}


_KINDS: dict[str, type[ConicBackend]] = {
    "": CasadiDaqp,
    "daqp": CasadiDaqp,
    "highs": CasadiHighs,
    "ipqp": CasadiIpqp,
    "nlpsol": CasadiIpopt,
    "osqp": CasadiOsqp,
    "piqp": CasadiPiqp,
    "proxqp": CasadiProxqp,
    "qpoases": CasadiQpoases,
    "qrqp": CasadiQrqp,
}


class CasadiFamily:
    """The QP solvers in CasADi's wheel."""

    name = "casadi"

    def variants(self) -> Iterable[BackendInfo]:
        """Return every variant, without importing CasADi."""
        return [describe(kind) for variant, kind in _KINDS.items() if variant != "daqp"]

    def backend(self, variant: str) -> type[Backend]:
        """Return the class of a variant; DAQP's for an empty one.

        Raises:
            UnknownNameError: there is none. BackendUnavailableError: CasADi is not installed.
        """
        if variant not in _KINDS:
            names = [info.name for info in self.variants()]
            raise UnknownNameError("backend", f"{self.name}:{variant}", names)
        kind = _KINDS[variant]
        if version(kind.package) is None:
            raise BackendUnavailableError(kind.name, f"pip install {kind.package}")
        return kind


register_family(CasadiFamily())
