# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""The structured form against the condensed one, which is certified by its own residuals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qpmpc import (
    BackendSetupError,
    BoundsError,
    CommandBound,
    Limits,
    LinearModel,
    MappedBound,
    ModelError,
    OutputBound,
    Problem,
    RateBound,
    Solver,
    Status,
    force_cone,
)
from qpmpc.arrays import Array
from qpmpc.native.errors import CompilerUnavailableError
from qpmpc.native.toolchain import compiler
from qpmpc.residuals import Check
from qpmpc.solver import TOLERANCE
from qpmpc.structured.problem import StructuredProblem
from qpmpc.structured.solver import engines

CERTIFIED = 1e-8
COMMAND = 20.0


def has_compiler() -> bool:
    try:
        compiler()
    except CompilerUnavailableError:
        return False
    return True


MODES = [
    "off",
    pytest.param("on", marks=pytest.mark.skipif(not has_compiler(), reason="no compiler")),
]
modes = pytest.mark.parametrize("compiled", MODES)


def exact(problem: Problem, q: Array, l: Array, u: Array):
    """Solve the condensed QP from a cold start; None where nobody certifies the answer."""
    for backend in ("daqp", "piqp"):
        solution = Solver(problem.qp, backend, problem.rows.values()).solve(q, l, u)
        if solution.status is Status.INFEASIBLE or solution.residuals.scaled < CERTIFIED:
            return solution
    return None


def compare(problem: StructuredProblem, solver, instance) -> tuple[bool, bool]:
    """Solve one instance in both forms; return whether rows were active, and gave way."""
    problem.update(instance.state, instance.previous, instance.reference)
    twin = problem.condensed
    twin.update(instance.state, instance.previous, instance.reference)
    for mine, theirs in ((problem.q, twin.q), (problem.l, twin.l), (problem.u, twin.u)):
        scale = np.abs(theirs[np.isfinite(theirs)]).max(initial=1.0)
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-10 * scale)
    found = solver.solve(problem.q, problem.l, problem.u)
    wanted = exact(twin, twin.q, twin.l, twin.u)
    assert wanted is not None
    assert found.status is wanted.status
    if found.status is Status.SOLVED:
        assert found.residuals.scaled < TOLERANCE
        np.testing.assert_allclose(found.x, wanted.x, atol=2e-6 * COMMAND)
        np.testing.assert_allclose(found.slack, wanted.slack, atol=1e-6)
    return bool(np.any(found.y)), bool((found.slack > 1e-6).any())


@modes
@pytest.mark.parametrize("decision", ["increment", "absolute"])
@pytest.mark.parametrize(
    "size",
    [(1, 1, None, 12), (3, 8, None, 8), (2, 8, 3, 8), (1, 32, None, 6), (2, 20, 1, 6)],
)
def test_it_finds_what_the_condensed_form_finds(
    size, decision, compiled, contact_problem, instance
):
    axes, horizon, moves, count = size
    rng = np.random.default_rng(axes * 1000 + horizon)
    active = gave = 0
    for _ in range(3):
        problem = contact_problem(
            rng, axes, horizon, kind=StructuredProblem,
            control_horizon=moves, decision=decision, compiled=compiled,
        )  # fmt: skip
        assert problem.rows == problem.condensed.rows
        solver = problem.solver("daqp", Limits(), None)
        for _ in range(count):
            some, soft = compare(problem, solver, instance(rng, problem))
            active, gave = active + some, gave + soft
    assert active > 3
    assert gave > 0 or horizon == 1


@pytest.mark.skipif(not has_compiler(), reason="no compiler")
@pytest.mark.parametrize("horizon", [64, 128])
def test_long_horizons_too(horizon, contact_problem, instance):
    rng = np.random.default_rng(horizon)
    problem = contact_problem(rng, 1, horizon, kind=StructuredProblem, compiled="on")
    solver = problem.solver("daqp", Limits(), None)
    assert sum(compare(problem, solver, instance(rng, problem))[0] for _ in range(6)) > 1


@pytest.mark.skipif(not has_compiler(), reason="no compiler")
def test_the_longest_horizon_runs_without_a_matrix_of_its_size(contact_problem, instance):
    rng = np.random.default_rng(512)
    problem = contact_problem(rng, 3, 512, kind=StructuredProblem, compiled="on")
    solver = problem.solver("daqp", Limits(), None)
    active = 0
    for _ in range(4):
        now = instance(rng, problem)
        problem.update(now.state, now.previous, now.reference)
        solution = solver.solve(problem.q, problem.l, problem.u)
        assert solution.status is Status.SOLVED
        active += np.count_nonzero(solution.y)
        assert problem.predict(solution.x).shape == (512, 3)
    assert active > 10
    assert "condensed" not in vars(problem)


@pytest.mark.skipif(not has_compiler(), reason="no compiler")
def test_compiled_and_interpreted_answers_are_the_same(contact_problem, instance):
    for seed in range(6):
        problems = [
            contact_problem(
                np.random.default_rng(seed), 2, 12, kind=StructuredProblem, compiled=compiled
            )
            for compiled in ("on", "off")
        ]
        assert [p.compiled for p in problems] == [True, False]
        solvers = [p.solver("daqp", Limits(), None) for p in problems]
        rng = np.random.default_rng(seed)
        for _ in range(6):
            now = instance(rng, problems[0])
            answers = []
            for problem, solver in zip(problems, solvers, strict=True):
                problem.update(now.state, now.previous, now.reference)
                answers.append(solver.solve(problem.q, problem.l, problem.u))
            a, b = answers
            assert a.status is b.status is Status.SOLVED
            scale = max(COMMAND, np.abs(a.x).max())
            np.testing.assert_allclose(a.x, b.x, rtol=0, atol=1e-9 * scale)
            np.testing.assert_allclose(problems[0].q, problems[1].q, rtol=1e-12)
            np.testing.assert_allclose(
                problems[0].predict(a.x), problems[1].predict(a.x), atol=1e-9
            )


@modes
def test_residuals_are_those_of_the_matrices(compiled, contact_problem, instance):
    rng = np.random.default_rng(5)
    for horizon in (1, 9, 24):
        problem = contact_problem(rng, 2, horizon, kind=StructuredProblem, compiled=compiled)
        solver = problem.solver("daqp", Limits(), None)
        qp, products = problem.condensed.qp, problem._products
        now = instance(rng, problem)
        problem.update(now.state, now.previous, now.reference)
        x, y = rng.standard_normal(qp.n), 100.0 * rng.standard_normal(qp.m)
        y[rng.random(qp.m) < 0.7] = 0.0
        out, rows = np.zeros(qp.n), np.zeros(qp.m)
        close = {"rtol": 1e-8, "atol": 1e-8}
        np.testing.assert_allclose(products.rows(x, rows), qp.A @ x, **close)
        np.testing.assert_allclose(products.slope(x, out), qp.P @ x, **close)
        np.testing.assert_allclose(products.pull(y, out), qp.A.T @ y, **close)
        np.testing.assert_allclose(
            problem.predict(x),
            (problem.condensed.prediction.Theta @ x + problem.free).reshape(horizon, -1),
            **close,
        )
        # T whitens: T' P T = I, column by column of P^{-1} T^{-T}.
        T = np.column_stack([products.whiten(e, out).copy() for e in np.eye(qp.n)]).T
        np.testing.assert_allclose(T.T @ qp.P @ T, np.eye(qp.n), atol=1e-7)
        scaling = solver._scaling
        norms = np.linalg.norm(qp.A @ T, axis=1) / scaling.size
        for group in problem.rows.values():
            np.testing.assert_allclose(scaling.E[group], 1.0 / norms[group].max(), rtol=1e-8)
        ours = solver._check(problem.q, problem.l, problem.u, x, y)
        dense = Check(qp, scaling, TOLERANCE)(problem.q, problem.l, problem.u, x, y)
        for name in ("primal", "dual", "gap", "scaled"):
            assert getattr(ours, name) == pytest.approx(getattr(dense, name), rel=1e-7, abs=1e-9)


# --- hard outputs, curved penalties, equations, moving bounds -------------------------------------


def cart(**changes):
    """Place and speed of a cart that is pushed."""
    T = 0.05
    model = LinearModel([[1, T], [0, 1]], [[T * T / 2], [T]], [[1, 0]], T)
    arguments = {
        "output_weight": 1.0,
        "increment_weight": 0.01,
        "bounds": [
            CommandBound(-2.0, 2.0),
            RateBound(-1.0, 1.0),
            OutputBound("speed", [[0, 1]], -0.5, 0.5, 30.0),
            OutputBound("place", [[1, 0]], -1.0, 1.0, 50.0, moving=True),
        ],
        **changes,
    }
    return StructuredProblem(model, 24, **arguments)


def with_bounds(problem: StructuredProblem, **changes) -> StructuredProblem:
    bounds = [
        replace(b, **changes) if isinstance(b, OutputBound) else b for b in problem._twin["bounds"]
    ]
    return cart(bounds=bounds)


def solve_both(problem, state, wish):
    previous = np.zeros(1)
    reference = np.full((problem.horizon, 1), wish)
    problem.update(np.array(state), previous, reference)
    solver = problem.solver("daqp", Limits(), None)
    twin = problem.condensed
    for name, rows in problem._bounds.items():  # bounds that were moved
        if name == "place":
            twin.move(name, rows.lower.reshape(-1, 1), rows.upper.reshape(-1, 1))
    twin.update(np.array(state), previous, reference)
    mine = solver.solve(problem.q, problem.l, problem.u)
    return mine, exact(twin, twin.q, twin.l, twin.u)


@modes
@given(
    state=st.tuples(st.floats(-2, 2), st.floats(-1, 1)),
    wish=st.floats(-3, 3),
    curve=st.sampled_from([0.0, 1.0, 1e3]),
    seed=st.integers(0, 99),
)
@settings(max_examples=12, deadline=None)
def test_a_cart_with_any_state_wish_and_curvature(compiled, state, wish, curve, seed):
    problem = with_bounds(cart(), quadratic=curve)
    problem = cart(bounds=problem._twin["bounds"], compiled=compiled)
    limits = np.sort(np.random.default_rng(seed).uniform(-1.5, 1.5, (2, 24, 1)), axis=0)
    problem.move("place", limits[0], limits[1])
    mine, wanted = solve_both(problem, state, wish)
    assert mine.status is Status.SOLVED
    assert mine.residuals.scaled < TOLERANCE
    if wanted is not None:
        np.testing.assert_allclose(mine.x, wanted.x, atol=1e-5)


@modes
def test_hard_rows_hold_or_are_reported(compiled):
    bounds = with_bounds(cart(), linear=np.inf)._twin["bounds"]
    problem = cart(bounds=bounds, compiled=compiled)
    held, _ = solve_both(problem, [0.9, 0.3], 3.0)
    assert held.status is Status.SOLVED
    values = problem.condensed.A @ held.x
    assert (values <= problem.u + 1e-8).all()
    cheap = with_bounds(problem, linear=1.0)
    assert solve_both(cheap, [0.9, 0.3], 3.0)[0].slack.max() > 0.01  # what it costs to hold them
    late, _ = solve_both(problem, [0.99, 0.5], 3.0)  # too fast to stop in time
    assert late.status is Status.INFEASIBLE
    assert np.isnan(late.x).all()
    back, wanted = solve_both(problem, [0.0, 0.0], 0.5)
    np.testing.assert_allclose(back.x, wanted.x, atol=1e-6)


@modes
def test_bounds_that_meet_are_equations(compiled):
    problem = cart(compiled=compiled)
    path = 0.002 * np.arange(24.0)[:, None] ** 1.5
    problem.move("place", path, path)
    mine, wanted = solve_both(problem, [0.0, 0.1], 1.0)
    assert mine.status is Status.SOLVED
    np.testing.assert_allclose(mine.x, wanted.x, atol=1e-5)
    assert (mine.y > 1e-6).any()
    assert (mine.y < -1e-6).any()


@modes
def test_a_limit_of_iterations_stops_it_and_the_next_solve_goes_on(compiled):
    problem = cart(compiled=compiled)
    solver = problem.solver("daqp", Limits(iterations=1), None)
    problem.update(np.array([-1.0, 0.5]), np.zeros(1), np.full((24, 1), 3.0))
    found = [solver.solve(problem.q, problem.l, problem.u).status for _ in range(30)]
    assert found[0] is Status.ITERATION_LIMIT
    enough = problem.solver("daqp", Limits(iterations=200), None)
    assert enough.solve(problem.q, problem.l, problem.u).status is Status.SOLVED


@modes
def test_what_is_not_finite_is_a_status(compiled):
    problem = cart(compiled=compiled)
    solver = problem.solver("daqp", Limits(), None)
    problem.update(np.array([np.nan, 0.0]), np.zeros(1), np.zeros((24, 1)))
    assert solver.solve(problem.q, problem.l, problem.u).status is Status.FAILED
    problem.update(np.zeros(2), np.zeros(1), np.zeros((24, 1)))
    assert solver.solve(problem.q, problem.l, problem.u).status is Status.SOLVED


@modes
def test_without_bounds_it_is_the_closed_form(compiled, contact_problem, instance):
    rng = np.random.default_rng(3)
    problem = contact_problem(rng, 3, 10, free=True, kind=StructuredProblem, compiled=compiled)
    now = instance(rng, problem)
    problem.update(now.state, now.previous, now.reference)
    wanted = np.linalg.solve(problem.condensed.qp.P, -problem.q)
    found = problem.solver("daqp", Limits(), None).solve(problem.q, problem.l, problem.u)
    np.testing.assert_allclose(found.x, wanted, atol=1e-9 * np.abs(wanted).max())
    np.testing.assert_allclose(problem.unconstrained(), wanted, atol=1e-9 * np.abs(wanted).max())


def test_a_cone_couples_axes_and_is_solved_as_one_part(contact_problem, instance):
    rng = np.random.default_rng(8)
    base = contact_problem(rng, 3, 8, kind=StructuredProblem)
    C = base.model.C
    cone = force_cone("grip", C[:2], C[2:], limit=0.5, friction=0.3, facets=6, linear=40.0)
    arguments = {**base._twin, "bounds": [*base._twin["bounds"], cone]}
    problem = StructuredProblem(base.model, 8, **arguments)
    assert [part.m for part in problem.program.parts] == [3]
    solver = problem.solver("daqp", Limits(), None)
    assert any(compare(problem, solver, instance(rng, problem))[1] for _ in range(8))


# --- what it refuses ------------------------------------------------------------------------------


def test_refusals_are_one_line_each(contact_problem):
    mapped = MappedBound("wheel", [[0, 1]], [[10.0]], -1.0, 1.0, 5.0)
    with pytest.raises(BoundsError, match="'wheel': has a map that changes"):
        cart(bounds=[mapped])
    with pytest.raises(ModelError, match=r"control_horizon must lie in 1\.\.24"):
        cart(control_horizon=25)
    with pytest.raises(BoundsError, match="same name"):
        cart(bounds=[CommandBound(-1, 1), CommandBound(-2, 2)])
    problem = cart()
    with pytest.raises(BackendSetupError, match="has no limit of time"):
        problem.solver("daqp", Limits(time=1.0), None)
    with pytest.raises(BackendSetupError, match="must be positive"):
        problem.solver("daqp", Limits(iterations=0), None)
    with pytest.raises(BackendSetupError, match="condensed form only"):
        problem.solver("osqp", Limits(), None)
    with pytest.raises(BoundsError, match="nothing to map"):
        problem.map("speed", [[1.0]], [0.0])
    with pytest.raises(BackendSetupError, match="no rows that change"):
        problem.solver("daqp", Limits(), None).replace_rows(np.zeros((1, 1)))


def test_without_a_compiler_numpy_does_it_and_on_is_an_error(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    from qpmpc.structured import compiled  # noqa: PLC0415

    compiled._library.cache_clear()
    assert not cart().compiled
    with pytest.raises(CompilerUnavailableError):
        cart(compiled="on")


def test_forgetting_starts_from_nothing():
    problem = cart(compiled="off")
    engine = engines(problem.program, "off")[0]
    x, y = np.zeros(problem.program.n), np.zeros(problem.program.m)
    problem.update(np.array([0.5, 0.4]), np.zeros(1), np.full((24, 1), 3.0))
    first = engine.solve(problem.q, problem.l, problem.u, x, y)[1]
    again = engine.solve(problem.q, problem.l, problem.u, x, y)[1]
    engine.forget()
    assert engine.solve(problem.q, problem.l, problem.u, x, y)[1] == first > again
