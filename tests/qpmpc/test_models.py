from typing import Any

import control
import numpy as np
import pytest
import scipy.signal

from qpmpc import LinearModel, ModelError, ShapeError, from_state_space, stack, zero_order_hold

A_CONTINUOUS = np.array([[0.0, 1.0], [-4.0, -0.5]])
B_CONTINUOUS = np.array([[0.0], [2.0]])
C = np.array([[1.0, 0.0]])
D = np.zeros((1, 1))
PERIOD = 0.05
A_DISCRETE, B_DISCRETE = zero_order_hold(A_CONTINUOUS, B_CONTINUOUS, PERIOD)

makers = pytest.mark.parametrize(
    "make",
    [
        scipy.signal.StateSpace,
        lambda *m, **k: control.StateSpace(*m, *k.values()),
        lambda *m, **k: control.ss(*m, *k.values()),
    ],
    ids=["scipy", "control", "control.ss"],
)


def assert_same(model: LinearModel, A: Any, B: Any, period: float) -> None:
    np.testing.assert_allclose(model.A, A, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(model.B, B, rtol=1e-13, atol=1e-15)
    np.testing.assert_array_equal(model.C, C)
    assert model.period == pytest.approx(period, rel=1e-12)


@pytest.mark.parametrize("n", [1, 3, 6])
@pytest.mark.parametrize("period", [1e-4, 1e-3, 0.2])
def test_zero_order_hold_is_that_of_scipy(rng: np.random.Generator, n: int, period: float) -> None:
    A, B = 3 * rng.standard_normal((n, n)), rng.standard_normal((n, 2))
    expected = scipy.signal.cont2discrete((A, B, np.eye(n), np.zeros((n, 2))), period, "zoh")
    for ours, theirs in zip(zero_order_hold(A, B, period), expected, strict=False):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-14)


def test_zero_order_hold_of_a_double_integrator() -> None:
    A, B = zero_order_hold([[0, 1], [0, 0]], [[0], [1]], 0.1)
    np.testing.assert_allclose(A, [[1, 0.1], [0, 1]], atol=1e-16)
    np.testing.assert_allclose(B, [[0.005], [0.1]], atol=1e-16)


def test_sizes_and_read_only_copies() -> None:
    A = np.eye(3)
    model = LinearModel(A, np.ones((3, 2)), np.ones((4, 3)), PERIOD)
    A[0, 0] = 7.0
    assert (model.n_states, model.n_inputs, model.n_outputs) == (3, 2, 4)
    assert model.A[0, 0] == 1.0
    assert "states=3, inputs=2, outputs=4, period=0.05 s" in repr(model)
    with pytest.raises(ValueError, match="read-only"):
        model.A[0, 0] = 7.0


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"A": np.ones((2, 3))}, "A"),
        ({"A": np.ones(4)}, "A"),
        ({"B": np.ones((3, 1))}, "B"),
        ({"B": np.ones((1, 2))}, "B"),
        ({"C": np.ones((2, 1))}, "C"),
    ],
)
def test_shape_error_names_the_matrix(changed: dict[str, Any], name: str) -> None:
    arguments = {"A": np.eye(2), "B": np.ones((2, 1)), "C": np.ones((1, 2)), "period": 1.0}
    with pytest.raises(ShapeError, match=f"^{name} must have shape") as error:
        LinearModel(**(arguments | changed))
    assert error.value.name == name
    assert error.value.actual == changed[name].shape


@pytest.mark.parametrize(
    "changed",
    [
        {"A": [[np.nan, 0], [0, 1]]},
        {"B": [[np.inf], [0]]},
        {"C": [["a", "b"]]},
        {"period": 0.0},
        {"period": -1.0},
        {"period": np.nan},
        {"period": np.inf},
    ],
)
def test_model_error(changed: dict[str, Any]) -> None:
    arguments = {"A": np.eye(2), "B": np.ones((2, 1)), "C": np.ones((1, 2)), "period": 1.0}
    with pytest.raises(ModelError, match=next(iter(changed))):
        LinearModel(**(arguments | changed))


@pytest.mark.parametrize("period", [0.0, -1.0, np.nan, np.inf])
def test_zero_order_hold_refuses_a_senseless_period(period: float) -> None:
    with pytest.raises(ModelError, match="period"):
        zero_order_hold(A_CONTINUOUS, B_CONTINUOUS, period)


@makers
def test_continuous_system_is_held(make: Any) -> None:
    system = make(A_CONTINUOUS, B_CONTINUOUS, C, D)
    assert_same(from_state_space(system, PERIOD), A_DISCRETE, B_DISCRETE, PERIOD)


@makers
def test_continuous_system_needs_a_period(make: Any) -> None:
    with pytest.raises(ModelError, match="period is needed"):
        from_state_space(make(A_CONTINUOUS, B_CONTINUOUS, C, D))


def test_control_system_with_dt_zero_or_none_is_continuous() -> None:
    for dt in (0, None):
        system = control.StateSpace(A_CONTINUOUS, B_CONTINUOUS, C, D, dt)
        assert_same(from_state_space(system, PERIOD), A_DISCRETE, B_DISCRETE, PERIOD)


@makers
@pytest.mark.parametrize("period", [None, PERIOD])
def test_discrete_system_is_taken_as_it_is(make: Any, period: float | None) -> None:
    system = make(A_DISCRETE, B_DISCRETE, C, D, dt=PERIOD)
    assert_same(from_state_space(system, period), A_DISCRETE, B_DISCRETE, PERIOD)


def test_dlti_is_taken_as_it_is() -> None:
    system = scipy.signal.dlti(A_DISCRETE, B_DISCRETE, C, D, dt=PERIOD).to_ss()
    assert_same(from_state_space(system), A_DISCRETE, B_DISCRETE, PERIOD)


@makers
def test_discrete_system_refuses_another_period(make: Any) -> None:
    with pytest.raises(ModelError, match="contradicts"):
        from_state_space(make(A_DISCRETE, B_DISCRETE, C, D, dt=PERIOD), 2 * PERIOD)


@makers
def test_discrete_system_of_unstated_time_needs_a_period(make: Any) -> None:
    system = make(A_DISCRETE, B_DISCRETE, C, D, dt=True)
    assert_same(from_state_space(system, 0.3), A_DISCRETE, B_DISCRETE, 0.3)
    with pytest.raises(ModelError, match="period is needed"):
        from_state_space(system)


@makers
def test_feed_through_is_refused(make: Any) -> None:
    with pytest.raises(ModelError, match="D must be zero"):
        from_state_space(make(A_CONTINUOUS, B_CONTINUOUS, C, [[0.1]]), PERIOD)


@pytest.mark.parametrize(
    "system",
    [object(), scipy.signal.TransferFunction([1], [1, 2]), control.tf([1], [1, 2]), None],
    ids=["object", "scipy-tf", "control-tf", "None"],
)
def test_what_is_no_state_space_is_refused(system: Any) -> None:
    with pytest.raises(ModelError, match="no state-space object"):
        from_state_space(system, PERIOD)


def test_stack_responds_as_its_parts_side_by_side(
    rng: np.random.Generator, random_model: Any, roll_out: Any
) -> None:
    parts = [random_model(rng, 2, 1, 2, 0.9), random_model(rng, 3, 2, 1, 1.1)]
    states = [rng.standard_normal(m.n_states) for m in parts]
    commands = [rng.standard_normal((6, m.n_inputs)) for m in parts]
    joined = roll_out(stack(parts), np.concatenate(states), np.hstack(commands))
    apart = [roll_out(*part) for part in zip(parts, states, commands, strict=True)]
    np.testing.assert_allclose(joined, np.hstack(apart), rtol=1e-12)


def test_stack_refuses_models_of_different_periods() -> None:
    models = [LinearModel(np.eye(1), np.eye(1), np.eye(1), period) for period in (1e-3, 2e-3)]
    with pytest.raises(ModelError, match="share one period"):
        stack(models)
    with pytest.raises(ModelError, match="share one period"):
        stack([])
