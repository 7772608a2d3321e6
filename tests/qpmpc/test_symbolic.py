"""CasADi's construction against numpy's formulas, and `linearise` against what it replaces."""

import subprocess
import sys
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from qpmpc import (
    NUMPY,
    ControllerConfig,
    ForceController,
    LinearModel,
    ModelError,
    Problem,
    ShapeError,
    constant,
    contact_model,
    stack,
    with_delay,
    with_disturbance,
)
from qpmpc.symbolic import CASADI, linearise

casadi = pytest.importorskip("casadi")

PERIOD = 1e-3


def close(ours: np.ndarray, theirs: np.ndarray, tolerance: float = 1e-12) -> None:
    """Equal, relative to the largest entry of the matrix."""
    assert ours.shape == theirs.shape
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=tolerance * np.abs(theirs).max())


# ---- contact


@pytest.mark.parametrize("lag", [0.0, 1e-3, 0.02])
@pytest.mark.parametrize("separate_tool", [False, True])
@pytest.mark.parametrize("damping", [0.0, 5.0, 300.0])
@pytest.mark.parametrize("period", [1e-3, 0.05])
def test_contact_model(lag: float, separate_tool: bool, damping: float, period: float) -> None:
    ours = CASADI.contact(1700.0, damping, period, lag=lag, separate_tool=separate_tool)
    theirs = contact_model(1700.0, damping, period, lag=lag, separate_tool=separate_tool)
    for name in ("load", "tissue", "velocity"):
        close(getattr(ours, name), getattr(theirs, name))
    for name in ("A", "B", "C"):
        close(getattr(ours.model, name), getattr(theirs.model, name))
    assert ours.model.period == period


@pytest.mark.parametrize(
    "wrong",
    [
        {"stiffness": 0.0},
        {"stiffness": np.nan},
        {"velocity_damping": -1.0},
        {"lag": -1e-3},
        {"period": 0.0},
        {"period": np.inf},
    ],
)
def test_contact_model_refuses_what_numpy_refuses_in_the_same_words(
    wrong: dict[str, float],
) -> None:
    figures = {"stiffness": 1e3, "velocity_damping": 5.0, "period": PERIOD, "lag": 0.0} | wrong
    texts = []
    for construction in (NUMPY, CASADI):
        with pytest.raises(ModelError) as caught:
            construction.contact(**figures, separate_tool=False)  # type: ignore[arg-type]
        texts.append(str(caught.value))
    assert texts[0] == texts[1]


# ---- prediction


@given(
    seed=st.integers(0, 2**32 - 1),
    sizes=st.tuples(st.integers(1, 6), st.integers(1, 3), st.integers(1, 3)),
    horizon=st.sampled_from([1, 2, 5, 8, 32]),
    share=st.floats(0, 1),
    radius=st.sampled_from([0.3, 0.95, 1.0, 1.03]),
    increments=st.booleans(),
    other_output=st.booleans(),
)
@settings(max_examples=60, deadline=None, derandomize=True)
def test_prediction(
    *,
    random_model: Callable[..., LinearModel],
    seed: int,
    sizes: tuple[int, int, int],
    horizon: int,
    share: float,
    radius: float,
    increments: bool,
    other_output: bool,
) -> None:
    rng = np.random.default_rng(seed)
    model = random_model(rng, *sizes, radius)
    moves = 1 + round(share * (horizon - 1))
    output = rng.standard_normal((2, model.n_states)) if other_output else None
    decision = "increment" if increments else "absolute"
    ours = CASADI.prediction(model, horizon, moves, output, decision)
    theirs = NUMPY.prediction(model, horizon, moves, output, decision)
    for name in ("Psi", "Upsilon", "Theta"):
        close(getattr(ours, name), getattr(theirs, name))


@pytest.mark.parametrize(("horizon", "moves"), [(0, 1), (4, 0), (4, 5)])
def test_prediction_refuses_horizons(
    random_model: Callable[..., LinearModel], rng: np.random.Generator, horizon: int, moves: int
) -> None:
    model = random_model(rng, 2, 1, 1, 0.9)
    with pytest.raises(ModelError, match="horizon"):
        CASADI.prediction(model, horizon, moves, None, "increment")


def test_prediction_refuses_an_output_that_does_not_fit(
    random_model: Callable[..., LinearModel], rng: np.random.Generator
) -> None:
    with pytest.raises(ShapeError, match="output"):
        CASADI.prediction(random_model(rng, 2, 1, 1, 0.9), 4, 4, np.ones((1, 3)), "increment")


# ---- cost


@pytest.mark.parametrize(("rows", "n"), [(1, 1), (8, 8), (24, 15), (96, 96)])
def test_cost(rng: np.random.Generator, rows: int, n: int) -> None:
    Theta = np.tril(rng.standard_normal((rows, n)))
    delta, lam = 10 ** rng.uniform(-3, 3, rows), 10 ** rng.uniform(-6, 0, n)
    delta[0] = 0.0
    for ours, theirs in zip(
        CASADI.cost(Theta, delta, lam), NUMPY.cost(Theta, delta, lam), strict=True
    ):
        close(ours, theirs)
    P, _ = CASADI.cost(Theta, delta, lam)
    np.testing.assert_array_equal(P, P.T)


# ---- all of it


@pytest.mark.parametrize("decision", ["increment", "absolute"])
def test_problem_on_three_axes_is_numpys(contact_problem: Any, decision: str) -> None:
    """Rows of bounds included: they are predictions as well."""
    one, other = (
        contact_problem(np.random.default_rng(2), 3, 8, decision=decision, construction=by)
        for by in (NUMPY, CASADI)
    )
    for name in ("P", "A", "l", "u", "linear"):
        ours, theirs = getattr(other.qp, name), getattr(one.qp, name)
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12 * np.abs(one.qp.P).max())
    rng = np.random.default_rng(3)
    state, previous = rng.standard_normal(one.model.n_states), rng.standard_normal(3)
    for problem in (one, other):
        problem.update(state, previous, np.ones((8, 3)))
    close(other.q, one.q)


def test_backends_of_casadi_build_the_controller_with_it() -> None:
    axes = ("x", "y", "z")
    numpy, ours = (
        ForceController(ControllerConfig(), axes, PERIOD, backend) for backend in ("daqp", "casadi")
    )
    for controller in (numpy, ours):
        controller.reset(np.ones(3))
    steps = [
        controller.step(np.ones(3), np.zeros(3), np.full((9, 3), 1.2))
        for controller in (numpy, ours)
    ]
    assert np.abs(steps[0].command).max() > 0.1
    np.testing.assert_allclose(steps[1].command, steps[0].command, rtol=1e-6)


def test_long_horizons_are_built_in_no_time() -> None:
    """Three axes of nine states over 32 steps: far below the second that a user would notice."""
    contact = contact_model(2000.0, 20.0, PERIOD, lag=1e-3)
    one = with_disturbance(with_delay(contact.model, 4), contact.load, constant())
    problem = Problem(
        stack([one] * 3), 32, output_weight=1.0, increment_weight=1e-3, construction=CASADI
    )
    assert problem.qp.n == 96


# ---- linearise


def pendulum() -> Any:
    """Angle and its rate; torque through a sine, so that the input matters at the point too."""
    x, u = casadi.SX.sym("x", 2), casadi.SX.sym("u")
    rates = casadi.vertcat(x[1], -9.81 * casadi.sin(x[0]) - 0.4 * x[1] * x[1] + casadi.sin(u))
    return casadi.Function("pendulum", [x, u], [rates])


STATE, COMMAND = np.array([2.1, -0.7]), np.array([0.3])


def test_pendulum_is_the_exponential_of_its_derivative() -> None:
    model = linearise(pendulum(), STATE, COMMAND, 0.02, [[1.0, 0.0]])
    slope = np.zeros((3, 3))
    slope[0, 1] = 1.0
    slope[1] = -9.81 * np.cos(STATE[0]), -0.8 * STATE[1], np.cos(COMMAND[0])
    exact = expm(slope * 0.02)
    close(model.A, exact[:2, :2], 1e-14)
    close(model.B, exact[:2, 2:], 1e-14)
    np.testing.assert_array_equal(model.C, [[1.0, 0.0]])
    assert model.period == 0.02


def test_pendulum_at_rest_moves_as_its_model_says() -> None:
    """At an equilibrium, against the plant itself, pushed a little and integrated."""
    ode, period, size = pendulum(), 0.02, 1e-5
    hanging = np.array([np.arcsin(np.sin(0.3) / 9.81), 0.0])
    model = linearise(ode, hanging, COMMAND, period, np.eye(2))

    def end(state: np.ndarray, command: np.ndarray) -> np.ndarray:
        run = solve_ivp(
            lambda _, x: ode(x, command).full().ravel(), (0, period), state, rtol=1e-12, atol=1e-14
        )
        return np.asarray(run.y[:, -1])

    columns = [
        (end(hanging + size * step, COMMAND) - end(hanging - size * step, COMMAND)) / (2 * size)
        for step in np.eye(2)
    ]
    close(model.A, np.stack(columns, axis=1), 1e-8)
    column = (end(hanging, COMMAND + size) - end(hanging, COMMAND - size)) / (2 * size)
    close(model.B, column[:, None], 1e-6)


@pytest.mark.parametrize("size", [1e-9, 1e-3, 1.0, 50.0, 2e3])
def test_linear_plants_of_any_speed_are_discretised_exactly(
    rng: np.random.Generator, size: float
) -> None:
    """Up to time constants of a two-thousandth of the period; all stable, so that A stays small."""
    A = rng.standard_normal((6, 6))
    A = -size * (A @ A.T + np.eye(6)) / 6 + size * (A - A.T)
    B = rng.standard_normal((6, 2))
    x, u = casadi.MX.sym("x", 6), casadi.MX.sym("u", 2)
    ode = casadi.Function("plant", [x, u], [casadi.DM(A) @ x + casadi.DM(B) @ u])
    model = linearise(ode, np.zeros(6), np.zeros(2), 1.0, np.eye(6))
    exact = expm(np.vstack([np.hstack([A, B]), np.zeros((2, 8))]))
    np.testing.assert_allclose(model.A, exact[:6, :6], rtol=0, atol=1e-12)
    close(model.B, exact[:6, 6:], 1e-11)


def test_scalars_stand_for_the_whole_point() -> None:
    whole = linearise(pendulum(), [0.5, 0.5], [0.3], 0.02, np.eye(2))
    short = linearise(pendulum(), 0.5, 0.3, 0.02, np.eye(2))
    np.testing.assert_array_equal(short.A, whole.A)


def function(*shapes: tuple[int, int], outputs: int = 1) -> Any:
    """A function of inputs of these shapes that returns ``outputs`` times (0, 0)."""
    symbols = [casadi.SX.sym(f"i{k}", *shape) for k, shape in enumerate(shapes)]
    return casadi.Function("f", symbols, [casadi.SX.zeros(2)] * outputs)


@pytest.mark.parametrize(
    ("ode", "message"),
    [
        (np.sin, "must be a casadi.Function, got ufunc"),
        (function((2, 1)), "has 1 inputs and 1 outputs"),
        (function((2, 1), (1, 1), outputs=2), "has 2 inputs and 2 outputs"),
        (function((2, 2), (1, 1)), "ode's x must have shape"),
        (function((2, 1), (1, 3)), "ode's u must have shape"),
        (function((3, 1), (1, 1)), "ode's dx must have shape"),
    ],
)
def test_what_is_no_ode_is_refused_in_one_line(ode: Any, message: str) -> None:
    with pytest.raises(ModelError, match=message) as caught:
        linearise(ode, STATE, COMMAND, 0.02, np.eye(2))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        ({"state": np.zeros(3)}, ShapeError, "state"),
        ({"command": np.zeros(2)}, ShapeError, "command"),
        ({"output": np.eye(3)}, ShapeError, "output"),
        ({"state": [np.nan, 0.0]}, ModelError, "state"),
        ({"period": 0.0}, ModelError, "period"),
        ({"period": np.nan}, ModelError, "period"),
    ],
)
def test_a_point_that_does_not_fit_is_refused(
    changed: dict[str, Any], error: type[Exception], message: str
) -> None:
    arguments = {"state": STATE, "command": COMMAND, "period": 0.02, "output": np.eye(2)}
    with pytest.raises(error, match=message):
        linearise(pendulum(), **(arguments | changed))


def test_a_corner_without_derivative_is_refused() -> None:
    x, u = casadi.SX.sym("x"), casadi.SX.sym("u")
    ode = casadi.Function("root", [x, u], [-casadi.sqrt(x) + u])
    with pytest.raises(ModelError, match="derivative of ode must be finite"):
        linearise(ode, 0.0, 0.0, 0.02, np.eye(1))


# ---- cost of having it


def test_casadi_is_imported_only_when_something_is_built() -> None:
    code = (
        "import sys, qpmpc, qpmpc.symbolic; qpmpc.available();"
        "from qpmpc.backends import backend_class; backend_class('casadi:qpoases');"
        "sys.exit('casadi' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
