"""QPs of other robots, and ill-mannered ones, through every solver that takes any QP.

What is right is decided here, by the optimality conditions of the QP as it was given, unscaled:

- no row leaves its bounds by more than 1e-6 max(1, largest finite bound);
- no entry of P x + q + A'y is larger than 1e-6 max(1, largest entry of q);
- cost and dual cost differ by no more than 1e-6 max(1, their largest term), and a multiplier
  stands on a finite bound.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from qpmpc import (
    BackendUnavailableError,
    QuadraticProgram,
    Solution,
    Solver,
    Status,
    UnknownNameError,
    solve,
)
from qpmpc.backends import backend_class

from .foreign import GENERATORS, Array, Foreign, Plan, cart_pole, quadruped, walking

TOLERANCE = 1e-6


@pytest.fixture(params=["daqp", "piqp", "clarabel", "osqp", "casadi"])
def backend(request: pytest.FixtureRequest) -> str:
    try:
        backend_class(request.param)
    except (UnknownNameError, BackendUnavailableError) as error:
        pytest.skip(str(error))
    return str(request.param)


def largest(*vectors: Array) -> float:
    return max(float(np.abs(v[np.isfinite(v)]).max(initial=0.0)) for v in vectors)


def complaint(qp: QuadraticProgram, x: Array, y: Array) -> str:
    """What is wrong with an answer; nothing where it is right."""
    rows = qp.A @ x
    beyond = float(np.maximum(rows - qp.u, qp.l - rows).max(initial=0.0))
    slope = float(np.abs(qp.P @ x + qp.q + qp.A.T @ y).max(initial=0.0))
    bound = np.where(y > 0, qp.u, qp.l)[y != 0]
    terms = np.array([x @ qp.P @ x, qp.q @ x, bound @ y[y != 0]])
    found = []
    if not beyond <= TOLERANCE * max(1.0, largest(qp.l, qp.u)):
        found.append(f"rows {beyond:.1e}")
    if not slope <= TOLERANCE * max(1.0, largest(qp.q)):
        found.append(f"slope {slope:.1e}")
    if not abs(terms.sum()) <= TOLERANCE * max(1.0, np.abs(terms).max()):
        found.append(f"gap {terms.sum():.1e}")
    return ", ".join(found)


def verdict(foreign: Foreign, solution: Solution) -> str:
    """What is wrong with a solution; nothing where it is right."""
    if solution.status is not foreign.status:
        return f"{foreign.name}: {solution.status}"
    if foreign.status is not Status.SOLVED:
        return ""
    wrong = complaint(foreign.qp, solution.x, solution.y)
    return wrong and f"{foreign.name}: {wrong}"


@pytest.mark.parametrize("name", GENERATORS)
def test_ends_as_it_has_to(name: str, backend: str) -> None:
    made = GENERATORS[name]()
    assert [v for foreign in made if (v := verdict(foreign, solve(foreign.qp, backend)))] == []


# ---- one solver through many cycles


@pytest.mark.parametrize("form", [Plan.condensed, Plan.sparse], ids=["condensed", "sparse"])
@pytest.mark.parametrize(
    "plan",
    [cart_pole(20, 0.05, (0.6, 0.5, -0.1, 0.1)), walking(16, 0.1), quadruped(1e-5, 5)],
    ids=["cart-pole", "walking", "quadruped"],
)
def test_closed_loop(plan: Plan, form: Callable[[Plan], QuadraticProgram], backend: str) -> None:
    """The bounds stay, the plant moves as predicted: one set of matrices, new vectors."""
    solver = Solver(form(plan), backend)
    n_x, n_u = plan.B.shape[1:]
    input_at = slice(0, n_u) if form is Plan.condensed else slice(n_x, n_x + n_u)
    wrong = []
    for cycle in range(12):
        qp = form(plan)
        solution = solver.solve(qp.q, qp.l, qp.u)
        if found := verdict(Foreign(f"cycle {cycle}", qp), solution):
            wrong.append(found)
            break
        plan = replace(plan, start=plan.A @ plan.start + plan.B[0] @ solution.x[input_at])
    assert wrong == []


def test_dynamics_that_change(backend: str) -> None:
    """A quadruped turns: the rows of its dynamics are other ones in each cycle, the cost is not."""
    turns = [quadruped(1e-4, 4, yaw=yaw).sparse() for yaw in (0.0, 0.4, 0.8)]
    may_be = np.any([qp.A != 0 for qp in turns], axis=0)
    solver = Solver(turns[0], backend, pattern=may_be)
    for qp in turns:
        solver.replace_rows(qp.A)
        solution = solver.solve(qp.q, qp.l, qp.u)
        assert verdict(Foreign("turned", qp), solution) == ""


# ---- whether the material is worth it


def test_condensed_and_sparse_form_have_one_answer() -> None:
    for plan in (cart_pole(10, 0.05, (0.3, 0.0, 0.1, 0.0)), walking(16, 0.1), quadruped(1e-4, 4)):
        N, n_x, n_u = plan.B.shape
        condensed, sparse = solve(plan.condensed()), solve(plan.sparse())
        inputs = sparse.x.reshape(N, n_x + n_u)[:, n_x:].ravel()
        np.testing.assert_allclose(inputs, condensed.x, atol=1e-4 * np.abs(condensed.x).max())


def test_bounds_are_active_and_generators_repeat() -> None:
    for name, make in GENERATORS.items():
        for foreign, again in zip(make(), make(), strict=True):
            for part in ("P", "q", "A", "l", "u"):
                np.testing.assert_array_equal(getattr(foreign.qp, part), getattr(again.qp, part))
            if " N=" in name:
                solution = solve(foreign.qp)
                assert np.count_nonzero(solution.y[foreign.qp.l < foreign.qp.u]) >= 2


@pytest.mark.parametrize(
    ("x", "y", "wrong"),
    [
        ([1.0, -0.5], [2.0, 0.0], ""),
        ([1.0 + 2e-6, -0.5], [2.0, 0.0], "rows"),
        ([1.0, -0.5 + 4e-6], [2.0, 0.0], "slope"),
        ([0.9, -0.5], [2.1, 0.0], "gap"),
        ([1.0, -0.5], [2.0, np.nan], "slope"),
    ],
)
def test_judge(x: list[float], y: list[float], wrong: str) -> None:
    qp = QuadraticProgram(np.eye(2), [-3.0, 0.5], np.eye(2), [-1.0, -np.inf], [1.0, np.inf])
    assert complaint(qp, np.array(x), np.array(y)).startswith(wrong)
    assert bool(complaint(qp, np.array(x), np.array(y))) == bool(wrong)


def test_a_large_program_takes_as_many_steps_as_it_needs(backend: str) -> None:
    """A linear program: DAQP needs some 1,150 steps."""
    rng = np.random.default_rng(1)
    n, m = 240, 560
    A, inside = rng.normal(size=(m, n)), rng.normal(size=n)
    u = A @ inside + rng.uniform(0.0, 1.0, m)
    price = np.maximum(rng.normal(size=m), 0.0)
    qp = QuadraticProgram(np.zeros((n, n)), -A.T @ price, A, np.full(m, -np.inf), u)
    solution = solve(qp, backend)
    assert solution.status is Status.SOLVED
    assert not complaint(qp, solution.x, solution.y)
