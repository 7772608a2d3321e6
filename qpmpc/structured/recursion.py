"""The Riccati recursion: P of a QP in stages, factored once, applied in one pass there and back.

With S the cost to go,

    Lambda_i = R + G' S_{i+1} G,   K_i = -Lambda_i^{-1} G' S_{i+1} F,
    S_i = Q + F' S_{i+1} (F + G K_i)

the decision that minimises 1/2 z' P z + q' z is

    z_i = K_i s_i - Lambda_i^{-1} (G' p_{i+1} + q_i)

with p from a pass backwards. In other words ``P = M' Lambda M`` with ``(M z)_i = z_i - K_i s_i``.
If P is taken for an inverse covariance, z is noise that went through the closed loop, which gives
the size of every row: ``a P^{-1} a'`` is the variance of what it reads.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qpmpc.arrays import Array
from qpmpc.structured.program import StagePart


@dataclass(frozen=True, eq=False)
class Recursion:
    """The constant part of the recursion; from step N_u on nothing is decided, and gains are 0."""

    closed: Array
    """F + G K_i, ``(N, n, n)``."""
    gain: Array
    """K_i, ``(N, m, n)``."""
    inverse: Array
    """Lambda_i^{-1}, ``(N, m, m)``."""
    noise: Array
    """G Lambda_i^{-1} G', ``(N, n, n)``."""
    covariance: Array
    """Of the states s(1) ... s(N), ``(N, n, n)``."""


def recursion(part: StagePart) -> Recursion:
    """Factor the quadratic cost of a part."""
    N, n, m = part.horizon, part.n, part.m
    F, F_held, G = part.dynamics.F, part.dynamics.F_held, part.dynamics.G
    Q = 2.0 * part.output.T @ (part.output_weight[:, None] * part.output)
    R = 2.0 * np.diag(part.decision_weight)
    closed, gain, inverse = np.zeros((N, n, n)), np.zeros((N, m, n)), np.zeros((N, m, m))
    S = Q
    for i in range(N - 1, -1, -1):
        if i < part.moves:
            inverse[i] = np.linalg.inv(R + G.T @ S @ G)
            inverse[i] = (inverse[i] + inverse[i].T) / 2
            gain[i] = -inverse[i] @ (G.T @ S @ F)
            closed[i] = F + G @ gain[i]
            S = Q + closed[i].T @ S @ closed[i] + gain[i].T @ R @ gain[i]
        else:
            closed[i] = F_held
            S = Q + F_held.T @ S @ F_held
        S = (S + S.T) / 2
    noise = G @ inverse @ G.T
    covariance, present = np.zeros((N, n, n)), np.zeros((n, n))
    for i in range(N):
        present = closed[i] @ present @ closed[i].T + noise[i]
        covariance[i] = present = (present + present.T) / 2
    return Recursion(closed, gain, inverse, noise, covariance)
