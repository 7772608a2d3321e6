"""The compiled step serves a controller with a previewed motion: it decides the same."""

from __future__ import annotations

import numpy as np
import pytest

from qpmpc import (
    BoundsConfig,
    ControllerConfig,
    ForceController,
    ObserverConfig,
    PerAxis,
    SolverConfig,
)

AXES = ("x", "y", "z")
SET = np.array([1.0, 2.0, -10.0])


@pytest.mark.parametrize("kind", ["beats", "tracked"])
def test_both_paths_decide_the_same(kind: str) -> None:
    rng = np.random.default_rng(2)
    time = 1e-3 * np.arange(2000)
    pulse = np.exp(-0.5 * (((time + 0.2) % 0.5 - 0.25) / 0.03) ** 2)
    samples = SET + np.outer(pulse, [1.0, -2.0, 4.0]) + 0.2 * rng.standard_normal((2000, 3))
    speeds = 1e-3 * np.sin(np.outer(time, [10.0, 20.0, 30.0]))
    bounds = PerAxis((0.5, 1.5), (1.5, 2.5), (-10.5, -9.5))
    commands, active = [], 0
    for compiled in ("on", "off"):
        controller = ForceController(
            ControllerConfig(
                observer=ObserverConfig(disturbance=kind, force_noise=0.2),  # type: ignore[arg-type]
                bounds=BoundsConfig(force=bounds),
                solver=SolverConfig(compiled=compiled),  # type: ignore[arg-type]
            ),
            AXES,
            1e-3,
        )
        controller.reset(SET)
        wish, given = np.tile(SET, (9, 1)), []
        for k in range(2000):
            if k % 500 == 100:
                controller.beat()
            step = controller.step(samples[k], speeds[k], wish)
            controller.prepare()
            given.append(step.command)
            active += step.iterations > 1
        commands.append(np.array(given))
        assert controller.general.compilation.used is (compiled == "on")
        assert controller.general.compilation.interpreted_cycles == 0
        assert controller.preview is not None
        assert controller.preview.estimator.following == (kind == "beats")
    np.testing.assert_allclose(*commands, rtol=1e-9, atol=1e-9)
    assert active > 100
