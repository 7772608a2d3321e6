"""The search over stored regions, in numpy and in C: the same answers, and never a wrong one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qpmpc.explicit.compiled import CompiledWalk
from qpmpc.explicit.interpreted import InterpretedWalk
from qpmpc.explicit.law import Law
from qpmpc.explicit.regions import change
from qpmpc.native import CompilerUnavailableError
from qpmpc.native.toolchain import compiler
from qpmpc.solver import Solver


def _walks():
    try:
        compiler()
    except CompilerUnavailableError:
        return [InterpretedWalk]
    return [InterpretedWalk, CompiledWalk]


walks = pytest.mark.parametrize("walk", _walks(), ids=lambda walk: walk.__name__)


def law_of(case, walk, most=100, tries=None):
    found = case.all_of_them
    law = Law(case.family, walk(case.family, tries), most)
    law.restart(found.regions, found.links)
    return law


def path(case, cycles, pace=0.1, seed=0):
    rng, v = np.random.default_rng(seed), np.zeros(case.parameters.size)
    for _ in range(cycles):
        v = np.clip(0.99 * v + pace * rng.standard_normal(v.size), -1.0, 1.0)
        yield case.parameters.vectors(v)


def error(case, walk, vectors):
    """How far an answer is from the optimality conditions, relative to the gradient."""
    q, l, u = vectors  # noqa: E741
    qp, level = case.qp, 1.0 + np.abs(q).max()
    v = qp.A @ walk.x
    slack = np.maximum(np.maximum(v - u, l - v), 0.0)
    hard = np.isinf(qp.linear)
    price = np.where(hard, np.inf, qp.linear) + 2 * qp.quadratic * slack
    stationary = np.abs(qp.P @ walk.x + q + qp.A.T @ walk.y).max()
    pull = np.abs(walk.y)
    room = np.where(walk.y > 0, u - v, v - l)
    complementary = np.where(walk.y == 0, 0.0, np.minimum(pull, np.maximum(room, 0.0)))
    giving = np.where(slack > 1e-8 * level, np.abs(pull - price), np.maximum(pull - price, 0.0))
    return (
        max(
            stationary,
            slack[hard].max(initial=0.0),
            complementary.max(),
            giving[~hard].max(initial=0),
        )
        / level
    )


@walks
@pytest.mark.parametrize("name", ["contact", "mixed"])
def test_finds_the_optimum_everywhere_in_the_range(request, walk, name):
    given = request.getfixturevalue(name)
    case = given(3) if name == "contact" else given
    law = law_of(case, walk)
    missed = ended = 0
    for vectors in [*path(case, 300), *(case.parameters.vectors(v) for v in case.points(300))]:
        tried = law.walk.search(*vectors)
        if tried > 0:
            assert error(case, law.walk, vectors) < 1e-8
        ended += tried == -law.walk.steps
        missed += -law.walk.steps < tried < 0
    assert missed <= 6  # where rows change places at one point
    assert ended <= (60 if walk is InterpretedWalk else 2)  # a long way, and few steps
    assert law.walk.tally.missed == missed + ended
    assert law.walk.tally.walked > 100


def test_the_plain_neighbour_goes_before_what_lay_behind_a_facet_at_one_point(mixed):
    law, plain = law_of(mixed, InterpretedWalk), 0
    regions = law.walk._regions
    index = {each.key: i for i, each in enumerate(regions)}
    for i, each in enumerate(regions):
        for slot in range(2 * mixed.qp.m):
            key = change(each.key, slot)
            if key in index:
                assert law.walk._links[i][slot] == index[key]
                plain += 1
    assert sum(len(links) for links in law.walk._links) > plain > 300  # and there are others


@walks
@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.floats(1.0, 30.0))
def test_what_it_finds_outside_is_the_optimum_too(mixed, walk, seed, size):
    law = law_of(mixed, walk)
    for v in mixed.points(20, seed, size):
        vectors = mixed.parameters.vectors(v)
        if law.walk.search(*vectors) > 0:
            assert error(mixed, law.walk, vectors) < 1e-8


@pytest.mark.skipif(len(_walks()) < 2, reason="no C compiler")
def test_both_languages_take_the_same_way(contact, mixed):
    for case in (contact(3), mixed):
        one, other = law_of(case, InterpretedWalk, tries=12), law_of(case, CompiledWalk, tries=12)
        for k, vectors in enumerate(path(case, 400, pace=0.2)):
            assert one.walk.search(*vectors) == other.walk.search(*vectors)
            scale = 1.0 + np.abs(other.walk.x).max()
            np.testing.assert_allclose(one.walk.x, other.walk.x, atol=1e-9 * scale)
            np.testing.assert_allclose(one.walk.y, other.walk.y, atol=1e-9 * scale)
            assert one.walk.stuck == other.walk.stuck
            if k % 50 == 49:
                one.walk.forget()
                other.walk.forget()
        assert one.walk.tally == other.walk.tally


@walks
def test_begins_where_the_last_search_ended(contact, walk):
    law = law_of(contact(3), walk)
    active = 0
    for vectors in path(contact(3), 200):
        law.walk.forget()
        if law.walk.search(*vectors) <= 1:
            continue
        active += 1
        assert law.walk.search(*vectors) == 1
        law.walk.forget()
        assert law.walk.search(*vectors) > 1
    assert active > 15


@walks
def test_never_tries_more_than_it_may(contact, walk):
    law = law_of(contact(3), walk, tries=3)
    case = contact(3)
    tried = []
    for v in case.points(200):
        law.walk.forget()
        tried.append(law.walk.search(*case.parameters.vectors(v)))
    assert max(np.abs(tried)) == law.walk.tally.longest == law.walk.steps == 3
    assert law.walk.tally.missed == sum(t < 0 for t in tried) > 0
    assert law.walk.tally.tried == np.abs(tried).sum()


@walks
def test_what_was_missed_is_learned_and_found_at_once(contact, walk):
    case = contact(3)
    law = Law(case.family, walk(case.family), most=200)
    assert len(law) == 1
    missed = []
    for v in case.points(120):
        vectors = case.parameters.vectors(v)
        if law.walk.search(*vectors) < 0:
            before = law.nbytes
            law.learn(case.find(*vectors))
            assert law.nbytes >= before
            assert law.walk.search(*vectors) == 1
            assert error(case, law.walk, vectors) < 1e-8
            missed.append(vectors)
    assert 20 < len(missed) == law.walk.tally.missed
    assert 10 < len(law) <= len(missed) + 1


@walks
def test_no_more_is_learned_than_there_is_room_for(contact, walk):
    case = contact(3)
    law = Law(case.family, walk(case.family), most=4)
    for v in case.points(100):
        vectors = case.parameters.vectors(v)
        if law.walk.search(*vectors) < 0:
            law.learn(case.find(*vectors))
    assert len(law) == 5


@walks
def test_bounds_that_come_go_and_are_equal(mixed, walk):
    law, qp = law_of(mixed, walk), mixed.qp
    q = np.array([0.3, -0.2, 0.1])
    free = np.full(qp.m, np.inf)
    for l, u in (  # noqa: E741
        (np.array(qp.l), np.array(qp.u)),
        (-free, free),
        (np.array(qp.l), free),
        (np.array(qp.l), np.array(qp.u)),
        (-1e-3 - np.zeros(qp.m), 1e-3 + np.zeros(qp.m)),
        (np.where(np.arange(qp.m) == 2, 0.1, -np.inf), np.where(np.arange(qp.m) == 2, 0.1, np.inf)),
    ):
        if law.walk.search(q, l, u) > 0:
            assert error(mixed, law.walk, (q, l, u)) < 1e-8
        else:
            law.learn(mixed.find(q, l, u))
            assert law.walk.search(q, l, u) == 1
            assert error(mixed, law.walk, (q, l, u)) < 1e-8


@walks
@pytest.mark.parametrize("where", [0, 1, 2])
def test_nan_is_in_no_region_and_does_no_harm(contact, walk, where):
    case = contact(2)
    law = law_of(case, walk)
    good = case.parameters.vectors(case.points(1)[0])
    assert law.walk.search(*good) > 0
    broken = [a.copy() for a in good]
    broken[where][:] = np.nan
    with np.errstate(invalid="ignore"):
        assert law.walk.search(*broken) < 0
    assert law.walk.search(*good) == 1


def test_rows_that_are_replaced_leave_no_region(contact):
    case = contact(2)
    for walk in _walks():
        law = law_of(case, walk)
        assert len(law) > 10
        law.restart()
        assert len(law) == 1
        assert law.walk.search(np.zeros(2), np.array(case.qp.l), np.array(case.qp.u)) == 1


def test_solver_is_here_to_be_compared_with(contact):
    """The reference of these tests is not the law itself."""
    case = contact(3)
    law = law_of(case, InterpretedWalk)
    solver = Solver(case.qp, "clarabel")
    for v in case.points(25, seed=8):
        vectors = case.parameters.vectors(v)
        if law.walk.search(*vectors) > 0:
            solution = solver.solve(*vectors)
            assert solution.status == "solved"
            scale = 1.0 + np.abs(solution.x).max()
            np.testing.assert_allclose(law.walk.x, solution.x, atol=1e-6 * scale)
