"""Iterative learning: what repeats is learned, what does not is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from qpmpc import ControllerConfig
from qpmpc.errors import ModelError
from qpmpc.rivals.config import LearningConfig, PiConfig
from qpmpc.rivals.learning import Memory, closed_loop_response

CONFIG = ControllerConfig(
    pi=PiConfig(50.0, 300.0, 150.0, 1.0, 0.002),
    ilc=LearningConfig(0.5, 1.25, 0.5, 0.0, 30.0, 0.0),
)
KNOWN = np.ones(1, dtype=np.bool_)
PERIODS = 12


def learning(**keys) -> ControllerConfig:
    return replace(CONFIG, ilc=replace(CONFIG.ilc, **keys))


def beat(period: float):
    """Velocity of a tissue that beats: three harmonics [m/s]."""

    def velocity(k: int) -> float:
        phase = 2 * np.pi * k * 1e-3 / period
        return 0.03 * np.sin(phase) + 0.02 * np.sin(2 * phase + 1) + 0.01 * np.sin(3 * phase + 2)

    return velocity


def errors(run, period: float) -> np.ndarray:
    """RMS of the force in each period."""
    n = round(period / 1e-3)
    whole = run.force[: len(run.force) // n * n, 0].reshape(-1, n)
    return np.sqrt(np.mean(whole**2, axis=1))


def test_the_error_of_what_repeats_falls_from_period_to_period(make, loop):
    run = loop(make("pi-ilc", CONFIG), CONFIG, 500 * PERIODS, tissue=beat(0.5))
    found = errors(run, 0.5)
    assert (np.diff(found[1:8]) < 0).all()
    alone = errors(loop(make("pi", CONFIG), CONFIG, 500 * PERIODS, tissue=beat(0.5)), 0.5)
    assert found[0] == pytest.approx(alone[0], rel=0.05)  # little is known in the first one
    assert found[-1] < 0.03 * alone[-1]


def test_a_period_need_not_be_a_whole_number_of_cycles(make, loop):
    period = 1 / 1.7  # 588.24 cycles
    config = learning(heart_period=period)
    run = loop(make("pi-ilc", config), config, 5000, tissue=beat(period))
    assert errors(run, period)[-1] < 0.03 * errors(run, period)[0]


def test_heart_and_breath_are_learned_side_by_side(make, loop):
    """Where one of them is not learned, its part of the error stays."""

    def tissue(k):
        return beat(0.31)(k) + 3 * beat(0.7)(k)

    def left(heart, breath):
        config = learning(
            heart_period=0.31, breath_period=0.7, heart_gain=heart, breath_gain=breath
        )
        run = loop(make("pi-ilc", config), config, 7000, tissue=tissue)
        return float(np.std(run.force[-2100:]))

    both = left(0.3, 0.3)
    assert both < 0.25 * left(0.3, 0.0)
    assert both < 0.25 * left(0.0, 0.3)


def test_with_another_period_than_it_is_told_learning_is_of_no_use(make, loop):
    alone = loop(make("pi", CONFIG), CONFIG, 6000, tissue=beat(0.55))
    told = loop(make("pi-ilc", CONFIG), CONFIG, 6000, tissue=beat(0.55))
    assert np.std(told.force[-2000:]) > 0.9 * np.std(alone.force[-2000:])


def test_a_higher_gain_learns_faster_and_none_not_at_all(make, loop):
    found = {}
    for gain in (0.0, 0.2, 0.8):
        config = learning(heart_gain=gain)
        found[gain] = errors(loop(make("pi-ilc", config), config, 2500, tissue=beat(0.5)), 0.5)
    assert found[0.8][3] < 0.5 * found[0.2][3] < 0.5 * found[0.0][3]
    alone = loop(make("pi", CONFIG), CONFIG, 2500, tissue=beat(0.5))
    assert np.allclose(found[0.0], errors(alone, 0.5), rtol=1e-9)


def test_what_is_forgotten_has_to_be_learned_again(make, loop):
    """w = (1 - f)(w + g e) and e = d - w leave 1 - (1 - f) g / (1 - (1 - f)(1 - g)) of d."""
    config = learning(forgetting=0.3)
    found = errors(loop(make("pi-ilc", config), config, 4000, tissue=beat(0.5)), 0.5)
    alone = errors(loop(make("pi", CONFIG), CONFIG, 4000, tissue=beat(0.5)), 0.5)
    assert found[-1] / alone[-1] == pytest.approx(1 - 0.35 / 0.65, abs=0.06)


def test_above_the_cutoff_nothing_is_learned(make, loop):
    def fast(k):
        return 0.02 * np.sin(2 * np.pi * 12 * k * 1e-3)

    left = {}
    for cutoff in (3.0, 40.0):
        config = learning(cutoff=cutoff)
        run = loop(make("pi-ilc", config), config, 4500, tissue=fast)
        left[cutoff] = np.std(run.force[-1000:]) / np.std(run.force[500:1000])
    assert left[3.0] > 0.9
    assert left[40.0] < 0.2


def test_the_filter_q_has_no_phase_and_halves_the_power_at_its_cutoff():
    """A memory that was given an error once repeats it, filtered, in the same place."""
    n, cutoff = 500, 20.0
    response = np.zeros(4096)
    response[0] = 1.0  # the loop is a one: what prevents an error is the error
    memory = Memory(response, 1, cycles=n, gain=1.0, cutoff=cutoff * 1e-3, forgetting=0.0)
    phase = 2 * np.pi * cutoff * np.arange(2 * n) * 1e-3
    out = [
        float(memory.recall(np.array([np.sin(phase[k]) if k < n else 0.0]), KNOWN)[0])
        for k in range(2 * n)
    ]
    middle = slice(n + 200, 2 * n - 200)
    assert np.allclose(out[middle], np.sqrt(0.5) * np.sin(phase[middle]), atol=2e-3)


@pytest.mark.parametrize("cycles", [250.0, 250.5, 249.7])
def test_what_comes_again_comes_a_period_later_to_the_fraction_of_a_cycle(cycles):
    response = np.zeros(4096)
    response[0] = 1.0
    memory = Memory(response, 1, cycles=cycles, gain=1.0, cutoff=0.2, forgetting=0.0)
    shape = lambda k: np.exp(-0.5 * ((k - 120) / 12) ** 2)  # noqa: E731
    out = [
        float(memory.recall(np.array([shape(k) if k < 240 else 0.0]), KNOWN)[0]) for k in range(480)
    ]
    again = shape(np.arange(480) - cycles)
    assert np.allclose(out, (1 - 1e-3 / 1.001) * again, atol=4e-3)


def test_nothing_is_learned_from_a_gap():
    response = np.zeros(4096)
    response[0] = 1.0
    memory = Memory(response, 1, cycles=100.0, gain=1.0, cutoff=0.1, forgetting=0.0)
    for k in range(200):
        out = memory.recall(np.ones(1), KNOWN if k >= 100 else np.zeros(1, dtype=np.bool_))
        assert k >= 150 or abs(out[0]) < 1e-9


def test_the_response_is_that_of_the_loop(make, loop):
    """An impulse added to the command, against the impulse on a loop that runs."""
    response = closed_loop_response(CONFIG, 1e-3)
    k = iter(range(10_000))
    run = loop(make("pi", CONFIG), CONFIG, 300, sent=lambda u: u + (next(k) == 0))
    assert np.allclose(run.force[:, 0], response[:300], atol=1e-12)
    assert response.max() > 1e-3


def test_a_loop_that_is_not_stable_is_refused(make):
    config = replace(CONFIG, pi=PiConfig(5000.0, 300.0, 2000.0, 1.0, 0.002))
    with pytest.raises(ModelError, match=r"controller\.pi"):
        make("pi-ilc", config)
    with pytest.raises(ModelError, match="4 cycles"):
        make("pi-ilc", learning(heart_period=0.003))
