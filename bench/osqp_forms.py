"""The ways to write one cycle's problem for OSQP that `bench.osqp_study` compares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bench.instances import BoundRows, Instances
from qpmpc import QuadraticProgram
from qpmpc.program import SlackForm
from qpmpc.scaling import Scaling
from scenarios import ScenarioError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Variables = Literal["increments", "commands", "whitened"]
Rows = Literal["as they are", "each", "by bound"]
FAR = 1e30
"""What OSQP takes for infinite."""


@dataclass(frozen=True, eq=False)
class Form:
    """A family of QPs ``min 1/2 x' P x + q' x, l <= A x <= u``, and K cycles of it."""

    P: sparse.csc_matrix
    """Upper triangle."""
    A: sparse.csc_matrix
    q: Array
    """``(K, n)``."""
    l: Array  # noqa: E741 - the field's name for it
    """``(K, m)``."""
    u: Array
    """``(K, m)``."""
    first: Callable[[int, Array], Array]
    """The first Delta u, ``(n_u,)``, from the number of the cycle and its answer."""
    shift: Callable[[Array, Array], tuple[Array, Array]]
    """Answer and multipliers of a cycle, moved one step ahead for the next."""


def program(data: Instances) -> QuadraticProgram:
    """Return the constant part of the condensed QP in its own units."""
    none = np.full(len(data.G), np.inf)
    return QuadraticProgram(data.P, data.q[0], data.G, -none, none, data.linear, data.quadratic)


def condensed(
    data: Instances,
    cycles: slice,
    variables: Variables = "whitened",
    rows: Rows = "by bound",
    *,
    slack: bool = True,
    unit: float = 0.0,
) -> Form:
    """Write the condensed QP.

    Args:
        data, cycles: which cycles.
        variables: increments as they are; the commands that they add up to, from u(k-1); or
            whitened by the Hessian's Cholesky factor. Each to the size of one in the mean.
        rows: what each is divided by: one, its norm, or the largest norm of its bound.
        slack: whether soft rows give way by a variable of their own; else they count as hard.
        unit: slack is measured in units of its price to minus this power: 0 is the row's own unit,
            1 the one in which the price is 1.
    """
    qp = program(data)
    n, n_u = qp.n, data.B.shape[1]
    groups = [np.flatnonzero(data.row_bound == name) for name in dict.fromkeys(data.row_bound)]
    T: Array = np.eye(n)
    if variables == "commands":
        T[:] = np.kron(np.eye(n // n_u) - np.eye(n // n_u, k=-1), np.eye(n_u))
    elif variables == "whitened":
        T[:] = Scaling(qp).T
    P, G = T.T @ data.P @ T, data.G @ T
    c, size = n / float(np.trace(P)), np.asarray(np.linalg.norm(G, axis=1))
    if rows == "as they are":
        size[:] = 1.0
    elif rows == "by bound":
        for group in groups:
            size[group] = size[group].max()
    E = 1.0 / size
    none = np.full(qp.m, np.inf)
    scaled = QuadraticProgram(
        c * (P + P.T) / 2, np.zeros(n), E[:, None] * G, -none, none,
        c * data.linear / E if slack else none, c * data.quadratic / E**2 * slack,
    )  # fmt: skip
    form = SlackForm(scaled)
    price = form.q[n:]
    column = np.append(np.ones(n), price**-unit)
    row = np.append(np.ones(form.l.size - price.size), price**unit)
    q, l, u = [], [], []  # noqa: E741
    for k in range(cycles.start, cycles.stop):
        form.update(c * (T.T @ data.q[k]), E * data.l[k], E * data.u[k])
        q.append(column * form.q)
        l.append(np.maximum(row * form.l, -FAR))
        u.append(np.minimum(row * form.u, FAR))
    ahead = np.linalg.inv(T) @ np.kron(np.eye(n // n_u, k=1), np.eye(n_u)) @ T

    def shift(x: Array, y: Array) -> tuple[Array, Array]:
        return np.concatenate([ahead @ x[:n], x[n:]]), y

    def first(_: int, x: Array) -> Array:
        return T[:n_u] @ x[:n]

    P_ = sparse.csc_matrix(np.triu(column[:, None] * form.P * column))
    A_ = sparse.csc_matrix(row[:, None] * form.A * column)
    return Form(P_, A_, np.array(q), np.array(l), np.array(u), first, shift)


def staged(data: Instances, cycles: slice) -> Form:
    """Write the QP with the states of every step as variables, bound by the model's equations.

    Variables are u(k) ... u(k+N-1), x(k+1) ... x(k+N) in units of what the recording shows of them,
    and a slack for each soft row. Bounds are those configured: none may move.

    Raises:
        ScenarioError: a bound on the rate, a control horizon below N, or commands as decision.
    """
    N, (n, n_u) = data.horizon, data.B.shape
    rated = any(bound.kind == "rate" and bound.kept.any() for bound in data.bounds)
    if rated or data.control_horizon != N or data.decision_form != "increment":
        raise ScenarioError("the staged form knows increments over the whole horizon, no rate")
    size = np.maximum(np.abs(data.state).max(axis=0), _LEAST)
    level = max(float(np.abs(data.command).max()), _LEAST)
    A, B = data.A / size[:, None] * size, data.B / size[:, None] * level
    C, W, R = data.C * size, np.diag(data.output_weight), np.diag(data.increment_weight) * level**2
    eye, below = sparse.identity(N), sparse.eye(N, k=-1)
    D = eye - below
    cost = 2.0 * sparse.block_diag([sparse.kron(D.T @ D, R), sparse.kron(eye, C.T @ W @ C)])
    dynamics = sparse.hstack(
        [-sparse.kron(eye, B), sparse.identity(N * n) - sparse.kron(below, A)], format="csr"
    )
    parts = [_staged_bound(b, N, n_u, size, level) for b in data.bounds if b.kept.any()]
    G = sparse.vstack([row for row, _ in parts], format="csr")
    lower, upper, linear, quadratic = np.hstack([vectors for _, vectors in parts])
    soft, hard = np.flatnonzero(np.isfinite(linear)), np.flatnonzero(np.isinf(linear))
    k, c = soft.size, cost.shape[0] / cost.diagonal().sum()
    S = sparse.identity(k)
    rows = sparse.bmat(
        [[dynamics, None], [G[hard], None], [G[soft], S], [G[soft], -S], [None, S]], format="csc"
    )
    P = sparse.block_diag([cost * c, sparse.diags(2.0 * c * quadratic[soft])], format="csc")
    free, K = np.full(k, FAR), cycles.stop - cycles.start
    q = np.zeros((K, rows.shape[1]))
    low = [np.zeros(N * n), lower[hard], lower[soft], -free, np.zeros(k)]
    high = [np.zeros(N * n), upper[hard], free, upper[soft], free]
    l, u = (np.tile(np.concatenate(side), (K, 1)) for side in (low, high))  # noqa: E741
    q[:, :n_u] = -2.0 * c / level * (data.previous[cycles] @ R)
    q[:, N * n_u : N * (n + n_u)] = -2.0 * c * (data.reference[cycles] @ W @ C).reshape(K, -1)
    q[:, N * (n + n_u) :] = c * linear[soft]
    l[:, :n] = u[:, :n] = data.state[cycles] / size @ A.T
    last = np.concatenate([_next(N, n_u), N * n_u + _next(N, n), N * (n + n_u) + np.arange(k)])

    def shift(x: Array, y: Array) -> tuple[Array, Array]:
        return x[last], y

    def first(i: int, x: Array) -> Array:
        return np.asarray(level * x[:n_u] - data.previous[cycles.start + i])

    return Form(
        sparse.triu(P, format="csc"), rows, q, np.maximum(l, -FAR), np.minimum(u, FAR), first, shift
    )


_LEAST = 1e-9
"""Size of a state that stays zero."""


def _staged_bound(
    bound: BoundRows, N: int, n_u: int, size: Array, level: float
) -> tuple[sparse.csr_matrix, Array]:
    """Return rows on commands and states, and lower, upper, linear and quadratic ``(4, m)``."""
    kept, width = np.flatnonzero(bound.kept), bound.kept.shape[1]
    if bound.kind == "output":
        one = sparse.kron(sparse.identity(N), bound.output * size)
        row = sparse.hstack([sparse.csr_matrix((N * width, N * n_u)), one], format="csr")
    else:
        one = level * sparse.identity(N * width)
        row = sparse.hstack([one, sparse.csr_matrix((N * width, N * size.size))], format="csr")
    E = 1.0 / np.abs(row.data).max()
    sides = [side.ravel()[kept] * E for side in (bound.lower, bound.upper)]
    prices = [np.full(kept.size, p) for p in (bound.linear / E, bound.quadratic / E**2)]
    return E * row[kept], np.array(sides + prices)


def _next(N: int, width: int) -> Indices:
    """Return where each entry of ``N`` steps finds what was one step ahead of it."""
    return np.minimum(np.arange(N) + 1, N - 1).repeat(width) * width + np.tile(np.arange(width), N)
