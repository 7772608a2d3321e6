"""The comparison of disturbance models, and the bound beside it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bench.rhythm import KNOWN, main
from bench.rhythm_bound import prediction_bound

pytestmark = pytest.mark.slow


def wandering(rng: np.random.Generator, pole: float, n: int) -> np.ndarray:
    x = np.zeros(n)
    steps = rng.standard_normal(n)
    for k in range(1, n):
        x[k] = pole * x[k - 1] + steps[k]
    return x


@pytest.mark.parametrize(("noise", "cycles"), [(0.1, 1), (3.0, 1), (3.0, 3)])
def test_the_bound_is_that_of_the_kalman_filter_where_this_is_best(
    noise: float, cycles: int
) -> None:
    """A first-order process: the steady-state variance is a root of a quadratic equation."""
    pole = 0.95
    motion = wandering(np.random.default_rng(0), pole, 200_000)[:, None]
    p = 1.0
    for _ in range(2000):
        p = pole**2 * p * noise**2 / (p + noise**2) + 1.0
    best = p * noise**2 / (p + noise**2)  # after the correction
    for _ in range(cycles):
        best = pole**2 * best + 1.0
    assert prediction_bound(motion, noise, cycles)[0] == pytest.approx(np.sqrt(best), rel=0.03)


def test_the_bound_grows_with_noise_and_with_time_ahead() -> None:
    time = 1e-3 * np.arange(15_000)
    motion = np.stack([np.exp(-0.5 * ((time % 0.8 - 0.4) / w) ** 2) for w in (0.03, 0.1)], axis=1)
    bounds = [prediction_bound(motion, n, c) for n, c in ((0.01, 2), (0.1, 2), (0.1, 6))]
    assert (np.diff(bounds, axis=0) > 0).all()
    assert (bounds[0][1] < bounds[0][0]).all()  # the smoother one is told better


def test_the_comparison_tells_every_figure(capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["--motions", "recording", "--sensors", "nano17", "--seeds", "1", "--duration", "1"]
    asked += ["--json", "--models"]
    assert main([*asked, "fused", "beats", "tracked", KNOWN]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["model"] for row in rows] == ["fused", "tracked", KNOWN]  # no R peaks: no beats
    for row in rows:
        assert len(row["rms"]) == len(row["bound"]) == 3
        assert 50 < min(row["reduction"]) <= 100
        assert row["least"] == row["reduction"]  # of one seed
    assert max(rows[-1]["worst"]) < 0.3


def test_bad_input_is_refused() -> None:
    for wrong in (["--seeds", "0"], ["--duration", "20"], ["--models", "none"]):
        with pytest.raises(SystemExit) as caught:
            main(wrong)
        assert caught.value.code == 2
