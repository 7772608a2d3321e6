# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import quadprog

from qpmpc import BoundsError, ModelError, QuadraticProgram, ShapeError
from qpmpc.feasibility import contradictory
from qpmpc.program import SlackForm


def violation(qp: QuadraticProgram, x: np.ndarray) -> np.ndarray:
    Ax = qp.A @ x
    return np.maximum(np.maximum(Ax - qp.u, qp.l - Ax), 0.0)


def price(qp: QuadraticProgram, x: np.ndarray) -> float:
    """The soft objective with its slack eliminated; infinite where a hard row is broken."""
    s, soft = violation(qp, x), qp.soft
    if np.delete(s, soft).max(initial=0.0) > 1e-9:
        return np.inf
    penalty = qp.linear[soft] @ s[soft] + qp.quadratic[soft] @ s[soft] ** 2
    return float(0.5 * x @ qp.P @ x + qp.q @ x + penalty)


seeds = pytest.mark.parametrize("seed", range(12))


@seeds
def test_reference_solver_of_these_tests_finds_the_minimum(
    random_program: Any, optimum: Any, seed: int
) -> None:
    """No point of a grid of directions and lengths around it is better (the QP is convex)."""
    rng = np.random.default_rng(seed)
    qp = random_program(rng, 2, 6, 2, quadratic=seed % 2 == 0)
    x = optimum(qp, qp.q, qp.l, qp.u).x
    least = price(qp, x)
    assert np.isfinite(least)
    for angle in np.linspace(0, 2 * np.pi, 360, endpoint=False):
        for length in (1e-4, 1e-2, 0.3, 2.0):
            step = length * np.array([np.cos(angle), np.sin(angle)])
            assert price(qp, x + step) >= least - 1e-10


@seeds
def test_slack_form_prices_every_point_like_the_soft_program(
    random_program: Any, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    qp = random_program(rng, 3, 8, 3, quadratic=True)
    form, soft = SlackForm(qp), qp.soft
    for _ in range(30):
        x = rng.standard_normal(3) * rng.choice([0.1, 1.0])
        s = violation(qp, x)[soft]
        z = np.concatenate([x, s])
        rows = form.A @ z
        fits = (rows >= form.l - 1e-12).all() and (rows <= form.u + 1e-12).all()
        assert fits == np.isfinite(price(qp, x))
        if fits:
            assert 0.5 * z @ form.P @ z + form.q @ z == pytest.approx(price(qp, x), rel=1e-12)
        for i in range(soft.size):  # and no smaller slack would do
            less = np.concatenate([x, s - 1e-6 * (np.arange(soft.size) == i)])
            rows = form.A @ less
            assert (rows < form.l - 1e-9).any() or (rows > form.u + 1e-9).any()


@seeds
def test_slack_form_and_its_folded_multipliers_solve_the_soft_program(
    random_program: Any, optimum: Any, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    qp = random_program(rng, 3, 8, 3, quadratic=True)
    form = SlackForm(qp)
    P = form.P + 1e-12 * np.eye(form.q.size)
    low, high = np.isfinite(form.l), np.isfinite(form.u)
    G = np.vstack([form.A[low], -form.A[high]])
    h = np.concatenate([form.l[low], -form.u[high]])
    z, _, _, _, multipliers, _ = quadprog.solve_qp(P, -form.q, G.T.copy(), h)
    x = z[:3]
    np.testing.assert_allclose(x, optimum(qp, qp.q, qp.l, qp.u).x, atol=1e-7)
    signed = np.zeros(form.l.size)
    signed[low] -= multipliers[: low.sum()]
    signed[high] += multipliers[low.sum() :]
    y = form.multipliers(signed, np.full(qp.m, np.nan))
    np.testing.assert_allclose(qp.P @ x + qp.q + qp.A.T @ y, 0.0, atol=1e-7)
    s, soft = violation(qp, x), qp.soft
    most = qp.linear[soft] + 2 * qp.quadratic[soft] * s[soft]
    assert (np.abs(y[soft]) <= most + 1e-7).all()
    given = s[soft] > 1e-6
    np.testing.assert_allclose(np.abs(y[soft])[given], most[given], rtol=1e-6)
    inside = np.minimum(qp.A @ x - qp.l, qp.u - qp.A @ x) > 1e-6
    np.testing.assert_allclose(y[inside], 0.0, atol=1e-7)


def test_update_moves_the_vectors_alone(rng: np.random.Generator, random_program: Any) -> None:
    qp = random_program(rng, 3, 7, 3)
    form, other = SlackForm(qp), random_program(rng, 3, 7, 3)
    P, A = form.P.copy(), form.A.copy()
    form.update(other.q, other.l, other.u)
    same = QuadraticProgram(qp.P, other.q, qp.A, other.l, other.u, qp.linear, qp.quadratic)
    fresh = SlackForm(same)
    for name in ("q", "l", "u", "P", "A"):
        np.testing.assert_array_equal(getattr(form, name), getattr(fresh, name))
    np.testing.assert_array_equal(form.P, P)
    np.testing.assert_array_equal(form.A, A)


@pytest.mark.parametrize("hard", [0, 3, 7])
def test_replaced_rows_are_those_of_a_form_made_so(
    rng: np.random.Generator, random_program: Any, hard: int
) -> None:
    qp = random_program(rng, 3, 7, hard)
    other = replace(qp, A=rng.standard_normal((7, 3)))
    form, fresh = SlackForm(qp), SlackForm(other)
    A, vectors = form.A, [form.q.copy(), form.l.copy(), form.u.copy()]
    form.replace_rows(np.array(other.A))
    assert form.A is A
    np.testing.assert_array_equal(form.A, fresh.A)
    for ours, before in zip((form.q, form.l, form.u), vectors, strict=True):
        np.testing.assert_array_equal(ours, before)


@pytest.mark.parametrize("hard", [0, 5])
def test_programs_that_are_all_soft_or_all_hard(
    rng: np.random.Generator, random_program: Any, hard: int
) -> None:
    qp = random_program(rng, 2, 5, hard)
    form = SlackForm(qp)
    slack = 5 - hard
    assert form.A.shape == (hard + 3 * slack, 2 + slack)
    assert qp.soft.size == slack


@pytest.mark.parametrize("factor", [0.5, 1.001])
def test_penalty_is_exact_above_the_multiplier(optimum: Any, factor: float) -> None:
    """min 1/2 x^2 - 3 x with x <= 1: the multiplier of the hard row is 2."""
    eye = np.eye(1)
    qp = QuadraticProgram(eye, [-3.0], eye, [-np.inf], [1.0], 2.0 * factor)
    found = optimum(qp, qp.q, qp.l, qp.u)
    expected = 1.0 if factor > 1 else 3.0 - 2.0 * factor
    assert found.x[0] == pytest.approx(expected, abs=1e-9)


def test_sizes() -> None:
    qp = QuadraticProgram(np.eye(2), [0, 0], np.ones((3, 2)), -1.0, 1.0, [np.inf, 1, np.inf])
    assert (qp.n, qp.m) == (2, 3)
    np.testing.assert_array_equal(qp.soft, [1])
    assert repr(qp) == "QuadraticProgram(variables=2, rows=3, soft=1)"


@pytest.mark.parametrize(
    ("changed", "error", "text"),
    [
        ({"P": np.ones((2, 3))}, ShapeError, "^P"),
        ({"P": [[1.0, 0.5], [0.0, 1.0]]}, ModelError, "symmetric"),
        ({"P": [[np.nan, 0], [0, 1]]}, ModelError, "^P"),
        ({"q": np.zeros(3)}, ShapeError, "^q"),
        ({"q": [0.0, np.inf]}, ModelError, "^q"),
        ({"A": np.ones((3, 1))}, ShapeError, "^A"),
        ({"l": np.zeros(2)}, ShapeError, "^l"),
        ({"u": np.zeros((3, 1))}, ShapeError, "^u"),
        ({"l": [np.nan, 0, 0]}, ModelError, "^l"),
        ({"linear": 0.0}, ModelError, "penalties"),
        ({"linear": -1.0}, ModelError, "penalties"),
        ({"quadratic": -1.0}, ModelError, "penalties"),
        ({"quadratic": np.inf}, ModelError, "quadratic"),
        ({"l": [-1.0, 2.0, -1.0]}, BoundsError, "row 1.*lower 2 exceeds upper 1"),
    ],
)
def test_program_refuses(changed: dict[str, Any], error: type[Exception], text: str) -> None:
    arguments: dict[str, Any] = {
        "P": np.eye(2),
        "q": np.zeros(2),
        "A": np.ones((3, 2)),
        "l": -np.ones(3),
        "u": np.ones(3),
    }
    with pytest.raises(error, match=text):
        QuadraticProgram(**(arguments | changed))


@pytest.mark.parametrize("far", [1e20, 3e25, np.inf])
def test_bounds_from_1e20_on_are_none(far: float) -> None:
    qp = QuadraticProgram(np.eye(2), [0, 0], np.eye(2), [-far, -9e19], [far, 1.0])
    np.testing.assert_array_equal(qp.l, [-np.inf, -9e19])
    np.testing.assert_array_equal(qp.u, [np.inf, 1.0])


def test_program_needs_a_variable() -> None:
    with pytest.raises(ModelError, match="at least one variable"):
        QuadraticProgram(np.zeros((0, 0)), [], np.zeros((1, 0)), -1.0, 1.0)


# ---- rows that contradict each other


def test_rows_contradict_where_no_point_meets_all_of_them(rng: np.random.Generator) -> None:
    """A point that meets them is known, until one row is moved beyond what the others allow."""
    for _ in range(40):
        A, x = rng.standard_normal((6, 3)), rng.standard_normal(3)
        A[5] = A[0] + A[1]
        l, u = A @ x - rng.random(6), A @ x + rng.random(6)
        l[2], u[3] = -np.inf, np.inf
        assert not contradictory(A, l, u)
        l[5], u[5] = u[0] + u[1] + 1e-3, np.inf
        assert contradictory(A, l, u)
        l[5] = u[0] + u[1] - 1e-3  # now a corner is left
        assert not contradictory(A[[0, 1, 5]], l[[0, 1, 5]], u[[0, 1, 5]])


def test_rows_that_bound_nothing_or_touch_nothing() -> None:
    free = np.full(2, np.inf)
    assert not contradictory(np.eye(2), -free, free)
    assert not contradictory(np.zeros((0, 2)), np.zeros(0), np.zeros(0))
    assert not contradictory(np.zeros((1, 2)), np.array([-1.0]), np.array([1.0]))
    assert contradictory(np.zeros((1, 2)), np.array([1.0]), np.array([2.0]))
    far = np.array([1e6, -1e6])
    assert not contradictory(np.eye(2), far, far)
