# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""One suite over every backend that is installed; what one promises is read from its class."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    Backend,
    BackendSetupError,
    BackendUnavailableError,
    QuadraticProgram,
    Solver,
    Status,
    available,
)
from qpmpc.backends import backend_class

COMMAND = 20.0
"""Bound on the command in the contact instances [m/s^2], the yardstick of accuracy."""

KINDS = [backend_class(info.name) for info in available() if info.version is not None]
backends = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
heeding = pytest.mark.parametrize(
    "kind", [kind for kind in KINDS if kind.heeds_rows], ids=lambda kind: kind.name
)
sizes = pytest.mark.parametrize(
    ("axes", "horizon"), [(axes, N) for axes in (1, 3) for N in (1, 8, 32)]
)
SIZES = {(3, 32): (3, 6)}
"""Problems and instances of each where it is not 5 times 10."""


@dataclass(frozen=True, eq=False)
class Solved:
    """A family of instances of one problem with their optima, found without the library."""

    qp: QuadraticProgram
    groups: list[slice]
    vectors: list[tuple[np.ndarray, np.ndarray, np.ndarray]]
    optima: list[Any]

    def solver(self, kind: type[Backend]) -> Solver:
        return Solver(self.qp, kind, self.groups)


@pytest.fixture(scope="session")
def families(contact_problem: Any, instance: Any, optimum: Any) -> Any:
    known: dict[tuple[int, int], list[Solved]] = {}

    def get(axes: int, horizon: int) -> list[Solved]:
        if (axes, horizon) not in known:
            rng = np.random.default_rng(100 * axes + horizon)
            problems, each = SIZES.get((axes, horizon), (5, 10))
            result = []
            for _ in range(problems):
                problem = contact_problem(rng, axes, horizon)
                vectors = [instance(rng, problem).vectors() for _ in range(each)]
                optima = [optimum(problem.qp, *v) for v in vectors]
                groups = list(problem.rows.values())
                result.append(Solved(problem.qp, groups, vectors, optima))
            known[axes, horizon] = result
        return known[axes, horizon]

    return get


def box(n: int = 2) -> QuadraticProgram:
    return QuadraticProgram(np.eye(n), np.zeros(n), np.eye(n), -np.ones(n), np.ones(n))


# ---- what a backend says of itself


@backends
def test_class_states_what_the_registry_shows(kind: type[Backend]) -> None:
    assert kind.name
    assert kind.name == kind.name.strip().lower()
    assert 0 < len(kind.summary) <= 88
    assert "\n" not in kind.summary
    assert isinstance(kind.heeds_rows, bool)
    assert backend_class(kind.name) is kind


def test_every_backend_is_listed_once_and_can_be_had_or_says_how() -> None:
    names = [info.name for info in available()]
    assert names == sorted(set(names))
    for info in available():
        if info.version is None:
            with pytest.raises(BackendUnavailableError, match=re.escape(info.install)):
                backend_class(info.name)
        else:
            assert backend_class(info.name).name == info.name


# ---- accuracy


def test_instances_are_many_and_bounds_are_active_in_a_fair_share(families: Any) -> None:
    optima = [o for axes in (1, 3) for N in (1, 8, 32) for f in families(axes, N) for o in f.optima]
    assert len(optima) >= 200
    assert all(o.feasible for o in optima)
    assert 0.2 < np.mean([o.active for o in optima]) < 0.8
    assert sum(o.slack.max() > 1e-3 for o in optima) > 20


@backends
@sizes
def test_is_the_closed_form_where_no_bound_is_active(
    families: Any, kind: type[Backend], axes: int, horizon: int
) -> None:
    calm = 0
    for family in families(axes, horizon):
        solver = family.solver(kind)
        for (q, l, u), optimum in zip(family.vectors, family.optima, strict=True):
            solution = solver.solve(q, l, u)
            if optimum.active:
                continue
            closed = np.linalg.solve(family.qp.P, -q)
            assert np.abs(solution.x - closed).max() <= 1e-6 * np.abs(closed).max()
            assert solution.status is Status.SOLVED
            calm += 1
    assert calm >= 3


@heeding
@sizes
def test_is_the_optimum_where_bounds_are_active(
    families: Any, kind: type[Backend], axes: int, horizon: int
) -> None:
    wrong, statuses = [], []
    for family in families(axes, horizon):
        solver = family.solver(kind)
        hard = np.isinf(family.qp.linear)
        room = (family.qp.u - family.qp.l)[hard]
        for (q, l, u), optimum in zip(family.vectors, family.optima, strict=True):
            solution = solver.solve(q, l, u)
            error = np.abs(solution.x - optimum.x)[:axes].max() / COMMAND
            rows = (family.qp.A @ solution.x)[hard]
            beyond = (np.maximum(rows - u[hard], l[hard] - rows) / room).max()
            statuses.append(solution.status)
            if not (error <= 1e-4 and beyond <= 1e-6):
                wrong.append((str(solution.status), error, beyond))
    assert not wrong
    assert set(statuses) == {Status.SOLVED}


@heeding
@pytest.mark.parametrize("quadratic", [0.0, 0.5])
def test_soft_rows_with_quadratic_penalty_and_one_sided_bounds(
    optimum: Any, kind: type[Backend], quadratic: float
) -> None:
    rng = np.random.default_rng(5)
    A = rng.standard_normal((6, 3))
    linear = np.array([np.inf, np.inf, 0.5, 0.5, 20.0, 20.0])
    l, u = np.array([-1, -np.inf, -1, -np.inf, 0.1, -1.0]), np.array([1, 0.5, np.inf, -0.2, 0.1, 2])
    qp = QuadraticProgram(np.eye(3), np.zeros(3), A, l, u, linear, quadratic)
    solver = Solver(qp, kind)
    for _ in range(40):
        q = 3 * rng.standard_normal(3)
        found, expected = solver.solve(q, l, u), optimum(qp, q, l, u)
        assert found.status is Status.SOLVED
        np.testing.assert_allclose(found.x, expected.x, atol=1e-5)
        np.testing.assert_allclose(found.slack, expected.slack, atol=1e-5)


@heeding
def test_bounds_move_in_and_out_of_infinity(kind: type[Backend]) -> None:
    qp = box()
    solver = Solver(qp, kind)
    free, q = np.full(2, np.inf), np.array([-3.0, 2.0])
    for l, u, expected in (
        (qp.l, qp.u, [1.0, -1.0]),
        (-free, free, [3.0, -2.0]),
        (-free, qp.u, [1.0, -2.0]),
        (qp.l, qp.u, [1.0, -1.0]),
        (np.zeros(2), np.zeros(2), [0.0, 0.0]),
    ):
        solution = solver.solve(q, l, u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, expected, atol=1e-6)


@backends
def test_program_without_rows(kind: type[Backend]) -> None:
    qp = QuadraticProgram(np.diag([2.0, 4.0]), np.zeros(2), np.zeros((0, 2)), [], [])
    solution = Solver(qp, kind).solve(np.array([2.0, 4.0]), np.zeros(0), np.zeros(0))
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, -1.0, atol=1e-6)


@backends
def test_semidefinite_hessian_is_refused_or_answered_rightly(kind: type[Backend]) -> None:
    qp = QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), np.eye(2), -1.0, 1.0)
    solver, refusal = None, None
    try:
        solver = Solver(qp, kind)
    except BackendSetupError as error:
        refusal = error.backend
    assert refusal in (None, kind.name)
    if solver:
        solution = solver.solve(np.array([-0.5, -1.0]), qp.l, qp.u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, [0.5, 1.0], atol=1e-6)


# ---- state


@backends
def test_cold_answer_is_the_warm_one(families: Any, kind: type[Backend]) -> None:
    for family in families(1, 8):
        warm = family.solver(kind)
        for v in family.vectors:
            ours = warm.solve(*v).x
            np.testing.assert_allclose(family.solver(kind).solve(*v).x, ours, atol=1e-4 * COMMAND)


@backends
def test_answers_do_not_depend_on_the_run(families: Any, kind: type[Backend]) -> None:
    family = families(3, 8)[0]
    runs = []
    for _ in range(2):
        solver = family.solver(kind)
        runs.append(
            [(s.x.copy(), s.iterations) for s in (solver.solve(*v) for v in family.vectors)]
        )
    for (x, iterations), (x_again, iterations_again) in zip(*runs, strict=True):
        np.testing.assert_array_equal(x, x_again)
        assert iterations == iterations_again


@backends
def test_two_solvers_do_not_disturb_each_other(families: Any, kind: type[Backend]) -> None:
    one, other = families(1, 8)[:2]
    a, b, alone = one.solver(kind), other.solver(kind), one.solver(kind)
    for mine, yours in zip(one.vectors, other.vectors, strict=True):
        x = a.solve(*mine).x
        b.solve(*yours)
        np.testing.assert_array_equal(x, alone.solve(*mine).x)


@backends
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_stays_usable_after_what_is_not_finite(
    families: Any, kind: type[Backend], value: float
) -> None:
    family = families(1, 8)[0]
    solver = family.solver(kind)
    for q, l, u in family.vectors:
        before = solver.solve(q, l, u).x.copy()
        broken = q.copy()
        broken[0] = value
        assert solver.solve(broken, l, u).status is Status.FAILED
        np.testing.assert_allclose(solver.solve(q, l, u).x, before, atol=1e-6 * COMMAND)


@heeding
def test_infeasible_is_said_and_survived(kind: type[Backend]) -> None:
    A = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    qp = QuadraticProgram(np.eye(2), np.zeros(2), A, [-2.0, -2, -1], [2.0, 2, 1])
    solver, q = Solver(qp, kind), np.array([0.3, 0.4])
    for _ in range(3):
        solution = solver.solve(q, np.array([1.0, -2, -1]), np.array([2.0, -1, 1]))
        assert solution.status is Status.INFEASIBLE
        assert np.isnan(solution.x).all()
        solution = solver.solve(q, qp.l, qp.u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, -q, atol=1e-6)


@heeding
def test_infeasible_contact_problem(families: Any, kind: type[Backend]) -> None:
    """A command so far outside its bound that the rate bound cannot bring it back in one cycle."""
    family = families(1, 8)[0]
    solver = family.solver(kind)
    q, l, u = family.vectors[0]
    command, hard = family.groups[0], np.isinf(family.qp.linear)
    far_l, far_u = l.copy(), u.copy()
    far_l[command], far_u[command] = l[command] + 1e3, u[command] + 1e3
    assert hard[command].all()
    assert solver.solve(q, far_l, far_u).status is Status.INFEASIBLE
    assert solver.solve(q, l, u).usable


@backends
def test_vectors_given_are_left_as_they_are(families: Any, kind: type[Backend]) -> None:
    family = families(1, 8)[0]
    solver = family.solver(kind)
    for v in family.vectors:
        before = [a.copy() for a in v]
        solver.solve(*v)
        for a, b in zip(v, before, strict=True):
            np.testing.assert_array_equal(a, b)


@backends
def test_nothing_is_printed(
    families: Any, kind: type[Backend], capfd: pytest.CaptureFixture[str]
) -> None:
    family = families(1, 8)[0]
    solver = family.solver(kind)
    for v in family.vectors:
        solver.solve(*v)
    qp = box()
    for q in ([0.3, 0.4], [3.0, 0.4], [3.0, -4.0]):  # none, one and all rows at a bound
        Solver(qp, kind).solve(np.array(q), qp.l, qp.u)
    assert capfd.readouterr() == ("", "")
