from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    Exosystem,
    LinearModel,
    ModelError,
    ShapeError,
    combined,
    constant,
    contact_model,
    oscillator,
    parabola,
    prediction,
    ramp,
    with_delay,
    with_disturbance,
)

PERIOD = 1e-3
STEPS = 30
time = np.arange(STEPS) * PERIOD
omega = 2 * np.pi * 17.0

DISTURBANCES: dict[str, tuple[Exosystem, list[float], np.ndarray]] = {
    "constant": (constant(), [1.5], np.full(STEPS, 1.5)),
    "ramp": (ramp(PERIOD), [1.5, -40.0], 1.5 - 40.0 * time),
    "parabola": (parabola(PERIOD), [1.5, -40.0, 9e3], 1.5 - 40.0 * time + 4.5e3 * time**2),
    "oscillator": (
        oscillator(17.0, PERIOD),
        [1.5, -0.5],
        1.5 * np.cos(omega * time) - 0.5 * np.sin(omega * time),
    ),
    "combined": (
        combined(constant(), oscillator(17.0, PERIOD), ramp(PERIOD)),
        [0.3, 0.0, 2.0, 0.1, 7.0],
        0.4 + 2.0 * np.sin(omega * time) + 7.0 * time,
    ),
}
disturbances = pytest.mark.parametrize("name", DISTURBANCES)


@pytest.fixture
def model(rng: np.random.Generator, random_model: Callable[..., LinearModel]) -> LinearModel:
    return random_model(rng, 3, 2, 2, 1.02)


@pytest.mark.parametrize("cycles", [0, 1, 2, 5])
def test_delay_shifts_the_input(
    rng: np.random.Generator, model: LinearModel, roll_out: Any, cycles: int
) -> None:
    state = rng.standard_normal(3)
    commands = rng.standard_normal((STEPS, 2))
    under_way = rng.standard_normal((cycles, 2))  # oldest first
    delayed = with_delay(model, cycles)
    augmented = np.concatenate([state, under_way[::-1].ravel()])
    shifted = np.vstack([under_way, commands])[:STEPS]
    np.testing.assert_allclose(
        roll_out(delayed, augmented, commands), roll_out(model, state, shifted), rtol=1e-12
    )
    assert delayed.n_states == 3 + 2 * cycles


def test_negative_delay_is_refused(model: LinearModel) -> None:
    with pytest.raises(ModelError, match="-1 cycles"):
        with_delay(model, -1)


@disturbances
def test_disturbance_is_the_explicit_signal(
    rng: np.random.Generator, model: LinearModel, roll_out: Any, name: str
) -> None:
    exosystem, initial, signal = DISTURBANCES[name]
    channel = rng.standard_normal((3, 1))
    state, commands = rng.standard_normal(3), rng.standard_normal((STEPS, 2))
    augmented = with_disturbance(model, channel, exosystem)
    ours = roll_out(augmented, np.concatenate([state, initial]), commands)
    x, expected = state, []
    for command, d in zip(commands, signal, strict=True):
        x = model.A @ x + model.B @ command + channel[:, 0] * d
        expected.append(model.C @ x)
    np.testing.assert_allclose(ours, expected, rtol=1e-10, atol=1e-12)


@disturbances
def test_order_of_delay_and_disturbance_does_not_matter(
    rng: np.random.Generator, model: LinearModel, roll_out: Any, name: str
) -> None:
    exosystem, initial, _ = DISTURBANCES[name]
    channel = rng.standard_normal((3, 1))
    state, commands = rng.standard_normal(3), rng.standard_normal((STEPS, 2))
    registers = rng.standard_normal(4)
    one = with_disturbance(with_delay(model, 2), channel, exosystem)
    other = with_delay(with_disturbance(model, channel, exosystem), 2)
    np.testing.assert_allclose(
        roll_out(one, np.concatenate([state, registers, initial]), commands),
        roll_out(other, np.concatenate([state, initial, registers]), commands),
        rtol=1e-12,
    )


def test_matched_disturbance_is_previewed_by_the_free_response() -> None:
    contact = contact_model(1000.0, 20.0, PERIOD)
    augmented = with_disturbance(contact.model, contact.load, ramp(PERIOD))
    free = prediction(augmented, 8).Psi @ [2.0, 0.0, 3.0, 100.0]
    commands = 3.0 + 100.0 * PERIOD * np.arange(8)
    x, expected = np.array([2.0, 0.0]), []
    for u in commands:
        x = contact.model.A @ x + contact.model.B[:, 0] * u
        expected.append(x[0])
    np.testing.assert_allclose(free, expected, rtol=1e-12)


def test_several_channels_at_once(
    rng: np.random.Generator, model: LinearModel, roll_out: Any
) -> None:
    channel = rng.standard_normal((3, 2))
    both = Exosystem(np.eye(2), np.eye(2))
    at_once = with_disturbance(model, channel, both)
    in_turn = with_disturbance(
        with_disturbance(model, channel[:, :1], constant()), channel[:, 1:], constant()
    )
    state, commands = rng.standard_normal(5), rng.standard_normal((STEPS, 2))
    np.testing.assert_allclose(
        roll_out(at_once, state, commands), roll_out(in_turn, state, commands), rtol=1e-12
    )


@pytest.mark.parametrize("frequency", [0.0, -1.0, 500.0, 1e4, np.nan])
def test_frequency_must_be_below_nyquist(frequency: float) -> None:
    with pytest.raises(ModelError, match="500"):
        oscillator(frequency, PERIOD)


def test_oscillator_does_not_decay() -> None:
    S = oscillator(1.3, PERIOD).S
    np.testing.assert_allclose(S.T @ S, np.eye(2), atol=1e-15)


def test_channel_must_fit(model: LinearModel) -> None:
    with pytest.raises(ModelError, match="4 rows, the model only 3"):
        with_disturbance(model, np.ones((4, 1)), constant())
    with pytest.raises(ShapeError, match="channel"):
        with_disturbance(model, np.ones((3, 2)), constant())


def test_exosystem_must_fit() -> None:
    with pytest.raises(ShapeError, match=r"^S "):
        Exosystem(np.ones((1, 2)), np.ones((1, 2)))
    with pytest.raises(ShapeError, match=r"^H "):
        Exosystem(np.eye(2), np.ones((1, 3)))
