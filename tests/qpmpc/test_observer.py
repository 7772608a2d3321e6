from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    KalmanObserver,
    LinearModel,
    ModelError,
    ObserverError,
    constant,
    contact_model,
    ramp,
    with_delay,
    with_disturbance,
)
from qpmpc.observer import kalman_gain

PERIOD = 1e-3


def riccati_gain(A: Any, C: Any, W: Any, V: Any, steps: int) -> np.ndarray:
    """The gain after many steps of the time-varying filter, started from ignorance."""
    P = W + np.eye(len(A))
    for _ in range(steps):
        L = P @ C.T @ np.linalg.inv(C @ P @ C.T + V)
        P = A @ (P - L @ C @ P) @ A.T + W
    return P @ C.T @ np.linalg.inv(C @ P @ C.T + V)


@pytest.fixture
def observed() -> tuple[LinearModel, KalmanObserver]:
    """Force and tool velocity of a delayed contact with a matched constant disturbance."""
    contact = contact_model(1000.0, 20.0, PERIOD)
    model = with_disturbance(with_delay(contact.model, 1), contact.load, constant())
    rows = np.array([[1.0, 0, 0, 0], [0, 1.0, 0, 0]])
    noise = np.diag([1e-6, 1e-6, 0.0, 0.3]) ** 2
    return model, KalmanObserver(model, rows, noise, np.diag([0.003, 1e-3]) ** 2)


@pytest.mark.parametrize("radius", [0.5, 0.95, 1.05])
@pytest.mark.parametrize("sizes", [(1, 1), (3, 1), (4, 2)])
def test_gain_is_the_limit_of_the_riccati_recursion(
    rng: np.random.Generator,
    random_model: Callable[..., LinearModel],
    radius: float,
    sizes: tuple[int, int],
) -> None:
    n, m = sizes
    model = random_model(rng, n, 1, m, radius)
    root, W_root = rng.standard_normal((m, m)), rng.standard_normal((n, n))
    W, V = W_root @ W_root.T + 0.1 * np.eye(n), root @ root.T + 0.1 * np.eye(m)
    expected = riccati_gain(model.A, model.C, W, V, 3000)
    np.testing.assert_allclose(kalman_gain(model.A, model.C, W, V), expected, rtol=1e-7, atol=1e-10)


def test_gain_of_the_contact_model_over_its_decades(
    observed: tuple[LinearModel, KalmanObserver],
) -> None:
    model, observer = observed
    rows, V = np.eye(4)[:2], np.diag([0.003, 1e-3]) ** 2
    W = np.diag([1e-6, 1e-6, 0.0, 0.3]) ** 2
    expected = riccati_gain(model.A, rows, W, V, 5000)
    np.testing.assert_allclose(observer.gain, expected, rtol=1e-5, atol=1e-9)


def test_converges_on_a_plant_and_has_no_offset(
    rng: np.random.Generator, observed: tuple[LinearModel, KalmanObserver]
) -> None:
    model, observer = observed
    x = np.array([3.0, 0.02, 0.0, -4.0])
    observer.reset()
    for _ in range(1500):
        estimate = observer.correct(x[:2])
        command = rng.uniform(-5, 5, 1)
        x = model.A @ x + model.B @ command
        observer.predict(command)
    x_now = observer.state
    np.testing.assert_allclose(x_now, x, rtol=1e-6, atol=1e-6)
    assert estimate is observer.state
    assert x_now[3] == pytest.approx(-4.0, rel=1e-6)


def test_one_cycle_is_correct_then_predict(
    rng: np.random.Generator, observed: tuple[LinearModel, KalmanObserver]
) -> None:
    model, observer = observed
    x, y, u = rng.standard_normal(4), rng.standard_normal(2), rng.standard_normal(1)
    observer.reset(x)
    corrected = x + observer.gain @ (y - x[:2])
    np.testing.assert_allclose(observer.correct(y), corrected, rtol=1e-13)
    np.testing.assert_allclose(
        observer.predict(u), model.A @ corrected + model.B @ u, rtol=1e-12, atol=1e-14
    )


def test_reset(observed: tuple[LinearModel, KalmanObserver]) -> None:
    _, observer = observed
    observer.correct(np.array([1.0, 2.0]))
    observer.reset([1.0, 2.0, 3.0, 4.0])
    np.testing.assert_array_equal(observer.state, [1, 2, 3, 4])
    observer.reset()
    np.testing.assert_array_equal(observer.state, np.zeros(4))


@pytest.mark.parametrize(
    ("model", "rows"),
    [
        (LinearModel(np.diag([1.0, 0.5]), np.ones((2, 1)), np.eye(2), 1.0), [[0.0, 1.0]]),
        (LinearModel(np.diag([1.2, 0.5]), np.ones((2, 1)), np.eye(2), 1.0), [[0.0, 1.0]]),
        (contact_model(1000.0, 20.0, PERIOD).model, [[0.0, 1.0]]),
    ],
    ids=["integrator", "unstable", "force-unseen"],
)
def test_undetectable_model(model: LinearModel, rows: list[list[float]]) -> None:
    with pytest.raises(ObserverError, match="observer"):
        KalmanObserver(model, rows, np.eye(2), [[1.0]])


def test_two_disturbances_that_cannot_be_told_apart() -> None:
    contact = contact_model(1000.0, 20.0, PERIOD)
    model = with_disturbance(contact.model, contact.load, constant())
    model = with_disturbance(model, contact.load, ramp(PERIOD))
    with pytest.raises(ObserverError, match="observer"):
        KalmanObserver(model, np.eye(model.n_states)[:2], np.eye(5), np.eye(2))


@pytest.mark.parametrize(
    ("rows", "W", "V", "error"),
    [
        (np.ones((1, 3)), np.eye(2), np.eye(1), ModelError),
        (np.ones((1, 2)), np.eye(3), np.eye(1), ModelError),
        (np.ones((1, 2)), np.eye(2), np.eye(2), ModelError),
        (np.ones((1, 2)), np.eye(2), [[0.0]], ObserverError),
        (np.ones((1, 2)), np.eye(2), [[-1.0]], ObserverError),
        (np.ones((1, 2)), np.eye(2), [[np.nan]], ModelError),
    ],
)
def test_arguments_that_do_not_fit(rows: Any, W: Any, V: Any, error: type[Exception]) -> None:
    with pytest.raises(error):
        KalmanObserver(contact_model(1000.0, 20.0, PERIOD).model, rows, W, V)
