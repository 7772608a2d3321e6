"""Solver and sensor fail for a while in closed loop: what stands in, and that the loop survives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plant import Cell
from qpmpc.backends import RawSolution, _registry
from qpmpc.backends.daqp import DaqpBackend
from qpmpc.fallback import Source
from qpmpc.status import Status

SOURCES = [str(source) for source in Source]
BEAT = range(420, 700)
"""Cycles in which the heart moves fast."""
ON_ITS_BOUND = "controller.bounds.force.z=[-10.2, -0.5]"
"""So that plans differ from the closed form."""


class Flaky(DaqpBackend):
    """DAQP that finds nothing in some of its solves."""

    name = "flaky"
    warm_starts = False  # one call a cycle: it is not asked again
    smallest_part = 1000
    fails: range
    status: Status

    def __init__(self, qp, limits):
        self._solves = None
        super().__init__(qp, limits)
        self._solves = 0

    def solve(self, q, l, u):  # noqa: E741
        raw = super().solve(q, l, u)
        if self._solves is None:
            return raw
        self._solves += 1
        if self._solves - 1 in self.fails:
            nothing = np.full(q.size, np.nan)
            return RawSolution(self.status, nothing, np.full(l.size, np.nan), 3)
        return raw


@pytest.fixture
def failing(monkeypatch, simulate):
    """Run `paper` with a solver that fails in a stretch of cycles."""

    def run(fails, status=Status.FAILED, settings=(), duration=0.7):
        kind = type("Flaky", (Flaky,), {"fails": fails, "status": status})
        monkeypatch.setitem(_registry._table, "flaky", kind)
        return simulate("paper", *settings, still=False, backend="flaky", duration=duration)

    return run


@pytest.fixture(scope="module")
def sound(simulate):
    """The same path as what fails here, which is no compiled one: equal to the last bit."""
    settings = (ON_ITS_BOUND, "controller.solver.compiled=off")
    return simulate("paper", *settings, still=False, duration=0.7)


def error(run, cycles) -> float:
    log = run.log
    return float(np.abs(log.force - log.setpoint)[cycles.start : cycles.stop].max())


def sources(run) -> list[str]:
    return [SOURCES[code] for code in run.log.source]


def check_finite(run, *known_unknown) -> None:
    """Everything is a number but the residual of an answer that there is not."""
    table = run.log.table()
    for name in table.column_names:
        values = table[name].to_numpy()
        if values.dtype.kind == "f" and not name.startswith(("residual", *known_unknown)):
            assert np.isfinite(values).all(), name


@pytest.mark.parametrize(
    "status", [Status.FAILED, Status.INFEASIBLE, Status.UNBOUNDED, Status.ITERATION_LIMIT]
)
def test_the_last_plan_goes_on_for_as_long_as_it_lasts(status, failing):
    fails = range(30, 37)
    run = failing(fails, status, duration=0.05)
    told = Status.FAILED if status is Status.ITERATION_LIMIT else status  # its answer was NaN
    assert run.summary["status"] == {"solved": 43, str(told): 7}
    assert run.summary["source"] == {"solution": 43, "plan": 7, "analytic": 0, "hold": 0}
    assert [k for k, s in enumerate(sources(run)) if s == "plan"] == list(fails)
    check_finite(run)


def test_without_any_plan_yet_the_closed_form_stands_in(failing):
    run = failing(range(5), duration=0.02)
    assert sources(run) == ["analytic"] * 5 + ["solution"] * 15
    check_finite(run)


def test_after_the_plan_the_closed_form_controls_and_then_the_solver_again(failing, sound):
    fails = range(450, 490)
    run = failing(fails, settings=[ON_ITS_BOUND])
    assert run.summary["status"] == {"solved": 660, "failed": 40}
    assert run.summary["source"] == {"solution": 660, "plan": 7, "analytic": 33, "hold": 0}
    assert sources(run)[449:458] == ["solution"] + ["plan"] * 7 + ["analytic"]
    assert sources(run)[489:491] == ["analytic", "solution"]
    check_finite(run)
    # Until it fails the run is that of a solver that never does.
    assert np.array_equal(run.log.command[:450], sound.log.command[:450])
    # 7 ms without control cost some of what a held tool would feel, and 50 ms later nothing more.
    assert error(run, BEAT) < 1.0
    assert error(run, range(540, 700)) < 2 * error(sound, range(540, 700)) + 0.02
    assert np.abs(run.log.command).max() <= 20.0


def test_a_solver_that_never_answers_leaves_the_clipped_closed_form(failing, simulate):
    run = failing(range(10**6), duration=0.5)
    closed = simulate("paper", still=False, backend="analytic", duration=0.5)
    assert run.summary["source"] == {"solution": 0, "plan": 0, "analytic": 500, "hold": 0}
    np.testing.assert_allclose(run.log.command[:400], closed.log.command[:400], atol=1e-6)
    assert error(run, range(500)) < 0.3


def test_every_other_answer_is_enough(failing, sound):
    class EverySecond:
        def __contains__(self, k):
            return k % 2 == 1

    run = failing(EverySecond(), settings=[ON_ITS_BOUND])
    assert run.summary["source"] == {"solution": 350, "plan": 350, "analytic": 0, "hold": 0}
    assert error(run, range(700)) < 2 * error(sound, range(700)) + 0.05
    check_finite(run)


@pytest.fixture
def blind(monkeypatch, simulate):
    """Run `paper` with a force sensor that tells nothing in a stretch of cycles."""

    def run(lost, *settings, duration=0.7):
        class Blind(Cell):
            def measure(self):
                seen = super().measure()
                if round(seen.time / self.period) in lost:
                    return replace(seen, force=np.full(3, np.nan))
                return seen

        monkeypatch.setattr("scenarios.experiment.Cell", Blind)
        return simulate("paper", ON_ITS_BOUND, *settings, still=False, duration=duration)

    return run


def test_without_a_force_the_estimate_goes_on_with_the_velocity(blind, sound):
    lost = range(450, 465)
    run, held = blind(lost), blind(lost, "controller.observer.patience=0.0")
    assert run.summary["source"] == {"solution": 700, "plan": 0, "analytic": 0, "hold": 0}
    assert np.isnan(run.log.force_measured[lost]).all()
    check_finite(run, "force_measured")
    assert error(run, range(450, 480)) < 0.3 * error(held, range(450, 480))
    assert error(run, range(560, 700)) < 1.3 * error(sound, range(560, 700)) + 0.02


def test_patience_ends_after_its_time(blind):
    run = blind(range(450, 530), "controller.observer.patience=0.03")
    assert sources(run)[449:531] == (
        ["solution"] * 31 + ["plan"] * 7 + ["hold"] * 43 + ["solution"]
    )


def test_without_patience_the_plan_goes_on_and_is_then_held(blind, sound):
    lost = range(450, 465)
    run = blind(lost, "controller.observer.patience=0.0")
    assert run.summary["status"] == {"solved": 685, "failed": 15}
    assert run.summary["source"] == {"solution": 685, "plan": 7, "analytic": 0, "hold": 8}
    assert sources(run)[449:466] == ["solution"] + ["plan"] * 7 + ["hold"] * 8 + ["solution"]
    assert np.isnan(run.log.force_measured[lost]).all()
    check_finite(run, "force_measured")
    assert (run.log.command[457:465] == run.log.command[456]).all()
    assert error(run, BEAT) < 2.0
    assert error(run, range(560, 700)) < 2 * error(sound, range(560, 700)) + 0.05


def test_a_sensor_that_is_lost_from_the_start_moves_nothing(blind):
    run = blind(range(50), duration=0.05)
    assert run.summary["source"] == {"solution": 0, "plan": 0, "analytic": 0, "hold": 50}
    assert not run.log.command.any()
    assert error(run, range(50)) < 0.1
