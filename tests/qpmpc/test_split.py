# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
from itertools import product
from typing import Any, ClassVar

import numpy as np
import pytest

from qpmpc import Backend, Limits, QuadraticProgram, RawSolution, Solver, Status
from qpmpc.split import components

WORST_LAST = [
    Status.SOLVED,
    Status.INACCURATE,
    Status.ITERATION_LIMIT,
    Status.FAILED,
    Status.UNBOUNDED,
    Status.INFEASIBLE,
]


def blocks(*sizes: int) -> np.ndarray:
    """Pattern of a block-diagonal matrix with full blocks."""
    label = np.repeat(np.arange(len(sizes)), sizes)
    return label[:, None] == label


def found(P: np.ndarray, A: np.ndarray) -> list[tuple[list[int], list[int]]]:
    return [(v.tolist(), r.tolist()) for v, r in components(P.astype(bool), A.astype(bool), 8)]


def no_rows(n: int) -> np.ndarray:
    return np.zeros((0, n))


class Recorder(Backend):
    """Remembers what it is given; answers the closed form, or what the class is told."""

    name: ClassVar[str] = "recorder"
    package: ClassVar[str] = "numpy"
    summary: ClassVar[str] = "for tests"
    heeds_rows: ClassVar[bool] = False
    limits = frozenset(("iterations", "time"))
    made: ClassVar[list["Recorder"]]
    statuses: ClassVar[list[Status]]

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        self.qp, self.given, self.forgotten, self.replaced = qp, limits, 0, None
        self.index = len(type(self).made)
        type(self).made.append(self)

    def forget(self) -> None:
        self.forgotten += 1

    def replace_rows(self, A: np.ndarray) -> None:
        self.replaced = A.copy()

    def solve(self, q: np.ndarray, l: np.ndarray, u: np.ndarray) -> RawSolution:
        told = type(self).statuses
        status = told[self.index % len(told)] if told else Status.SOLVED
        x = np.linalg.solve(self.qp.P, -q)
        return RawSolution(status, x, np.zeros(l.size), 10**self.index, 0.25 * (1 + self.index))


@pytest.fixture
def recorder() -> type[Recorder]:
    return type("Mine", (Recorder,), {"made": [], "statuses": []})


def three(rng: np.random.Generator, sizes: tuple[int, ...] = (9, 10, 11)) -> QuadraticProgram:
    """Blocks that nothing couples, with variables and rows in any order."""
    n = sum(sizes)
    label = rng.permutation(np.repeat(np.arange(len(sizes)), sizes))
    same = label[:, None] == label
    root = rng.standard_normal((n, n)) * same
    of_row = rng.integers(0, len(sizes), 2 * n)
    A = rng.standard_normal((2 * n, n)) * (of_row[:, None] == label)
    linear = np.where(rng.random(2 * n) < 0.5, np.inf, 2.0)
    return QuadraticProgram(root @ root.T + np.eye(n) * n, np.zeros(n), A, -1.0, 1.0, linear)


# ---- which variables and rows belong together


def test_blocks_of_the_hessian_are_components() -> None:
    assert found(blocks(8, 9, 10), no_rows(27)) == [
        (list(range(8)), []),
        (list(range(8, 17)), []),
        (list(range(17, 27)), []),
    ]


def test_variables_may_be_coupled_through_others_and_need_not_be_neighbours() -> None:
    P = np.eye(24, dtype=bool)
    for i in range(0, 22):  # each with the one after the next: even ones and odd ones
        P[i, i + 2] = P[i + 2, i] = True
    assert found(P, no_rows(24)) == [
        (list(range(0, 24, 2)), []),
        (list(range(1, 24, 2)), []),
    ]


def test_a_row_couples_what_it_holds_and_goes_with_it() -> None:
    A = np.zeros((4, 30))
    A[0, [12, 29]] = 1.0  # joins the second and the third block
    A[1, 3] = A[2, 11] = A[3, 25] = 1.0
    assert found(blocks(10, 10, 10), A) == [
        (list(range(10)), [1]),
        (list(range(10, 30)), [0, 2, 3]),
    ]


def test_a_row_that_touches_nothing_is_in_no_component() -> None:
    A = np.zeros((3, 20))
    A[0, 0] = A[2, 19] = 1.0
    assert found(blocks(10, 10), A) == [(list(range(10)), [0]), (list(range(10, 20)), [2])]


@pytest.mark.parametrize(
    ("smallest", "sizes", "packs"),
    [
        (8, (1, 1, 1), [3]),
        (8, (4, 4), [8]),
        (8, (4, 4, 1), [8, 1]),
        (8, (3, 3, 3), [9]),  # the third makes the pack worth a call
        (8, (7, 2, 8), [9, 8]),
        (8, (8, 8), [8, 8]),
        (8, (20, 1, 1), [20, 2]),
        (8, (1,) * 17, [8, 8, 1]),
        (8, (1,), [1]),
        (1, (1, 2, 3), [1, 2, 3]),
        (2, (1, 1, 2, 1, 5), [2, 2, 6]),
        (64, (24, 24, 24), [72]),
        (64, (64, 63, 1, 1), [64, 64, 1]),
    ],
)
def test_small_components_are_packed(
    smallest: int, sizes: tuple[int, ...], packs: list[int]
) -> None:
    """Neighbours are put together until there is enough to be worth a solver call."""
    n = sum(sizes)
    result = components(blocks(*sizes), np.eye(n, dtype=bool), smallest)
    assert [variables.size for variables, _ in result] == packs
    np.testing.assert_array_equal(np.concatenate([v for v, _ in result]), np.arange(n))
    for variables, rows in result:
        np.testing.assert_array_equal(variables, rows)


def test_least_part_is_the_backends_own_or_what_is_asked_for(recorder: Any) -> None:
    qp = QuadraticProgram(np.eye(12), np.zeros(12), no_rows(12), [], [])
    recorder.smallest_part = 5
    assert Solver(qp, recorder).parts == 3
    assert Solver(qp, recorder, smallest_part=1).parts == 12
    assert Solver(qp, recorder, smallest_part=100).parts == 1


def test_random_patterns_are_cut_where_nothing_couples(rng: np.random.Generator) -> None:
    for _ in range(50):
        n, m = int(rng.integers(1, 40)), int(rng.integers(0, 20))
        P = rng.random((n, n)) < 1.5 / n**1.5
        P = P | P.T | np.eye(n, dtype=bool)
        A = rng.random((m, n)) < 1.2 / n
        parts = components(P, A, int(rng.integers(1, 12)))
        assert sorted(np.concatenate([v for v, _ in parts]).tolist()) == list(range(n))
        label = np.empty(n, dtype=int)
        for i, (variables, rows) in enumerate(parts):
            label[variables] = i
            assert A[rows].any(axis=1).all()
        for i, (variables, rows) in enumerate(parts):
            assert not P[np.ix_(variables, label != i)].any()
            assert not A[np.ix_(rows, label != i)].any()
        with_rows = sum(rows.size for _, rows in parts)
        assert with_rows == A.any(axis=1).sum()


# ---- what comes out is what would come out of the whole


@pytest.mark.parametrize(("axes", "horizon", "parts"), [(1, 8, 1), (3, 8, 3), (3, 2, 1), (2, 9, 2)])
def test_axes_are_parts_and_answer_as_one(
    contact_problem: Any, instance: Any, axes: int, horizon: int, parts: int
) -> None:
    rng = np.random.default_rng(axes + horizon)
    for _ in range(3):
        problem = contact_problem(rng, axes, horizon)
        groups = list(problem.rows.values())
        split = Solver(problem.qp, "daqp", groups, smallest_part=8)
        whole = Solver(problem.qp, "daqp", groups, pattern=np.ones_like(problem.A, dtype=bool))
        assert (split.parts, whole.parts) == (parts, 1)
        for _ in range(10):
            v = instance(rng, problem).vectors()
            ours, theirs = split.solve(*v), whole.solve(*v)
            assert ours.status is theirs.status is Status.SOLVED
            np.testing.assert_allclose(ours.x, theirs.x, atol=1e-7)
            np.testing.assert_allclose(ours.slack, theirs.slack, atol=1e-7)


def test_answer_and_multipliers_are_put_where_they_belong(
    rng: np.random.Generator, optimum: Any
) -> None:
    """Variables and rows of the blocks lie among one another."""
    for _ in range(5):
        qp = three(rng)
        solver = Solver(qp, "clarabel", smallest_part=8)
        assert solver.parts == 3
        for _ in range(5):
            q = 60 * rng.standard_normal(qp.n)
            solution = solver.solve(q, qp.l, qp.u)
            expected = optimum(qp, q, qp.l, qp.u)
            assert solution.status is Status.SOLVED
            assert expected.slack.max() > 0.01
            np.testing.assert_allclose(solution.x, expected.x, atol=1e-6)
            np.testing.assert_allclose(solution.slack, expected.slack, atol=1e-6)
            stationary = qp.P @ solution.x + q + qp.A.T @ solution.y
            np.testing.assert_allclose(stationary, 0.0, atol=1e-5)


def test_a_coupling_row_joins_two_axes(contact_problem: Any, instance: Any, optimum: Any) -> None:
    rng = np.random.default_rng(3)
    problem = contact_problem(rng, 3, 8)
    qp, groups = problem.qp, list(problem.rows.values())
    i = instance(rng, problem)
    q, l, u = i.vectors()
    alone = Solver(qp, "daqp", groups).solve(q, l, u).x
    both = alone[0] + alone[1]  # first increments of x and y
    row = np.zeros((1, qp.n))
    row[0, :2] = 1.0
    joined = QuadraticProgram(
        qp.P, q, np.vstack([qp.A, row]),
        np.append(l, -np.inf), np.append(u, both - 0.5), np.append(qp.linear, np.inf), 0.0,
    )  # fmt: skip
    solver = Solver(joined, "daqp", groups, smallest_part=8)
    assert solver.parts == 2
    solution = solver.solve(joined.q, joined.l, joined.u)
    assert solution.status is Status.SOLVED
    assert solution.x[0] + solution.x[1] == pytest.approx(both - 0.5, abs=1e-7)
    np.testing.assert_allclose(solution.x[2::3], alone[2::3], atol=1e-7)  # z as if alone
    np.testing.assert_allclose(solution.x, optimum(joined, q, joined.l, joined.u).x, atol=1e-5)


# ---- rows that touch no variable


def with_empty(low: float, high: float, linear: float, quadratic: float = 0.0) -> QuadraticProgram:
    """min 1/2 |x|^2 - 3 x_0 with |x_0| <= 1 between rows of zeros."""
    A = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 0.0]])
    return QuadraticProgram(
        np.eye(2), [-3.0, 0.0], A, [low, -1.0, -np.inf], [high, 1.0, np.inf],
        [linear, np.inf, np.inf], [quadratic, 0.0, 0.0],
    )  # fmt: skip


@pytest.mark.parametrize(
    ("low", "high", "possible"),
    [
        (-1.0, 1.0, True),
        (0.0, 0.0, True),
        (-np.inf, 0.0, True),
        (1.0, 2.0, False),
        (-2.0, -1.0, False),
        (1e-6, np.inf, False),
    ],
)
def test_hard_rows_of_zeros_hold_or_do_not(low: float, high: float, possible: bool) -> None:
    qp = with_empty(low, high, np.inf)
    solver = Solver(qp)
    solution = solver.solve(qp.q, qp.l, qp.u)
    assert solution.status is (Status.SOLVED if possible else Status.INFEASIBLE)
    if possible:
        np.testing.assert_allclose(solution.x, [1.0, 0.0], atol=1e-9)
        assert solution.y[0] == 0.0
    again = solver.solve(qp.q, np.array([-1.0, -1.0, -1.0]), np.ones(3))
    assert again.status is Status.SOLVED


@pytest.mark.parametrize(
    ("low", "high", "slack", "y"),
    [
        (-1.0, 1.0, 0.0, 0.0),
        (0.5, 2.0, 0.5, -(3.0 + 2 * 0.7 * 0.5)),
        (0.5, np.inf, 0.5, -(3.0 + 2 * 0.7 * 0.5)),
        (-4.0, -2.0, 2.0, 3.0 + 2 * 0.7 * 2.0),
    ],
)
def test_soft_rows_of_zeros_give_way_at_their_price(
    low: float, high: float, slack: float, y: float
) -> None:
    qp = with_empty(low, high, 3.0, 0.7)
    solution = Solver(qp).solve(qp.q, qp.l, qp.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.slack, [slack, 0.0, 0.0], atol=1e-9)
    np.testing.assert_allclose(solution.y, [y, 2.0, 0.0], atol=1e-9)
    residuals = solution.residuals
    assert max(residuals.primal, residuals.dual, residuals.gap, residuals.scaled) < 1e-9


def test_nothing_but_rows_of_zeros() -> None:
    qp = QuadraticProgram(np.eye(2), [-3.0, 4.0], np.zeros((2, 2)), [-1, 1], [1, 2], [np.inf, 2.0])
    solution = Solver(qp).solve(qp.q, qp.l, qp.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [3.0, -4.0], atol=1e-12)
    np.testing.assert_allclose(solution.y, [0.0, -2.0])


# ---- rows that change


def test_pattern_keeps_together_what_rows_will_couple(optimum: Any) -> None:
    """The second row holds the first block alone at first, and both later."""
    n = 10
    A = np.zeros((2, 2 * n))
    A[0, 0], A[1, 1] = 1.0, 1.0
    pattern = A != 0
    pattern[1, n] = True
    P = np.eye(2 * n) + 0.1 * blocks(n, n)
    qp = QuadraticProgram(P, np.zeros(2 * n), A, -1.0, 1.0)
    cut, kept = Solver(qp, smallest_part=8), Solver(qp, pattern=pattern, smallest_part=8)
    assert (cut.parts, kept.parts) == (2, 1)
    later = A.copy()
    later[1, n] = 1.0
    q = -6 * np.ones(2 * n)
    expected = optimum(QuadraticProgram(qp.P, q, later, qp.l, qp.u), q, qp.l, qp.u).x
    kept.replace_rows(later)
    solution = kept.solve(q, qp.l, qp.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, expected, atol=1e-7)
    cut.replace_rows(later)  # beyond its pattern: wrong, and said to be
    assert cut.solve(q, qp.l, qp.u).status is not Status.SOLVED


def test_a_row_that_is_zero_at_first_and_in_the_pattern_is_no_empty_row() -> None:
    qp = QuadraticProgram(np.eye(2), np.zeros(2), np.zeros((1, 2)), -1.0, 1.0)
    solver = Solver(qp, pattern=np.ones((1, 2), dtype=bool))
    solver.replace_rows(np.array([[1.0, 0.0]]))
    solution = solver.solve(np.array([-3.0, -3.0]), qp.l, qp.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [1.0, 3.0], atol=1e-7)


@pytest.mark.parametrize("replaces", [True, False])
def test_each_part_gets_its_own_rows(
    rng: np.random.Generator, recorder: Any, replaces: bool
) -> None:
    recorder.replaces_rows = replaces
    qp = three(rng)
    solver = Solver(qp, recorder)
    before = list(recorder.made)
    assert len(before) == solver.parts == 3
    solver.replace_rows(3.0 * qp.A)
    if replaces:
        assert recorder.made == before
        for part in before:
            np.testing.assert_allclose(part.replaced, 3.0 * part.qp.A, rtol=1e-12)
    else:
        new = recorder.made[3:]
        assert len(new) == 3
        for part, old in zip(new, before, strict=True):
            np.testing.assert_allclose(part.qp.A, 3.0 * old.qp.A, rtol=1e-12)
            np.testing.assert_array_equal(part.qp.P, old.qp.P)
            np.testing.assert_array_equal(part.qp.linear, old.qp.linear)
            assert part.given == old.given
    solver.solve(qp.q, qp.l, qp.u)


def test_a_part_without_rows_is_left_in_peace_when_rows_change() -> None:
    A = np.zeros((3, 20))
    A[:, :3] = np.eye(3)
    qp = QuadraticProgram(np.eye(20), np.zeros(20), A, -1.0, 1.0)
    solver = Solver(qp, smallest_part=8)
    assert solver.parts > 1
    solver.replace_rows(2.0 * A)
    solution = solver.solve(-3.0 * np.ones(20), qp.l, qp.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, np.where(np.arange(20) < 3, 0.5, 3.0), atol=1e-7)


# ---- what is told of the parts together


@pytest.mark.parametrize("pair", list(product(WORST_LAST, repeat=2)), ids="-".join)
def test_status_is_the_worst_of_the_parts(recorder: Any, pair: tuple[Status, Status]) -> None:
    qp = QuadraticProgram(np.kron(np.eye(2), np.eye(9) + 1.0), np.zeros(18), no_rows(18), [], [])
    recorder.statuses = list(pair)
    solver = Solver(qp, recorder)
    assert solver.parts == 2
    worst = max(pair, key=WORST_LAST.index)
    assert solver.solve(np.ones(18), qp.l, qp.u).status is worst
    recorder.statuses = [Status.SOLVED]
    assert solver.solve(np.ones(18), qp.l, qp.u).status is Status.SOLVED


def test_iterations_and_build_times_add_up(rng: np.random.Generator, recorder: Any) -> None:
    qp = three(rng)
    solution = Solver(qp, recorder).solve(np.ones(qp.n), qp.l, qp.u)
    assert solution.iterations == 111
    assert solution.build_time == pytest.approx(0.25 * (1 + 2 + 3))
    np.testing.assert_allclose(solution.x, np.linalg.solve(qp.P, -np.ones(qp.n)), rtol=1e-9)


def test_time_is_shared_out_and_iterations_are_not(rng: np.random.Generator, recorder: Any) -> None:
    Solver(three(rng), recorder, limits=Limits(50, 3e-3))
    assert len(recorder.made) == 3
    for part in recorder.made:
        assert part.given.iterations == 50
        assert part.given.time == pytest.approx(1e-3)
    recorder.made.clear()
    Solver(three(rng), recorder)
    assert all(part.given == Limits() for part in recorder.made)


def test_all_parts_forget(rng: np.random.Generator, recorder: Any) -> None:
    recorder.warm_starts, recorder.statuses = True, [Status.SOLVED, Status.FAILED, Status.SOLVED]
    qp = three(rng)
    Solver(qp, recorder).solve(np.ones(qp.n), qp.l, qp.u)
    assert [part.forgotten for part in recorder.made] == [1, 1, 1]
