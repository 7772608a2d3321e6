# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""One suite over every backend that is installed; what one promises is read from its class.

Backends that stand for themselves see every size; those that are another way to a solver that is
there anyway see a few.
"""

import ctypes
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    Backend,
    BackendSetupError,
    BackendUnavailableError,
    BoundsConfig,
    ControllerConfig,
    ForceController,
    Limits,
    QuadraticProgram,
    Solution,
    Solver,
    Status,
    TangentialConfig,
    available,
)
from qpmpc.backends import backend_class

COMMAND = 20.0
"""Bound on the command in the contact instances [m/s^2], the yardstick of accuracy."""
RIGHT = 1e-4
"""Error of a right answer, as a share of the bound."""

KINDS = [backend_class(info.name) for info in available() if info.version is not None]
HEEDING = [kind for kind in KINDS if kind.heeds_rows]
EVERY_SIZE = [(axes, horizon) for axes in (1, 3, 6) for horizon in (1, 8, 32)]
FEW_SIZES = [(1, 1), (1, 8), (3, 8)]
FAMILIES = {(3, 32): (2, 4), (6, 1): (2, 6), (6, 8): (2, 4), (6, 32): (1, 4)}
"""Problems and instances of each where it is not 4 times 8."""


def by_another_way(kind: type[Backend]) -> bool:
    return ":" in kind.name and kind.name != "casadi:osqp"


def may_fail(kind: type[Backend]) -> bool:
    """Whether the backend says that it now and then has no answer."""
    return "fails" in kind.summary


def name(kind: type[Backend]) -> str:
    return kind.name


def sized(kinds: list[type[Backend]]) -> Any:
    pairs = [
        pytest.param(kind, *size, id=f"{kind.name}-{size[0]}x{size[1]}")
        for kind in kinds
        for size in (FEW_SIZES if by_another_way(kind) else EVERY_SIZE)
    ]
    return pytest.mark.parametrize(("kind", "axes", "horizon"), pairs)


def except_for(kinds: list[type[Backend]], marks: dict[str, str]) -> Any:
    """All kinds, of which some are known to fail, and why."""
    each = [
        pytest.param(kind, marks=pytest.mark.xfail(strict=True, reason=marks[kind.name]))
        if kind.name in marks
        else kind
        for kind in kinds
    ]
    return pytest.mark.parametrize("kind", each, ids=[kind.name for kind in kinds])


backends = pytest.mark.parametrize("kind", KINDS, ids=name)
heeding = pytest.mark.parametrize("kind", HEEDING, ids=name)
Vectors = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Family:
    """Instances of one problem with their optima, found without the library."""

    qp: QuadraticProgram
    groups: list[slice]
    vectors: list[Vectors]
    optima: list[Any]

    def solver(self, kind: type[Backend], **settings: Any) -> Solver:
        return Solver(self.qp, kind, self.groups, **settings)


def copied(solution: Solution) -> Solution:
    """A solution whose arrays outlive the next solve."""
    return replace(solution, x=solution.x.copy(), y=solution.y.copy(), slack=solution.slack.copy())


@pytest.fixture(scope="session")
def families(contact_problem: Any, instance: Any, optimum: Any) -> Callable[..., list[Family]]:
    known: dict[tuple[int, int], list[Family]] = {}

    def get(axes: int, horizon: int) -> list[Family]:
        if (axes, horizon) not in known:
            rng = np.random.default_rng(100 * axes + horizon)
            problems, each = FAMILIES.get((axes, horizon), (4, 8))
            known[axes, horizon] = []
            for _ in range(problems):
                problem = contact_problem(rng, axes, horizon)
                vectors = [instance(rng, problem).vectors() for _ in range(each)]
                optima = [optimum(problem.qp, *v) for v in vectors]
                family = Family(problem.qp, list(problem.rows.values()), vectors, optima)
                known[axes, horizon].append(family)
        return known[axes, horizon]

    return get


@pytest.fixture(scope="session")
def solutions(families: Any) -> Callable[..., Any]:
    """What a backend answers to all instances of a size, solved once in a row."""
    known: dict[tuple[str, int, int], list[tuple[Family, Vectors, Any, Solution]]] = {}

    def get(kind: type[Backend], axes: int, horizon: int) -> Any:
        key = kind.name, axes, horizon
        if key not in known:
            found = known[key] = []
            for family in families(axes, horizon):
                solver = family.solver(kind)
                for v, best in zip(family.vectors, family.optima, strict=True):
                    found.append((family, v, best, copied(solver.solve(*v))))
        return known[key]

    return get


def is_right(solution: Solution, best: Any, commands: int | None = None) -> bool:
    """Whether the commands of the first step (all variables, if not given) are the optimum's."""
    error = np.abs(solution.x - best.x)[:commands].max()
    return bool(error <= RIGHT * COMMAND)


def box(n: int = 2) -> QuadraticProgram:
    return QuadraticProgram(np.eye(n), np.zeros(n), np.eye(n), -np.ones(n), np.ones(n))


# ---- what a backend says of itself


@backends
def test_class_states_what_the_registry_shows(kind: type[Backend]) -> None:
    assert kind.name
    assert kind.name == kind.name.strip().lower()
    assert 0 < len(kind.summary) <= 88
    assert "\n" not in kind.summary
    assert all(isinstance(t, bool) for t in (kind.heeds_rows, kind.warm_starts, kind.replaces_rows))
    assert kind.limits <= {"iterations", "time"}
    assert kind.smallest_part >= 1
    assert backend_class(kind.name) is kind
    info = next(info for info in available() if info.name == kind.name)
    assert (info.summary, info.package) == (kind.summary, kind.package)
    assert (info.warm_starts, info.replaces_rows) == (kind.warm_starts, kind.replaces_rows)
    assert info.limits == kind.limits


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
    optima = [o for size in EVERY_SIZE for family in families(*size) for o in family.optima]
    assert len(optima) >= 150
    assert all(o.feasible for o in optima)
    assert 0.2 < np.mean([o.active for o in optima]) < 0.8
    assert sum(o.slack.max() > 1e-3 for o in optima) > 20


@sized(KINDS)
def test_is_the_closed_form_where_no_bound_is_active(
    solutions: Any, kind: type[Backend], axes: int, horizon: int
) -> None:
    for family, (q, _, _), best, solution in solutions(kind, axes, horizon):
        if best.active or (may_fail(kind) and solution.status is not Status.SOLVED):
            continue
        closed = np.linalg.solve(family.qp.P, -q)
        assert solution.status is Status.SOLVED
        assert np.abs(solution.x - closed).max() <= 1e-6 * np.abs(closed).max()


@sized(HEEDING)
def test_is_the_optimum_within_hard_bounds_where_bounds_are_active(
    solutions: Any, kind: type[Backend], axes: int, horizon: int
) -> None:
    wrong, solved, count = [], 0, 0
    for family, (_, l, u), best, solution in solutions(kind, axes, horizon):
        count += 1
        if solution.status is not Status.SOLVED:
            assert not (solution.usable and not is_right(solution, best, axes))
            continue
        solved += 1
        hard = np.isinf(family.qp.linear)
        room, rows = (family.qp.u - family.qp.l)[hard], (family.qp.A @ solution.x)[hard]
        beyond = (np.maximum(rows - u[hard], l[hard] - rows) / room).max()
        if not (is_right(solution, best, axes) and beyond <= 1e-6):
            wrong.append((np.abs(solution.x - best.x)[:axes].max(), beyond))
    assert not wrong
    assert solved == count or (may_fail(kind) and solved >= 0.7 * count)


@pytest.fixture(scope="session")
def coupled(optimum: Any) -> Family:
    """Three axes under a cone, with the large penalties that an order of bounds asks for."""
    bounds = BoundsConfig(
        force=(-4.0, 4.0), velocity=(-0.05, 0.05), tangential=TangentialConfig(3.0, 0.2)
    )
    controller = ForceController(ControllerConfig(bounds=bounds), ("x", "y", "z"), 1e-3)
    problem, rng, vectors = controller.general.problem, np.random.default_rng(7), []
    for _ in range(12):
        state = np.zeros((3, problem.model.n_states // 3))
        previous = rng.uniform(-10, 10, 3)
        state[:, 0], state[:, 1] = rng.uniform(-5, 5, 3), rng.uniform(-0.05, 0.05, 3)
        state[:, 2:4], state[:, -4] = previous[:, None], rng.uniform(-0.06, 0.06, 3)
        state[:, -1] = rng.uniform(-3, 3, 3) - previous
        problem.update(state.ravel(), previous, np.tile(rng.uniform(-5, 5, 3), (8, 1)))
        vectors.append((problem.q.copy(), problem.l.copy(), problem.u.copy()))
    optima = [optimum(problem.qp, *v) for v in vectors]
    assert sum(best.slack.max() > 1e-2 for best in optima) >= 6
    return Family(problem.qp, list(problem.rows.values()), vectors, optima)


@heeding
def test_coupled_axes_and_ordered_penalties(coupled: Family, kind: type[Backend]) -> None:
    """Hard for a solver: some may not get there, but none calls a wrong answer solved."""
    solver, solved = coupled.solver(kind), 0
    for v, best in zip(coupled.vectors, coupled.optima, strict=True):
        solution = solver.solve(*v)
        if solution.status is Status.SOLVED:
            assert is_right(solution, best, 3)
            solved += 1
    assert solved >= (0.3 if may_fail(kind) else 0.8) * len(coupled.vectors)


@heeding
def test_any_mixture_of_hard_soft_and_quadratic_rows(
    random_program: Any, optimum: Any, kind: type[Backend]
) -> None:
    for seed in range(25):
        qp = random_program(np.random.default_rng(seed), 6, 20, 5, quadratic=seed % 2 == 0)
        solution, best = Solver(qp, kind).solve(qp.q, qp.l, qp.u), optimum(qp, qp.q, qp.l, qp.u)
        if may_fail(kind) and solution.status is not Status.SOLVED:
            continue
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, best.x, atol=1e-5)
        np.testing.assert_allclose(solution.slack, best.slack, atol=1e-5)
        stationary = qp.P @ solution.x + qp.q + qp.A.T @ solution.y
        np.testing.assert_allclose(stationary, 0.0, atol=1e-4)


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


# ---- bounds of every sort


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
        (qp.l, free, [3.0, -1.0]),
        (np.array([0.5, -np.inf]), np.array([0.5, np.inf]), [0.5, -2.0]),
        (-free, free, [3.0, -2.0]),
    ):
        solution = solver.solve(q, l, u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, expected, atol=1e-6)


@heeding
@pytest.mark.parametrize("linear", [np.inf, 50.0], ids=["hard", "soft"])
def test_equality_rows(optimum: Any, kind: type[Backend], linear: float) -> None:
    """Rows with equal bounds from the start, and rows that become so and part again."""
    rng = np.random.default_rng(8)
    A, P = rng.standard_normal((4, 5)), np.diag([1.0, 2.0, 3.0, 4.0, 5.0])
    l, u = np.array([0.3, -0.2, -1.0, -1.0]), np.array([0.3, -0.2, 1.0, 1.0])
    qp = QuadraticProgram(P, np.zeros(5), A, l, u, linear)
    solver = Solver(qp, kind)
    for third in ((-1.0, 1.0), (0.4, 0.4), (-1.0, 1.0)):
        q = 3.0 * rng.standard_normal(5)
        l[2], u[2] = third
        solution = solver.solve(q, l, u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose((A @ solution.x)[:2], [0.3, -0.2], atol=1e-6)
        np.testing.assert_allclose(solution.x, optimum(qp, q, l, u).x, atol=1e-6)


@heeding
def test_rows_that_nothing_bounds(optimum: Any, kind: type[Backend]) -> None:
    """Infinite on both sides from the start: no row, whatever its place among the others."""
    rng = np.random.default_rng(9)
    l, u = np.full(6, -np.inf), np.full(6, np.inf)
    linear = [np.inf] * 3 + [5.0] * 3
    free = QuadraticProgram(np.eye(3), np.zeros(3), rng.standard_normal((6, 3)), l, u, linear)
    q = 3.0 * rng.standard_normal(3)
    solution = Solver(free, kind).solve(q, l, u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, -q, atol=1e-6)
    np.testing.assert_allclose(solution.y, 0.0, atol=1e-6)
    l[4], u[4] = -0.1, 0.1
    bounded = replace(free, l=l, u=u)
    solution = Solver(bounded, kind).solve(q, l, u)
    assert solution.status is Status.SOLVED
    assert abs(solution.y[4]) > 0.01
    np.testing.assert_allclose(solution.x, optimum(bounded, q, l, u).x, atol=1e-6)
    np.testing.assert_allclose(np.delete(solution.y, 4), 0.0, atol=1e-6)


@backends
def test_program_without_rows(kind: type[Backend]) -> None:
    qp = QuadraticProgram(np.diag([2.0, 4.0]), np.zeros(2), np.zeros((0, 2)), [], [])
    solver = Solver(qp, kind)
    solution = solver.solve(np.array([2.0, 4.0]), np.zeros(0), np.zeros(0))
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, -1.0, atol=1e-6)
    solver.replace_rows(np.zeros((0, 2)))
    assert solver.solve(np.ones(2), np.zeros(0), np.zeros(0)).status is Status.SOLVED


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
    for family in families(1, 8)[:2]:
        warm = family.solver(kind)
        for v in family.vectors:
            ours, cold = warm.solve(*v), family.solver(kind).solve(*v)
            if may_fail(kind) and not (ours.usable and cold.usable):
                continue
            np.testing.assert_allclose(cold.x, ours.x, atol=RIGHT * COMMAND)


@backends
def test_order_of_the_instances_does_not_matter(families: Any, kind: type[Backend]) -> None:
    family = families(3, 8)[1]
    straight, other = family.solver(kind), family.solver(kind)
    expected = [copied(straight.solve(*v)) for v in family.vectors]
    for i in np.random.default_rng(1).permutation(len(expected)):
        solution = other.solve(*family.vectors[i])
        if may_fail(kind) and not (solution.usable and expected[i].usable):
            continue
        np.testing.assert_allclose(solution.x, expected[i].x, atol=RIGHT * COMMAND)


@pytest.mark.parametrize("kind", [k for k in KINDS if not k.warm_starts], ids=name)
@pytest.mark.parametrize("size", [(1, 8), (3, 8)])
def test_without_a_warm_start_the_past_is_forgotten(
    families: Any, kind: type[Backend], size: tuple[int, int]
) -> None:
    """To the last digits but one: what was solved before, bounds that came and went, NaN."""
    family = families(*size)[0]
    for i, (q, l, u) in enumerate(family.vectors[:4]):
        fresh = copied(family.solver(kind).solve(q, l, u))
        used = family.solver(kind)
        for v in family.vectors[i + 1 :]:
            used.solve(*v)
        used.solve(q, np.where(np.arange(l.size) % 3, l, -np.inf), u)
        used.solve(np.full(q.size, np.nan), l, u)
        again = used.solve(q, l, u)
        assert again.status is fresh.status
        np.testing.assert_allclose(again.x, fresh.x, rtol=1e-9, atol=1e-9 * COMMAND)


@backends
def test_forgetting_is_harmless(families: Any, kind: type[Backend]) -> None:
    family = families(1, 8)[0]
    solver = family.solver(kind)
    for v, best in zip(family.vectors, family.optima, strict=True):
        solver.solve(*v)
        solver.forget()
        solution = solver.solve(*v)
        if kind.heeds_rows and not may_fail(kind):
            assert is_right(solution, best, 1)


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
@pytest.mark.parametrize("vector", [0, 1, 2], ids=["q", "l", "u"])
def test_stays_usable_after_what_is_not_finite(
    families: Any, kind: type[Backend], value: float, vector: int
) -> None:
    family = families(1, 8)[0]
    solver = family.solver(kind)
    for v in family.vectors[:4]:
        before = solver.solve(*v).x.copy()
        broken = [a.copy() for a in v]
        broken[vector][0] = -value if vector == 2 else value
        solution = solver.solve(*broken)
        assert solution.status is Status.FAILED
        assert np.isnan(solution.x).all()
        np.testing.assert_allclose(solver.solve(*v).x, before, atol=1e-6 * COMMAND)


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
@pytest.mark.parametrize("axes", [1, 3])
def test_infeasible_contact_problem(families: Any, kind: type[Backend], axes: int) -> None:
    """A command so far outside its bound that the rate bound cannot bring it back in one cycle."""
    family = families(axes, 8)[0]
    solver = family.solver(kind)
    for (q, l, u), best in list(zip(family.vectors, family.optima, strict=True))[:3]:
        command, hard = family.groups[0], np.isinf(family.qp.linear)
        far_l, far_u = l.copy(), u.copy()
        one = np.arange(command.start, command.stop)[::axes]  # the first axis alone
        far_l[one], far_u[one] = l[one] + 1e3, u[one] + 1e3
        assert hard[command].all()
        assert solver.solve(q, far_l, far_u).status is Status.INFEASIBLE
        solution = solver.solve(q, l, u)
        assert may_fail(kind) or is_right(solution, best, axes)


@backends
def test_vectors_given_are_left_as_they_are(families: Any, kind: type[Backend]) -> None:
    family = families(1, 8)[0]
    solver = family.solver(kind)
    for v in family.vectors:
        before = [a.copy() for a in v]
        solver.solve(*v)
        for a, b in zip(v, before, strict=True):
            np.testing.assert_array_equal(a, b)


# ---- rows that change


@heeding
def test_replaced_rows_give_what_a_fresh_solver_gives(families: Any, kind: type[Backend]) -> None:
    """Other entries, zeros that fill and entries that vanish; at once, and after some solves."""
    rng = np.random.default_rng(4)
    for family in families(1, 8)[:2]:
        qp = family.qp
        solver = family.solver(kind, pattern=np.ones((qp.m, qp.n), dtype=bool))
        size = np.abs(qp.A).max(axis=1, keepdims=True)
        soft = np.isfinite(qp.linear)[:, None]
        for k, (q, l, u) in enumerate(family.vectors):
            change = rng.standard_normal(qp.A.shape) * (rng.random(qp.A.shape) < 0.5)
            keep = 1.0 if k % 2 else -1.0  # other rows altogether, every second time
            A = np.where(soft, keep * qp.A + 0.3 * size * change, qp.A)
            A[soft[:, 0] & (rng.random(qp.m) < 0.1)] = 0.0  # rows that touch nothing, for now
            solver.replace_rows(A)
            for _ in range(1 + k % 2):
                solution = solver.solve(q, l, u)
            other = Solver(replace(qp, A=A), kind, pattern=np.ones((qp.m, qp.n), dtype=bool))
            fresh = other.solve(q, l, u)
            if may_fail(kind) and not (solution.usable and fresh.usable):
                continue
            assert solution.status is fresh.status is Status.SOLVED
            np.testing.assert_allclose(solution.x, fresh.x, atol=RIGHT * COMMAND)
            np.testing.assert_allclose(solution.slack, fresh.slack, atol=1e-4)


@heeding
def test_rows_come_back(families: Any, kind: type[Backend]) -> None:
    family = families(3, 8)[0]
    solver = family.solver(kind)
    expected = [copied(solver.solve(*v)) for v in family.vectors[:3]]
    solver.replace_rows(1.5 * family.qp.A)
    changed = solver.solve(*family.vectors[0])
    assert may_fail(kind) or changed.usable
    solver.replace_rows(np.array(family.qp.A))
    for v, before in zip(family.vectors, expected, strict=False):
        if may_fail(kind) and not before.usable:
            continue
        np.testing.assert_allclose(solver.solve(*v).x, before.x, atol=1e-2 * RIGHT * COMMAND)


@heeding
def test_rows_replaced_before_a_solve_that_fails(kind: type[Backend]) -> None:
    qp = box()
    solver, q = Solver(qp, kind), np.array([-3.0, 0.5])
    solver.replace_rows(2.0 * qp.A)
    assert solver.solve(np.full(2, np.nan), qp.l, qp.u).status is Status.FAILED
    solution = solver.solve(q, qp.l, qp.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [0.5, -0.5], atol=1e-6)


# ---- limits


def limited(kinds: list[type[Backend]], limit: Any) -> Any:
    return pytest.mark.parametrize("kind", [k for k in kinds if limit in k.limits], ids=name)


def hard_instances(coupled: Family, families: Any) -> list[tuple[Family, Vectors, Any]]:
    """Instances with soft rows that give way: no solver has them at once."""
    found = [(coupled, v, o) for v, o in zip(coupled.vectors, coupled.optima, strict=True)]
    for family in families(3, 8)[:2]:
        found += [(family, v, o) for v, o in zip(family.vectors, family.optima, strict=True)]
    return [(f, v, best) for f, v, best in found if best.slack.max() > 1e-3][:10]


def check_stopped(
    solve: Callable[[Family, Vectors], Solution], instances: list[tuple[Family, Vectors, Any]]
) -> int:
    """Assert that each answer is right or said to be none; return how many were stopped."""
    stopped = 0
    for family, v, best in instances:
        solution = solve(family, v)
        if solution.status is Status.SOLVED:
            assert is_right(solution, best, 3)
        else:
            assert solution.status is Status.ITERATION_LIMIT
            stopped += 1
    return stopped


@limited(HEEDING, "iterations")
def test_one_iteration_is_not_enough_and_that_is_said(
    coupled: Family, families: Any, kind: type[Backend]
) -> None:
    def solve(family: Family, v: Vectors) -> Solution:
        return family.solver(kind, limits=Limits(iterations=1)).solve(*v)

    assert check_stopped(solve, hard_instances(coupled, families)) >= 3


@limited(HEEDING, "time")
def test_no_time_is_not_enough_and_that_is_said(
    coupled: Family, families: Any, kind: type[Backend]
) -> None:
    def solve(family: Family, v: Vectors) -> Solution:
        return family.solver(kind, limits=Limits(time=1e-9)).solve(*v)

    assert check_stopped(solve, hard_instances(coupled, families)) >= 3


@except_for(
    [kind for kind in HEEDING if "iterations" in kind.limits],
    {"qpsolvers:osqp": "not polished under any limit, though it stopped at one of its own"},
)
def test_a_stopped_solver_goes_on_with_the_next(families: Any, kind: type[Backend]) -> None:
    """What was cut short leaves nothing wrong behind, and wide limits change nothing."""
    family = families(1, 8)[0]
    settings: Any = {"limits": Limits(iterations=100_000)}
    if "time" in kind.limits:
        settings = {"limits": Limits(iterations=100_000, time=10.0)}
    wide = family.solver(kind, **settings)
    tight = family.solver(kind, limits=Limits(iterations=2))
    for v, best in zip(family.vectors, family.optima, strict=True):
        solution = tight.solve(*v)
        assert solution.status in (Status.SOLVED, Status.ITERATION_LIMIT)
        assert solution.status is not Status.SOLVED or is_right(solution, best, 1)
        solution = wide.solve(*v)
        assert may_fail(kind) or (solution.status is Status.SOLVED and is_right(solution, best, 1))


@backends
@pytest.mark.parametrize("limit", ["iterations", "time"])
def test_limits_are_taken_or_refused(kind: type[Backend], limit: str) -> None:
    make = partial(Solver, box(), kind)
    for value in (0, -1):
        with pytest.raises(BackendSetupError, match=limit) as error:
            make(limits=Limits(**{limit: value}))
        assert error.value.backend == kind.name
    if limit in kind.limits:
        assert (
            make(limits=Limits(**{limit: 1000})).solve(np.ones(2), -np.ones(2), np.ones(2)).usable
        )
    else:
        with pytest.raises(BackendSetupError, match=f"has no limit of {limit}") as error:
            make(limits=Limits(**{limit: 1000}))
        assert error.value.backend == kind.name


# ---- silence


def printed(capfd: pytest.CaptureFixture[str]) -> tuple[str, str]:
    """What came out, also of solvers in C that have not flushed it yet."""
    ctypes.CDLL(None).fflush(None)
    return tuple(capfd.readouterr())


@backends
def test_nothing_is_printed(
    families: Any, coupled: Family, kind: type[Backend], capfd: pytest.CaptureFixture[str]
) -> None:
    family = families(1, 8)[0]
    solver = family.solver(kind)
    for v in family.vectors:
        solver.solve(*v)
    qp, no = box(), np.full(2, np.inf)
    for q in ([0.3, 0.4], [3.0, 0.4], [3.0, -4.0]):  # none, one and all rows at a bound
        Solver(qp, kind).solve(np.array(q), qp.l, qp.u)
    solver, q = Solver(qp, kind), np.array([3.0, 0.4])
    solver.solve(q, -no, no)
    solver.solve(q, qp.u, qp.l)
    solver.solve(q * np.nan, qp.l, qp.u)
    solver.replace_rows(np.ones((2, 2)))
    solver.solve(q, np.array([1.0, -3.0]), np.array([2.0, -2.0]))  # contradict each other
    solver.forget()
    solver.solve(q, qp.l, qp.u)
    solver = coupled.solver(kind)
    for v in coupled.vectors[:4]:
        solver.solve(*v)
    if "iterations" in kind.limits:
        coupled.solver(kind, limits=Limits(iterations=1)).solve(*coupled.vectors[0])
    flat = replace(qp, P=np.diag([1.0, 0.0]))
    with suppress(BackendSetupError):
        Solver(flat, kind).solve(np.array([0.0, 1.0]), -no, no)  # without an end
    assert printed(capfd) == ("", "")


@heeding
def test_far_bounds_are_as_good_as_none(
    kind: type[Backend], capfd: pytest.CaptureFixture[str]
) -> None:
    qp, q = box(), np.array([-3.0, 2.0])
    solver = Solver(qp, kind)
    for far in (1e12, 1e20, 1e31):
        solution = solver.solve(q, np.array([-far, -1.0]), np.array([far, 1.0]))
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, [3.0, -1.0], atol=1e-6)
    assert printed(capfd) == ("", "")
