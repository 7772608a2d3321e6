"""The study of OSQP: its forms are the same problem, and what it prints is what was measured."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from typing import Any

import numpy as np
import osqp
import pytest

from bench import osqp_study
from bench.instances import BoundRows, Instances, instances
from bench.osqp_forms import Form, condensed, staged
from bench.osqp_study import Case, Row, busiest, main, raw, table, through
from bench.stream import record
from qpmpc.backends import backend_class
from scenarios import ScenarioError, load_scenario

TIGHT = ("controller.bounds.command=[-3,3]", "controller.bounds.force.z=[-10.5,-9.5]")
CYCLES = 12


@pytest.fixture(scope="module")
def data() -> Instances:
    scenario = load_scenario("paper-1d", top={"duration": 0.8}, settings=TIGHT)
    stream = record(scenario, report=lambda *_: None, stop=lambda: False)
    assert stream is not None
    return instances(stream, 6)


@pytest.fixture(scope="module")
def some(data: Instances) -> slice:
    window = busiest(data, CYCLES)
    assert data.active[window].any(axis=1).mean() > 0.3
    return window


def solved(form: Form) -> list[tuple[np.ndarray, np.ndarray]]:
    """Solve every cycle cold, far beyond what the study asks for."""
    found = []
    for k in range(len(form.q)):
        solver = osqp.OSQP()
        solver.setup(
            form.P, form.q[k], form.A, form.l[k], form.u[k],
            verbose=False, eps_abs=1e-9, eps_rel=1e-9, max_iter=200_000, adaptive_rho_interval=50,
        )  # fmt: skip
        answer = solver.solve(raise_error=False)
        assert answer.info.status == "solved"
        found.append((answer.x, answer.y))
    return found


@pytest.mark.parametrize(
    ("make", "error"),
    [
        (condensed, 1e-5),
        (lambda d, k: condensed(d, k, "commands"), 1e-5),
        (lambda d, k: condensed(d, k, "increments", "each"), 1e-5),
        (staged, 1e-3),
    ],
    ids=["whitened", "commands", "increments", "staged"],
)
def test_every_form_has_the_certified_answer(
    make: Any, error: float, data: Instances, some: slice
) -> None:
    form = make(data, some)
    first = [form.first(k, x) for k, (x, _) in enumerate(solved(form))]
    np.testing.assert_allclose(first, data.decision[some, :1], atol=error)


@pytest.mark.parametrize("make", [condensed, staged])
def test_shifted_is_the_plan_one_step_later(make: Any, data: Instances, some: slice) -> None:
    """Where the model is right and nothing new is measured, it begins the next plan."""
    form = make(data, slice(some.start, some.start + 1))
    x, y = solved(form)[0]
    ahead, _ = form.shift(x, y)
    plan = data.decision[some.start]
    if make is condensed:
        np.testing.assert_allclose(form.first(0, ahead), plan[1:2], atol=1e-3)
    else:
        moved = form.first(0, ahead) - form.first(0, x)
        np.testing.assert_allclose(moved, plan[1:2], atol=1e-3)


def test_soft_rows_taken_as_hard_have_no_slack(data: Instances, some: slice) -> None:
    n = data.q.shape[1]
    assert condensed(data, some, slack=False).q.shape == (CYCLES, n)
    assert condensed(data, some).q.shape == (CYCLES, n + np.isfinite(data.linear).sum())


def test_staged_refuses_what_it_does_not_know(data: Instances, some: slice) -> None:
    rate = BoundRows(
        "rate", "rate", np.zeros((0, 8)), *np.full((2, 6, 1), 1.0), np.inf, 0.0,
        np.ones((6, 1), dtype=np.bool_),
    )  # fmt: skip
    for other in (
        replace(data, bounds=(*data.bounds, rate)),
        replace(data, control_horizon=3),
        replace(data, decision_form="absolute"),
    ):
        with pytest.raises(ScenarioError, match="staged form"):
            staged(other, some)


def test_busiest_window_holds_the_most_active_cycles(data: Instances) -> None:
    active = data.active.any(axis=1)
    window = busiest(data, 50)
    most = max(active[k : k + 50].sum() for k in range(data.cycles - 49))
    assert window.stop - window.start == 50
    assert active[window].sum() == most
    assert busiest(data, 10**6) == slice(0, data.cycles)


def test_a_row_tells_what_was_measured(data: Instances, some: slice) -> None:
    case = Case("tight", data, some)
    wrong = (np.array([1e-6, 3e-6]), np.array([5, 7]), np.array([0, 1]))

    def run() -> Any:
        times = (
            np.resize(wrong[0], CYCLES),
            np.resize(wrong[1], CYCLES),
            np.resize(wrong[2], CYCLES),
        )
        return *times, data.decision[some, :1] + 0.25

    row = case.row("ways", "made up", run, 2)
    assert (row.case, row.horizon, row.variant) == ("tight", 6, "made up")
    np.testing.assert_allclose([row.p50, row.p999], [2.0, 3.0], rtol=1e-12)
    np.testing.assert_allclose([row.iterations, row.stopped, row.error], [6.0, 0.5, 0.25])


def test_a_limit_of_iterations_counts_as_stopped(data: Instances, some: slice) -> None:
    form = condensed(data, some)
    _, iterations, stopped, _ = raw(form, max_iter=5, check_termination=0, time_limit=1e3)()
    assert (iterations == 5).all()
    assert stopped.all()
    _, _, stopped, _ = raw(form, max_iter=100_000, time_limit=1e3)()
    assert not stopped.any()


@pytest.mark.parametrize("start", ["last answer", "shifted", "cold"])
def test_starts_change_the_way_and_not_the_answer(start: Any, data: Instances, some: slice) -> None:
    form = condensed(data, some)
    _, _, _, first = raw(
        form, start=start, eps_abs=1e-8, eps_rel=1e-8, max_iter=100_000, time_limit=1e3
    )()
    np.testing.assert_allclose(first, data.decision[some, :1], atol=1e-4)


@pytest.mark.parametrize("name", ["osqp", "daqp"])
def test_backends_are_run_through_the_library(name: str, data: Instances, some: slice) -> None:
    times, _, _, first = through(Case("tight", data, some), backend_class(name))()
    assert (times > 0).all()
    np.testing.assert_allclose(first, data.decision[some, :1], atol=1e-7)


def test_table_puts_cases_side_by_side() -> None:
    def row(case: str, variant: str, stopped: float = 0.0) -> Row:
        return Row("ways", case, 8, variant, 10.4, 20.0, 30.0, 5.0, stopped, 1e-6)

    rows = [row("a", "one"), row("a", "two", 0.25), row("b", "one")]
    assert table(rows, "ways").splitlines() == [
        "| | a, N = 8 | b, N = 8 |",
        "|---|---|---|",
        "| one | 10 / 20 / 30; 5; 1e-06 | 10 / 20 / 30; 5; 1e-06 |",
        "| two | 10 / 20 / 30; 5; 1e-06, 25% unsolved |  |",
    ]
    assert "one" not in table(rows, "horizons")


def test_whole_study_on_little(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(osqp_study, "_CASES", {"tight": ("paper-1d", 0.15, TIGHT)})
    assert main(["--cycles", "20", "--passes", "1", "--horizons", "4", "--json"]) == 0
    said = capsys.readouterr()
    rows = json.loads(said.out)["rows"]
    assert {row["part"] for row in rows} == {"ways", "horizons"}
    ours = [row for row in rows if "backend `osqp`" in row["variant"]]
    assert [row["horizon"] for row in ours] == [8, 4]
    assert all(row["error"] < 1e-6 and row["stopped"] == 0 for row in ours)
    assert "recording paper-1d" in said.err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--cycles", "0"], "must be a positive whole number, got '0'"),
        (["--cycles", "1e3"], "must be a positive whole number, got '1e3'"),
        (["--horizons", "8,x"], "must be a positive whole number, got 'x'"),
        (["--passes=-1"], "must be a positive whole number, got '-1'"),
        (["--what"], "unrecognized arguments: --what"),
    ],
)
def test_bad_arguments_end_with_two(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(arguments)
    assert ended.value.code == 2
    told = capsys.readouterr()
    assert said in told.err
    assert not told.out


def test_runs_as_a_program() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "bench.osqp_study", "--help"],
        capture_output=True, text=True, timeout=120, check=False, env=os.environ,
    )  # fmt: skip
    assert done.returncode == 0
    assert "--horizons" in done.stdout
