"""cvxpy: the condensed problem with parameters, compiled to a cone program once (DPP)."""

import cvxpy as cp
import numpy as np
from _condensed import parametrised

PACKAGES = ("cvxpy", "osqp", "clarabel")


def _step(task, solver, options):
    problem, z, parameters, write = parametrised(task)
    assert problem.is_dcp(dpp=True)
    q, low, high = parameters
    n_u = task.n_u

    def step(state, previous, reference, moved):
        q.value, low.value, high.value = write(state, previous, reference, moved)
        problem.solve(solver=solver, **options)
        return z.value[:n_u] if problem.status == cp.OPTIMAL else np.nan

    return step


_OSQP = {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 4000, "warm_start": True}
VARIANTS = {
    "OSQP": ("soft bounds, slack", lambda task: _step(task, cp.OSQP, _OSQP)),
    "Clarabel": ("soft bounds, slack", lambda task: _step(task, cp.CLARABEL, {})),
}
