"""Every region of the parameters' range is found, and is what optimality says."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from qpmpc.arrays import Array
from qpmpc.explicit.regions import back, change, region


def holds(case: Any, sides: Array, vectors: Any, tolerance: float) -> bool:
    """Whether some active rows are the optimum's, by the KKT equations, without a `Region`."""
    qp, n, (q, l, u) = case.qp, case.qp.n, vectors  # noqa: E741
    size, sign = np.abs(sides), np.sign(sides).astype(float)
    curved = (size == 2) & (qp.quadratic > 0)
    held = np.flatnonzero((size == 1) | curved)
    fixed = np.flatnonzero((size == 2) & ~curved)
    A, y = qp.A, np.zeros(qp.m)
    y[fixed] = sign[fixed] * qp.linear[fixed]
    bound = np.where(sides > 0, u, l)
    soft = np.where(curved[held], 0.5 / np.where(qp.quadratic[held] > 0, qp.quadratic[held], 1), 0)
    K = np.block([[qp.P, A[held].T], [A[held], -np.diag(soft)]])
    pushed = soft * sign[held] * np.where(curved[held], qp.linear[held], 0.0)
    right = np.concatenate([-q - A.T @ y, bound[held] - pushed])
    if np.linalg.matrix_rank(K) < K.shape[0] or not np.isfinite(right).all():
        return False
    x, y[held] = np.split(np.linalg.solve(K, right), [n])
    v, pull = A @ x, y * sign
    level = 1.0 + np.abs(q).max()
    inside = (v <= u + tolerance * level) & (v >= l - tolerance * level)
    at = (pull >= -tolerance * level) & (pull <= qp.linear + tolerance * level)
    beyond = sign * (v - np.where(size > 0, bound, v)) >= -tolerance * level
    return bool(np.where(size == 0, inside, np.where(size == 1, at & inside, beyond)).all())


def uncovered(case: Any, keys: list[bytes], points: Array) -> int:
    """How many points lie in no region; ties (on a boundary to 1e-7) lie in either."""
    known, missing = set(keys), 0
    table = [np.frombuffer(key, dtype=np.int8) for key in keys]
    for v in points:
        vectors = case.parameters.vectors(v)
        sides = case.find(*vectors)
        assert sides is not None
        if sides.tobytes() in known:
            continue
        missing += not any(holds(case, each, vectors, 1e-7) for each in table)
    return missing


@pytest.mark.parametrize(("horizon", "regions"), [(1, 3), (2, 21), (3, 80)])
def test_no_point_of_the_range_is_without_its_region(contact, horizon, regions):
    case = contact(horizon)
    found = case.all_of_them
    assert found.complete
    assert found.lost == 0
    assert len(found.regions) >= regions
    keys = [each.key for each in found.regions]
    assert len(set(keys)) == len(keys)
    assert uncovered(case, keys, case.points(1500)) == 0


def test_soft_rows_with_and_without_a_quadratic_penalty(mixed):
    found = mixed.all_of_them
    assert found.complete
    sides = np.array([each.sides for each in found.regions])
    soft = np.isfinite(mixed.qp.linear)
    assert (np.abs(sides[:, soft]) == 2).any(axis=0).all()  # each of them gives way somewhere
    assert np.abs(sides[:, ~soft]).max() == 1
    assert uncovered(mixed, [each.key for each in found.regions], mixed.points(3000)) == 0


def test_each_region_is_somewhere_the_optimum(mixed):
    """Seen by dense sampling too, but for slivers; none is made up."""
    found = {each.key for each in mixed.all_of_them.regions}
    seen = {mixed.find(*mixed.parameters.vectors(v)).tobytes() for v in mixed.points(6000)}
    assert seen <= found
    assert len(seen) > 0.5 * len(found)


def test_the_covered_share_is_the_share_of_points(contact):
    case = contact(3)
    found = case.enumerate(most=40)
    keys = {each.key for each in found.regions}
    points = case.points(1500, seed=5)
    share = np.mean([case.find(*case.parameters.vectors(v)).tobytes() in keys for v in points])
    assert abs(found.covered - share) < 0.05
    assert 0.3 < found.covered < 1.0


def test_an_enumeration_that_ends_early_holds_the_nearest_and_says_so(mixed):
    all_of_them, few = mixed.all_of_them, mixed.enumerate(most=60)
    assert not few.complete
    assert 60 <= len(few.regions) < 80
    keys = [each.key for each in few.regions]
    assert keys == [each.key for each in all_of_them.regions[: len(keys)]]
    assert uncovered(mixed, keys, mixed.points(400, size=0.2)) == 0
    assert uncovered(mixed, keys, mixed.points(200)) > 50


def test_an_enumeration_ends_at_its_limit_of_programs(contact):
    few = contact(3).enumerate(programs=200)
    assert not few.complete
    assert 1 <= len(few.regions) < len(contact(3).all_of_them.regions)


def test_an_enumeration_is_the_same_each_time(contact):
    one, other = contact(2).enumerate(), contact(2).enumerate()
    assert [each.key for each in one.regions] == [each.key for each in other.regions]
    assert one.links == other.links


def test_a_change_and_its_way_back():
    for side in (0, 1, -1, 2, -2):
        key = np.array([1, side, 0], dtype=np.int8).tobytes()
        for slot in (2, 3):
            there = change(key, slot)
            if there is None:
                assert (abs(side), slot) == (2, 3)
                continue
            now = np.frombuffer(there, dtype=np.int8)
            assert now[[0, 2]].tolist() == [1, 0]
            assert abs(int(now[1]) - side) == 1
            assert change(there, back(key, slot)) == key


def test_dependent_rows_make_no_region(contact):
    case = contact(2)
    doubled = np.array([1, 0, 1, 0], dtype=np.int8)  # both take the first command alone
    assert region(case.family, doubled.tobytes()) is None
    assert region(case.family, np.array([1, 0, 0, 0], dtype=np.int8).tobytes()) is not None
