# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""What is particular to CasADi's solvers; test_backends.py has what all backends promise."""

import importlib.metadata
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    BackendSetupError,
    BackendUnavailableError,
    Limits,
    QuadraticProgram,
    Solver,
    Status,
    UnknownNameError,
    available,
)
from qpmpc.backends import backend_class
from qpmpc.symbolic import CASADI

pytest.importorskip("casadi")

NAMES = [info.name for info in available() if info.name.partition(":")[0] == "casadi"]
variants = pytest.mark.parametrize("name", NAMES)
INFINITE = np.full(2, np.inf)


@pytest.fixture(autouse=True)
def silence(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Nothing is printed, whatever a solver meets."""
    yield
    assert capfd.readouterr() == ("", "")


# ---- names


def test_variants() -> None:
    assert NAMES == [
        "casadi",
        "casadi:highs",
        "casadi:ipqp",
        "casadi:nlpsol",
        "casadi:osqp",
        "casadi:piqp",
        "casadi:proxqp",
        "casadi:qpoases",
        "casadi:qrqp",
    ]
    for info in available():
        if info.name in NAMES:
            assert info.version == importlib.metadata.version("casadi")
            assert info.install == "pip install casadi"
            assert info.replaces_rows
            assert "iterations" in info.limits


@variants
def test_class_is_made_once(name: str) -> None:
    kind = backend_class(name)
    assert kind is backend_class(name)
    assert kind.name == name
    assert kind.construction is CASADI


@pytest.mark.parametrize("name", ["casadi:", "casadi:daqp"])
def test_daqp_is_what_plain_casadi_means(name: str) -> None:
    assert backend_class(name) is backend_class("casadi")


def test_unknown_plugin_is_told_with_the_valid_ones() -> None:
    with pytest.raises(UnknownNameError, match=r"'casadi:qpoasis'.*'casadi:qpoases'") as caught:
        backend_class("casadi:qpoasis")
    assert list(caught.value.valid) == sorted(NAMES)
    assert caught.value.kind == "backend"


@variants
def test_without_casadi_it_says_what_to_install(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def none(package: str) -> str:
        raise importlib.metadata.PackageNotFoundError(package)

    monkeypatch.setattr(importlib.metadata, "version", none)
    with pytest.raises(BackendUnavailableError, match="pip install casadi") as caught:
        backend_class(name)
    assert caught.value.backend == name


def test_plugin_that_is_not_in_the_wheel_is_refused_in_one_line() -> None:
    class Missing(backend_class("casadi:qpoases")):  # type: ignore[misc]
        plugin = "no_such_plugin"

    with pytest.raises(BackendSetupError) as caught:
        Solver(QuadraticProgram(np.eye(2), np.zeros(2), np.eye(2), -1.0, 1.0), Missing)
    assert caught.value.backend == "casadi:qpoases"
    assert "\n" not in str(caught.value)


# ---- rows


@variants
def test_replaced_rows_are_those_of_a_fresh_solver(
    name: str, random_program: Callable[..., QuadraticProgram], optimum: Callable[..., Any]
) -> None:
    """Entries that were zero included, hard and soft rows alike, and back again."""
    rng = np.random.default_rng(8)
    first = random_program(rng, 5, 12, 5)
    first = QuadraticProgram(
        first.P, first.q, np.where(rng.random((12, 5)) < 0.5, 0.0, first.A),
        first.l, first.u, first.linear, first.quadratic,
    )  # fmt: skip
    second = QuadraticProgram(
        first.P, first.q, rng.standard_normal((12, 5)),
        first.l, first.u, first.linear, first.quadratic,
    )  # fmt: skip
    solver = Solver(first, name, pattern=np.ones((12, 5), dtype=bool))
    for qp in (second, first, second):
        solver.replace_rows(qp.A)
        fresh = Solver(qp, name)
        for _ in range(3):
            q = 3 * rng.standard_normal(5)
            ours, theirs = solver.solve(q, qp.l, qp.u), fresh.solve(q, qp.l, qp.u)
            assert ours.status is theirs.status is Status.SOLVED
            np.testing.assert_allclose(ours.x, optimum(qp, q, qp.l, qp.u).x, atol=1e-6)
            np.testing.assert_allclose(theirs.x, ours.x, atol=1e-6)


@variants
def test_rows_without_bounds_are_replaced_as_well(name: str) -> None:
    """A row that bounds nothing may be zeroed for a solver; it must come back with its bound."""
    qp = QuadraticProgram(np.eye(2), np.zeros(2), np.eye(2), -np.ones(2), np.ones(2))
    solver, q = Solver(qp, name), np.array([-3.0, -3.0])
    assert solver.solve(q, -INFINITE, INFINITE).x == pytest.approx([3.0, 3.0], abs=1e-6)
    solver.replace_rows(np.array([[1.0, 1.0], [0.0, 1.0]]))
    half = np.array([2.0, np.inf])
    assert solver.solve(q, -INFINITE, half).x == pytest.approx([1.0, 1.0], abs=1e-6)
    assert solver.solve(q, -INFINITE, INFINITE).x == pytest.approx([3.0, 3.0], abs=1e-6)
    assert solver.solve(q, qp.l, qp.u).x == pytest.approx([0.5, 0.5], abs=1e-6)


@variants
def test_equations_and_inequalities_have_their_own_multipliers(name: str) -> None:
    """In whatever order they stand: CasADi itself mixes ProxQP's up."""
    qp = QuadraticProgram(np.eye(3), np.zeros(3), np.eye(3), -np.ones(3), np.ones(3))
    solver = Solver(qp, name)
    for equal in range(3):
        l, u = qp.l.copy(), qp.u.copy()
        l[equal] = u[equal] = 0.25
        solution = solver.solve(np.array([-2.0, 3.0, 0.5]), l, u)
        expected = np.clip([2.0, -3.0, -0.5], l, u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, expected, atol=1e-6)
        np.testing.assert_allclose(solution.y, [2.0, -3.0, -0.5] - expected, atol=1e-5)


def test_multipliers_of_proxqp_are_right_before_any_polish() -> None:
    class Plain(backend_class("casadi:proxqp")):  # type: ignore[misc]
        def _better(self, q: np.ndarray, l: np.ndarray, u: np.ndarray) -> bool:
            return False

    qp = QuadraticProgram(np.eye(3), np.zeros(3), np.eye(3), -np.ones(3), np.ones(3))
    solver = Solver(qp, Plain)
    l, u = np.array([-1.0, 0.25, -1.0]), np.array([1.0, 0.25, 1.0])
    solution = solver.solve(np.array([-2.0, 3.0, 0.5]), l, u)
    np.testing.assert_allclose(solution.y, [1.0, -3.25, 0.0], atol=1e-4)


@variants
def test_bounds_that_rounding_has_crossed_are_equations(name: str) -> None:
    qp = QuadraticProgram(np.eye(2), np.zeros(2), np.eye(2), -np.ones(2), np.ones(2))
    l, u = np.array([0.25 + 1e-12, -1.0]), np.array([0.25, 1.0])
    solution = Solver(qp, name).solve(np.array([-2.0, 0.5]), l, u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [0.25, -0.5], atol=1e-6)


@pytest.mark.parametrize("price", [1e2, 1e4, 1e6])
def test_daqp_ends_by_itself_however_dear_slack_is(
    price: float, contact_problem: Callable[..., Any], instance: Callable[..., Any]
) -> None:
    """Its proximal steps end where rounding keeps them from becoming shorter."""

    class Unpolished(backend_class("casadi")):  # type: ignore[misc]
        def _better(self, q: np.ndarray, l: np.ndarray, u: np.ndarray) -> bool:
            return False

    rng = np.random.default_rng(11)
    for _ in range(20):
        problem = contact_problem(rng, 1, 8)
        qp = problem.qp
        dear = QuadraticProgram(
            qp.P, qp.q, qp.A, qp.l, qp.u, np.where(np.isinf(qp.linear), np.inf, price), qp.quadratic
        )
        backend = Unpolished(dear, Limits())
        for _ in range(20):
            assert backend.solve(*instance(rng, problem).vectors()).status is Status.SOLVED


# ---- state


@variants
def test_warm_answers_are_the_cold_ones(
    name: str, contact_problem: Callable[..., Any], instance: Callable[..., Any]
) -> None:
    """Whatever came before, and where two solvers run side by side."""
    rng = np.random.default_rng(4)
    problem = contact_problem(rng, 1, 8)
    vectors = [instance(rng, problem).vectors() for _ in range(4)]
    cold = []
    for v in vectors:
        cold.append(Solver(problem.qp, name).solve(*v).x.copy())
    for order in (vectors, vectors[::-1], [*vectors, *vectors]):
        solver = Solver(problem.qp, name)
        for v in order:
            expected = cold[next(i for i, w in enumerate(vectors) if w is v)]
            solution = solver.solve(*v)
            assert solution.status is Status.SOLVED
            np.testing.assert_allclose(solution.x, expected, atol=1e-4)


@variants
def test_contradiction_is_told_and_forgotten(name: str) -> None:
    """Rows against each other, equations too, a lower bound above the upper one."""
    A = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    qp = QuadraticProgram(np.eye(2), np.zeros(2), A, [-2.0, -2, -1], [2.0, 2, 1])
    solver, q = Solver(qp, name), np.array([0.3, 0.4])
    for l, u in (
        ([1.0, -2, -1], [2.0, -1, 1]),
        ([1.0, -1, -1], [1.0, -1, 1]),
        ([1.0, -2, -1], [-1.0, 2, 1]),
    ):
        assert solver.solve(q, np.array(l), np.array(u)).status is Status.INFEASIBLE
        solution = solver.solve(q, qp.l, qp.u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, -q, atol=1e-6)


@variants
def test_nothing_stops_the_cost(name: str) -> None:
    """Told where the solver knows; never solved, and the next solve is as if nothing had been."""
    qp = QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), np.eye(2), -1.0, 1.0)
    solver, q = Solver(qp, name), np.array([-0.5, -1.0])
    status = solver.solve(q, -INFINITE, INFINITE).status
    assert status in (Status.UNBOUNDED, Status.ITERATION_LIMIT, Status.FAILED)
    if name in ("casadi:nlpsol", "casadi:osqp", "casadi:qpoases"):
        assert status is Status.UNBOUNDED
    solution = solver.solve(q, qp.l, qp.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [0.5, 1.0], atol=1e-6)


# ---- limits


@variants
def test_limit_of_iterations_is_heeded(
    name: str, contact_problem: Callable[..., Any], instance: Callable[..., Any]
) -> None:
    rng = np.random.default_rng(3)
    problem = contact_problem(rng, 1, 8)
    short = Solver(problem.qp, name, limits=Limits(iterations=1))
    enough = Solver(problem.qp, name, limits=Limits(iterations=5000))
    statuses = set()
    for _ in range(6):
        vectors = instance(rng, problem).vectors()
        statuses.add(short.solve(*vectors).status)
        assert enough.solve(*vectors).status is Status.SOLVED
    assert Status.ITERATION_LIMIT in statuses
    assert statuses <= {Status.ITERATION_LIMIT, Status.SOLVED}


def test_limit_of_time_is_heeded(
    contact_problem: Callable[..., Any], instance: Callable[..., Any]
) -> None:
    rng = np.random.default_rng(3)
    problem = contact_problem(rng, 1, 8)
    names = [name for name in NAMES if "time" in backend_class(name).limits]
    assert names == ["casadi:nlpsol"]
    solver = Solver(problem.qp, names[0], limits=Limits(time=1e-6))
    statuses = {solver.solve(*instance(rng, problem).vectors()).status for _ in range(4)}
    assert statuses == {Status.ITERATION_LIMIT}
