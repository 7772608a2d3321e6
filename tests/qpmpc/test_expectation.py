"""What is expected of the vectors is what the problem makes of the states."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
import pytest

from qpmpc import (
    BoundsConfig,
    CommandBound,
    ControllerConfig,
    ExponentialReference,
    ForceController,
    MappedBound,
    ObserverConfig,
    Problem,
    contact_model,
)
from qpmpc.backends.daqp import DaqpBackend
from qpmpc.expectation import Ranges, expected
from qpmpc.parametric import Parametric


class Listening(DaqpBackend):
    """DAQP that keeps what it is told to expect, and what it is given."""

    name: ClassVar[str] = "listening"
    takes_parameters: ClassVar[bool] = True
    smallest_part: ClassVar[int] = 1
    made: ClassVar[list[Listening]] = []

    def expect(self, parameters: Parametric) -> None:
        self.parameters = parameters
        type(self).made.append(self)

    def solve(self, q, l, u):  # noqa: E741
        self.given = q.copy(), l.copy(), u.copy()
        return super().solve(q, l, u)


@pytest.fixture
def listening():
    Listening.made.clear()
    return Listening


def force_controller(backend, axes="z", **config):
    bounds = config.pop("bounds", BoundsConfig(velocity=(-0.1, 0.2), force=(-14.0, 2.0)))
    made = ControllerConfig(horizon=config.pop("horizon", 4), bounds=bounds, **config)
    return ForceController(made, tuple(axes), 1e-3, backend)


def parameters_of(made, state, previous, setpoint):
    """Where states lie in their ranges, in the order of the parameters: registers left out."""
    low, high = made.general.problem.commands
    sides = np.vstack([made.ranges.state, np.column_stack([low, high]), made.ranges.setpoint])
    values = np.concatenate([state, previous, setpoint])
    return (values - sides.mean(axis=1)) / (np.ptp(sides, axis=1) / 2)


@pytest.mark.parametrize("kind", ["none", "constant", "ramp", "fused"])
@pytest.mark.parametrize("axes", ["z", "xz"])
def test_vectors_follow_from_the_parameters(listening, kind, axes):
    made = force_controller(listening, axes, observer=ObserverConfig(disturbance=kind))
    general, count = made.general, len(axes)
    assert len(listening.made) == count
    problem, rng = general.problem, np.random.default_rng(2)
    known = expected(problem, made.ranges, general.reference)
    registers = np.flatnonzero(~problem.model.A.any(axis=1))
    assert registers.size == count  # one cycle of delay: the last command, twice in the state
    for _ in range(5):
        inside = rng.uniform(-1, 1, len(made.ranges.state) + 2 * count)
        sides = np.vstack(
            [made.ranges.state, np.column_stack(problem.commands), made.ranges.setpoint]
        )
        values = sides.mean(axis=1) + inside * np.ptp(sides, axis=1) / 2
        n = len(made.ranges.state)
        state, previous, setpoint = values[:n], values[n : n + count], values[n + count :]
        state[registers] = previous
        reference = general.reference(np.tile(setpoint, (5, 1)), problem.model.C @ state)
        problem.update(state, previous, reference)
        v = np.delete(parameters_of(made, state, previous, setpoint), registers)
        for mine, theirs in zip(known.vectors(v), (problem.q, problem.l, problem.u), strict=True):
            np.testing.assert_allclose(mine, theirs, atol=1e-9 * (1 + np.abs(theirs).max()))
        general.solver.solve(problem.q, problem.l, problem.u)
        for i, part in enumerate(listening.made):  # scaled, split, without what moves nothing
            moves = np.delete(np.arange(len(inside)), registers)
            mine = own_parameters(moves, n, count, i)
            for told, given in zip(part.parameters.vectors(v[mine]), part.given, strict=True):
                np.testing.assert_allclose(told, given, atol=1e-8 * (1 + np.abs(given).max()))


def own_parameters(moves, n, count, axis):
    """Parameters of one axis among all that are left."""
    per = n // count
    own = [k // per == axis if k < n else (k - n) % count == axis for k in moves]
    return np.array(own)


def test_ranges_are_the_bounds_where_there_are_some():
    bounds = BoundsConfig(command=(-5.0, 6.0), velocity=(-0.1, 0.2), force=(-14.0, np.inf))
    made = force_controller("daqp", bounds=bounds)
    state = made.ranges.state  # force, velocity, lag, delay, tissue: v, a, jerk; input error
    np.testing.assert_allclose(made.ranges.setpoint, [[-14.0, bounds.largest_error]])
    np.testing.assert_allclose(state[0], [-14.0, bounds.largest_error])
    np.testing.assert_allclose(state[[1, 4]], [[-0.1, 0.2]] * 2)
    np.testing.assert_allclose(state[[2, 3, 5, 7]], [[-5.0, 6.0]] * 4)
    np.testing.assert_allclose(state[6], np.array([-5.0, 6.0]) / 0.02)


def test_ranges_without_bounds_follow_from_the_largest_error():
    made = force_controller("daqp", bounds=BoundsConfig(largest_error=10.0))
    np.testing.assert_allclose(made.ranges.state[0], [-10.0, 10.0])
    speed = 10.0 / (2500.0 * 0.02)
    np.testing.assert_allclose(made.ranges.state[1], [-speed, speed])


def test_nothing_is_expected_of_commands_without_bounds(listening):
    force_controller(listening, bounds=BoundsConfig(command=(-np.inf, 5.0)))
    assert not listening.made


def test_nothing_is_expected_of_rows_that_change():
    model = contact_model(2500, 20, 1e-3).model
    mapped = MappedBound("joint", model.C, [[1.0]], -1.0, 1.0, 1.0)
    weights = {"output_weight": 1.0, "increment_weight": 0.003}
    ranges = Ranges(np.tile([-1.0, 1.0], (2, 1)), np.array([[-1.0, 1.0]]))
    reference = ExponentialReference(4, 1, 1e-3, 0.02)
    for bounds, known in (((), True), ((mapped,), False)):
        problem = Problem(model, 4, bounds=[CommandBound(-5.0, 5.0), *bounds], **weights)
        assert (expected(problem, ranges, reference) is not None) is known


def test_infinite_ranges_are_none():
    made = force_controller("daqp")
    ranges = Ranges(np.full_like(made.ranges.state, np.inf), made.ranges.setpoint)
    assert expected(made.general.problem, ranges, made.general.reference) is None
