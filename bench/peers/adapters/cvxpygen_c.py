"""cvxpygen: C for the condensed problem, generated and compiled once; parameters in each cycle.

The parameters are the vectors of the QP, so that the generated code has nothing to multiply; what
numpy does for them is on the clock. Code that is there already is used again.
"""

import importlib
import sys
from pathlib import Path

import numpy as np
from _condensed import parametrised
from cvxpygen import cpg

PACKAGES = ("cvxpygen", "cvxpy")
_SOLVED = ("1", "solved", "optimal")
"""How statuses of answers begin."""


def _step(task, solver, options):
    problem, z, parameters, write = parametrised(task)
    first = write(task.state[0], task.previous[0], task.reference[0], task.bounds(0))
    for parameter, value in zip(parameters, first):
        parameter.value = value
    code = f"code_{solver.lower()}"
    if not list(Path(code).glob("cpg_module*.so")):
        cpg.generate_code(problem, code_dir=code, solver=solver, prefix=solver.lower())
    sys.path.insert(0, str(Path.cwd()))
    module = importlib.import_module(f"{code}.cpg_solver")
    problem.register_solve("CPG", module.cpg_solve)
    q, low, high = parameters
    n_u = task.n_u

    def step(state, previous, reference, moved):
        q.value, low.value, high.value = write(state, previous, reference, moved)
        problem.solve(method="CPG", updated_params=["q", "l", "u"], **options)
        return z.value[:n_u] if problem.status.startswith(_SOLVED) else np.nan

    return step


_OSQP = {"eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 4000, "warm_start": True}
VARIANTS = {
    "OSQP": ("soft bounds, slack", lambda task: _step(task, "OSQP", _OSQP)),
    "QOCO": ("soft bounds, slack", lambda task: _step(task, "QOCO", {})),
}
