from typing import Any

import numpy as np
import pytest
import scipy.signal
from scipy.linalg import expm

from qpmpc import ModelError, contact_model

PERIOD = 1e-3


def continuous(
    stiffness: float, damping: float, lag: float, separate: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Generator for states (y, v or v - v_e, [v], [a]) and inputs (u, d, v_e), written by hand."""
    A = np.array(
        [
            [0.0, stiffness, 0.0, 0.0],
            [0.0, -damping, 0.0, 1.0],
            [0.0, 0.0, -damping, 1.0],
            [0.0, 0.0, 0.0, -1.0 / lag if lag else 0.0],
        ]
    )
    # What disturbs the relative velocity is the tissue: the tool itself does not feel it.
    B = np.array([[0, 0, -stiffness], [0, 1, 0], [0, 0, 0], [1 / lag if lag else 0, 0, 0]], float)
    if not lag:
        B[1:3, 0] = 1.0
    keep = [0, 1, *([2] if separate else []), *([3] if lag else [])]
    if not separate:
        keep = [0, 1, *([3] if lag else [])]
    return A[np.ix_(keep, keep)], B[keep]


@pytest.mark.parametrize(("stiffness", "damping"), [(200.0, 5.0), (2500.0, 20.0), (1e4, 120.0)])
@pytest.mark.parametrize("period", [1e-4, 1e-3, 1e-2])
def test_closed_form_of_the_hold(stiffness: float, damping: float, period: float) -> None:
    contact = contact_model(stiffness, damping, period)
    decay = np.exp(-damping * period)
    travel = -np.expm1(-damping * period) / damping
    gain = (period - travel) / damping
    np.testing.assert_allclose(contact.model.A, [[1, stiffness * travel], [0, decay]], rtol=1e-12)
    np.testing.assert_allclose(contact.model.B, [[stiffness * gain], [travel]], rtol=1e-9)
    np.testing.assert_allclose(contact.load, contact.model.B)
    np.testing.assert_allclose(contact.tissue, [[-stiffness * period], [0]], atol=1e-14)
    np.testing.assert_array_equal(contact.model.C, [[1, 0]])
    np.testing.assert_array_equal(contact.velocity, [[0, 1]])
    assert contact.model.period == period


def test_without_damping_it_is_a_chain_of_integrators() -> None:
    model = contact_model(1000.0, 0.0, PERIOD).model
    np.testing.assert_allclose(model.A, [[1, 1.0], [0, 1]], rtol=1e-14)
    np.testing.assert_allclose(model.B, [[1000 * PERIOD**2 / 2], [PERIOD]], rtol=1e-12)


@pytest.mark.parametrize("lag", [0.0, 1e-3])
@pytest.mark.parametrize("separate", [False, True])
def test_every_column_is_that_of_scipy(lag: float, separate: bool) -> None:
    contact = contact_model(2500.0, 20.0, PERIOD, lag=lag, separate_tool=separate)
    A, B = continuous(2500.0, 20.0, lag, separate)
    n = A.shape[0]
    Ad, Bd, *_ = scipy.signal.cont2discrete((A, B, np.eye(n), np.zeros((n, 3))), PERIOD, "zoh")
    np.testing.assert_allclose(contact.model.A, Ad, rtol=1e-10, atol=1e-15)
    columns = np.hstack([contact.model.B, contact.load, contact.tissue])
    np.testing.assert_allclose(columns, Bd, rtol=1e-10, atol=1e-15)


def test_lag_against_a_fine_simulation(rng: np.random.Generator, roll_out: Any) -> None:
    stiffness, damping, lag, fine = 2500.0, 20.0, 1.5e-3, 2000
    contact = contact_model(stiffness, damping, PERIOD, lag=lag)
    commands = rng.uniform(-20, 20, (10, 1))
    state = np.array([2.0, 0.05, 3.0])
    expected, (y, v, a), h = [], state, PERIOD / fine
    for u in commands[:, 0]:
        for _ in range(fine):  # midpoint rule
            am = a + h / 2 * (u - a) / lag
            vm = v + h / 2 * (a - damping * v)
            y, v, a = y + h * stiffness * vm, v + h * (am - damping * vm), a + h * (u - am) / lag
        expected.append([y, v])
    outputs = np.vstack([contact.model.C, contact.velocity])
    ours = roll_out(contact.model, state, commands, outputs)
    np.testing.assert_allclose(ours, expected, rtol=1e-6)


@pytest.mark.parametrize("lag", [0.0, 1e-3])
def test_force_follows_the_relative_velocity_and_the_tool_its_own(lag: float) -> None:
    """A tissue that moves steadily under a tool that damps itself to rest."""
    contact = contact_model(1000.0, 20.0, PERIOD, lag=lag)
    x, speed = np.zeros((contact.model.n_states, 1)), 0.03
    for _ in range(50):
        x = contact.model.A @ x + contact.tissue * speed
    assert contact.model.C @ x == pytest.approx(-1000.0 * speed * 50 * PERIOD)
    assert contact.velocity @ x == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("lag", [0.0, 1e-3])
def test_separate_tool_gives_the_same_force_for_any_tissue_motion(
    rng: np.random.Generator, lag: float
) -> None:
    """With ``d - a_e - K2 v_e`` for ``d`` and no ``v_e`` the two readings agree."""
    damping = 20.0
    absolute = contact_model(1000.0, damping, PERIOD, lag=lag)
    relative = contact_model(1000.0, damping, PERIOD, lag=lag, separate_tool=True)
    x, z = np.zeros((absolute.model.n_states, 1)), np.zeros((relative.model.n_states, 1))
    # The tissue is accelerated so that v_e follows dv_e/dt + K2 v_e = pull, pull held per period.
    transition = expm(np.array([[-damping, 1.0], [0.0, 0.0]]) * PERIOD)
    speed, travel = 0.0, []
    for _ in range(40):
        u, pull = rng.uniform(-20, 20), rng.uniform(-30, 30)
        x = absolute.model.A @ x + absolute.model.B * u
        z = relative.model.A @ z + relative.model.B * u - relative.load * pull
        z[2] += relative.load[2, 0] * pull  # the tool itself feels none of it
        faster = transition[0, 0] * speed + transition[0, 1] * pull
        travel.append((pull * PERIOD - (faster - speed)) / damping)
        speed = faster
        assert z[0, 0] == pytest.approx(x[0, 0] - 1000.0 * sum(travel), rel=1e-9, abs=1e-9)
        assert relative.velocity @ z == pytest.approx(absolute.velocity @ x, rel=1e-9, abs=1e-12)
        assert z[1, 0] == pytest.approx(x[1, 0] - speed, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        ({"stiffness": 0.0}, "stiffness"),
        ({"stiffness": np.nan}, "stiffness"),
        ({"velocity_damping": -1.0}, "velocity_damping"),
        ({"velocity_damping": np.nan}, "velocity_damping"),
        ({"lag": -1e-3}, "lag"),
        ({"lag": np.nan}, "lag"),
        ({"period": 0.0}, "period"),
        ({"period": np.nan}, "period"),
    ],
)
def test_figures_out_of_range(changed: dict[str, float], name: str) -> None:
    arguments = {"stiffness": 1000.0, "velocity_damping": 20.0, "period": PERIOD}
    with pytest.raises(ModelError, match=name):
        contact_model(**(arguments | changed))
