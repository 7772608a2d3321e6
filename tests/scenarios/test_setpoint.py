"""The setpoint over a run and its preview."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios import Setpoint, SetpointConfig, SetpointStep

PERIOD = 1e-3
STEPS = (SetpointStep(0.003, z=-8.0), SetpointStep(0.0055, x=0.5, z=-6.0))


def test_without_steps_it_is_constant():
    setpoint = Setpoint(SetpointConfig(), ("x", "y", "z"), 5, 8, PERIOD)
    assert np.array_equal(setpoint.force, np.tile([1.0, 2.0, -10.0], (13, 1)))


def test_a_step_begins_at_its_time_and_leaves_the_other_axes():
    config = SetpointConfig(x=1.0, y=2.0, z=-10.0, steps=STEPS)
    force = Setpoint(config, ("x", "y", "z"), 10, 4, PERIOD).force
    assert force[:, 1].tolist() == [2.0] * 14
    assert force[:, 2].tolist() == [-10.0] * 3 + [-8.0] * 3 + [-6.0] * 8
    assert force[:, 0].tolist() == [1.0] * 6 + [0.5] * 8


def test_columns_are_the_axes_in_their_order():
    force = Setpoint(SetpointConfig(steps=STEPS), ("z", "x"), 10, 1, PERIOD).force
    assert force[0].tolist() == [-10.0, 1.0]
    assert force[-1].tolist() == [-6.0, 0.5]


@pytest.mark.parametrize("horizon", [1, 8])
def test_the_preview_looks_the_horizon_ahead_even_at_the_end(horizon):
    cycles = 10
    setpoint = Setpoint(SetpointConfig(steps=STEPS), ("x", "z"), cycles, horizon, PERIOD)
    for k in range(cycles):
        preview = setpoint.preview(k)
        assert preview.shape == (horizon + 1, 2)
        assert np.array_equal(preview, setpoint.force[k : k + horizon + 1])
    known_ahead = setpoint.preview(3 - horizon if horizon < 3 else 0)
    assert -8.0 in known_ahead[:, 1]


def test_a_step_beyond_the_run_is_previewed_only():
    late = SetpointConfig(steps=(SetpointStep(0.012, z=-5.0),))
    setpoint = Setpoint(late, ("z",), 10, 4, PERIOD)
    assert (setpoint.force[:10] == -10.0).all()
    assert setpoint.preview(9)[-1, 0] == -5.0
    beyond = SetpointConfig(steps=(SetpointStep(5.0, z=-5.0),))
    assert (Setpoint(beyond, ("z",), 10, 4, PERIOD).force == -10.0).all()
