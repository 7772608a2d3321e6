"""The smaller recursion says what the whole model says, and couples what is coupled."""

import numpy as np
import pytest

from qpmpc import ModelConfig, ObserverConfig, axis_model, stack
from qpmpc.structured.dynamics import coupled, joined_dynamics, reachable


def responses(dynamics, functionals, steps=60, held_from=None):
    s, found = dynamics.G, []
    for i in range(steps):
        found.append(functionals @ s)
        s = (dynamics.F if held_from is None or i < held_from else dynamics.F_held) @ s
    return np.array(found)


@pytest.mark.parametrize("decision", ["increment", "absolute"])
@pytest.mark.parametrize("seed", range(6))
def test_nothing_is_lost_by_keeping_what_is_reached(seed, decision, random_model):
    rng = np.random.default_rng(seed)
    model = random_model(rng, int(rng.integers(1, 7)), 2, 2, [0.5, 1.0, 1.1][seed % 3])
    whole = joined_dynamics(model, decision, rates=True)
    functionals = rng.standard_normal((3, whole.n))
    for inputs in ([0], [1], [0, 1]):
        small, reads = reachable(whole, np.array(inputs), functionals)
        for held_from in (None, 3):
            wanted = responses(whole, functionals, held_from=held_from)[:, :, inputs]
            np.testing.assert_allclose(
                responses(small, reads, held_from=held_from), wanted,
                rtol=1e-9, atol=1e-10 * np.abs(wanted).max(),
            )  # fmt: skip


@pytest.mark.parametrize("disturbance", ["none", "constant", "ramp", "fused"])
def test_an_axis_of_the_contact_has_four_states_that_a_decision_reaches(disturbance):
    """Force, velocity, lag and command: no disturbance, no second velocity, no register twice."""
    axis = axis_model(ModelConfig(), ObserverConfig(disturbance=disturbance), 1e-3).model
    model = stack([axis] * 3)
    dynamics = joined_dynamics(model, "increment", rates=False)
    output = np.hstack([model.C, np.zeros((3, 3))])
    groups = coupled(dynamics, output)
    assert [(g.tolist(), f.tolist()) for g, f in groups] == [([i], [i]) for i in range(3)]
    for inputs, own in groups:
        assert reachable(dynamics, inputs, output[own])[0].n == 4


def test_a_functional_of_two_axes_couples_them_and_one_that_nothing_moves_is_nowhere():
    axis = axis_model(ModelConfig(), ObserverConfig(), 1e-3).model
    model = stack([axis] * 3)
    dynamics = joined_dynamics(model, "increment", rates=False)
    rows = np.zeros((3, dynamics.n))
    rows[0, [0, axis.n_states]] = 1.0
    rows[1, 2 * axis.n_states] = 1.0
    rows[2, axis.n_states - 1] = 1.0  # a disturbance
    groups = coupled(dynamics, rows)
    assert [(g.tolist(), f.tolist()) for g, f in groups] == [([0, 1], [0]), ([2], [1])]
