"""What the decision moves: the reachable part of the model, split into parts nothing couples.

States that no decision reaches (disturbance models, tissue) shape the free response only, and a
register that repeats another state adds nothing: both drop out here, whatever they stand for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from qpmpc.arrays import Array, Indices
from qpmpc.construction import Decision
from qpmpc.models import LinearModel

_RANK = 1e-9
"""Length, beside what it was before the known directions were taken out, that is rounding."""
_TOUCH = 1e-12
"""Response, beside the largest of the same quantity, below which an input does not act on it."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """A recursion from decisions to deviations from the free response.

    s(0) = 0,   s(i+1) = F s(i) + G z(i)  for i < N_u,   s(i+1) = F_held s(i)  after
    """

    F: Array
    """``(n, n)``."""
    F_held: Array
    """``(n, n)``."""
    G: Array
    """``(n, n_inputs)``."""

    @property
    def n(self) -> int:
        """Number of states."""
        return int(self.F.shape[0])


def joined_dynamics(model: LinearModel, decision: Decision, *, rates: bool) -> Dynamics:
    """Return the recursion of ``[x(i); u(i-1); Delta u(i-1)]`` under increments or commands.

    With the last command and its change among the states, every bound on commands, rates and
    outputs is one on the states of a step.

    Args:
        model, decision: as for `qpmpc.problem.Problem`.
        rates: whether the change of the command is needed; it is left out otherwise.
    """
    n, m = model.n_states, model.n_inputs
    eye, size = np.eye(m), n + (1 + rates) * m
    held = np.zeros((size, size))
    held[:n, :n], held[:n, n : n + m], held[n : n + m, n : n + m] = model.A, model.B, eye
    G = np.vstack([model.B, eye, eye][: 2 + rates])
    if decision == "increment":
        return Dynamics(held, held, G)
    free = np.zeros_like(held)
    free[:n, :n] = model.A
    if rates:
        free[n + m :, n : n + m] = -eye
    return Dynamics(free, held, G)


def coupled(dynamics: Dynamics, functionals: Array) -> list[tuple[Indices, Indices]]:
    """Return inputs and functionals in groups, such that no functional depends on two groups.

    Args:
        functionals: rows that read outputs and bounded quantities from the states, ``(k, n)``.
            Those that no input moves are in no group.
    """
    m = dynamics.G.shape[1]
    peak = np.zeros((len(functionals), m))
    for F in (dynamics.F, dynamics.F_held):
        response = dynamics.G
        for _ in range(dynamics.n + 1):
            np.maximum(peak, np.abs(functionals @ response), out=peak)
            response = F @ response
    touched = peak > _TOUCH * peak.max(axis=1, initial=0.0, keepdims=True)
    rows = csr_matrix(touched.astype(np.int64))
    count, label = connected_components(rows.T @ rows, directed=False)
    own = np.where(touched.any(axis=1), label[touched.argmax(axis=1)], -1)
    return [(np.flatnonzero(label == i), np.flatnonzero(own == i)) for i in range(count)]


def reachable(dynamics: Dynamics, inputs: Indices, functionals: Array) -> tuple[Dynamics, Array]:
    """Restrict to the states that some of the inputs reach.

    Args:
        inputs: which, ``(m,)``.
        functionals: rows on the states, ``(k, n)``.

    Returns:
        The smaller recursion, and the same functionals on its states, ``(k, n_reached)``.
    """
    G = dynamics.G[:, inputs]
    size = _sizes(dynamics, G)
    basis = np.zeros((dynamics.n, 0))
    front: Sequence[Array] = list((G / size[:, None]).T)
    maps = [(F * size) / size[:, None] for F in (dynamics.F, dynamics.F_held)]
    while front:
        found = []
        for vector in front:
            rest, length = vector, np.linalg.norm(vector)
            for _ in range(2):  # once is not enough where little is left
                rest = rest - basis @ (basis.T @ rest)
            left = np.linalg.norm(rest)
            if length > 0 and left > _RANK * length:
                basis = np.column_stack([basis, rest / left])
                found.append(rest / left)
        front = [F @ vector for vector in found for F in maps]
    back = (basis * size[:, None], basis.T / size)  # states from the smaller ones, and the reverse
    return (
        Dynamics(back[1] @ dynamics.F @ back[0], back[1] @ dynamics.F_held @ back[0], back[1] @ G),
        functionals @ back[0],
    )


def _sizes(dynamics: Dynamics, G: Array) -> Array:
    """Return the largest response of each state over as many steps as there are states."""
    peak, response = np.abs(G).max(axis=1), G
    for _ in range(dynamics.n):
        response = dynamics.F @ response
        np.maximum(peak, np.abs(response).max(axis=1), out=peak)
    return np.where(peak > 0, peak, 1.0)
