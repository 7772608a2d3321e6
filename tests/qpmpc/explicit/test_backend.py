"""The backend as a whole: DAQP's answers in and outside the range, and what it tells of itself."""

from __future__ import annotations

import numpy as np
import pytest

import qpmpc.backends.explicit as module
from qpmpc import BackendSetupError, QuadraticProgram, Solver
from qpmpc.native.errors import CacheError, CompilerUnavailableError


@pytest.fixture(autouse=True)
def few(monkeypatch):
    """Enough to be incomplete at most horizons, and quick."""
    monkeypatch.setattr(module, "REGIONS", 60)


def cycle(made, rng, size=1.0):
    """Vectors of one cycle, from states within ``size`` times what is expected."""
    general, ranges = made.general, made.ranges
    problem = general.problem
    low, high = problem.commands

    def draw(sides):
        return sides.mean(axis=1) + size * np.ptp(sides, axis=1) / 2 * rng.uniform(
            -1, 1, len(sides)
        )

    state, setpoint = draw(ranges.state), draw(ranges.setpoint)
    previous = draw(np.column_stack([low, high]))
    output = problem.model.C @ state
    preview = np.tile(setpoint, (problem.horizon + 1, 1))
    problem.update(state, previous, general.reference(preview, output))
    return problem.q.copy(), problem.l.copy(), problem.u.copy()


def compare(ours, theirs, vectors):
    """Assert that an answer is the other one, to what the other one is exact to."""
    one, other = ours.solve(*vectors), theirs.solve(*vectors)
    assert one.status == other.status == "solved"
    if other.residuals.scaled > 1e-12 or one.residuals.scaled > 1e-12:
        assert one.residuals.scaled <= 1e-6
        return False
    scale = 1.0 + np.abs(other.x).max()
    np.testing.assert_allclose(one.x, other.x, atol=1e-9 * scale)
    np.testing.assert_allclose(one.slack, other.slack, atol=1e-9 * (1 + np.abs(other.slack).max()))
    return True


@pytest.mark.parametrize("axes", ["z", "xyz"])
@pytest.mark.parametrize("horizon", [1, 2, 5, 8, 10])
def test_is_daqp_in_the_range_and_outside(controller, axes, horizon):
    ours, theirs = controller(horizon, axes, "explicit"), controller(horizon, axes)
    solver, other = ours.general.solver, theirs.general.solver
    assert solver.parts == len(axes)
    rng, compared, slack = np.random.default_rng(horizon), 0, 0
    for k in range(60):
        vectors = cycle(ours, rng, 0.3 if k % 3 == 0 else 1.0 if k % 3 == 1 else 3.0)
        compared += compare(solver, other, vectors)
        slack += other.solve(*vectors).slack.max(initial=0.0) > 1e-3
        solver.prepare()
    assert compared > 20
    assert slack > 10 or horizon == 1
    for facts in solver.facts():
        ended = facts["found_at_once"] + facts["found_elsewhere"] + facts["left_to_daqp"]
        assert ended >= 60
        assert facts["regions"] >= facts["regions_enumerated"] >= 3
    assert solver.facts()[0]["complete"] is (horizon <= 2)


def test_bounds_that_move(controller):
    ours, theirs = controller(5, "z", "explicit"), controller(5)
    rng, compared = np.random.default_rng(3), 0
    for k in range(60):
        for made in (ours, theirs):
            made.move("force", *((-14.0 + k / 10, 2.0) if k % 2 else (-np.inf, 3.0)))
        compared += compare(ours.general.solver, theirs.general.solver, cycle(ours, rng))
        ours.prepare()
    assert compared > 40


def test_what_daqp_had_to_solve_is_learned_between_solves(controller):
    ours = controller(8, "z", "explicit")
    solver, rng = ours.general.solver, np.random.default_rng(1)
    stream = [cycle(ours, rng) for _ in range(60)]
    counts, before = [], solver.facts()[0]["memory_bytes"]
    for _ in range(3):
        for vectors in stream:
            solver.solve(*vectors)
            solver.prepare()
        counts.append(solver.facts()[0])
    left = np.diff([0, *(facts["left_to_daqp"] for facts in counts)])
    assert left[0] > 10
    assert left[2] < left[0] / 2
    learned = counts[-1]["regions"] - counts[-1]["regions_enumerated"]
    assert 5 < learned <= left.sum() + 1
    assert counts[-1]["memory_bytes"] > before


def test_without_prepare_the_next_solve_learns(controller):
    ours = controller(8, "z", "explicit")
    solver, rng = ours.general.solver, np.random.default_rng(1)
    before = solver.facts()[0]["regions"]
    for _ in range(20):
        solver.solve(*cycle(ours, rng))
    assert solver.facts()[0]["regions"] > before


def test_a_plain_qp_is_learned_from_nothing(random_program):
    qp = random_program(np.random.default_rng(4), 4, 10, 3)
    solver, other, rng = Solver(qp, "explicit"), Solver(qp, "daqp"), np.random.default_rng(0)
    gradients = [qp.q + rng.standard_normal(4) for _ in range(30)]
    for _ in range(2):
        for q in gradients:
            compare(solver, other, (q, qp.l, qp.u))
    (facts,) = solver.facts()
    assert facts["regions_enumerated"] == 0
    assert facts["regions"] > 3
    assert facts["left_to_daqp"] < 45


def test_the_command_has_to_be_bounded_to_be_prepared_for(controller):
    ours = controller(3, "z", "explicit", command=(-np.inf, np.inf))
    assert ours.general.solver.facts()[0]["regions_enumerated"] == 0
    theirs, rng = controller(3, "z", command=(-np.inf, np.inf)), np.random.default_rng(0)
    for _ in range(20):
        state = rng.standard_normal(ours.general.problem.model.n_states)
        for made in (ours, theirs):
            made.general.problem.update(state, np.zeros(1), np.full((3, 1), -5.0))
        problem = ours.general.problem
        compare(ours.general.solver, theirs.general.solver, (problem.q, problem.l, problem.u))


def test_new_rows_leave_no_region_and_are_learned_when_they_stay(random_program):
    qp = random_program(np.random.default_rng(4), 4, 10, 3)
    solver, rng = Solver(qp, "explicit"), np.random.default_rng(0)
    gradients = [qp.q + rng.standard_normal(4) for _ in range(10)]

    def run(A=None):
        for q in gradients:
            if A is not None:
                solver.replace_rows(A)
            solver.solve(q, qp.l, qp.u)
            solver.prepare()
        return solver.facts()[0]["regions"]

    assert run() > 2
    assert run(1.5 * qp.A) == 1  # new in every cycle: nothing is worth learning
    assert run() > 2
    other = Solver(QuadraticProgram(qp.P, qp.q, 1.5 * qp.A, qp.l, qp.u, qp.linear), "daqp")
    for q in gradients:
        compare(solver, other, (q, qp.l, qp.u))


def test_a_semidefinite_hessian_is_refused_in_one_line():
    qp = QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), np.eye(2), -1.0, 1.0)
    with pytest.raises(BackendSetupError, match="'explicit': P is not positive definite") as error:
        Solver(qp, "explicit")
    assert "\n" not in str(error.value)


def test_without_a_compiler_numpy_walks(controller, monkeypatch):
    compiled = controller(3, "z", "explicit")

    def refuse(*_):
        raise CompilerUnavailableError(["cc"])

    monkeypatch.setattr(module, "CompiledWalk", refuse)
    interpreted = controller(3, "z", "explicit")
    assert interpreted.general.solver.facts()[0]["language"] == "numpy"
    rng = np.random.default_rng(0)
    for _ in range(40):
        vectors = cycle(compiled, rng)
        compare(interpreted.general.solver, compiled.general.solver, vectors)


@pytest.mark.parametrize("what", ["load", "save"])
def test_without_a_cache_it_is_enumerated_each_time(controller, monkeypatch, what):
    expected = controller(2, "z", "explicit").general.solver.facts()[0]["regions"]

    def refuse(*_):
        raise CacheError("nowhere", "cannot be used")

    monkeypatch.setattr(module.archive, what, refuse)
    assert controller(2, "z", "explicit").general.solver.facts()[0]["regions"] == expected


def test_three_equal_axes_are_enumerated_once(controller, monkeypatch, own_cache):
    calls = []
    real = module.enumerate_regions
    monkeypatch.setattr(module, "REGIONS", 37)
    monkeypatch.setattr(
        module, "enumerate_regions", lambda *a, **k: calls.append(1) or real(*a, **k)
    )
    first = controller(3, "xyz", "explicit").general.solver.facts()
    assert len(calls) == 1
    again = controller(3, "xyz", "explicit").general.solver.facts()
    assert len(calls) == 1
    assert [f["regions"] for f in first] == [f["regions"] for f in again]


def test_facts_are_plain_and_bound_the_search(controller):
    solver = controller(5, "z", "explicit").general.solver
    (facts,) = solver.facts()
    assert all(isinstance(value, bool | int | float | str) for value in facts.values())
    rng, made = np.random.default_rng(0), controller(5)
    for _ in range(50):
        solver.solve(*cycle(made, rng))
    (after,) = solver.facts()
    assert 1 < after["longest_search"] <= after["most_tried"]
    assert after["tried"] <= 50 * 2 * after["most_tried"]
    rows = made.general.problem.qp.m
    assert after["most_operations"] > after["most_tried"] * rows
    assert 0.0 < facts["covered"] < 1.0


def test_other_backends_are_told_nothing_and_tell_nothing(controller):
    assert controller(2, "xyz").general.solver.facts() == [{}]
