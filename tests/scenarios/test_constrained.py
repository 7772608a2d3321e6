"""Where bounds matter: the approach from free motion, a step and a cap on force, in 1 s."""

from __future__ import annotations

import numpy as np
import pytest

from qpmpc.backends import available
from scenarios import load_scenario

SHORT = (
    "setpoint.steps=[{time=0.4, z=-12.0}]",
    "bounds_steps=[{time=0.65, ramp=0.05, force={z=[-9.0, inf]}},"
    " {time=0.85, ramp=0.05, force={z=[-14.0, inf]}}]",
)
"""The scenario's own events, closer together; the first beat follows the step."""
CAP = slice(700, 850)
INSTALLED = {backend.name for backend in available() if backend.version}
SOLVERS = [name for name in ("daqp", "osqp", "clarabel", "piqp", "casadi") if name in INSTALLED]


@pytest.fixture(scope="module")
def runs(simulate):
    """One run a backend, made when it is first asked for."""
    made = {}

    def get(backend):
        if backend not in made:
            made[backend] = simulate(
                "constrained", *SHORT, still=False, duration=1.0, backend=backend
            )
        return made[backend]

    return get


def test_the_short_variant_has_all_events_of_the_scenario():
    shipped, short = (load_scenario("constrained", settings=s) for s in ((), SHORT))
    assert [step.force for step in short.bounds_steps] == [s.force for s in shipped.bounds_steps]
    assert [step.ramp for step in short.bounds_steps] == [s.ramp for s in shipped.bounds_steps]
    assert [step.z for step in short.setpoint.steps] == [s.z for s in shipped.setpoint.steps]
    assert short.cell == shipped.cell
    assert short.cell.contact.unilateral
    assert short.cell.contact.gap == 0.01


def test_the_closed_form_breaks_both_caps_clearly(runs):
    found = runs("analytic").summary["violations"]
    assert found["velocity"]["worst"] > 0.2  # three times what is allowed, on the way to contact
    assert found["velocity"]["count"] > 50
    assert found["force"]["worst"] > 2.5  # it goes on to press with 12 N
    assert found["force"]["count"] > 150
    assert found["command"] == {"count": 0, "worst": 0.0, "integral": 0.0}  # that much it clips


@pytest.mark.parametrize("backend", SOLVERS)
def test_a_solver_holds_both(backend, runs):
    found, log = runs(backend).summary["violations"], runs(backend).log
    assert found["velocity"]["worst"] <= 0.01 * 0.1
    assert found["force"]["worst"] <= 0.05
    assert found["command"] == {"count": 0, "worst": 0.0, "integral": 0.0}
    # Not by keeping away: the bounds are reached.
    assert np.abs(log.tool_velocity).max() > 0.0999
    assert -9.05 < log.force[CAP, 2].min() < np.median(log.force[CAP, 2]) < -8.9


@pytest.mark.parametrize("backend", SOLVERS)
def test_every_qp_is_solved(backend, runs):
    summary = runs(backend).summary
    assert summary["status"] == {"solved": 1000}
    assert summary["source"] == {"solution": 1000, "plan": 0, "analytic": 0, "hold": 0}


@pytest.mark.parametrize("backend", ["analytic", *SOLVERS])
def test_contact_is_made_once_and_not_lost(backend, runs):
    log = runs(backend).log
    turns = np.flatnonzero(np.diff(log.touching.astype(int)))
    assert not log.touching[0]
    assert len(turns) == 1
    assert (log.force[: turns[0] + 1] == 0.0).all()
    assert (log.force[turns[0] + 1 :, 2] < 0.0).all()


@pytest.mark.parametrize("backend", SOLVERS)
def test_within_the_bounds_the_setpoint_is_kept(backend, runs):
    log = runs(backend).log
    for calm, z in ((slice(220, 380), -2.0), (slice(550, 630), -12.0), (slice(970, 1000), -12.0)):
        assert np.abs(log.force[calm, 2] - z).max() < 0.3


def test_the_approach_takes_as_long_as_the_cap_on_velocity_makes_it(runs):
    """10 mm at 0.1 m/s; without the cap it is over in a third of that."""
    first = {name: int(runs(name).log.touching.argmax()) for name in ("analytic", "daqp")}
    assert 100 <= first["daqp"] <= 120
    assert first["analytic"] < 50


@pytest.mark.parametrize("backend", SOLVERS[1:])
def test_all_solvers_make_the_same_run(backend, runs):
    """They answer the same QPs; the plant sticks and slips, so it is not the same to the bit."""
    log, other = runs("daqp").log, runs(backend).log
    assert np.abs(other.command[:100] - log.command[:100]).max() < 1e-4
    assert np.sqrt(np.mean((other.force - log.force) ** 2, axis=0)).max() < 0.05
