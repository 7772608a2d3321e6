"""The error of a command against the certified answer of the same QP."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from bench.compare import compare
from bench.reference import CERTIFIED, CommandError
from qpmpc import Solver
from qpmpc.backends import RawSolution, _registry, available
from qpmpc.backends.daqp import DaqpBackend
from qpmpc.config import BoundsConfig, ControllerConfig, JointsConfig, ObserverConfig
from qpmpc.force_control import ForceController
from qpmpc.status import Status
from scenarios import load_scenario, run_experiment

AXES = ("x", "y", "z")
TIGHT = BoundsConfig(command=(-3.0, 3.0), force=(-10.5, 2.5), velocity=(-0.05, 0.05))
EXACT = [
    name for name in ("daqp", "osqp", "clarabel", "piqp", "casadi")
    if name in {backend.name for backend in available() if backend.version}
]  # fmt: skip
LOOSE = ("controller.bounds.command=[-1e4, 1e4]",)


def measurements(cycles):
    """Forces about a setpoint of 1, 2, -10 N, so far off that bounds are active."""
    rng = np.random.default_rng(4)
    return np.array([1.0, 2.0, -10.0]) + rng.normal(0.0, 1.0, (cycles, 3))


def judged(controller, cycles, change=lambda k, step: step) -> CommandError:
    error = CommandError(controller, cycles)
    preview = np.tile([1.0, 2.0, -10.0], (9, 1))
    for k, force in enumerate(measurements(cycles)):
        error(change(k, controller.step(force, np.zeros(3), preview)))
    return error


@pytest.mark.parametrize("backend", EXACT)
def test_an_exact_backend_has_no_error(backend):
    controller = ForceController(ControllerConfig(bounds=TIGHT), AXES, 1e-3, backend)
    found = judged(controller, 60).errors
    assert found.shape == (60, 3)
    assert found.max() < 1e-5


def test_the_closed_form_differs_where_bounds_act_and_only_there():
    taken = ObserverConfig(force_gate=np.inf)  # forces that jump are to be believed here
    loose, tight = (
        judged(
            ForceController(
                ControllerConfig(bounds=bounds, observer=taken), AXES, 1e-3, "analytic"
            ),
            30,
        ).errors
        for bounds in (BoundsConfig(command=(-1e5, 1e5)), TIGHT)
    )
    assert loose.max() < 1e-8
    assert tight.max() > 0.1


def test_the_error_is_how_far_the_applied_command_is_off():
    controller = ForceController(ControllerConfig(bounds=TIGHT), AXES, 1e-3, "daqp")
    off = np.array([0.0, 0.25, -0.5])

    def change(k, step):
        return replace(step, command=step.command + off * (k == 7))

    error = CommandError(controller, 10)
    preview = np.tile([1.0, 2.0, -10.0], (9, 1))
    for k, force in enumerate(measurements(10)):
        step = change(k, controller.step(force, np.zeros(3), preview))
        controller.general.command[:] = step.command  # what was applied is what the next builds on
        error(step)
    expected = np.zeros((10, 3))
    expected[7] = np.abs(off)
    np.testing.assert_allclose(error.errors, expected, atol=1e-8)


def test_the_rows_of_joints_are_those_of_the_cycle():
    """Where the maps change in every cycle, the reference has to follow them."""
    rng = np.random.default_rng(1)

    class Joints:
        speed_limit, torque_limit = np.full(6, 1.0), np.full(6, 100.0)
        speed_offset, torque_offset = np.zeros(6), np.zeros(6)

        def __init__(self):
            self.speed_gain, self.command_gain, self.velocity_gain, self.force_gain = rng.normal(
                5.0, 4.0, (4, 6, 3)
            )

    bounds = BoundsConfig(joints=JointsConfig(speed=0.05, torque=0.2))
    controller = ForceController(
        ControllerConfig(bounds=bounds), AXES, 1e-3, "daqp", joints=Joints()
    )
    error, preview = CommandError(controller, 40), np.tile([1.0, 2.0, -10.0], (9, 1))
    free = ForceController(ControllerConfig(bounds=BoundsConfig()), AXES, 1e-3, "daqp")
    largest = 0.0
    for force in measurements(40):
        controller.view(Joints())
        step = controller.step(force, np.zeros(3), preview)
        error(step)
        loose = free.step(force, np.zeros(3), preview)
        largest = max(largest, np.abs(step.command - loose.command).max())
    assert largest > 1.0  # the bounds act
    known = error.errors[np.isfinite(error.errors).all(axis=1)]
    assert len(known) > 30
    assert known.max() < 1e-5


def test_a_cycle_whose_reference_is_not_certified_has_none(monkeypatch):
    controller = ForceController(ControllerConfig(bounds=TIGHT), AXES, 1e-3, "daqp")
    solve, doubtful = Solver.solve, range(0)

    def doubt(self, *vectors):
        answer = solve(self, *vectors)
        if self is not controller.general.solver and turn[0] in doubtful:
            poor = replace(answer.residuals, scaled=2 * CERTIFIED)
            return replace(answer, residuals=poor)
        return answer

    monkeypatch.setattr(Solver, "solve", doubt)
    turn, doubtful = [0], range(4, 6)

    def count(k, step):
        turn[0] = k
        return step

    found = judged(controller, 10, count).errors
    assert np.flatnonzero(np.isnan(found).any(axis=1)).tolist() == [4, 5]


# --- in a comparison -----------------------------------------------------------------------------


class Off(DaqpBackend):
    """DAQP whose first increment is a little off, by less than what makes an answer unusable."""

    name = "off"
    warm_starts = False
    by = 1e-5

    def solve(self, q, l, u):  # noqa: E741
        raw = super().solve(q, l, u)
        x = raw.x.copy()
        x[0] += self.by
        return RawSolution(raw.status, x, raw.y, raw.iterations)


@pytest.fixture
def kept(monkeypatch):
    """Compare backends on `ideal`, with one that is off; return the rows and the experiments."""
    monkeypatch.setitem(_registry._table, "off", Off)

    def run(*backends, settings=LOOSE, duration=0.04, stop=lambda: False):
        scenario = load_scenario("ideal", top={"duration": duration}, settings=settings)
        experiments = {}
        made = compare(
            scenario, backends, bounded=True, report=lambda *_: None, stop=stop,
            keep=experiments.__setitem__,
        )  # fmt: skip
        return {row["backend"]: row for row in made.rows}, experiments

    return run


def test_a_comparison_tells_how_far_a_backend_is_off(kept):
    rows, experiments = kept("daqp", "off")
    scenario = experiments["off"].scenario
    controller = ForceController(scenario.controller, scenario.axes, 1e-3, "daqp")
    by = np.abs(controller.general.solver.scaling.T[:3, 0] * Off.by).max()
    assert by > 1e-6
    assert rows["daqp"]["command_error"] < 1e-9
    assert rows["off"]["command_error"] == pytest.approx(by, rel=1e-3)
    assert rows["off"]["command_error_rms"] == pytest.approx(by / np.sqrt(3), rel=1e-3)
    assert rows["off"]["without_reference"] == 0
    assert rows["off"]["status"] == {str(Status.INACCURATE): 40}


def test_watching_does_not_change_the_run(kept):
    _, experiments = kept("daqp", settings=("controller.bounds.velocity=[-0.001, 0.001]",))
    scenario = experiments["daqp"].scenario
    alone = run_experiment(scenario, report=lambda *_: None, stop=lambda: False)
    for name in ("command", "force", "force_uncompensated", "iterations"):
        assert np.array_equal(getattr(alone.log, name), getattr(experiments["daqp"].log, name))


def test_a_comparison_that_is_stopped_at_once_is_empty(kept):
    rows, experiments = kept("daqp", "off", stop=lambda: True)
    assert (rows, experiments) == ({}, {})


def test_a_row_without_cycles_can_be_written(kept):
    asked = iter([False] + [True] * 10)
    rows, _ = kept("daqp", stop=lambda: next(asked))
    row = rows["daqp"]
    assert row["error"] == "interrupted"
    assert (row["command_error"], row["solve_us"]["p50"], row["without_reference"]) == (
        None,
        None,
        0,
    )
    assert json.loads(json.dumps(row, allow_nan=False)) == row
