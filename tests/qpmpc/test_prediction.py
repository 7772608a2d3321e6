from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qpmpc import LinearModel, ModelError, Prediction, ShapeError, absolute_prediction, prediction

Build = Callable[..., Prediction]
builds = pytest.mark.parametrize("build", [prediction, absolute_prediction])


def commands_of(build: Build, decision: np.ndarray, previous: np.ndarray, N: int) -> np.ndarray:
    """The commands that a decision ``(N_u, n_inputs)`` stands for, held to the end of N steps."""
    moves = previous + np.cumsum(decision, axis=0) if build is prediction else decision
    return np.vstack([moves, np.tile(moves[-1], (N - len(moves), 1))])


@st.composite
def cases(draw: st.DrawFn) -> dict[str, Any]:
    N = draw(st.integers(1, 64))
    return {
        "sizes": tuple(draw(st.integers(1, 4)) for _ in range(3)),
        "radius": draw(st.sampled_from([0.0, 0.5, 0.99, 1.0, 1.05])),
        "N": N,
        "N_u": draw(st.one_of(st.none(), st.integers(1, N))),
        "own_output": draw(st.booleans()),
        "seed": draw(st.integers(0, 2**32 - 1)),
    }


@builds
@given(case=cases())
@settings(max_examples=150, deadline=None, derandomize=True)
def test_equals_the_roll_out(
    random_model: Callable[..., LinearModel], roll_out: Any, build: Build, case: dict[str, Any]
) -> None:
    rng = np.random.default_rng(case["seed"])
    n, m, p = case["sizes"]
    model = random_model(rng, n, m, p, case["radius"])
    output = rng.standard_normal((2, n)) if case["own_output"] else None
    C = model.C if output is None else output
    N, N_u = case["N"], case["N_u"]
    matrices = build(model, N, N_u, output)
    moves = N_u or N
    assert matrices.Psi.shape == (N * C.shape[0], n)
    assert matrices.Upsilon.shape == (N * C.shape[0], m)
    assert matrices.Theta.shape == (N * C.shape[0], moves * m)
    zero_u, zero_z = np.zeros(m), np.zeros((moves, m))

    def response(state: np.ndarray, previous: np.ndarray, decision: np.ndarray) -> np.ndarray:
        return roll_out(model, state, commands_of(build, decision, previous, N), C).ravel()

    expected = {
        "Psi": np.array([response(e, zero_u, zero_z) for e in np.eye(n)]).T,
        "Upsilon": np.array([response(np.zeros(n), e, zero_z) for e in np.eye(m)]).T,
        "Theta": np.array(
            [response(np.zeros(n), zero_u, e.reshape(moves, m)) for e in np.eye(moves * m)]
        ).T,
    }
    for name, value in expected.items():
        ours = getattr(matrices, name)
        assert np.abs(ours - value).max() <= 1e-12 * np.abs(value).max(), name


@builds
@pytest.mark.parametrize("N", [1, 2, 8])
def test_diagonal_blocks_are_cb(
    rng: np.random.Generator, random_model: Callable[..., LinearModel], build: Build, N: int
) -> None:
    model = random_model(rng, 3, 2, 2, 0.9)
    Theta = build(model, N).Theta.reshape(N, 2, N, 2)
    for i in range(N):
        np.testing.assert_allclose(Theta[i, :, i], model.C @ model.B, rtol=1e-13)
        assert not Theta[i, :, i + 1 :].any()
    for i in range(N - 1):
        np.testing.assert_array_equal(Theta[1:, :, i + 1], Theta[:-1, :, i])


def test_increments_and_absolute_commands_predict_the_same(
    rng: np.random.Generator, random_model: Callable[..., LinearModel]
) -> None:
    model = random_model(rng, 4, 2, 3, 1.01)
    state, previous, steps = (
        rng.standard_normal(4),
        rng.standard_normal(2),
        rng.standard_normal((3, 2)),
    )
    one, other = prediction(model, 9, 3), absolute_prediction(model, 9, 3)
    absolute = previous + np.cumsum(steps, axis=0)
    np.testing.assert_allclose(
        one.Psi @ state + one.Upsilon @ previous + one.Theta @ steps.ravel(),
        other.Psi @ state + other.Theta @ absolute.ravel(),
        rtol=1e-11,
    )


@builds
@pytest.mark.parametrize(
    "case", [(0, None, "horizon"), (-3, None, "horizon"), (4, 0, "control"), (4, 5, "control")]
)
def test_horizons_out_of_range(
    rng: np.random.Generator,
    random_model: Callable[..., LinearModel],
    build: Build,
    case: tuple[int, int | None, str],
) -> None:
    N, N_u, name = case
    with pytest.raises(ModelError, match=name):
        build(random_model(rng, 2, 1, 1, 0.5), N, N_u)


@builds
def test_output_must_fit_the_states(
    rng: np.random.Generator, random_model: Callable[..., LinearModel], build: Build
) -> None:
    with pytest.raises(ShapeError, match="output"):
        build(random_model(rng, 2, 1, 1, 0.5), 4, output=np.ones((2, 3)))
