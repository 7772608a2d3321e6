import numpy as np
import pytest

from qpmpc import ExponentialReference, ModelError


@pytest.mark.parametrize(("N", "n"), [(1, 1), (8, 1), (8, 3), (64, 2)])
@pytest.mark.parametrize("time_constant", [0.0, 1e-3, 0.02, 1e3])
def test_formula_with_preview(
    rng: np.random.Generator, N: int, n: int, time_constant: float
) -> None:
    reference = ExponentialReference(N, n, 1e-3, time_constant)
    s, y = rng.standard_normal((N + 1, n)), rng.standard_normal(n)
    alpha = np.exp(-1e-3 / time_constant) if time_constant else 0.0
    w = reference(s, y)
    assert w.shape == (N, n)
    for i in range(1, N + 1):
        np.testing.assert_allclose(w[i - 1], s[i] - alpha**i * (s[0] - y), rtol=1e-13, atol=1e-15)


def test_on_the_setpoint_it_is_the_setpoint(rng: np.random.Generator) -> None:
    s = rng.standard_normal((9, 2))
    np.testing.assert_array_equal(ExponentialReference(8, 2, 1e-3, 0.02)(s, s[0]), s[1:])


def test_setpoint_step_ahead_is_seen_before_it_comes() -> None:
    s = np.zeros((9, 1))
    s[5:] = 2.0
    w = ExponentialReference(8, 1, 1e-3, 0.02)(s, np.zeros(1))
    np.testing.assert_array_equal(w[:, 0], [0, 0, 0, 0, 2, 2, 2, 2])


def test_arguments_are_not_changed(rng: np.random.Generator) -> None:
    s, y = rng.standard_normal((9, 2)), rng.standard_normal(2)
    before = s.copy(), y.copy()
    ExponentialReference(8, 2, 1e-3, 0.02)(s, y)
    np.testing.assert_array_equal(s, before[0])
    np.testing.assert_array_equal(y, before[1])


@pytest.mark.parametrize("time_constant", [-1e-3, np.nan])
def test_time_constant_out_of_range(time_constant: float) -> None:
    with pytest.raises(ModelError, match="time_constant"):
        ExponentialReference(8, 1, 1e-3, time_constant)
