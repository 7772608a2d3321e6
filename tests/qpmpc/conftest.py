"""Builders that several files share; each fixture hands out a function or a small record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest
import quadprog
from numpy.typing import ArrayLike

from qpmpc import (
    Backend,
    CommandBound,
    ForceController,
    Limits,
    LinearModel,
    OutputBound,
    Problem,
    QuadraticProgram,
    RateBound,
    RawSolution,
    Status,
    Step,
    constant,
    contact_model,
    stack,
    with_delay,
    with_disturbance,
)
from qpmpc import controller as controller_module
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
    rng: np.random.Generator,
    axes: int,
    horizon: int,
    *,
    free: bool = False,
    kind: type[Problem] = Problem,
    **settings: object,
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
    return kind(
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


def _random_program(
    rng: np.random.Generator, n: int, m: int, hard: int, *, quadratic: bool = False
) -> QuadraticProgram:
    """A program that x = 0 keeps feasible in its hard rows, with bounds on one or both sides."""
    root = rng.standard_normal((n, n))
    l, u = -rng.random(m), rng.random(m)  # noqa: E741
    l[hard:] += rng.uniform(-1, 1, m - hard)
    u[hard:] = l[hard:] + 2 * rng.random(m - hard)
    l[rng.random(m) < 0.2] = -np.inf
    linear = np.where(np.arange(m) < hard, np.inf, 3 * rng.random(m) + 0.1)
    square = rng.random(m) if quadratic else np.zeros(m)
    order = rng.permutation(m)  # hard and soft rows in any order
    return QuadraticProgram(
        root @ root.T + 0.3 * np.eye(n),
        3 * rng.standard_normal(n),
        rng.standard_normal((m, n)),
        l[order],
        u[order],
        linear[order],
        square[order],
    )


def _groups(qp: QuadraticProgram) -> list[tuple[Array, Array]]:
    """Variables and rows that nothing couples with the others: spread from each variable."""
    linked = (qp.P != 0) | ((np.abs(qp.A).T @ np.abs(qp.A)) > 0)
    left, found = set(range(qp.n)), []
    while left:
        reached = {left.pop()}
        while True:
            more = set(np.flatnonzero(linked[list(reached)].any(axis=0)).tolist()) - reached
            if not more:
                break
            reached |= more
        left -= reached
        variables = np.array(sorted(reached))
        found.append((variables, np.flatnonzero((qp.A[:, variables] != 0).any(axis=1))))
    return found


def _optimum(qp: QuadraticProgram, q: Array, l: Array, u: Array) -> Optimum:  # noqa: E741
    """Solve a soft QP, one group of coupled variables after the other."""
    x, active, feasible = np.zeros(qp.n), False, True
    linear, square = np.broadcast_to(qp.linear, qp.m), np.broadcast_to(qp.quadratic, qp.m)
    for variables, rows in _groups(qp):
        part = QuadraticProgram(
            qp.P[np.ix_(variables, variables)],
            q[variables],
            qp.A[np.ix_(rows, variables)],
            l[rows],
            u[rows],
            linear[rows],
            square[rows],
        )
        found = _dense_optimum(part, part.q, part.l, part.u)
        x[variables] = found.x
        active, feasible = active or found.active, feasible and found.feasible
    value = qp.A @ x
    return Optimum(x, np.maximum(np.maximum(value - u, l - value), 0.0), active, feasible)


def _dense_optimum(qp: QuadraticProgram, q: Array, l: Array, u: Array) -> Optimum:  # noqa: E741
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
    equal = np.isinf(np.broadcast_to(qp.linear, qp.m)) & (low == high)
    below, above = np.isfinite(low) & ~equal, np.isfinite(high) & ~equal
    G = np.vstack(
        [
            np.hstack([rows, select])[equal],
            np.hstack([rows, select])[below],
            np.hstack([-rows, select])[above],
            np.hstack([np.zeros((k, n)), np.eye(k)]),
        ]
    )
    h = np.concatenate([low[equal], low[below], -high[above], np.zeros(k)])
    curvature = 1e-3 * weight
    slack, z, feasible = np.zeros(k), np.zeros(n), True
    for _ in range(50):
        H = np.diag(np.concatenate([np.ones(n), 2 * square + curvature]))
        g = np.concatenate([T.T @ q, weight - curvature * slack])
        try:
            found = quadprog.solve_qp(H, -g, G.T.copy(), h, int(equal.sum()))[0]
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


@dataclass(frozen=True, eq=False)
class Trace:
    """What a closed loop did, one entry a cycle."""

    steps: list[Step]
    force: Array
    velocity: Array

    @property
    def commands(self) -> Array:
        return np.array([step.command for step in self.steps])


def _on_own_model(
    controller: ForceController,
    force: ArrayLike,
    setpoint: ArrayLike,
    cycles: int,
    *,
    tissue: ArrayLike = 0.0,
    before: Callable[[int, Array, Array], None] | None = None,
) -> Trace:
    """Close the loop on the controller's own model, begun at rest with the estimate right.

    Args:
        force, setpoint: of each axis [N]. tissue: its steady velocity on each axis [m/s], for a
            controller with the disturbance ``fused``.
        before: called before each step with the cycle, force and velocity.
    """
    model, axes = controller.general.problem.model, len(controller.axes)
    x = np.zeros((axes, model.n_states // axes))
    x[:, 0] = force
    controller.reset(x[:, 0])
    if np.any(tissue):
        x[:, -4] = tissue
    preview = np.tile(
        np.asarray(setpoint, dtype=float), (controller.general.problem.horizon + 1, 1)
    )
    steps, forces, velocities = [], [], []
    for k in range(cycles):
        force, velocity = x[:, 0].copy(), x[:, 1].copy()
        if before is not None:
            before(k, force, velocity)
        step = controller.step(force, velocity, preview)
        controller.prepare()
        x = (model.A @ x.ravel() + model.B @ step.command).reshape(x.shape)
        steps.append(step)
        forces.append(force)
        velocities.append(velocity)
    return Trace(steps, np.array(forces), np.array(velocities))


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
def random_program() -> Callable[..., QuadraticProgram]:
    return _random_program


@pytest.fixture(scope="session")
def optimum() -> Callable[..., Optimum]:
    return _optimum


@pytest.fixture(scope="session")
def on_own_model() -> Callable[..., Trace]:
    return _on_own_model


@pytest.fixture(scope="session")
def liar() -> Callable[..., type[_Liar]]:
    def make(
        answer: Callable[[Array, Array, Array], tuple[Array, Array]],
        status: Status = Status.SOLVED,
    ) -> type[_Liar]:
        return type("Liar", (_Liar,), {"answer": staticmethod(answer), "status": status})

    return make


@pytest.fixture(autouse=True)
def compiled_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """Hundreds of controllers are made here: their steps stay interpreted. See ``native/``."""
    monkeypatch.setattr(controller_module, "obstacle", lambda *_: "left out in these tests")
