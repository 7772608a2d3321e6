"""ProxSuite: dense ProxQP on the condensed problem, persistent, vectors updated, warm start.

No MPC package, but what several robotics stacks solve their MPC with.
"""

import numpy as np
import proxsuite
from _condensed import PRICE, vectors

PACKAGES = ("proxsuite",)


def _step(task):
    n_d, m = task.n_d, len(task.G)
    soft = np.flatnonzero(np.isfinite(task.row_linear))
    k = soft.size
    unit = PRICE / task.row_linear[soft]
    hard = np.setdiff1d(np.arange(m), soft)
    h = hard.size
    give = np.diag(unit)
    # Rows: hard; soft from below, l <= G z + s; from above, G z - s <= u; slack itself.
    C = np.zeros((h + 3 * k, n_d + k))
    C[:h, :n_d] = task.G[hard]
    C[h : h + k, :n_d] = C[h + k : h + 2 * k, :n_d] = task.G[soft]
    C[h:, n_d:] = np.vstack([give, -give, np.eye(k)])
    H = np.zeros((n_d + k, n_d + k))
    H[:n_d, :n_d] = task.P
    H[n_d:, n_d:] = 2.0 * np.diag(task.row_quadratic[soft] * unit**2)
    g = np.full(n_d + k, PRICE)
    low, high = np.full(len(C), -1e20), np.full(len(C), 1e20)
    low[h + 2 * k :] = 0.0
    write = vectors(task, [np.arange(m), np.arange(m)])
    qp = proxsuite.proxqp.dense.QP(n_d + k, 0, len(C))
    qp.settings.eps_abs, qp.settings.eps_rel = 1e-7, 0.0
    qp.settings.initial_guess = proxsuite.proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
    solved = proxsuite.proxqp.QPSolverOutput.PROXQP_SOLVED
    n_u = task.n_u

    def fill(state, previous, reference, moved):
        g[:n_d], lower, upper = write(state, previous, reference, moved)
        low[:h], high[:h] = lower[hard], upper[hard]
        low[h : h + k], high[h + k : h + 2 * k] = lower[soft], upper[soft]

    fill(task.state[0], task.previous[0], task.reference[0], task.bounds(0))
    qp.init(H, g, None, None, C, low, high)
    qp.solve()  # before the first update, which would crash otherwise

    def step(state, previous, reference, moved):
        fill(state, previous, reference, moved)
        qp.update(g=g, l=low, u=high)
        qp.solve()
        return qp.results.x[:n_u] if qp.results.info.status == solved else np.nan

    return step


VARIANTS = {"dense": ("soft bounds, slack", _step)}
