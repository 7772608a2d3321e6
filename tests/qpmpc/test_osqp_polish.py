# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""OSQP as a backend, and the polish that takes its loose answers to exact ones."""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np
import pytest

from qpmpc import BackendSetupError, Limits, QuadraticProgram, Residuals, Solver, Status
from qpmpc.backends.osqp import OsqpBackend
from qpmpc.multipliers import MultiplierSearch
from qpmpc.polish import Polish
from qpmpc.residuals import Check
from qpmpc.scaling import Scaling

from .foreign import cart_pole, linear_program, quadruped, semidefinite

NO_LIMITS = Limits()
LONG = 10_000


def soft_program(rng: np.random.Generator, *, definite: bool = True) -> QuadraticProgram:
    """Hard, firm and yielding rows with all kinds of bounds, some of them equalities."""
    n, m = int(rng.integers(2, 7)), int(rng.integers(4, 14))
    root = rng.standard_normal((n if definite else n // 2, n))
    A = np.vstack([np.eye(n), rng.standard_normal((m, n))])
    soft = np.append(np.zeros(n, dtype=bool), rng.random(m) < 0.6)
    middle = A @ rng.uniform(-0.5, 0.5, n) + np.where(soft, rng.standard_normal(n + m), 0.0)
    l, u = middle - rng.uniform(0, 0.5, n + m), middle + rng.uniform(0, 0.5, n + m)
    l[:n], u[:n] = -1.0, 1.0
    kind = rng.integers(0, 6, n + m)
    kind[:n] = 0
    l[kind == 1], u[kind == 2] = -np.inf, np.inf
    l[kind == 3] = u[kind == 3] = np.where(soft, u, middle)[kind == 3]
    linear = np.where(soft, 10 ** rng.uniform(-1, 2, n + m), np.inf)
    quadratic = np.where(soft & (rng.random(n + m) < 0.5), rng.uniform(0.1, 2, n + m), 0.0)
    P = root.T @ root + (0.1 * np.eye(n) if definite else 0.0)
    return QuadraticProgram(P, 3 * rng.standard_normal(n), A, l, u, linear, quadratic)


def residuals(qp: QuadraticProgram, x: np.ndarray, y: np.ndarray) -> Residuals:
    return Check(qp, Scaling(qp), 0.0)(qp.q, qp.l, qp.u, x, y)


def polish(qp: QuadraticProgram, *, steps: int = LONG) -> Polish | None:
    """Polish zero, the loosest answer there is."""
    it = Polish(qp)
    it.allow(steps, np.inf)
    zero = np.zeros(qp.n), np.zeros(qp.m)
    return it if it(qp.q, qp.l, qp.u, *zero) else None


def worst(qp: QuadraticProgram, x: np.ndarray, y: np.ndarray) -> float:
    r = residuals(qp, x, y)
    return max(r.primal, r.dual, r.gap)


# ---- the polish by itself


@pytest.mark.parametrize("definite", [True, False])
def test_ends_at_the_exact_answer_from_nothing(definite: bool) -> None:
    found = 0
    for seed in range(60):
        qp = soft_program(np.random.default_rng(seed), definite=definite)
        it = polish(qp)
        if it is not None:
            assert worst(qp, it.x, it.y) <= 1e-7
            found += 1
    assert found >= 55


def test_is_what_quadprog_finds(optimum: Any) -> None:
    for seed in range(20):
        qp = soft_program(np.random.default_rng(seed))
        it = polish(qp)
        assert it is not None
        np.testing.assert_allclose(it.x, optimum(qp, qp.q, qp.l, qp.u).x, atol=1e-7)


def test_changes_rows_one_by_one_where_all_at_once_goes_in_circles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    programs = [soft_program(np.random.default_rng(seed)) for seed in range(40)]
    assert sum(polish(qp) is None for qp in programs) <= 1
    monkeypatch.setattr(MultiplierSearch, "climb", lambda *_: None)
    assert sum(polish(qp) is None for qp in programs) > 5


def test_from_the_answer_it_takes_one_step() -> None:
    qp = soft_program(np.random.default_rng(3))
    it = polish(qp)
    assert it is not None
    x, y = it.x, it.y
    it.allow(1, np.inf)
    assert it(qp.q, qp.l, qp.u, x, y)
    assert it.steps == 1
    np.testing.assert_allclose(it.x, x, atol=1e-12)


def test_leaves_its_last_answer_where_it_fails() -> None:
    A = np.array([[1.0, 1.0], [1.0, 1.0], [1.0, -1.0]])
    good = QuadraticProgram(np.eye(2), [-3.0, 0.0], A, [-1, -1, -1], [1, 1, 1])
    it = Polish(good)
    it.allow(LONG, np.inf)
    assert it(good.q, good.l, good.u, np.zeros(2), np.zeros(3))
    x = it.x.copy()
    l, u = np.array([0.5, -1.0, -1.0]), np.array([1.0, 0.4, 1.0])  # contradictory
    assert not it(good.q, l, u, np.zeros(2), np.zeros(3))
    np.testing.assert_array_equal(it.x, x)


@pytest.mark.parametrize("steps", [0, 1, 5])
def test_stops_at_the_limit_of_steps(steps: int) -> None:
    for qp in (soft_program(np.random.default_rng(0)), semidefinite(7, 30, 10, 30).qp):
        it = Polish(qp)
        it.allow(steps, np.inf)
        assert not it(qp.q, qp.l, qp.u, np.zeros(qp.n), np.zeros(qp.m))
        assert it.steps == steps


def test_stops_at_the_deadline() -> None:
    qp = soft_program(np.random.default_rng(0))
    it = Polish(qp)
    it.allow(LONG, perf_counter() - 1.0)
    assert not it(qp.q, qp.l, qp.u, np.zeros(qp.n), np.zeros(qp.m))
    assert it.steps == 0


def test_far_along_a_flat_direction() -> None:
    """Without a look ahead, each proximal point goes on by the cost over the added curvature."""
    q = np.array([1e-3, -2.0])
    qp = QuadraticProgram(np.diag([0.0, 1.0]), q, np.eye(2), [-1e6, -1.0], [1e6, 1.0])
    it = polish(qp)
    assert it is not None
    np.testing.assert_allclose(it.x, [-1e6, 1.0], rtol=1e-12)
    assert it.steps < 20


# ---- OSQP with it


def backend(qp: QuadraticProgram, limits: Limits = NO_LIMITS) -> OsqpBackend:
    return OsqpBackend(qp, limits)


def test_without_the_polish_the_answer_is_osqps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Polish, "__call__", lambda *_, **__: False)
    for seed in range(5):
        qp = soft_program(np.random.default_rng(seed))
        raw = backend(qp).solve(qp.q, qp.l, qp.u)
        assert raw.status in (Status.SOLVED, Status.ITERATION_LIMIT)
        assert raw.iterations > 25
        assert worst(qp, raw.x, raw.y) <= (1e-6 if raw.status is Status.SOLVED else 1e-2)


def test_osqp_itself_starts_from_the_last_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Polish, "__call__", lambda *_, **__: False)
    qp = semidefinite(6, 5, 2, 6).qp
    solver = backend(qp)
    first, second = (solver.solve(qp.q, qp.l, qp.u).iterations for _ in range(2))
    assert second <= 25 < first
    solver.forget()
    assert solver.solve(qp.q, qp.l, qp.u).iterations > 25


@pytest.mark.parametrize("make", [linear_program, semidefinite], ids=["LP", "semidefinite"])
def test_semidefinite_is_exact(make: Any) -> None:
    for seed in range(10):
        qp = make(seed, 12, 8).qp if make is linear_program else make(seed, 12, 4, 8).qp
        raw = backend(qp).solve(qp.q, qp.l, qp.u)
        assert raw.status is Status.SOLVED
        assert worst(qp, raw.x, raw.y) <= 1e-8


def test_states_as_variables_are_exact() -> None:
    for plan in (cart_pole(10, 0.05, (0.3, 0.0, 0.1, 0.0)), quadruped(1e-4, 4)):
        qp = plan.sparse()
        solution = Solver(qp, "osqp").solve(qp.q, qp.l, qp.u)
        assert solution.status is Status.SOLVED
        assert solution.residuals.scaled <= 1e-8


def test_a_cycle_like_the_last_takes_few_iterations() -> None:
    rng = np.random.default_rng(1)
    qp = soft_program(rng)
    solver = backend(qp)
    solver.solve(qp.q, qp.l, qp.u)
    for _ in range(10):
        raw = solver.solve(qp.q + 1e-3 * rng.standard_normal(qp.n), qp.l, qp.u)
        assert raw.status is Status.SOLVED
        assert raw.iterations <= 30


def test_where_no_row_is_broken_osqp_has_nothing_to_do() -> None:
    qp = QuadraticProgram(np.diag([1.0, 4.0]), np.zeros(2), np.eye(2), -1.0, 1.0)
    solver = backend(qp)
    raw = solver.solve(np.array([0.5, -4.0]), qp.l, qp.u)  # the second row exactly at its bound
    assert (raw.status, raw.iterations) == (Status.SOLVED, 0)
    np.testing.assert_allclose(raw.x, [-0.5, 1.0], rtol=1e-15)
    assert not raw.y.any()
    raw = solver.solve(np.array([0.5, -4.1]), qp.l, qp.u)
    assert (raw.status, raw.iterations > 0) == (Status.SOLVED, True)
    np.testing.assert_allclose(raw.x, [-0.5, 1.0], atol=1e-12)
    np.testing.assert_allclose(raw.y, [0.0, 0.1], atol=1e-12)


@pytest.mark.parametrize("polished", [True, False])
def test_the_step_size_of_a_hard_cycle_is_not_kept(
    polished: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a solve gives depends on the last multipliers alone."""
    if not polished:
        monkeypatch.setattr(Polish, "__call__", lambda *_, **__: False)
    programs = [soft_program(np.random.default_rng(seed)) for seed in range(4)]
    for qp in programs:
        solver, fresh = backend(qp), backend(qp)
        for scale in (1.0, 30.0, -8.0):
            solver.solve(scale * qp.q, qp.l, qp.u)
        solver.forget()
        after, first = (s.solve(qp.q, qp.l, qp.u) for s in (solver, fresh))
        assert after.iterations == first.iterations
        np.testing.assert_array_equal(after.x, first.x)
        np.testing.assert_array_equal(after.y, first.y)


def test_the_larger_a_program_the_longer_it_is_left_to_osqp(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    allowed: list[int] = []

    def allow(_: Polish, steps: int, __: float) -> None:
        allowed.append(steps)

    monkeypatch.setattr(Polish, "allow", allow)
    monkeypatch.setattr(Polish, "__call__", lambda *_, **__: False)
    most = []
    for size in (8, 32, 128):
        allowed.clear()
        qp = QuadraticProgram(np.eye(size), np.full(size, -3.0), np.eye(size), -1.0, 1.0)
        backend(qp).solve(qp.q, qp.l, qp.u)
        most.append(allowed[0])
    assert most == sorted(most, reverse=True)
    np.testing.assert_allclose(np.divide(most[:2], most[1:]), 4.0, rtol=0.05)


def test_infeasible_and_unbounded() -> None:
    A = np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]])
    qp = QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), A, -1.0, [1.0, np.inf, np.inf])
    solver, q = backend(qp), np.array([0.5, -1.0])
    assert solver.solve(q, qp.l, qp.u).status is Status.UNBOUNDED
    assert (
        solver.solve(q, np.array([-1.0, -1.0, 3.0]), np.array([1.0, 1.0, 9.0])).status
        is Status.INFEASIBLE
    )
    raw = solver.solve(q, qp.l, np.array([1.0, 1.0, 2.0]))
    assert raw.status is Status.SOLVED
    np.testing.assert_allclose(raw.x, [-0.5, 1.0], atol=1e-9)


def test_bounds_crossed_by_rounding_are_equal_and_nothing_is_printed(
    capfd: pytest.CaptureFixture[str],
) -> None:
    qp = QuadraticProgram(np.eye(2), np.zeros(2), np.eye(2), -1.0, 1.0)
    raw = backend(qp).solve(np.ones(2), np.array([0.5, -1.0]), np.array([0.5 - 1e-12, 1.0]))
    assert raw.status is Status.SOLVED
    np.testing.assert_allclose(raw.x, [0.5, -1.0], atol=1e-9)
    assert capfd.readouterr() == ("", "")


def test_contradiction_that_osqp_does_not_see_in_time() -> None:
    A = np.array([[1.0, 0.0], [1.0, 1e-5]])
    qp = QuadraticProgram(np.eye(2), np.zeros(2), np.vstack([A, np.eye(2)]), -9.0, 9.0)
    l, u = np.array([1.0, -9.0, -9.0, -9.0]), np.array([9.0, 1.0 - 1e-4, 9.0, 9.0])
    assert backend(qp).solve(np.ones(2), l, u).status is Status.INFEASIBLE


def test_indefinite_hessian_is_refused() -> None:
    qp = QuadraticProgram(np.diag([1.0, -1.0]), np.zeros(2), np.eye(2), -1.0, 1.0)
    with pytest.raises(BackendSetupError, match="semidefinite"):
        backend(qp)


def test_stays_usable_after_nan() -> None:
    for definite in (True, False):
        qp = soft_program(np.random.default_rng(2), definite=definite)
        solver = backend(qp)
        before = solver.solve(qp.q, qp.l, qp.u).x.copy()
        raw = solver.solve(np.full(qp.n, np.nan), qp.l, qp.u)
        assert raw.status is Status.FAILED
        after = solver.solve(qp.q, qp.l, qp.u)
        assert after.status is Status.SOLVED
        if definite:
            np.testing.assert_allclose(after.x, before, atol=1e-8)


# ---- limits


@pytest.mark.parametrize("most", [1, 2, 5, 20, 100, 400])
def test_iterations_never_exceed_their_limit(most: int) -> None:
    ends = set()
    for seed in range(12):
        qp = soft_program(np.random.default_rng(seed), definite=seed % 2 == 0)
        raw = backend(qp, Limits(iterations=most)).solve(qp.q, qp.l, qp.u)
        assert raw.iterations <= most
        assert np.isfinite(raw.x).all()
        ends.add(raw.status)
    assert ends <= {Status.SOLVED, Status.ITERATION_LIMIT}
    assert (Status.ITERATION_LIMIT in ends) == (most <= 20)
    assert (Status.SOLVED in ends) == (most >= 5)


def test_time_ends_a_solve() -> None:
    qp = cart_pole(50, 0.02, (0.7, 0.3, 0.05, 0.0)).sparse()
    scaled = Scaling(qp).qp
    begin = perf_counter()
    raw = backend(scaled, Limits(time=1e-4)).solve(scaled.q, scaled.l, scaled.u)
    assert raw.status is Status.ITERATION_LIMIT
    assert raw.iterations < 25  # OSQP stops within a round, not only after it
    assert perf_counter() - begin < 5.0
    ample = backend(scaled, Limits(time=60.0))
    assert ample.solve(scaled.q, scaled.l, scaled.u).status is Status.SOLVED


def test_limits_hold_for_each_solve_anew() -> None:
    qp = soft_program(np.random.default_rng(4))
    solver = backend(qp, Limits(iterations=1000, time=60.0))
    for _ in range(5):
        solver.forget()
        raw = solver.solve(qp.q, qp.l, qp.u)
        assert raw.status is Status.SOLVED


# ---- other rows


@pytest.mark.parametrize("sparse", [True, False])
def test_replaced_rows_are_as_good_as_new_ones(sparse: bool) -> None:
    """Within the first pattern, and beyond it."""
    rng = np.random.default_rng(6)
    qp = soft_program(rng)
    solver = backend(qp)
    for _ in range(5):
        A = rng.standard_normal(qp.A.shape)
        if sparse:
            A *= qp.A != 0
        solver.replace_rows(A)
        l, u = np.where(np.isinf(qp.linear), -9.0, qp.l), np.where(np.isinf(qp.linear), 9.0, qp.u)
        fresh = QuadraticProgram(qp.P, qp.q, A, l, u, qp.linear, qp.quadratic)
        raw = solver.solve(qp.q, l, u)
        assert raw.status is Status.SOLVED
        assert worst(fresh, raw.x, raw.y) <= 1e-8
        np.testing.assert_allclose(raw.x, backend(fresh).solve(qp.q, l, u).x, atol=1e-8)


@pytest.mark.parametrize("polished", [True, False])
def test_rows_may_vanish_and_come_back(polished: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the polish as well, which would put right what OSQP did with the rows it had."""
    if not polished:
        monkeypatch.setattr(Polish, "__call__", lambda *_, **__: False)
    qp = QuadraticProgram(np.eye(2), np.zeros(2), np.eye(2), -1.0, 1.0)
    solver, q = backend(qp), np.array([-3.0, 2.0])
    for A, expected in (
        (np.eye(2), [1.0, -1.0]),
        (np.array([[1.0, 0.0], [0.0, 0.0]]), [1.0, -2.0]),
        (np.array([[0.0, 1.0], [1.0, 0.0]]), [1.0, -1.0]),
        (np.array([[2.0, 0.0], [0.0, 1.0]]), [0.5, -1.0]),
    ):
        solver.replace_rows(A)
        np.testing.assert_allclose(solver.solve(q, qp.l, qp.u).x, expected, atol=1e-7)
