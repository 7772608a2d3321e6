from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    BoundsError,
    CommandBound,
    LinearModel,
    ModelError,
    OutputBound,
    Prediction,
    Problem,
    RateBound,
    ShapeError,
    UnknownNameError,
    with_delay,
)
from qpmpc.construction import NumpyConstruction

N, N_U = 6, 4
DELTA, LAMBDA = np.array([1.5, 0.3]), np.array([0.02, 0.1])
decisions = pytest.mark.parametrize("decision", ["increment", "absolute"])
moves = pytest.mark.parametrize("N_u", [1, N_U, N])
SENSE = np.array([[0.3, -1.0, 2.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0]])


def bounds() -> list[Any]:
    return [
        CommandBound([-3.0, -4.0], [5.0, 6.0]),
        RateBound([-1.0, -2.0], [1.5, 2.5]),
        OutputBound("speed", SENSE, [-1.0, -2.0, -3.0], [1.0, 2.0, 4.0], 10.0, 0.5),
    ]


class Case:
    """A problem with random parameters, and the plant's own view of any decision."""

    def __init__(
        self, rng: np.random.Generator, model: LinearModel, roll_out: Any, **arguments: Any
    ) -> None:
        settings = {"output_weight": DELTA, "increment_weight": LAMBDA} | arguments
        self.problem, self.model, self.roll_out = Problem(model, N, **settings), model, roll_out
        self.state, self.previous = rng.standard_normal(model.n_states), rng.standard_normal(2)
        self.reference = rng.standard_normal((N, 2))
        self.problem.update(self.state, self.previous, self.reference)

    def commands(self, z: np.ndarray) -> np.ndarray:
        moves = z.reshape(-1, 2)
        if self.problem.decision == "increment":
            moves = self.previous + np.cumsum(moves, axis=0)
        return moves

    def outputs(self, z: np.ndarray, C: np.ndarray | None = None) -> np.ndarray:
        moves = self.commands(z)
        held = np.vstack([moves, np.tile(moves[-1], (N - len(moves), 1))])
        return self.roll_out(self.model, self.state, held, C)

    def cost(self, z: np.ndarray) -> float:
        error = self.outputs(z) - self.reference
        return float((DELTA * error**2).sum() + (LAMBDA * z.reshape(-1, 2) ** 2).sum())

    def values(self, name: str, z: np.ndarray) -> np.ndarray:
        """What the rows of a bound say its quantity is under the decision z."""
        p, rows = self.problem, self.problem.rows[name]
        return p.qp.A[rows] @ z + (p.qp.u - p.u)[rows]


@pytest.fixture
def model(rng: np.random.Generator, random_model: Callable[..., LinearModel]) -> LinearModel:
    return random_model(rng, 3, 2, 2, 1.02)


@pytest.fixture
def case(rng: np.random.Generator, model: LinearModel, roll_out: Any) -> Callable[..., Case]:
    return lambda plant=model, **arguments: Case(rng, plant, roll_out, **arguments)


@decisions
@moves
def test_objective_is_the_cost_of_the_rolled_out_plant(
    rng: np.random.Generator, case: Any, decision: str, N_u: int
) -> None:
    c = case(decision=decision, control_horizon=N_u)
    P, q, n = c.problem.qp.P, c.problem.q, 2 * N_u
    constant = c.cost(np.zeros(n))
    for _ in range(10):
        z = rng.standard_normal(n)
        assert 0.5 * z @ P @ z + q @ z + constant == pytest.approx(c.cost(z), rel=1e-11)


@decisions
def test_gradient_vanishes_where_the_cost_is_least(case: Any, decision: str) -> None:
    c = case(decision=decision)
    z = np.linalg.solve(c.problem.qp.P, -c.problem.q)
    least = c.cost(z)
    for e in 1e-3 * np.eye(2 * N):
        assert min(c.cost(z + e), c.cost(z - e)) > least
        assert c.cost(z + e) == pytest.approx(c.cost(z - e), rel=1e-8)


@decisions
@moves
def test_rows_are_the_rolled_out_quantities(
    rng: np.random.Generator, case: Any, decision: str, N_u: int
) -> None:
    c = case(decision=decision, control_horizon=N_u, bounds=bounds())
    z = rng.standard_normal(2 * N_u)
    commands = c.commands(z)
    rates = np.diff(np.vstack([c.previous, commands]), axis=0)
    for name, expected in (
        ("command", commands),
        ("rate", rates),
        ("speed", c.outputs(z, SENSE)),
    ):
        np.testing.assert_allclose(c.values(name, z), expected.ravel(), rtol=1e-10, atol=1e-12)


@decisions
def test_vectors_are_bounds_less_the_free_response(case: Any, decision: str) -> None:
    c = case(decision=decision, bounds=bounds())
    p = c.problem
    np.testing.assert_allclose(p.u - p.l, p.qp.u - p.qp.l, rtol=1e-12)
    still = np.zeros(p.qp.n) if decision == "increment" else np.tile(c.previous, N)
    free = c.outputs(still, SENSE).ravel()
    gap = p.qp.A[p.rows["speed"]] @ still
    np.testing.assert_allclose(
        p.l[p.rows["speed"]], np.tile([-1, -2, -3], N) - free + gap, rtol=1e-9
    )
    np.testing.assert_allclose(p.u[p.rows["speed"]], np.tile([1, 2, 4], N) - free + gap, rtol=1e-9)


@decisions
def test_free_response(case: Any, decision: str) -> None:
    c = case(decision=decision)
    np.testing.assert_allclose(
        c.problem.free, c.outputs(np.zeros(2 * N)).ravel(), rtol=1e-11, atol=1e-13
    )


def test_penalties_and_hardness_of_the_rows(case: Any) -> None:
    p = case(bounds=bounds()).problem
    assert list(p.rows) == ["command", "rate", "speed"]
    for name in ("command", "rate"):
        assert np.isinf(p.qp.linear[p.rows[name]]).all()
    assert (p.qp.linear[p.rows["speed"]] == 10.0).all()
    assert (p.qp.quadratic[p.rows["speed"]] == 0.5).all()


@pytest.mark.parametrize("shape", [(), (3,), (N, 3)])
def test_bounds_per_step_per_output_or_for_all(
    rng: np.random.Generator, case: Any, shape: tuple[int, ...]
) -> None:
    low, high = -1 - rng.random(shape), 1 + rng.random(shape)
    p = case(bounds=[OutputBound("speed", SENSE, low, high, 1.0)]).problem
    np.testing.assert_array_equal(p.qp.l, np.broadcast_to(low, (N, 3)).ravel())
    np.testing.assert_array_equal(p.qp.u, np.broadcast_to(high, (N, 3)).ravel())


def test_rows_that_bound_nothing_are_dropped(case: Any) -> None:
    upper = np.full((N, 3), np.inf)
    upper[2, 1] = upper[5, 0] = 7.0
    p = case(
        bounds=[
            CommandBound(-np.inf, np.inf),
            RateBound(-np.inf, [np.inf, 1.0]),
            OutputBound("speed", SENSE, -np.inf, upper, 1.0),
        ]
    ).problem
    sizes = {name: rows.stop - rows.start for name, rows in p.rows.items()}
    assert sizes == {"rate": N, "speed": 2}
    full = case(bounds=[OutputBound("speed", SENSE, -1.0, 1.0, 1.0)]).problem
    np.testing.assert_array_equal(p.qp.A[p.rows["speed"]], full.qp.A[[3 * 2 + 1, 3 * 5]])


@pytest.mark.parametrize("cycles", [0, 1, 3])
def test_rows_that_nothing_can_change_are_dropped(
    rng: np.random.Generator, case: Any, model: LinearModel, cycles: int
) -> None:
    delayed = with_delay(model, cycles)
    wide = np.hstack([SENSE, np.zeros((3, 2 * cycles))])
    c = case(delayed, bounds=[OutputBound("speed", wide, -1.0, 1.0, 1.0)])
    assert c.problem.qp.m == 3 * (N - cycles)
    z = rng.standard_normal(2 * N)
    np.testing.assert_allclose(
        c.values("speed", z), c.outputs(z, wide)[cycles:].ravel(), rtol=1e-10, atol=1e-12
    )


@decisions
def test_command_of_a_decision(rng: np.random.Generator, case: Any, decision: str) -> None:
    c = case(decision=decision)
    z = rng.standard_normal(2 * N)
    np.testing.assert_allclose(c.problem.command(z, c.previous), c.commands(z)[0], rtol=1e-14)
    assert not np.shares_memory(c.problem.command(z, c.previous), z)


@pytest.mark.parametrize(
    ("previous", "expected"),
    [
        (0.0, (-2.0, 1.0)),
        (4.5, (2.5, 5.0)),
        (-4.0, (-5.0, -3.0)),
        (20.0, (5.0, 5.0)),  # so far outside that both cannot hold: the command bound wins
        (-20.0, (-5.0, -5.0)),
    ],
)
def test_limits_join_command_and_rate(
    case: Any, previous: float, expected: tuple[float, float]
) -> None:
    p = case(bounds=[CommandBound(-5.0, 5.0), RateBound(-2.0, 1.0)]).problem
    low, high = p.limits(np.full(2, previous))
    np.testing.assert_array_equal(low, np.full(2, expected[0]))
    np.testing.assert_array_equal(high, np.full(2, expected[1]))


def test_limits_take_the_first_step_and_the_tightest_bound(case: Any) -> None:
    wide = np.full((N, 2), 9.0)
    wide[0] = [3.0, 4.0]
    p = case(bounds=[CommandBound(-5.0, wide), CommandBound(-1.0, 3.5, "second")]).problem
    low, high = p.limits(np.zeros(2))
    np.testing.assert_array_equal(low, [-1.0, -1.0])
    np.testing.assert_array_equal(high, [3.0, 3.5])
    low, high = case().problem.limits(np.zeros(2))
    np.testing.assert_array_equal(low, [-np.inf, -np.inf])
    np.testing.assert_array_equal(high, [np.inf, np.inf])


@pytest.mark.parametrize("kind", [CommandBound, RateBound, OutputBound])
@pytest.mark.parametrize(
    ("lower", "upper", "text"),
    [
        (np.zeros(5), 1.0, r"got \(5,\)"),
        (0.0, np.ones((2, N + 1)), r"got \(2, 7\)"),
        (np.zeros((2, N)), 1.0, r"got \(2, 6\)"),  # transposed
        (np.nan, 1.0, "lower holds NaN"),
        (0.0, [1.0, np.nan], "upper holds NaN"),
        (2.0, 1.0, "lower 2 exceeds upper 1 .step 0, row 0"),
        ([0.0, 3.0], [1.0, 1.0], "step 0, row 1"),
        ("low", 1.0, "lower is not numeric"),
    ],
)
def test_bounds_error_names_the_bound(
    case: Any, kind: type[Any], lower: Any, upper: Any, text: str
) -> None:
    if kind is OutputBound:
        bound = OutputBound("mine", SENSE[:2], lower, upper, 1.0)
    else:
        bound = kind(lower, upper, "mine")
    with pytest.raises(BoundsError, match=f"^bound 'mine': .*{text}") as error:
        case(bounds=[bound])
    assert error.value.bound == "mine"


def test_two_bounds_of_one_name(case: Any) -> None:
    with pytest.raises(BoundsError, match="same name"):
        case(bounds=[CommandBound(-1, 1), CommandBound(-2, 2)])


@pytest.mark.parametrize(
    ("linear", "quadratic"), [(0.0, 0.0), (-1.0, 0.0), (np.nan, 0.0), (1.0, -1.0)]
)
def test_penalties_out_of_range(case: Any, linear: float, quadratic: float) -> None:
    with pytest.raises(ModelError, match="'speed'"):
        case(bounds=[OutputBound("speed", SENSE, -1, 1, linear, quadratic)])


@pytest.mark.parametrize(
    ("changed", "error", "text"),
    [
        ({"output_weight": -1.0}, ModelError, "output_weight"),
        ({"output_weight": np.ones(3)}, ShapeError, "output_weight"),
        ({"increment_weight": 0.0}, ModelError, "increment_weight"),
        ({"increment_weight": [1.0, -1.0]}, ModelError, "increment_weight"),
        ({"increment_weight": np.nan}, ModelError, "increment_weight"),
        ({"control_horizon": N + 1}, ModelError, "control_horizon"),
        ({"decision": "incremental"}, UnknownNameError, "did you mean 'increment'"),
    ],
)
def test_arguments_out_of_range(
    case: Any, changed: dict[str, Any], error: type[Exception], text: str
) -> None:
    with pytest.raises(error, match=text):
        case(**changed)


def test_output_bound_must_fit_the_states(case: Any) -> None:
    with pytest.raises(ShapeError, match="output"):
        case(bounds=[OutputBound("speed", np.ones((1, 5)), -1, 1, 1.0)])


# ---- commands and decisions


@decisions
@moves
def test_decision_of_commands_is_what_gives_them(
    rng: np.random.Generator, case: Any, decision: str, N_u: int
) -> None:
    c = case(decision=decision, control_horizon=N_u)
    for given in range(1, N_u + 1):
        commands = rng.standard_normal((given, 2))
        z = c.problem.decide(commands, c.previous)
        held = np.vstack([commands, np.tile(commands[-1], (N_u - given, 1))])
        np.testing.assert_allclose(c.commands(z), held, atol=1e-13)
        np.testing.assert_allclose(c.problem.command(z, c.previous), commands[0], atol=1e-13)


# ---- who builds the matrices


@decisions
def test_matrices_come_from_the_construction(case: Any, model: LinearModel, decision: str) -> None:
    """Prediction of the outputs and of each bounded quantity, and the cost, are asked for."""

    class Spy(NumpyConstruction):
        def __init__(self) -> None:
            self.asked: list[str] = []

        def prediction(self, *arguments: Any) -> Prediction:
            self.asked.append("outputs" if arguments[3] is model.C else "others")
            assert arguments[:3] == (model, N, N_U)
            assert arguments[4] == decision
            return super().prediction(*arguments)

        def cost(self, Theta: Any, delta: Any, lam: Any) -> Any:
            self.asked.append("cost")
            np.testing.assert_array_equal(delta, np.tile(DELTA, N))
            np.testing.assert_array_equal(lam, np.tile(LAMBDA, N_U))
            P, slope = super().cost(Theta, delta, lam)
            return 3.0 * P, slope

    spy, settings = Spy(), {"decision": decision, "control_horizon": N_U, "bounds": bounds()}
    ours, theirs = case(construction=spy, **settings), case(**settings)
    assert sorted(spy.asked) == ["cost", "others", "outputs"]
    np.testing.assert_allclose(ours.problem.qp.P, 3.0 * theirs.problem.qp.P, rtol=1e-14)
    np.testing.assert_array_equal(ours.problem.A, theirs.problem.A)
