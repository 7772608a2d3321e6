"""What is particular to each solver behind qpsolvers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True)
class Variant:
    """A solver that pip installs as an extra of qpsolvers."""

    package: str
    """Its distribution."""
    summary: str
    """What it is and how it solves."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Its settings, as qpsolvers hands them on; those apply that the installed version has."""
    iterations: str = ""
    """Name of its limit of iterations, where it has one."""
    time: str = ""
    """Name of its limit of time [s], where it has one."""
    definite: bool = False
    """Whether it wants a positive definite Hessian."""
    extra: str = ""
    """Name of qpsolvers' extra that installs it, where it is not the solver's own."""


def _all(value: float, *names: str) -> dict[str, Any]:
    return dict.fromkeys(names, value)


# Left out: those that pip does not install (HPIPM, NPPro, PDHCG, qpOASES, qpSWIFT), and those that
# print their licence whatever one asks (COPT, Gurobi, MOSEK).
VARIANTS = {
    "clarabel": Variant(
        "clarabel",
        "Clarabel, interior point",
        _all(1e-10, "tol_feas", "tol_gap_abs", "tol_gap_rel") | {"max_threads": 1},
        iterations="max_iter",
        time="time_limit",
    ),
    "cvxopt": Variant(
        "cvxopt",
        "CVXOPT, interior point",
        _all(1e-10, "feastol", "abstol", "reltol"),
        iterations="maxiters",
    ),
    "daqp": Variant(
        "daqp",
        "DAQP, dual active set",
        {"primal_tol": 1e-9},
        iterations="iter_limit",
        time="time_limit",
    ),
    "ecos": Variant(
        "ecos",
        "ECOS, interior point for cones",
        _all(1e-10, "feastol", "abstol", "reltol"),
        iterations="max_iters",
        definite=True,
    ),
    "highs": Variant(
        "highspy",
        "HiGHS, active set",
        # On nearly dependent rows it goes round in circles.
        _all(1e-10, "primal_feasibility_tolerance", "dual_feasibility_tolerance")
        | {"time_limit": 1.0},
        iterations="qp_iteration_limit",
        time="time_limit",
    ),
    "jaxopt_osqp": Variant(
        "jaxopt",
        "OSQP in JAX, seconds a solve",
        {"tol": 1e-6},
        iterations="maxiter",
        extra="jaxopt",
    ),
    "kvxopt": Variant(
        "kvxopt",
        "KVXOPT, interior point",
        _all(1e-10, "feastol", "abstol", "reltol"),
        iterations="maxiters",
    ),
    "osqp": Variant(
        "osqp",
        "OSQP, operator splitting",
        # Scaling is done before; the default interval of rho's adaptation follows the clock.
        _all(1e-5, "eps_abs", "eps_rel") | {"scaling": 0, "rho": 1.0, "adaptive_rho_interval": 25},
        iterations="max_iter",
        time="time_limit",
    ),
    "piqp": Variant(
        "piqp",
        "PIQP, proximal interior point",
        _all(1e-10, "eps_abs", "eps_duality_gap_abs")
        | _all(1e-13, "eps_rel", "eps_duality_gap_rel"),
        iterations="max_iter",
    ),
    "proxqp": Variant(
        "proxsuite",
        "ProxQP, augmented Lagrangian",
        # Its own limit lets it run for minutes where the cost has no lower end.
        {"eps_abs": 1e-9, "eps_rel": 0.0, "max_iter": 100},
        iterations="max_iter",
    ),
    "pyqpmad": Variant(
        "pyqpmad",
        "qpmad, dual active set",
        {"tolerance": 1e-10},
        iterations="max_iter",
        definite=True,
    ),
    "qpalm": Variant(
        "qpalm",
        "QPALM, augmented Lagrangian",
        # With its own 1e-5 feasible problems count as infeasible.
        _all(1e-10, "eps_abs", "eps_rel", "eps_prim_inf", "eps_dual_inf"),
        iterations="max_iter",
        time="time_limit",
    ),
    "qpax": Variant("qpax", "qpax in JAX, interior point, seconds a solve", {"solver_tol": 1e-6}),
    "qtqp": Variant(
        "qtqp", "QTQP, interior point", _all(1e-10, "atol", "rtol"), iterations="max_iter"
    ),
    "quadprog": Variant("quadprog", "quadprog, dual active set", definite=True),
    "scs": Variant(
        "scs",
        "SCS, operator splitting for cones",
        _all(1e-9, "eps_abs", "eps_rel"),
        iterations="max_iters",
        time="time_limit_secs",
    ),
    "sip": Variant(
        "sip_qp_python",
        "SIP, interior point",
        _all(1e-10, "eps_abs", "eps_rel"),
        iterations="max_iterations",
        time="time_limit",
    ),
}
