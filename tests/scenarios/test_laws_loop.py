"""The default controller, whose model is a spring, on each contact law with default figures."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.slow

PUSHING = "cell.contact.unilateral=true"
LAWS = {
    "spring": ("cell.contact.law=spring",),
    "spring, pushing": ("cell.contact.law=spring", PUSHING),
    "kelvin_voigt": ("cell.contact.law=kelvin_voigt",),
    "standard_linear_solid": ("cell.contact.law=standard_linear_solid",),
    "standard_linear_solid, pushing": ("cell.contact.law=standard_linear_solid", PUSHING),
    "hunt_crossley": ("cell.contact.law=hunt_crossley", PUSHING),
    "systole": ("cell.contact.stiffness=1750", "cell.contact.systolic_stiffening=0.5"),
}


@pytest.fixture(scope="module")
def runs(simulate):
    """One run a law, 1.5 s with two beats, made when it is first asked for."""
    made = {}

    def get(name):
        if name not in made:
            made[name] = simulate("paper", *LAWS[name], still=False, duration=1.5)
        return made[name]

    return get


@pytest.mark.parametrize("name", LAWS)
def test_it_stays_stable_and_nothing_trips(name, runs):
    run = runs(name)
    assert run.summary["trip"] is None
    assert run.summary["status"] == {"solved": 1500}
    assert run.summary["saturation"]["command"] < 0.005
    for axis in run.summary["axes"].values():
        assert axis["compensated"]["rms"] < 0.04
        assert axis["compensated"]["max"] < 0.2
    # No limit cycle under the surface: the command is as calm in the rest as after a beat.
    assert np.std(np.diff(run.log.command[:300], axis=0)) < 1.5


def test_each_law_is_another_run(runs):
    """But for the default, which with no damper is the spring."""
    forces = {name: runs(name).log.force for name in LAWS}
    assert np.array_equal(forces.pop("kelvin_voigt"), forces["spring"])
    pairs = [(a, b) for a in forces for b in forces if a < b]
    same = {pair for pair in pairs if np.abs(forces[pair[0]] - forces[pair[1]]).max() < 1e-9}
    # As long as nothing slips or lifts off, pushing alone makes no difference but in rounding.
    assert all(a.split(",")[0] == b.split(",")[0] for a, b in same)
