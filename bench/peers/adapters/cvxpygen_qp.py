"""cvxpygen: C for the condensed problem, generated and compiled once; parameters in each cycle.

The parameters are the free response's error and the vectors of the rows, so that the generated code
has nothing to multiply; what numpy does for them is on the clock.
"""

import importlib
import sys
from pathlib import Path

import cvxpy as cp
import numpy as np
from cvxpygen import cpg

PACKAGES = ("cvxpygen", "cvxpy")


def problem_of(task):
    """Return the problem of cvxpy and its parameters ``q (n_d,)``, ``l (m,)``, ``u (m,)``.

    A side of a row that is infinite in every cycle is left out.
    """
    z = cp.Variable(task.n_d, name="z")
    q = cp.Parameter(task.n_d, name="q")
    bounded = [np.flatnonzero(np.isfinite(task.rows[:, i]).any(axis=0)) for i in (0, 1)]
    low, high = (cp.Parameter(len(b), name=name) for b, name in zip(bounded, ("l", "u")))
    root = np.linalg.cholesky(task.P / 2).T
    cost = cp.sum_squares(root @ z) + q @ z
    soft = np.isfinite(task.row_linear)
    give = np.zeros((len(task.G), int(soft.sum())))
    give[soft] = np.eye(int(soft.sum()))
    limits = []
    s = None
    if soft.any():
        s = cp.Variable(int(soft.sum()), name="s", nonneg=True)
        cost = cost + task.row_linear[soft] @ s
        if task.row_quadratic[soft].any():
            cost = cost + cp.sum_squares(cp.multiply(np.sqrt(task.row_quadratic[soft]), s))
    for rows, parameter, sign in ((bounded[0], low, 1.0), (bounded[1], high, -1.0)):
        side = task.G[rows] @ z
        if s is not None:
            side = side + sign * (give[rows] @ s)
        limits.append(side >= parameter if sign > 0 else side <= parameter)
    return cp.Problem(cp.Minimize(cost), limits), z, (q, low, high), bounded


def vectors(task, bounded):
    """Return a function that gives q, l, u of a cycle: what any condensed QP needs."""
    n = task.n
    p = np.zeros(n + task.n_u)
    rows = [task.rows[0, i][bounded[i]] for i in (0, 1)]
    maps = [np.ascontiguousarray(task.row_map[b]) for b in bounded]

    def write(state, previous, reference, moved):
        if moved is not None:
            for i, far in ((0, -1e8), (1, 1e8)):
                kept = moved.rows[i][bounded[i]]
                rows[i] = np.where(np.isfinite(kept), kept, far)
        p[:n], p[n:] = state, previous
        q = task.error_to_q @ (reference.reshape(-1) - task.free_map @ p)
        return q, rows[0] - maps[0] @ p, rows[1] - maps[1] @ p

    return write


def _step(task, solver, options):
    problem, z, parameters, bounded = problem_of(task)
    write = vectors(task, bounded)
    for parameter, value in zip(
        parameters,
        write(task.state[0], task.previous[0], task.reference[0], task.bounds(0)),
    ):
        parameter.value = value
    code = f"code_{solver.lower()}"
    if not Path(code).is_dir() or not list(Path(code).glob("cpg_module*.so")):
        cpg.generate_code(problem, code_dir=code, solver=solver, prefix=solver.lower())
    sys.path.insert(0, str(Path.cwd()))
    module = importlib.import_module(f"{code}.cpg_solver")
    problem.register_solve("CPG", module.cpg_solve)
    q, low, high = parameters
    n_u = task.n_u
    names = [p.name() for p in parameters if p.size]

    def step(state, previous, reference, moved):
        q.value, low.value, high.value = write(state, previous, reference, moved)
        problem.solve(method="CPG", updated_params=names, **options)
        return z.value[:n_u] if problem.status in ("optimal", "solved") else np.nan

    return step


VARIANTS = {
    "OSQP": (
        "soft bounds, slack",
        lambda task: _step(
            task, "OSQP", {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 20000, "warm_start": True}
        ),
    ),
    "QOCO": ("soft bounds, slack", lambda task: _step(task, "QOCO", {})),
}
