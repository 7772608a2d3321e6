"""The condensed problem with explicit slack, for packages that take QPs and know no soft rows."""

import numpy as np

PRICE = 0.1
"""Linear price of the unit in which slack is measured: OSQP converges best with small ones."""
_FAR = 1e8


def parametrised(task):
    """Return the problem for cvxpy, its variable, its parameters q, l, u, and `vectors`.

    A side of a row that is infinite in every cycle is left out.
    """
    import cvxpy as cp

    z = cp.Variable(task.n_d, name="z")
    q = cp.Parameter(task.n_d, name="q")
    bounded = [np.flatnonzero(np.isfinite(task.rows[:, i]).any(axis=0)) for i in (0, 1)]
    low, high = cp.Parameter(len(bounded[0]), name="l"), cp.Parameter(len(bounded[1]), name="u")
    cost = cp.sum_squares(np.linalg.cholesky(task.P / 2).T @ z) + q @ z
    soft = np.isfinite(task.row_linear)
    count = int(soft.sum())
    give, s = np.zeros((len(task.G), count)), None
    if count:
        unit = PRICE / task.row_linear[soft]
        give[soft] = np.diag(unit)
        s = cp.Variable(count, name="s", nonneg=True)
        cost = cost + PRICE * cp.sum(s)
        curve = np.sqrt(task.row_quadratic[soft]) * unit
        if curve.any():
            cost = cost + cp.sum_squares(cp.multiply(curve, s))
    below, above = (task.G[rows] @ z for rows in bounded)
    if s is not None:
        below, above = below + give[bounded[0]] @ s, above - give[bounded[1]] @ s
    problem = cp.Problem(cp.Minimize(cost), [below >= low, above <= high])
    return problem, z, (q, low, high), vectors(task, bounded)


def vectors(task, bounded):
    """Return a function that gives q, l, u of a cycle: what any condensed QP needs.

    Args:
        task: see ``_harness.py``.
        bounded: rows with a lower, and with an upper bound.
    """
    n = task.n
    p = np.zeros(n + task.n_u)
    rows = [task.rows[0, i][bounded[i]] for i in (0, 1)]
    maps = [np.ascontiguousarray(task.row_map[b]) for b in bounded]

    def write(state, previous, reference, moved):
        if moved is not None:
            for i, far in ((0, -_FAR), (1, _FAR)):
                kept = moved.rows[i][bounded[i]]
                rows[i] = np.where(np.isfinite(kept), kept, far)
        p[:n], p[n:] = state, previous
        q = task.error_to_q @ (reference.reshape(-1) - task.free_map @ p)
        return q, rows[0] - maps[0] @ p, rows[1] - maps[1] @ p

    return write
