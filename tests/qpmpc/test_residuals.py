# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""Residuals against the optimality conditions written out anew, row by row, in plain numpy."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from qpmpc import QuadraticProgram, Residuals, Solver, Status
from qpmpc.residuals import Check
from qpmpc.scaling import Scaling
from qpmpc.solver import TOLERANCE

seeds = pytest.mark.parametrize("seed", range(8))
kinds = pytest.mark.parametrize("hard", [0, 4, 8], ids=["soft", "both", "hard"])
squares = pytest.mark.parametrize("quadratic", [False, True], ids=["linear", "quadratic"])


def residuals(qp: QuadraticProgram, x: np.ndarray, y: np.ndarray) -> Residuals:
    scaling = Scaling(qp)
    scaling.update(qp.q, qp.l, qp.u)
    return Check(qp, scaling, TOLERANCE)(qp.q, qp.l, qp.u, x, y)


def violation(qp: QuadraticProgram, x: np.ndarray) -> np.ndarray:
    Ax = qp.A @ x
    return np.maximum(np.maximum(Ax - qp.u, qp.l - Ax), 0.0)


def cost(qp: QuadraticProgram, x: np.ndarray) -> float:
    """Cost with the penalties of the soft rows; what hard rows are violated by is not counted."""
    s, soft = violation(qp, x), qp.soft
    penalty = qp.linear[soft] @ s[soft] + qp.quadratic[soft] @ s[soft] ** 2
    return float(0.5 * x @ qp.P @ x + qp.q @ x + penalty)


def dual_cost(qp: QuadraticProgram, y: np.ndarray) -> float:
    """Least value over x and s >= 0 of the Lagrangian: cost plus multipliers times rows."""
    v = np.linalg.solve(qp.P, -(qp.q + qp.A.T @ y))
    value = 0.5 * v @ qp.P @ v + (qp.q + qp.A.T @ y) @ v
    for i, price in enumerate(y):
        value -= price * (qp.u[i] if price > 0 else qp.l[i]) if price else 0.0
        if np.isfinite(qp.linear[i]):
            left, square = qp.linear[i] - abs(price), qp.quadratic[i]
            if square > 0:
                least = minimize_scalar(
                    lambda s, a=left, b=square: a * s + b * s**2,
                    bounds=(0.0, 1.0 + max(-left, 0.0) / square),
                    options={"xatol": 1e-8},
                )
                value += min(least.fun, 0.0)
            else:
                assert left >= 0  # else there is no least value
    return float(value)


def some_multipliers(rng: np.random.Generator, qp: QuadraticProgram) -> np.ndarray:
    """Random ones with a finite dual cost: none for a missing bound or beyond a firm penalty."""
    y = 2.0 * rng.standard_normal(qp.m) * (rng.random(qp.m) < 0.7)
    y[(y > 0) & np.isinf(qp.u) | (y < 0) & np.isinf(qp.l)] = 0.0
    firm = qp.quadratic == 0
    y[firm] = np.clip(y[firm], -qp.linear[firm], qp.linear[firm])
    return y


def multipliers(qp: QuadraticProgram, x: np.ndarray) -> np.ndarray:
    """Of the optimum x, if rows at their bounds are independent: the least of all is taken."""
    s, Ax = violation(qp, x), qp.A @ x
    y = np.zeros(qp.m)
    given = s > 1e-7
    sign = np.where(Ax > qp.u, 1.0, -1.0)
    price = np.where(given, qp.linear, 0.0) + 2.0 * qp.quadratic * s
    y[given] = (sign * price)[given]
    at = (np.minimum(np.abs(Ax - qp.l), np.abs(qp.u - Ax)) < 1e-7) & ~given
    y[at] = np.linalg.lstsq(qp.A[at].T, -(qp.P @ x + qp.q + qp.A.T @ y), rcond=None)[0]
    return y


@pytest.fixture
def solved(random_program: Any, optimum: Any) -> Callable[..., Any]:
    """A random program, its optimum and its multipliers."""

    def make(seed: int, hard: int, quadratic: bool) -> Any:
        rng = np.random.default_rng(seed)
        qp = random_program(rng, 4, 8, hard, quadratic=quadratic)
        x = optimum(qp, qp.q, qp.l, qp.u).x
        return rng, qp, x, multipliers(qp, x)

    return make


# ---- the figures are what their words say


@seeds
@kinds
@squares
def test_primal_and_dual_are_in_the_units_of_the_program(
    random_program: Any, seed: int, hard: int, quadratic: bool
) -> None:
    rng = np.random.default_rng(seed)
    qp = random_program(rng, 4, 8, hard, quadratic=quadratic)
    for _ in range(10):
        x, y = 2.0 * rng.standard_normal(4), 3.0 * rng.standard_normal(8)
        found = residuals(qp, x, y)
        broken = [
            v for v, price in zip(violation(qp, x), qp.linear, strict=True) if price == np.inf
        ]
        assert found.primal == pytest.approx(max(broken, default=0.0), abs=1e-13)
        stationary = qp.P @ x + qp.q + qp.A.T @ y
        assert found.dual == pytest.approx(np.abs(stationary).max(), rel=1e-12)


@seeds
@kinds
@squares
def test_gap_is_cost_less_dual_cost(
    random_program: Any, seed: int, hard: int, quadratic: bool
) -> None:
    """Where the answer is stationary: the dual cost is that of its multipliers."""
    rng = np.random.default_rng(seed)
    qp = random_program(rng, 4, 8, hard, quadratic=quadratic)
    qp = replace(qp, quadratic=np.where(np.isinf(qp.linear), 0.0, qp.quadratic))
    for _ in range(5):
        y = some_multipliers(rng, qp)
        x = np.linalg.solve(qp.P, -(qp.q + qp.A.T @ y))
        expected = abs(cost(qp, x) - dual_cost(qp, y))
        found = residuals(qp, x, y)
        assert found.dual < 1e-10
        assert found.gap == pytest.approx(expected, rel=1e-6, abs=1e-7)


@seeds
@kinds
def test_gap_is_at_least_what_can_be_gained(
    random_program: Any, optimum: Any, seed: int, hard: int
) -> None:
    rng = np.random.default_rng(seed)
    qp = random_program(rng, 4, 8, hard, quadratic=True)
    best = cost(qp, optimum(qp, qp.q, qp.l, qp.u).x)
    feasible = 0
    for _ in range(50):
        y = 0.3 * some_multipliers(rng, qp)
        x = np.linalg.solve(qp.P, -(qp.q + qp.A.T @ y))
        found = residuals(qp, x, y)
        if found.primal == 0.0:
            feasible += 1
            assert found.gap >= cost(qp, x) - best - 1e-9
    assert feasible > 0 or hard > 0


def test_quadratic_penalty_of_a_hard_row_means_nothing() -> None:
    soft_too = np.array([np.inf, 1.0])
    found = [
        residuals(
            QuadraticProgram(np.eye(2), [-3.0, 0.0], np.eye(2), -1.0, 1.0, soft_too, square),
            np.array([1.5, 0.0]),
            np.array([1.5, 0.0]),
        ).gap
        for square in ([0.0, 1.0], [1e3, 1.0])
    ]
    assert found[0] == found[1]


def test_gap_is_infinite_where_a_multiplier_belongs_to_no_bound() -> None:
    qp = QuadraticProgram(np.eye(1), [0.0], np.eye(1), [-np.inf], [1.0])
    found = residuals(qp, np.array([1.0]), np.array([-1.0]))
    assert found.gap == np.inf
    assert found.scaled > TOLERANCE


def test_slack_is_the_violation_of_every_row(random_program: Any) -> None:
    rng = np.random.default_rng(0)
    qp = random_program(rng, 4, 8, 4)
    scaling = Scaling(qp)
    scaling.update(qp.q, qp.l, qp.u)
    check, x = Check(qp, scaling, TOLERANCE), 2.0 * rng.standard_normal(4)
    check(qp.q, qp.l, qp.u, x, np.zeros(8))
    np.testing.assert_allclose(check.slack, violation(qp, x), rtol=1e-12, atol=1e-14)
    assert check.slack.max() > 0


# ---- they vanish at the optimum, and nowhere else


@seeds
@kinds
@squares
def test_all_vanish_at_the_optimum_and_grow_away_from_it(
    solved: Any, seed: int, hard: int, quadratic: bool
) -> None:
    rng, qp, x, y = solved(seed, hard, quadratic)
    found = residuals(qp, x, y)
    assert max(found.primal, found.dual, found.gap, found.scaled) < 1e-6
    for size in (1e-4, 1e-2, 1.0):
        for _ in range(10):
            off = size * rng.choice([-1.0, 1.0], 4) * rng.uniform(0.5, 1.0, 4)
            assert residuals(qp, x + off, y).scaled > 0.01 * size / (1 + size)
            wrong = size * rng.choice([-1.0, 1.0], 8) * rng.uniform(0.5, 1.0, 8)
            assert residuals(qp, x, y + wrong).scaled > 0.01 * size / (1 + size)


@seeds
@squares
def test_solver_hands_them_on_with_multipliers_of_the_program(
    solved: Any, seed: int, quadratic: bool
) -> None:
    _, qp, x, y = solved(seed, 4, quadratic)
    units = np.array([1e3, 1.0, 1e-2, 10.0])  # of the variables
    sizes = 10.0 ** np.arange(-3, 5)  # and of the rows
    raw = QuadraticProgram(
        7.0 * units[:, None] * qp.P * units, 7.0 * units * qp.q, sizes[:, None] * qp.A * units,
        sizes * qp.l, sizes * qp.u, 7.0 * qp.linear / sizes, 7.0 * qp.quadratic / sizes**2,
    )  # fmt: skip
    solution = Solver(raw).solve(raw.q, raw.l, raw.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(units * solution.x, x, atol=1e-6)
    np.testing.assert_allclose(sizes * solution.y / 7.0, y, atol=1e-5)
    found = solution.residuals
    again = residuals(raw, solution.x, solution.y)
    assert found.primal == pytest.approx(again.primal, abs=1e-12)
    assert found.dual == pytest.approx(again.dual, abs=1e-8)
    assert found.gap == pytest.approx(again.gap, abs=1e-6)


# ---- units


def moved(qp: QuadraticProgram, rows: float, money: float) -> QuadraticProgram:
    """The same program with other units of rows and cost."""
    return QuadraticProgram(
        money * qp.P, money * qp.q, rows * qp.A, rows * qp.l, rows * qp.u,
        money * qp.linear / rows, money * qp.quadratic / rows**2,
    )  # fmt: skip


@seeds
@pytest.mark.parametrize(("rows", "money"), [(1e3, 1.0), (1.0, 1e-4), (1e-2, 1e3)])
def test_units_of_rows_and_cost_are_told_from_what_is_judged(
    random_program: Any, seed: int, rows: float, money: float
) -> None:
    rng = np.random.default_rng(seed)
    qp = random_program(rng, 4, 8, 4, quadratic=True)
    x, y = 2.0 * rng.standard_normal(4), some_multipliers(rng, qp)
    ours, theirs = residuals(qp, x, y), residuals(moved(qp, rows, money), x, money / rows * y)
    assert theirs.primal == pytest.approx(rows * ours.primal, rel=1e-9)
    assert theirs.dual == pytest.approx(money * ours.dual, rel=1e-9)
    assert theirs.gap == pytest.approx(money * ours.gap, rel=1e-8)
    assert theirs.scaled == pytest.approx(ours.scaled, rel=1e-9)


@pytest.mark.parametrize(
    "unit",
    [
        1e-6,
        1.0,
        pytest.param(
            1e6,
            marks=pytest.mark.xfail(
                strict=True, reason="answers much smaller than 1 in their own unit are not judged"
            ),
        ),
    ],
)
def test_only_what_is_scaled_is_judged(liar: Any, unit: float) -> None:
    """The same relative error passes or not, whatever it comes to in the program's own units."""
    qp = QuadraticProgram(unit**2 * np.eye(1), [-2.0 * unit], np.zeros((0, 1)), [], [])
    for error, status in ((1e-7, Status.SOLVED), (1e-4, Status.INACCURATE)):
        kind = liar(lambda q, l, u, e=error: (-q * (1 + e), np.zeros(0)))
        solution = Solver(qp, kind).solve(qp.q, qp.l, qp.u)
        assert solution.status is status
        assert solution.residuals.dual == pytest.approx(2.0 * unit * error, rel=1e-4)


# ---- rows that change


def test_residuals_are_those_of_the_rows_of_the_day(random_program: Any) -> None:
    rng = np.random.default_rng(1)
    qp = random_program(rng, 4, 8, 4)
    other = replace(qp, A=rng.standard_normal((8, 4)))
    scaling = Scaling(qp)
    scaling.update(qp.q, qp.l, qp.u)
    check = Check(qp, scaling, TOLERANCE)
    x, y = rng.standard_normal(4), some_multipliers(rng, qp)
    check.replace_rows(np.array(other.A))
    found, expected = check(qp.q, qp.l, qp.u, x, y), residuals(other, x, y)
    assert found.primal == pytest.approx(expected.primal, rel=1e-12)
    assert found.dual == pytest.approx(expected.dual, rel=1e-12)
    assert found.gap == pytest.approx(expected.gap, rel=1e-9)


def test_multipliers_that_are_not_finite_give_no_figures() -> None:
    qp = QuadraticProgram(np.eye(2), np.zeros(2), np.eye(2), -1.0, 1.0)
    for value in (np.nan, np.inf, -np.inf):
        found = residuals(qp, np.zeros(2), np.array([value, 0.0]))
        assert all(np.isnan([found.primal, found.dual, found.gap, found.scaled]))
