# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
from collections.abc import Callable
from dataclasses import replace
from time import perf_counter, sleep
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    BackendSetupError,
    BackendUnavailableError,
    Limits,
    ModelError,
    OutputBound,
    Problem,
    QuadraticProgram,
    RawSolution,
    Solver,
    Status,
    UnknownNameError,
    available,
    contact_model,
    register,
    solve,
)
from qpmpc.backends import _registry, backend_class
from qpmpc.scaling import Scaling
from qpmpc.solver import TOLERANCE

EYE = np.eye(2)


def program(linear: Any = np.inf, quadratic: Any = 0.0) -> QuadraticProgram:
    """min 1/2 |x|^2 + q'x with -1 <= x <= 1 in other units: variables and rows far from order 1."""
    D = np.diag([1e3, 1e-2])
    return QuadraticProgram(
        D @ D, np.zeros(2), 50.0 * D, [-50.0, -50.0], [50.0, 50.0], linear, quadratic
    )


@pytest.fixture
def true_answer(optimum: Any) -> Callable[..., Any]:
    """The optimum of a scaled program and its multipliers, as a backend would give them."""

    def make(qp: QuadraticProgram) -> Callable[..., tuple[np.ndarray, np.ndarray]]:
        scaled = Scaling(qp).qp

        def answer(q: Any, l: Any, u: Any) -> tuple[np.ndarray, np.ndarray]:
            x = optimum(scaled, q, l, u).x
            y = np.linalg.solve(scaled.A.T, -(scaled.P @ x + q))
            return x, y

        return answer

    return make


# ---- scaling


def test_scaled_hessian_is_the_identity_and_rows_are_of_order_one(
    rng: np.random.Generator, contact_problem: Any
) -> None:
    qp = contact_problem(rng, 3, 8).qp
    scaled = Scaling(qp).qp
    np.testing.assert_allclose(scaled.P, np.eye(qp.n) * scaled.P[0, 0], atol=1e-10)
    assert scaled.P[0, 0] == pytest.approx(1.0, rel=1e-9)
    np.testing.assert_allclose(np.linalg.norm(scaled.A, axis=1), 1.0, rtol=1e-12)


@pytest.mark.parametrize("grouped", [False, True])
def test_scaling_keeps_objective_rows_and_penalties(
    rng: np.random.Generator, contact_problem: Any, instance: Any, grouped: bool
) -> None:
    problem = contact_problem(rng, 2, 5)
    qp = problem.qp
    q, l, u = instance(rng, problem).vectors()
    scaling = Scaling(qp, problem.rows.values() if grouped else None)
    scaling.update(q, l, u)
    scaled = scaling.qp
    for _ in range(5):
        z, s = rng.standard_normal(qp.n), rng.random(qp.m)
        x = scaling.T @ z
        cost = 0.5 * x @ qp.P @ x + q @ x
        assert 0.5 * z @ scaled.P @ z + scaling.q @ z == pytest.approx(scaling.c * cost, rel=1e-9)
        np.testing.assert_allclose(scaled.A @ z / scaling.E, qp.A @ x, rtol=1e-8, atol=1e-10)
        soft = qp.soft
        give = (scaling.E * s)[soft]
        np.testing.assert_allclose(
            scaled.linear[soft] * give, scaling.c * qp.linear[soft] * s[soft], rtol=1e-12
        )
    np.testing.assert_array_equal(scaled.soft, qp.soft)
    np.testing.assert_allclose(scaling.l / scaling.E, l, rtol=1e-13)
    np.testing.assert_allclose(scaling.u / scaling.E, u, rtol=1e-13)


def test_quadratic_penalty_is_scaled_with_the_square() -> None:
    qp = program(linear=2.0, quadratic=[3.0, 4.0])
    scaling = Scaling(qp)
    s = np.array([0.2, 0.7])
    np.testing.assert_allclose(
        scaling.qp.quadratic * (scaling.E * s) ** 2, scaling.c * qp.quadratic * s**2, rtol=1e-12
    )


def test_rows_of_a_group_share_one_scale() -> None:
    contact = contact_model(1000.0, 20.0, 1e-3)
    bounds = [OutputBound("force", contact.model.C, 0, 5, 1.0)]
    problem = Problem(contact.model, 16, output_weight=1, increment_weight=1e-3, bounds=bounds)
    own, shared = Scaling(problem.qp), Scaling(problem.qp, problem.rows.values())
    assert np.ptp(own.E) > 0
    assert np.ptp(shared.E) == 0
    assert shared.E[0] == own.E.min()


def test_semidefinite_hessian_is_scaled_by_its_diagonal() -> None:
    scaled = Scaling(QuadraticProgram(np.diag([4e6, 0.0]), np.zeros(2), EYE, -1.0, 1.0)).qp
    np.testing.assert_allclose(scaled.P / scaled.P.max(), np.diag([1.0, 0.0]), atol=1e-12)


def test_row_of_zeros_and_no_rows_at_all() -> None:
    assert np.isfinite(Scaling(QuadraticProgram(EYE, [0, 0], [[0.0, 0.0]], -1, 1)).qp.A).all()
    empty = QuadraticProgram(EYE, [0, 0], np.zeros((0, 2)), [], [])
    solution = Solver(empty, "analytic").solve(np.ones(2), np.zeros(0), np.zeros(0))
    np.testing.assert_allclose(solution.x, -1.0)
    assert solution.residuals.dual == pytest.approx(0.0, abs=1e-12)


# ---- closed form


def test_analytic_is_equation_13(
    rng: np.random.Generator, contact_problem: Any, instance: Any
) -> None:
    problem = contact_problem(rng, 3, 8)
    i = instance(rng, problem)
    q, l, u = i.vectors()
    ours = Solver(problem.qp, "analytic", problem.rows.values()).solve(q, l, u)
    p = problem.prediction
    Theta, R = p.Theta, problem.qp.P / 2 - p.Theta.T @ p.Theta  # delta is 1 here
    error = i.reference.ravel() - p.Psi @ i.state - p.Upsilon @ i.previous
    expected = np.linalg.solve(Theta.T @ Theta + R, Theta.T @ error)
    np.testing.assert_allclose(ours.x, expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max())
    assert ours.status is Status.SOLVED


# ---- the check of answers


@pytest.mark.parametrize("linear", [np.inf, 30.0, 0.5], ids=["hard", "firm", "gives way"])
@pytest.mark.parametrize("square", [0.0, 0.7])
def test_residuals_vanish_at_the_optimum_alone(
    rng: np.random.Generator, liar: Any, true_answer: Any, linear: float, square: float
) -> None:
    qp = program(linear, square)
    truth = true_answer(qp)
    q, l, u = np.diag([1e3, 1e-2]) @ [2.0, -0.3], qp.l, qp.u
    residuals = Solver(qp, liar(truth)).solve(q, l, u).residuals
    assert max(residuals.primal, residuals.dual, residuals.gap) < 1e-9
    for size in (1e-3, 1e-2, 1e-1):
        for _ in range(10):
            off = size * rng.choice([-1.0, 1.0], 2) * rng.uniform(0.5, 1.0, 2)
            for moved in ((off, 0 * off), (0 * off, off)):

                def lie(q: Any, l: Any, u: Any, moved: Any = moved) -> Any:
                    x, y = truth(q, l, u)
                    return x + moved[0], y + moved[1]

                solution = Solver(qp, liar(lie)).solve(q, l, u)
                r = solution.residuals
                assert max(r.primal, r.dual, r.gap) > 0.3 * size
                assert solution.status is Status.INACCURATE


@pytest.mark.parametrize(
    ("x", "y", "residual"),
    [
        ([3.0, 0.0], [0.0, 0.0], "primal"),  # stationary, but outside a hard row
        ([0.0, 0.0], [0.0, 0.0], "dual"),  # inside, but not stationary
        ([0.0, 0.0], [3.0, 0.0], "gap"),  # stationary by a multiplier of a row that is not active
        ([1.0, 0.0], [-2.0, 0.0], "gap"),  # a multiplier of the wrong sign
    ],
)
def test_each_residual_sees_its_own_lie(
    liar: Any, x: list[float], y: list[float], residual: str
) -> None:
    q = np.array([-3.0, 0.0])
    if y[0] == -2.0:
        q = np.array([1.0, 0.0])
    qp = QuadraticProgram(EYE, q, EYE, -1.0, 1.0)
    solution = Solver(qp, liar(lambda q, l, u: (np.array(x), np.array(y)))).solve(q, qp.l, qp.u)
    found = {name: getattr(solution.residuals, name) for name in ("primal", "dual", "gap")}
    assert max(found, key=found.__getitem__) == residual
    assert solution.status is Status.INACCURATE


def test_multiplier_beyond_the_penalty_of_a_soft_row_is_a_lie(liar: Any) -> None:
    qp = QuadraticProgram(EYE, [-3.0, 0.0], EYE, -1.0, 1.0, 1.5)

    def hard(q: Any, l: Any, u: Any) -> Any:  # the answer if the row were hard
        return np.array([1.0, 0.0]), np.array([2.0, 0.0])

    solution = Solver(qp, liar(hard)).solve(qp.q, qp.l, qp.u)
    assert solution.residuals.scaled == pytest.approx(0.5 / 4.0)  # |q| is 3
    assert solution.status is Status.INACCURATE


@pytest.mark.parametrize("size", [0.0, 1.0, 50.0])
def test_tolerance_is_relative_to_the_size_of_the_problem(liar: Any, size: float) -> None:
    qp = QuadraticProgram(EYE, [size, 0.0], EYE, -1e3, 1e3)
    level = TOLERANCE * (1 + size)
    for error, status in ((0.5 * level, Status.SOLVED), (2 * level, Status.INACCURATE)):
        x = np.array([-size, error])
        kind = liar(lambda q, l, u, x=x: (x, np.zeros(2)))
        assert Solver(qp, kind).solve(qp.q, qp.l, qp.u).status is status


@pytest.mark.parametrize(("axes", "horizon"), [(1, 1), (1, 8), (3, 8), (1, 32)])
def test_what_passes_as_solved_is_right_to_a_ten_thousandth_of_the_command_bound(
    contact_problem: Any, instance: Any, liar: Any, axes: int, horizon: int
) -> None:
    rng = np.random.default_rng(horizon)
    passed = refused = 0
    for _ in range(5):
        problem = contact_problem(rng, axes, horizon, free=True)
        for size in np.logspace(-7, 0, 30):
            off = size * rng.standard_normal(problem.qp.n)
            kind = liar(lambda q, l, u, off=off: (off[: q.size] - q, np.zeros(0)))
            q, l, u = instance(rng, problem).vectors()
            solution = Solver(problem.qp, kind).solve(q, l, u)
            right = np.linalg.solve(problem.qp.P, -q)
            if solution.status is Status.SOLVED:
                assert np.abs(solution.x - right)[:axes].max() <= 1e-4 * 20.0
                passed += 1
            else:
                refused += 1
    assert passed >= 10
    assert refused >= 10


@pytest.mark.parametrize(
    ("x", "y", "status"),
    [
        ([np.nan, 0.0], [0.0, 0.0], Status.FAILED),
        ([np.inf, 0.0], [0.0, 0.0], Status.FAILED),
        ([-np.inf, np.inf], [0.0, 0.0], Status.FAILED),
        ([0.0, 0.0], [np.nan, 0.0], Status.INACCURATE),
        ([0.0, 0.0], [np.nan, np.nan], Status.INACCURATE),
    ],
)
def test_what_is_not_finite_is_never_called_solved(
    liar: Any, x: list[float], y: list[float], status: Status
) -> None:
    qp = QuadraticProgram(EYE, [0.0, 0.0], EYE, -1.0, 1.0)
    solution = Solver(qp, liar(lambda q, l, u: (np.array(x), np.array(y)))).solve(qp.q, qp.l, qp.u)
    assert solution.status is status
    assert np.isnan(solution.x).all() == (status is Status.FAILED)


@pytest.mark.parametrize("status", [Status.FAILED, Status.INFEASIBLE])
def test_a_solver_that_has_nothing_is_believed(liar: Any, status: Status) -> None:
    qp = QuadraticProgram(EYE, [0.0, 0.0], EYE, -1.0, 1.0)
    kind = liar(lambda q, l, u: (np.zeros(2), np.zeros(2)), status)
    assert Solver(qp, kind).solve(qp.q, qp.l, qp.u).status is status


@pytest.mark.parametrize("status", [Status.INACCURATE, Status.ITERATION_LIMIT])
@pytest.mark.parametrize("right", [True, False])
def test_a_solver_that_doubts_its_answer_is_checked(liar: Any, status: Status, right: bool) -> None:
    qp = QuadraticProgram(EYE, [-0.5, 0.0], EYE, -1.0, 1.0)
    answer = np.array([0.5, 0.0]) if right else np.array([0.4, 0.0])
    solver = Solver(qp, liar(lambda q, l, u: (answer, np.zeros(2)), status))
    assert solver.solve(qp.q, qp.l, qp.u).status is (Status.SOLVED if right else status)


def test_infeasible_comes_without_an_answer(liar: Any) -> None:
    qp = QuadraticProgram(EYE, [0.0, 0.0], EYE, -1.0, 1.0)
    kind = liar(lambda q, l, u: (np.full(2, 2.1e9), np.zeros(2)), Status.INFEASIBLE)
    assert np.isnan(Solver(qp, kind).solve(qp.q, qp.l, qp.u).x).all()


def test_rows_are_not_held_against_a_backend_that_does_not_heed_them(liar: Any) -> None:
    qp = QuadraticProgram(EYE, [-3.0, 0.0], EYE, -1.0, 1.0)
    kind = liar(lambda q, l, u: (-q, np.zeros(2)))
    kind.heeds_rows = False
    solution = Solver(qp, kind).solve(qp.q, qp.l, qp.u)
    assert solution.status is Status.SOLVED
    assert solution.residuals.primal == pytest.approx(2.0)
    np.testing.assert_allclose(solution.slack, [2.0, 0.0])


@pytest.mark.parametrize("vector", ["q", "l", "u"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_senseless_vectors_fail_and_the_next_solve_works(vector: str, value: float) -> None:
    qp = QuadraticProgram(EYE, [0.5, -3.0], EYE, -1.0, 1.0)
    solver = Solver(qp)
    vectors = {"q": qp.q.copy(), "l": qp.l.copy(), "u": qp.u.copy()}
    vectors[vector][1] = value
    harmless = (vector, value) in {("l", -np.inf), ("u", np.inf)}
    solution = solver.solve(**vectors)
    assert solution.status is (Status.SOLVED if harmless else Status.FAILED)
    assert np.isnan(solution.x).any() != harmless
    after = solver.solve(qp.q, qp.l, qp.u)
    assert after.status is Status.SOLVED
    np.testing.assert_allclose(after.x, [-0.5, 1.0], atol=1e-7)


def test_slack_is_in_the_units_of_the_rows() -> None:
    qp = program(linear=1e-3)
    solution = Solver(qp).solve(np.array([-3e3, 0.0]), qp.l, qp.u)
    expected = np.maximum(qp.A @ solution.x - qp.u, 0.0)
    np.testing.assert_allclose(solution.slack, expected, rtol=1e-9)
    assert solution.slack[0] == pytest.approx(50 * (3.0 - 50e-3) - 50, rel=1e-6)


def test_times_add_up_to_the_call(liar: Any) -> None:
    def slow(q: Any, l: Any, u: Any) -> Any:
        sleep(0.02)
        return np.zeros(2), np.zeros(2)

    qp = QuadraticProgram(EYE, [0.0, 0.0], EYE, -1.0, 1.0)
    solver = Solver(qp, liar(slow))
    begin = perf_counter()
    solution = solver.solve(qp.q, qp.l, qp.u)
    whole = perf_counter() - begin
    assert 0.02 <= solution.solve_time <= whole
    assert 0 < solution.update_time < whole - solution.solve_time


# ---- finding backends


def test_unknown_backend_lists_the_valid_names() -> None:
    name = available()[0].name
    with pytest.raises(UnknownNameError, match=f"did you mean '{name}'") as error:
        Solver(program(), name + "x")
    assert set(error.value.valid) == {info.name for info in available()}


def test_backend_whose_package_is_missing(monkeypatch: pytest.MonkeyPatch, liar: Any) -> None:
    monkeypatch.setattr(_registry, "_table", _registry.registered())
    kind = liar(lambda q, l, u: (q, l))
    kind.name, kind.package = "absent", "no-such-distribution"
    assert register(kind) is kind
    info = next(i for i in available() if i.name == "absent")
    assert info.version is None
    assert info.install == "pip install no-such-distribution"
    with pytest.raises(BackendUnavailableError, match="pip install no-such-distribution"):
        backend_class("absent")


def test_registered_backend_is_found_by_name(monkeypatch: pytest.MonkeyPatch, liar: Any) -> None:
    monkeypatch.setattr(_registry, "_table", _registry.registered())
    register(liar(lambda q, l, u: (np.zeros(2), np.zeros(2))))
    assert Solver(program(), "liar").backend_name == "liar"
    assert next(i.version for i in available() if i.name == "liar") == np.__version__


def test_analytic_needs_a_definite_hessian() -> None:
    qp = QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), EYE, -1.0, 1.0)
    with pytest.raises(BackendSetupError, match="not positive definite") as error:
        Solver(qp, "analytic")
    assert error.value.backend == "analytic"


def test_an_answer_that_fails_the_check_gets_a_second_attempt_from_cold(liar: Any) -> None:
    qp = QuadraticProgram(EYE, [-3.0, 0.0], EYE, -1.0, 1.0)
    right = np.array([1.0, 0.0]), np.array([2.0, 0.0])
    kind = liar(lambda q, l, u: (np.zeros(2), np.zeros(2)))

    class Recovers(kind):  # type: ignore[misc, valid-type]
        warm_starts = True
        cold = False

        def forget(self) -> None:
            self.cold = True

        def solve(self, q: Any, l: Any, u: Any) -> RawSolution:
            answer = right if self.cold else (np.zeros(2), np.zeros(2))
            return RawSolution(Status.SOLVED, *answer, 1)

    solution = Solver(qp, Recovers).solve(qp.q, qp.l, qp.u)
    assert solution.status is Status.SOLVED
    assert solution.iterations == 2
    np.testing.assert_allclose(solution.x, right[0])


def test_time_of_a_solve_that_fails_counts(liar: Any) -> None:
    def slow(q: Any, l: Any, u: Any) -> Any:
        sleep(0.002)
        return np.zeros(2), np.zeros(2)

    qp = QuadraticProgram(EYE, [0.0, 0.0], EYE, -1.0, 1.0)
    solution = Solver(qp, liar(slow, Status.INFEASIBLE)).solve(qp.q, qp.l, qp.u)
    assert solution.status is Status.INFEASIBLE
    assert solution.solve_time >= 0.002


# ---- one QP, and its answer in its own units


def test_solve_is_a_solver_used_once(liar: Any) -> None:
    qp = program(linear=30.0)
    qp = replace(qp, q=np.diag([1e3, 1e-2]) @ [-3.0, 0.4])
    mine, again = solve(qp), solve(replace(qp, q=-qp.q))
    solver = Solver(qp, "daqp").solve(qp.q, qp.l, qp.u)
    for name in ("x", "y", "slack"):
        np.testing.assert_array_equal(getattr(mine, name), getattr(solver, name))
        assert not np.shares_memory(getattr(mine, name), getattr(again, name))
    assert mine.status is Status.SOLVED
    lie = solve(qp, liar(lambda q, l, u: (q, l)))
    assert lie.status is Status.INACCURATE
    with pytest.raises(UnknownNameError):
        solve(qp, "no-such-backend")
    with pytest.raises(BackendSetupError, match="has no limit of time"):
        solve(qp, "piqp", limits=Limits(time=1.0))


@pytest.mark.parametrize("linear", [np.inf, 1e-2])
@pytest.mark.parametrize("backend", ["daqp", "osqp", "clarabel", "piqp"])
def test_multipliers_are_those_of_the_program_as_it_was_given(backend: str, linear: float) -> None:
    """Units of variables and rows lie far apart: the conditions hold in all of them."""
    qp = replace(program(linear), q=np.diag([1e3, 1e-2]) @ [-3.0, 0.4])
    solution = solve(qp, backend)
    assert solution.status is Status.SOLVED
    slope = qp.P @ solution.x + qp.q + qp.A.T @ solution.y
    np.testing.assert_allclose(slope / [1e3, 1e-2], 0.0, atol=1e-6)
    # With the bound at x_0 = 1e-3 a slope of -2e3 is left, over 5e4 of the row per unit of x_0.
    given = np.isfinite(linear)
    np.testing.assert_allclose(solution.y, [1e-2 if given else 0.04, 0.0], rtol=1e-6, atol=1e-9)
    assert (solution.slack[0] > 1e-3) == given


# ---- what may be applied


OF_A_BACKEND = [s for s in Status if s not in (Status.CLIPPED, Status.LATE)]
"""What a backend may say; the others are the controller's."""


@pytest.mark.parametrize("status", OF_A_BACKEND)
@pytest.mark.parametrize(
    ("error", "usable"), [(0.0, True), (0.9e-3, True), (1.1e-3, False), (np.nan, False)]
)
def test_usable_is_what_is_solved_or_nearly(
    liar: Any, status: Status, error: float, usable: bool
) -> None:
    qp = QuadraticProgram(EYE, [-0.5, 0.0], EYE, -1.0, 1.0)
    level = 1.5  # 1 + |q|
    kind = liar(lambda q, l, u: (np.array([0.5, error * level]), np.zeros(2)), status)
    solution = Solver(qp, kind).solve(qp.q, qp.l, qp.u)
    has_answer = status in (Status.SOLVED, Status.INACCURATE, Status.ITERATION_LIMIT)
    assert solution.usable == (usable and has_answer)
    if solution.usable:
        assert solution.residuals.scaled == pytest.approx(error, abs=1e-12)


# ---- the second attempt


def counting(liar: Any, status: Status, *, warm: bool) -> Any:
    """A backend that counts its solves and what it has been told to forget."""

    class Counts(liar(lambda q, l, u: (q, l), status)):  # type: ignore[misc]
        warm_starts, limits, solves, forgotten = warm, frozenset(("iterations", "time")), 0, 0
        given: Any = None

        def __init__(self, qp: Any, limits: Any) -> None:
            super().__init__(qp, limits)
            type(self).given = limits

        def forget(self) -> None:
            type(self).forgotten += 1

        def solve(self, q: Any, l: Any, u: Any) -> RawSolution:
            type(self).solves += 1
            return super().solve(q, l, u)

    return Counts


@pytest.mark.parametrize("status", OF_A_BACKEND)
@pytest.mark.parametrize("warm", [False, True])
def test_second_attempt_is_for_doubtful_answers_of_what_starts_warm(
    liar: Any, status: Status, warm: bool
) -> None:
    qp = QuadraticProgram(EYE, [-3.0, 0.0], EYE, -1.0, 1.0)
    kind = counting(liar, status, warm=warm)
    Solver(qp, kind).solve(qp.q, qp.l, qp.u)
    again = warm and status is not Status.ITERATION_LIMIT  # which was its own to set
    assert kind.solves == 1 + again
    assert kind.forgotten == again


def test_a_good_answer_needs_no_second_attempt(liar: Any) -> None:
    qp = QuadraticProgram(EYE, [-3.0, 0.0], EYE, -1.0, 1.0)
    kind = counting(liar, Status.SOLVED, warm=True)
    kind.answer = staticmethod(lambda q, l, u: (np.array([1.0, 0.0]), np.array([2.0, 0.0])))
    assert Solver(qp, kind).solve(qp.q, qp.l, qp.u).status is Status.SOLVED
    assert (kind.solves, kind.forgotten) == (1, 0)


def test_time_is_kept_for_a_second_attempt(liar: Any) -> None:
    qp = QuadraticProgram(EYE, [-3.0, 0.0], EYE, -1.0, 1.0)
    for warm, share in ((True, 0.5), (False, 1.0)):
        kind = counting(liar, Status.FAILED, warm=warm)
        Solver(qp, kind, limits=Limits(20, 1e-3))
        assert kind.given == Limits(20, share * 1e-3)


def test_forget_reaches_the_backend(liar: Any) -> None:
    kind = counting(liar, Status.SOLVED, warm=True)
    Solver(program(), kind).forget()
    assert kind.forgotten == 1


@pytest.mark.parametrize("limits", [Limits(iterations=5), Limits(time=1.0), Limits(5, 1.0)])
def test_limits_that_a_backend_does_not_have_are_refused(liar: Any, limits: Limits) -> None:
    with pytest.raises(BackendSetupError, match=r"has no limit of .* \(it has: none\)"):
        Solver(program(), liar(lambda q, l, u: (q, l)), limits=limits)


# ---- what no solver should see


@pytest.mark.parametrize("linear", [np.inf, 3.0])
def test_bounds_that_cross_are_contradictory(liar: Any, linear: float) -> None:
    qp = QuadraticProgram(EYE, [0.5, 0.0], EYE, -1.0, 1.0, linear)
    kind = counting(liar, Status.SOLVED, warm=True)
    solver = Solver(qp, kind)
    solution = solver.solve(qp.q, np.array([0.3, -1.0]), np.array([0.2, 1.0]))
    assert solution.status is Status.INFEASIBLE
    assert kind.solves == 0
    assert np.isnan(solution.x).all()
    ours = Solver(qp)
    nearly = ours.solve(qp.q, np.array([0.2 + 1e-12, -1.0]), np.array([0.2, 1.0]))
    assert nearly.status is Status.SOLVED
    assert nearly.x[0] == pytest.approx(0.2, abs=1e-9)


def test_indefinite_hessian_is_refused_and_rounding_is_not() -> None:
    with pytest.raises(ModelError, match=r"positive semidefinite.*-1"):
        Solver(QuadraticProgram(np.diag([1.0, -1.0]), [0, 0], EYE, -1.0, 1.0))
    nearly = np.diag([1.0, -1e-12])
    solver = Solver(QuadraticProgram(nearly, [0, 0], EYE, -1.0, 1.0), "clarabel")
    solution = solver.solve(np.array([-0.5, 0.1]), -np.ones(2), np.ones(2))
    np.testing.assert_allclose(solution.x, [0.5, -1.0], atol=1e-6)
