"""Whether rows contradict each other: for solvers that only say that they found nothing."""

from __future__ import annotations

import numpy as np
from scipy.optimize import linprog

from qpmpc.arrays import Array

_TOLERANCE = 1e-7
"""How far rows of order one may be missed together and still count as met."""


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
