"""Builders that several files share; each fixture hands out a function or a small record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import quadprog

from qpmpc import (
    Backend,
    CommandBound,
    Limits,
    LinearModel,
    OutputBound,
    Problem,
    QuadraticProgram,
    RateBound,
    RawSolution,
    Status,
    constant,
    contact_model,
    stack,
    with_delay,
    with_disturbance,
)
from qpmpc.arrays import Array

PERIOD = 1e-3
COMMAND = 20.0


def _random_model(rng: np.random.Generator, n: int, m: int, p: int, radius: float) -> LinearModel:
    """A random model whose fastest state grows by ``radius`` per step; exactly 1: integrating."""
    A = rng.standard_normal((n, n))
    A *= radius / np.abs(np.linalg.eigvals(A)).max()
    if radius == 1.0:
        A = np.eye(n) + np.triu(rng.standard_normal((n, n)), 1) / n
    return LinearModel(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), PERIOD)


def _roll_out(model: LinearModel, state: Array, commands: Array, C: Array | None = None) -> Array:
    """Outputs after each command, ``(N, n_outputs)``, by the recursion itself."""
    x, outputs = np.array(state, dtype=float), []
    for command in commands:
        x = model.A @ x + model.B @ command
        outputs.append((model.C if C is None else C) @ x)
    return np.array(outputs)


@dataclass(frozen=True, eq=False)
class Instance:
    """One random QP of the contact problem: the problem and the parameters of one cycle."""

    problem: Problem
    state: Array
    previous: Array
    reference: Array

    def vectors(self) -> tuple[Array, Array, Array]:
        self.problem.update(self.state, self.previous, self.reference)
        return self.problem.q.copy(), self.problem.l.copy(), self.problem.u.copy()


def _contact_problem(
    rng: np.random.Generator, axes: int, horizon: int, *, free: bool = False, **settings: object
) -> Problem:
    contact = contact_model(
        rng.uniform(500, 2500), rng.uniform(5, 40), PERIOD, lag=rng.choice([0.0, 1e-3])
    )
    delayed = with_delay(contact.model, int(rng.integers(0, min(horizon, 3))))
    one = with_disturbance(delayed, contact.load, constant())
    model = stack([one] * axes)
    reading = np.hstack([contact.velocity, np.zeros((1, one.n_states - contact.velocity.shape[1]))])
    velocity = np.kron(np.eye(axes), reading)
    speed, rate = rng.uniform(0.02, 0.1), rng.uniform(2.0, 20.0)
    bounds = [
        CommandBound(-COMMAND, COMMAND),
        RateBound(-rate, rate),
        OutputBound("force", model.C, 0.3, rng.uniform(4.0, 8.0, axes), 100.0),
        OutputBound("velocity", velocity, -speed, speed, 1e4),
    ]
    return Problem(
        model,
        horizon,
        output_weight=1.0,
        increment_weight=10 ** rng.uniform(-4, -2),
        bounds=() if free else bounds,
        **settings,
    )


def _instance(rng: np.random.Generator, problem: Problem) -> Instance:
    """Parameters of one cycle: half the draws are calm, half drive the plan into its bounds."""
    model, axes = problem.model, problem.model.n_outputs
    strength = rng.choice([0.1, 1.0])
    state = np.zeros((axes, model.n_states // axes))
    state[:, 0] = rng.uniform(1.0, 5.0, axes) + strength * rng.standard_normal(axes)
    state[:, 1] = 0.05 * strength * rng.standard_normal(axes)
    previous = strength * rng.uniform(-COMMAND, COMMAND, axes)
    state[:, 2:-1] = previous[:, None] + 2.0 * rng.standard_normal((axes, state.shape[1] - 3))
    state[:, -1] = -previous + 5.0 * strength * rng.standard_normal(axes)
    wish = state[:, 0] + strength * rng.standard_normal(axes)
    return Instance(problem, state.ravel(), previous, np.tile(wish, (problem.horizon, 1)))


@dataclass(frozen=True, eq=False)
class Optimum:
    x: Array
    slack: Array
    active: bool
    feasible: bool


def _optimum(qp: QuadraticProgram, q: Array, l: Array, u: Array) -> Optimum:  # noqa: E741
    """Solve a soft QP by the dual active-set method of quadprog, on a slack form of our own.

    Variables are whitened; slack gets a small curvature around its last value until it stays
    (proximal points), for quadprog wants a positive definite Hessian.
    """
    T = np.linalg.inv(np.linalg.cholesky(qp.P)).T
    n, soft = qp.n, np.flatnonzero(np.isfinite(qp.linear))
    k = soft.size
    A = qp.A @ T
    norms = np.linalg.norm(A, axis=1)
    select = np.zeros((qp.m, k))
    select[soft, np.arange(k)] = 1.0  # slack in the units of the scaled rows
    weight = np.broadcast_to(qp.linear, qp.m)[soft] * norms[soft]
    square = np.broadcast_to(qp.quadratic, qp.m)[soft] * norms[soft] ** 2
    rows = A / norms[:, None]
    low, high = l / norms, u / norms
    G = np.vstack(
        [
            np.hstack([rows, select])[np.isfinite(low)],
            np.hstack([-rows, select])[np.isfinite(high)],
            np.hstack([np.zeros((k, n)), np.eye(k)]),
        ]
    )
    h = np.concatenate([low[np.isfinite(low)], -high[np.isfinite(high)], np.zeros(k)])
    curvature = 1e-3 * weight
    slack, z, feasible = np.zeros(k), np.zeros(n), True
    for _ in range(50):
        H = np.diag(np.concatenate([np.ones(n), 2 * square + curvature]))
        g = np.concatenate([T.T @ q, weight - curvature * slack])
        try:
            found = quadprog.solve_qp(H, -g, G.T.copy(), h)[0]
        except ValueError:
            feasible = False
            break
        moved = np.abs(found[n:] - slack).max(initial=0.0)
        z, slack = found[:n], np.maximum(found[n:], 0.0)
        if moved <= 1e-11 * (1 + np.abs(slack).max(initial=0.0)):
            break
    x = T @ z
    value = qp.A @ x
    margin = np.minimum(value - l, u - value) / norms
    over = np.maximum(np.maximum(value - u, l - value), 0.0)
    return Optimum(x, over, bool((margin < 1e-7).any()), feasible)


class _Liar(Backend):
    """A backend that calls whatever it is told to answer solved."""

    name: ClassVar[str] = "liar"
    package: ClassVar[str] = "numpy"
    summary: ClassVar[str] = "for tests"
    heeds_rows: ClassVar[bool] = True
    answer: ClassVar[Callable[[Array, Array, Array], tuple[Array, Array]]]
    status: ClassVar[Status] = Status.SOLVED

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        self.qp = qp

    def forget(self) -> None:
        pass

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        x, y = type(self).answer(q, l, u)
        return RawSolution(self.status, x, y, 1)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20091011)


@pytest.fixture(scope="session")
def random_model() -> Callable[..., LinearModel]:
    return _random_model


@pytest.fixture(scope="session")
def roll_out() -> Callable[..., Array]:
    return _roll_out


@pytest.fixture(scope="session")
def contact_problem() -> Callable[..., Problem]:
    return _contact_problem


@pytest.fixture(scope="session")
def instance() -> Callable[..., Instance]:
    return _instance


@pytest.fixture(scope="session")
def optimum() -> Callable[..., Optimum]:
    return _optimum


@pytest.fixture(scope="session")
def liar() -> Callable[..., type[_Liar]]:
    def make(
        answer: Callable[[Array, Array, Array], tuple[Array, Array]],
        status: Status = Status.SOLVED,
    ) -> type[_Liar]:
        return type("Liar", (_Liar,), {"answer": staticmethod(answer), "status": status})

    return make
