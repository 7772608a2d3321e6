"""Why a QP has no answer: for solvers that only say that they found none."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from qpmpc.arrays import Array

_TOLERANCE = 1e-7
"""How far rows of order one may be missed together and still count as met."""

_FALL = 1e-6
"""Slope, relative to the gradient, that is none."""


def contradictory(A: Array, l: Array, u: Array) -> bool:  # noqa: E741
    """Whether no x satisfies ``l <= A x <= u`` (rows of order one; ``l``, ``u`` may be infinite).

    Solves for the x with the least largest violation, a linear program that always has an answer.
    Takes milliseconds: nothing for a control cycle that has an answer.
    """
    upper, lower = np.isfinite(u), np.isfinite(l)
    rows = np.vstack([A[upper], -A[lower]])
    if not rows.size:
        return False
    n = A.shape[1]
    found = linprog(
        np.append(np.zeros(n), 1.0),
        A_ub=np.hstack([rows, -np.ones((rows.shape[0], 1))]),
        b_ub=np.concatenate([u[upper], -l[lower]]),
        bounds=[(None, None)] * n + [(0.0, None)],
        method="highs",
    )
    reach = 1.0 + max(np.abs(u[upper]).max(initial=0.0), np.abs(l[lower]).max(initial=0.0))
    return bool(found.status == 0 and found.fun > _TOLERANCE * reach)


def bottomless(P: Array, q: Array, A: Array, l: Array, u: Array) -> bool:  # noqa: E741
    """Whether the cost of a QP that has a feasible point falls without end.

    Solves for the steepest of the directions in which the cost is straight and every row holds
    however far one goes, a linear program that always has an answer. Soft rows must have been
    turned into hard ones (`SlackForm`).
    """
    found = linprog(
        q,
        A_ub=np.vstack([A[u < np.inf], -A[l > -np.inf]]),
        b_ub=np.zeros(np.count_nonzero(u < np.inf) + np.count_nonzero(l > -np.inf)),
        A_eq=P,
        b_eq=np.zeros(q.size),
        bounds=(-1.0, 1.0),
        method="highs",
    )
    return bool(found.status == 0 and found.fun < -_FALL * (1.0 + np.abs(q).max()))
