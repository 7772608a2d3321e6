"""A controller's problem in groups that share nothing: states, inputs, outputs, rows of each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components

from qpmpc.arrays import Array, Indices
from qpmpc.observer import KalmanObserver
from qpmpc.problem import Problem
from qpmpc.scaling import Scaling

Pattern = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Whole:
    """What a compiled step is made from: the constant parts of a controller."""

    problem: Problem
    observer: KalmanObserver
    scaling: Scaling


@dataclass(frozen=True, eq=False)
class Group:
    """An axis, or several that something couples; index arrays into the whole, ascending."""

    whole: Whole
    states: Indices
    inputs: Indices
    measured: Indices
    outputs: Indices
    rows: Indices

    @cached_property
    def decision(self) -> Indices:
        """Its part of the decision ``(N_u * n_inputs,)``."""
        return _over(self.whole.problem.moves, self.whole.problem.model.n_inputs, self.inputs)

    @cached_property
    def free(self) -> Indices:
        """Its part of the outputs over the horizon ``(N * n_outputs,)``."""
        return _over(self.whole.problem.horizon, self.whole.problem.model.n_outputs, self.outputs)

    @cached_property
    def parameters(self) -> Indices:
        """Its part of state and last command together ``(n + n_inputs,)``."""
        return np.concatenate([self.states, self.whole.problem.model.n_states + self.inputs])

    @cached_property
    def back(self) -> Array:
        """Its variables from the scaled ones."""
        return self.whole.scaling.T[np.ix_(self.decision, self.decision)]

    @cached_property
    def scaled_rows(self) -> Array:
        """Its rows in scaled units."""
        return self.whole.scaling.qp.A[np.ix_(self.rows, self.decision)]

    @cached_property
    def scaled_hessian(self) -> Array:
        """Its Hessian in scaled units."""
        return self.whole.scaling.qp.P[np.ix_(self.decision, self.decision)]


def _over(steps: int, width: int, which: Indices) -> Indices:
    return np.asarray((np.arange(steps)[:, None] * width + which).ravel())


def groups(whole: Whole) -> list[Group]:
    """Split a controller into groups, in the order of their first states.

    Two quantities are in one group where the model, the observer, a row or the cost knows both. A
    group has at least one of each kind but rows: what would not is put to its neighbour.
    """
    problem, observer = whole.problem, whole.observer
    model = problem.model
    sizes = [model.n_states, model.n_inputs, observer.gain.shape[1], model.n_outputs, problem.qp.m]
    kinds = ("states", "inputs", "measured", "outputs", "rows")
    at = dict(zip(kinds, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
    edges: list[Indices] = []

    def join(first: str, second: str, M: Array | Pattern) -> None:
        i, j = np.nonzero(M)
        edges.append(np.stack([at[first] + i, at[second] + j]))

    n, n_u, n_y = sizes[0], sizes[1], sizes[3]

    def input_of(M: Array | Pattern) -> Pattern:
        """Rows of a decision's matrix by the input whatever the step."""
        return np.asarray((M.reshape(M.shape[0], M.shape[1] // n_u, n_u) != 0).any(axis=1))

    def by_output(M: Array | Pattern) -> Pattern:
        return np.asarray((M.reshape(-1, n_y, M.shape[1]) != 0).any(axis=0))

    join("states", "states", observer.A)
    join("states", "inputs", observer.B)
    join("measured", "states", observer.measured)
    join("states", "measured", observer.gain)
    join("outputs", "states", model.C)
    join("inputs", "inputs", input_of(input_of(problem.qp.P).T))
    join("rows", "inputs", input_of(problem.qp.A))
    maps = problem.maps
    join("rows", "states", maps.rows[:, :n])
    join("rows", "inputs", maps.rows[:, n:])
    join("outputs", "states", by_output(maps.free[:, :n]))
    join("outputs", "inputs", by_output(maps.free[:, n:]))
    join("outputs", "inputs", input_of(by_output(problem.prediction.Theta)))
    join("outputs", "inputs", by_output(input_of(maps.gradient.T)))
    pairs = np.concatenate(edges, axis=1)
    total = sum(sizes)
    graph = csr_matrix((np.ones(pairs.shape[1]), (pairs[0], pairs[1])), shape=(total, total))
    count, label = connected_components(graph, directed=False)
    label = _complete(
        label, count, [np.arange(at[k], at[k] + s) for k, s in zip(kinds, sizes, strict=True)]
    )
    found = []
    for i in dict.fromkeys(label.tolist()):
        members = [
            np.flatnonzero(label[at[kind] : at[kind] + size] == i)
            for kind, size in zip(kinds, sizes, strict=True)
        ]
        found.append(Group(whole, *members))
    return found


def _complete(label: Indices, count: int, members: list[Indices]) -> Indices:
    """Put what lacks a state, an input, a measurement or an output to the first that has them."""
    has = [np.bincount(label[kind], minlength=count) > 0 for kind in members[:4]]
    whole = np.logical_and.reduce(has)
    if not whole.any():
        return np.zeros_like(label)
    first = int(np.flatnonzero(whole)[0])
    return np.where(whole[label], label, first)
