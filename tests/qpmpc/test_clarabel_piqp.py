# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""What is particular to Clarabel and PIQP; test_backends.py has what all backends promise."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from qpmpc import BackendSetupError, Limits, QuadraticProgram, Solver, Status
from qpmpc.arrays import Array
from qpmpc.backends import backend_class
from qpmpc.backends._layout import Setups
from qpmpc.polish import Polish
from qpmpc.scaling import Scaling

pytest.importorskip("clarabel")
pytest.importorskip("piqp")
both = pytest.mark.parametrize("name", ["clarabel", "piqp"])
INF = np.inf


@pytest.fixture(autouse=True)
def silence(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Nothing is printed, whatever a solver meets."""
    yield
    assert capfd.readouterr() == ("", "")


@pytest.fixture(params=["polished", "as the solver leaves it"])
def polish(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    """Whether answers are polished: what is wrong with a set-up must not hide behind that."""
    if request.param == "polished":
        return True
    monkeypatch.setattr(Polish, "__call__", lambda *_, **__: False)
    return False


@pytest.fixture
def program(rng: np.random.Generator) -> QuadraticProgram:
    """Five variables, ten rows, four of them soft, feasible at x = 0."""
    root = rng.standard_normal((5, 5))
    linear = np.array([INF, 5.0] * 2 + [INF] * 4 + [5.0] * 2)
    return QuadraticProgram(
        root @ root.T + np.eye(5), np.zeros(5), rng.standard_normal((10, 5)),
        np.full(10, -0.5), np.full(10, 0.5), linear, np.where(linear < 8, 0.3, 0.0),
    )  # fmt: skip


def layouts(qp: QuadraticProgram) -> list[tuple[Array, Array]]:
    """Bounds that come, go and fall together, hard and soft, and return to what they were."""
    found = []
    for infinite_l, infinite_u, equal in (
        ([], [], []),
        ([0, 1, 2], [3, 4], []),
        ([], [], [0, 5]),
        ([0, 4], [0, 4], [1]),
        (range(10), range(10), []),
        ([], [], []),
        ([], [], [5]),
        ([2, 3], [], []),
        ([], range(10), []),
        (range(10), [], []),
        ([6], [7], [8]),
        ([7], [6], [9]),
        ([], [], []),
    ):
        l, u = np.array(qp.l), np.array(qp.u)
        l[list(infinite_l)], u[list(infinite_u)] = -INF, INF
        l[list(equal)] = u[list(equal)] = 0.1
        found.append((l, u))
    return found


# ---- layouts of the bounds


@both
def test_each_layout_gives_the_answer_of_a_fresh_solver_and_of_daqp(
    name: str, polish: bool, program: QuadraticProgram, rng: np.random.Generator
) -> None:
    solver, daqp = Solver(program, name), Solver(program, "daqp")
    accuracy = 1e-8 if polish else 1e-6
    for l, u in layouts(program):
        q = 5 * rng.standard_normal(5)
        found, fresh = solver.solve(q, l, u), Solver(program, name).solve(q, l, u)
        expected = daqp.solve(q, l, u)
        assert found.status is fresh.status is expected.status is Status.SOLVED
        assert found.residuals.scaled <= accuracy
        np.testing.assert_allclose(found.x, fresh.x, atol=accuracy)
        np.testing.assert_allclose(found.x, expected.x, atol=accuracy)
        np.testing.assert_allclose(found.slack, expected.slack, atol=accuracy)


@both
def test_build_time_is_told_of_a_new_layout_only(name: str, program: QuadraticProgram) -> None:
    solver, q = Solver(program, name), np.ones(5)
    free = np.full(10, INF)
    assert solver.solve(q, program.l, program.u).build_time == 0.0
    assert solver.solve(2 * q, program.l - 1, program.u).build_time == 0.0
    assert solver.solve(q, -free, free).build_time > 0.0
    assert solver.solve(q, program.l, program.u).build_time == 0.0
    assert solver.solve(2 * q, -free, free).build_time == 0.0
    for i in range(10):  # so many that the first are forgotten
        u = program.u.copy()
        u[i] = INF
        assert solver.solve(q, program.l, u).build_time > 0.0
    assert solver.solve(q, -free, free).build_time > 0.0


@both
@pytest.mark.parametrize("far", [1e4, 1e7, 1e9, 1e15, 1e19])
def test_far_bound_that_is_out_of_reach_does_no_harm(
    name: str, far: float, polish: bool, program: QuadraticProgram, rng: np.random.Generator
) -> None:
    solver = Solver(program, name)
    far_l, far_u, free_l, free_u = (np.array(b) for b in (program.l, program.u) * 2)
    far_l[:3], far_u[2:5], free_l[:3], free_u[2:5] = -far, far, -INF, INF
    for _ in range(5):
        q = 5 * rng.standard_normal(5)
        expected = solver.solve(q, free_l, free_u).x.copy()
        found = solver.solve(q, far_l, far_u)
        assert found.status is Status.SOLVED
        np.testing.assert_allclose(found.x, expected, atol=1e-6)


@both
@pytest.mark.parametrize(("curve", "slope"), [(0.0, -1.0), (1e-6, -1e3)])
def test_far_bound_that_holds_is_kept(name: str, curve: float, slope: float) -> None:
    qp = QuadraticProgram([[curve, 0], [0, 1.0]], np.zeros(2), np.eye(2), -1.0, 1.0)
    solver = Solver(qp, name)
    for far in (1e8, 1e7):
        found = solver.solve(np.array([slope, 0.0]), qp.l, np.array([far, 1.0]))
        assert found.status is Status.SOLVED
        assert found.x[0] == pytest.approx(far, rel=1e-6)


@both
@pytest.mark.parametrize(("curve", "slope"), [(0.0, -1.0), (1.0, -4e6)])
def test_far_bound_that_holds_is_seen_by_the_solver(
    name: str, polish: bool, curve: float, slope: float
) -> None:
    qp = QuadraticProgram([[curve, 0], [0, 1.0]], np.zeros(2), np.eye(2), -1.0, 1.0)
    found = Solver(qp, name).solve(np.array([slope, 0.0]), qp.l, np.array([2e6, 1.0]))
    assert found.status is Status.SOLVED
    assert found.x[0] == pytest.approx(2e6, rel=1e-6)


@both
def test_backend_itself_bears_a_bound_beyond_all_measure(name: str) -> None:
    """Clarabel would take such a row out, and then refuse to be updated."""
    qp = QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), np.eye(2), -1.0, [1.0, INF])
    backend, q = backend_class(name)(qp, Limits()), np.array([0.5, -1.0])
    for _ in range(2):
        backend.solve(q, np.array(qp.l), np.array([1.0, 1e25]))
        assert backend.solve(q, np.array(qp.l), np.ones(2)).status is Status.SOLVED


def test_rows_are_sorted_by_what_bounds_them() -> None:
    setups = Setups(lambda layout: layout)
    l = np.array([-INF, -INF, -1.0, 0.5, -1.0, -1e7, -1e7, 3e7])
    u = np.array([INF, 1.0, INF, 0.5, 1.0, 1.0, 1e7, 3e7])
    layout, _ = setups(l, u, 1e6)
    np.testing.assert_array_equal(layout.equal, [3, 7])
    np.testing.assert_array_equal(layout.lower, [2, 4])
    np.testing.assert_array_equal(layout.upper, [1, 4, 5])
    layout, _ = setups(l, u, INF)
    np.testing.assert_array_equal(layout.equal, [3, 7])
    np.testing.assert_array_equal(layout.lower, [2, 4, 5, 6])
    np.testing.assert_array_equal(layout.upper, [1, 4, 5, 6])


# ---- rows


@both
def test_replaced_rows_give_the_answer_of_a_fresh_solver(
    name: str, polish: bool, program: QuadraticProgram, rng: np.random.Generator
) -> None:
    sparse = np.where(rng.random((10, 5)) < 0.5, program.A, 0.0)
    first = QuadraticProgram(
        program.P, program.q, sparse, program.l, program.u, program.linear, program.quadratic
    )
    solver = Solver(first, name, pattern=np.ones((10, 5), dtype=np.bool_))
    l, u = layouts(program)[3]
    kept = np.abs(sparse).max(axis=1) > 0  # rows of nothing have no scale to compare
    assert kept.all()
    for A in (
        sparse * 2.0,
        sparse * rng.random((10, 5)),
        program.A,  # entries that were zero
        sparse,  # and are again
        rng.standard_normal((10, 5)),
    ):
        solver.replace_rows(A)
        new = QuadraticProgram(
            program.P, program.q, A, program.l, program.u, program.linear, program.quadratic
        )
        for bounds in ((program.l, program.u), (l, u)):
            q = 5 * rng.standard_normal(5)
            found, fresh = solver.solve(q, *bounds), Solver(new, name).solve(q, *bounds)
            assert found.status is fresh.status is Status.SOLVED
            np.testing.assert_allclose(found.x, fresh.x, atol=1e-8 if polish else 1e-6)


@both
def test_rows_are_replaced_in_place(
    name: str, program: QuadraticProgram, rng: np.random.Generator
) -> None:
    solver = Solver(program, name)
    q = 5 * rng.standard_normal(5)
    solver.replace_rows(program.A * 1.1)
    assert solver.solve(q, program.l, program.u).build_time == 0.0


# ---- multipliers


@both
def test_multipliers_have_the_sign_of_their_bound(name: str) -> None:
    qp = QuadraticProgram(
        np.eye(5), np.zeros(5), np.eye(5), -np.ones(5), np.ones(5), [INF, INF, INF, 2.0, 2.0]
    )
    l, u = np.array([-1, -1, 0.5, -1, -1]), np.array([1, 1, 0.5, 1, 1])
    solution = Solver(qp, name).solve(np.array([-3.0, 4.0, 0.0, -6.0, 6.0]), l, u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [1.0, -1.0, 0.5, 4.0, -4.0], atol=1e-9)
    np.testing.assert_allclose(solution.y, [2.0, -3.0, -0.5, 2.0, -2.0], atol=1e-9)
    np.testing.assert_allclose(solution.slack, [0, 0, 0, 3.0, 3.0], atol=1e-9)


@both
def test_row_that_is_touched_without_force_is_exact(name: str) -> None:
    """Where distance and multiplier both are zero, an interior point has the root of either."""
    qp = QuadraticProgram(np.eye(3), np.zeros(3), np.eye(3), -np.ones(3), np.ones(3), [INF, 1, 1])
    solver = Solver(qp, name)
    for q, x in (([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0]), ([-1.0, 1.0, -2.0], [1.0, -1.0, 1.0])):
        solution = solver.solve(np.array(q), qp.l, qp.u)
        assert solution.status is Status.SOLVED
        assert solution.residuals.scaled <= 1e-9
        np.testing.assert_allclose(solution.x, x, atol=1e-9)


# ---- limits and what has no answer


@both
def test_limit_of_iterations(name: str, contact_problem: Any, instance: Any) -> None:
    rng = np.random.default_rng(7)
    problem = contact_problem(rng, 1, 8)
    vectors = [instance(rng, problem).vectors() for _ in range(10)]
    groups = list(problem.rows.values())
    short = Solver(problem.qp, name, groups, limits=Limits(iterations=1))
    ample = Solver(problem.qp, name, groups, limits=Limits(iterations=100))
    for v in vectors:
        solution = short.solve(*v)
        assert solution.status is Status.ITERATION_LIMIT
        assert solution.iterations == 1
        assert ample.solve(*v).status is Status.SOLVED


def test_limit_of_time(program: QuadraticProgram) -> None:
    q = 5 * np.ones(5)
    for time, status in ((1e-9, Status.ITERATION_LIMIT), (1.0, Status.SOLVED)):
        solver = Solver(program, "clarabel", limits=Limits(time=time))
        assert solver.solve(q, program.l, program.u).status is status
    with pytest.raises(BackendSetupError, match="no limit of time"):
        Solver(program, "piqp", limits=Limits(time=1.0))


@both
def test_without_answer_and_with_one_again(name: str) -> None:
    qp = QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), [[1.0, 0], [1.0, 1.0]], -1.0, 1.0)
    solver = Solver(qp, name)
    free = np.array([-1.0, -INF]), np.array([1.0, INF])
    for _ in range(2):
        assert solver.solve(np.array([0.0, 1.0]), *free).status is Status.UNBOUNDED
        solution = solver.solve(np.array([-0.5, 1.0]), qp.l, qp.u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, [1.0, -2.0], atol=1e-7)
        solver.replace_rows(np.array([[1.0, 0.0], [2.0, 0.0]]))
        apart = np.array([0.9, -1.0]), np.array([1.0, 1.0])
        assert solver.solve(np.zeros(2), *apart).status is Status.INFEASIBLE
        solver.replace_rows(np.array(qp.A))


@both
def test_soft_row_far_out_of_reach_is_no_contradiction(name: str, polish: bool) -> None:
    """A row that the variable hardly moves is thousands of its units away after scaling."""
    A = np.ones((4, 1))
    l, u = np.array([-5.4, -12.2, 10978.0, -190.0]), np.array([34.6, 12.2, 87725.0, -51.0])
    qp = QuadraticProgram([[1.0]], [0.0], A, l, u, [INF, INF, 0.64, 307.5])
    solution = Solver(qp, name).solve(np.array([0.0084]), l, u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [-5.4], atol=1e-7)


@both
def test_hessian_must_be_semidefinite(name: str) -> None:
    qp = QuadraticProgram(np.diag([1.0, -1.0]), np.zeros(2), np.eye(2), -1.0, 1.0)
    with pytest.raises(BackendSetupError, match="semidefinite"):
        backend_class(name)(qp, Limits())


@both
def test_backend_itself_survives_what_is_not_finite(name: str, program: QuadraticProgram) -> None:
    qp = Scaling(program).qp
    backend, q = backend_class(name)(qp, Limits()), np.ones(5)
    before = backend.solve(q, qp.l, qp.u).x.copy()
    nan = np.full(5, np.nan)
    assert backend.solve(nan, qp.l, qp.u).status is Status.FAILED
    bounds = qp.l.copy()
    bounds[:2] = np.nan
    backend.solve(q, bounds, qp.u)
    after = backend.solve(q, qp.l, qp.u)
    assert after.status is Status.SOLVED
    np.testing.assert_allclose(after.x, before, atol=1e-9)


@both
def test_begins_from_cold(name: str, program: QuadraticProgram) -> None:
    kind, q = backend_class(name), np.array([4.0, -3.0, 2.0, -1.0, 0.5])
    assert not kind.warm_starts
    solver = Solver(program, name)
    first = solver.solve(q, program.l, program.u)
    x, iterations = first.x.copy(), first.iterations
    for factor in (-3.0, 0.1, 1.0):
        again = solver.solve(factor * q, program.l, program.u)
    assert again.iterations == iterations
    np.testing.assert_allclose(again.x, x, atol=1e-13)
