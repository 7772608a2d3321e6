"""The paper's law as a controller: nothing else than the reduced predictive one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from qpmpc import BoundsConfig, ControllerConfig, ForceController, ModelConfig, ObserverConfig
from qpmpc.rivals.config import PaperLawConfig

CONFIG = ControllerConfig(
    increment_weight=0.5,
    reference_time=0.4,
    bounds=BoundsConfig(force=(-3.0, 3.0), velocity=(-0.001, 0.001)),
    paper_law=PaperLawConfig(0.002, 0.0025),
)


def test_it_is_the_scenario_of_that_name(make, loop):
    """Closed form, no disturbance, no delay, no lag, no bound but that of the command."""
    shipped = ControllerConfig(
        increment_weight=0.002,
        reference_time=0.0025,
        model=ModelConfig(delay=0, lag=0.0),
        observer=ObserverConfig(disturbance="none"),
    )
    moving = {"tissue": lambda k: 0.03 * np.sin(0.02 * k), "setpoint": lambda k: 1.0}
    found = loop(make("paper-law", CONFIG, "xyz"), CONFIG, 300, **moving)
    expected = loop(ForceController(shipped, "xyz", 1e-3, "analytic"), CONFIG, 300, **moving)
    assert np.array_equal(found.command, expected.command)
    assert np.ptp(found.command) > 1.0


def test_a_constant_disturbance_leaves_the_offset_of_the_formula(make, loop):
    """Section 2 of docs/mathematics.md, without delay and lag in the plant."""
    config = replace(CONFIG, model=ModelConfig(delay=0, lag=0.0))
    controller = make("paper-law", config)
    force = loop(controller, config, 2000, load=lambda k: 1.5).force[-1, 0]
    problem = controller.general.problem
    weights = problem.prediction.Theta.T @ problem.prediction.Theta
    gain = np.linalg.solve(weights + 0.002 * np.eye(8), problem.prediction.Theta.T)[0]
    decay = np.exp(-np.arange(1, 9) / 2.5)
    expected = -1.5 * gain @ problem.prediction.Upsilon[:, 0] / (gain @ (1 - decay))
    assert -force == pytest.approx(expected, rel=1e-6)
