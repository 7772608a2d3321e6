"""The harness itself: what is put in must be found, at the right percentile, counted exactly."""

from __future__ import annotations

import time

import numpy as np
import pytest

from bench.latency.judge import Standard
from bench.realtime import SystemClock
from bench.reference import Reference
from bench.stream import Replay
from qpmpc.backends import _registry
from qpmpc.scaling import Scaling

US, MS = 1_000, 1_000_000
CYCLES, EVERY = 1500, 500


def rows(group, backend):
    return {row.mode: row for row in group.rows if row.backend == backend}


def advance(clock):
    def spend(nanoseconds):
        clock.time += nanoseconds

    return spend


# --- a stall of 2 ms every 500 cycles ------------------------------------------------------------


def test_a_stall_is_found_at_its_percentile_hot(stalled):
    row = rows(stalled, "stalling")["hot"]
    step = row.step_us
    assert (row.passes, row.instances, row.cut) == (3, CYCLES, None)
    # 3 of 1500: 99.8 % are usual.
    assert (step.p50, step.p99) == (50.0, 50.0)
    assert (step.p999, step.p9999, step.max) == (2000.0, 2000.0, 2000.0)
    assert (step.floor_p50, step.floor_p999, step.floor_max) == (50.0, 2000.0, 2000.0)
    assert row.misses == 3 * 3
    assert row.missed_in_every_pass == 3
    assert row.response_us.p50 is None
    assert row.pass_p50_us == [50.0] * 3


def test_a_stall_is_not_hidden_by_pacing(stalled):
    row = rows(stalled, "stalling")["paced"]
    assert (row.step_us.p50, row.step_us.p99, row.step_us.p999) == (50.0, 50.0, 2000.0)
    # What was due meanwhile is late: the next one by 1 ms, the one after by 50 us.
    assert row.response_us.p50 == 50.0
    assert row.response_us.max == 2000.0
    assert row.lateness_us.max == 1000.0
    times = stalled.times["stalling", "interpreted", "paced"].of
    for stall in (499, 999):
        response = times["response"][:, stall : stall + 4] / US
        np.testing.assert_array_equal(response, [[2000.0, 1050.0, 100.0, 50.0]] * 3)
    # The last stall has nobody behind it.
    assert row.misses == 3 * (2 + 2 + 1)
    assert row.missed_in_every_pass == 2 + 2 + 1


@pytest.fixture
def stalling_run(make_stream, stalling, clock, run):
    def measured(cycles, every):
        stalling(usual=50 * US, stall=2 * MS, every=every, spend=advance(clock))
        return run(make_stream(cycles), "stalling", paced=False)

    return measured


@pytest.mark.parametrize(
    ("every", "values"),
    [
        (20, [50.0, 2000.0, 2000.0, 2000.0, 2000.0]),
        (100, [50.0, 50.0, 2000.0, 2000.0, 2000.0]),  # 1 % is not beyond p99
        (399, [50.0, 50.0, 2000.0, 2000.0, 2000.0]),
    ],
)
def test_stalls_are_found_where_they_are(every, values, stalling_run):
    row = rows(stalling_run(400, every), "stalling")["hot"]
    assert [getattr(row.step_us, p) for p in ("p50", "p99", "p999", "p9999", "max")] == values
    assert row.misses == 3 * (400 // every)


def test_a_stall_of_one_pass_is_not_the_backends_own(make_stream, stalling, clock, run):
    """The least time of each instance takes out what hit one pass only."""
    calls = [0]

    def spend(nanoseconds):
        calls[0] += 1
        # Twice 20 to see what it costs, 300 to judge, 200 to warm up, 150 of the first pass.
        clock.time += 2 * MS if calls[0] == 40 + 300 + 200 + 150 else 50 * US

    stalling(spend=spend)
    group = run(make_stream(300), "stalling", paced=False)
    row = rows(group, "stalling")["hot"]
    assert group.times["stalling", "interpreted", "hot"].of["step"][0, 149] == 2 * MS
    assert (row.misses, row.missed_in_every_pass) == (1, 0)
    assert (row.step_us.max, row.step_us.floor_max) == (2000.0, 50.0)


def test_a_stall_is_found_by_the_real_clock(make_stream, stalling, run):
    """The same once more with time that passes; the machine's own stalls come on top."""

    def spend(nanoseconds):
        end = time.monotonic_ns() + nanoseconds
        while time.monotonic_ns() < end:
            pass

    stalling(usual=0, stall=2 * MS, every=200, spend=spend)
    group = run(make_stream(500), "stalling", clock=SystemClock())
    for mode, stage in (("hot", "step"), ("paced", "response")):
        row = rows(group, "stalling")[mode]
        times = group.times["stalling", "interpreted", mode].of[stage]
        assert (times[:, [199, 399]] >= 2 * MS).all()
        assert row.step_us.floor_p999 >= 2000.0
        assert row.missed_in_every_pass >= 2 + 2 * (mode == "paced")  # and the cycle behind it
        assert row.misses >= 3 * row.missed_in_every_pass
    assert (times[:, [200, 400]] > 1 * MS).all()
    assert rows(group, "stalling")["paced"].lateness_us.p50 > 0


# --- fair to all ---------------------------------------------------------------------------------


def test_passes_are_interleaved_and_the_order_turns(make_stream, stalling, clock, run, monkeypatch):
    kind = stalling(usual=10 * US, spend=advance(clock))
    for name in ("second", "third"):
        twin = type(name, (kind,), {"name": name})
        monkeypatch.setitem(_registry._table, name, twin)
    run(make_stream(60), "stalling", "second", "third", paced=False)
    # Each pass begins twice: warming up, then counted. Before that: probe, twice, and judgement.
    names = ["stalling", "second", "third"]
    turned = [names, names[1:] + names[:1], names[2:] + names[:2]]
    # The closed form takes part and comes first, so that these turn after it.
    order = kind.begun[9:][::2]
    assert len(order) == 9
    assert [order[:3], order[3:6], order[6:]] == [turned[0], turned[0], turned[1]]


def test_who_is_slow_gets_fewer_instances_and_says_so(make_stream, stalling, clock, run):
    stalling(usual=30 * MS, spend=advance(clock))
    stream = make_stream(400)
    group = run(stream, "stalling", budget=9.0)
    row = rows(group, "stalling")["hot"]
    assert row.instances == 100  # 9 s for three passes at 30 ms
    assert row.recorded == 400
    assert "30 ms" in row.cut
    assert "100 of 400" in row.cut
    assert row.step_us.p50 == 30_000.0
    # As hard as the whole, as far as a window can be.
    standard = Standard(stream, 8)
    standard.certify(lambda: False)
    assert row.active_share == pytest.approx(standard.share(slice(None)), abs=0.03)
    assert "paced" not in rows(group, "stalling")
    (left,) = group.left_out
    assert (left.backend, left.mode) == ("stalling", "paced")
    assert "30 ms" in left.reason
    assert rows(group, "analytic")["hot"].instances == 400


def test_fewer_instances_may_be_paced(make_stream, run):
    group = run(make_stream(200), paced_instances=80)
    hot, paced = rows(group, "analytic").values()
    assert (hot.instances, hot.cut) == (200, None)
    assert paced.instances == 80
    assert "80 instances" in paced.cut


def test_the_closed_form_is_always_there_and_is_the_unit(make_stream, stalling, clock, run):
    stalling(usual=50 * US, spend=advance(clock))
    group = run(make_stream(60), "stalling", paced=False)
    assert [row.backend for row in group.rows] == ["analytic", "stalling"]
    # Under a clock that stands still the closed form takes no time: there is no ratio to that.
    assert [row.ratio_to_analytic for row in group.rows] == [None, None]
    group = run(make_stream(60), "daqp", "analytic", paced=False, clock=SystemClock())
    analytic, daqp = group.rows
    assert analytic.ratio_to_analytic == 1.0
    assert daqp.ratio_to_analytic == daqp.step_us.p50 / analytic.step_us.p50


def test_stages_add_up(make_stream, run):
    group = run(make_stream(60), "daqp", "qpsolvers", passes=2, clock=SystemClock())
    for key, times in group.times.items():
        of = times.of
        inside = of["update"] + of["build"] + of["solve"]
        assert (inside <= of["step"]).all(), key
        assert (of["solve"] > 0).all()
        assert (of["prepare"] > 0).all()
        built = np.median(of["build"])
        assert (built > 0) == (key[0] == "qpsolvers")
        if key[2] == "paced":
            np.testing.assert_array_equal(of["response"], of["lateness"] + of["step"])
            assert (of["lateness"] >= 0).all()


# --- right or wrong ------------------------------------------------------------------------------


def test_an_exact_backend_has_no_error_and_the_closed_form_has(make_stream, run):
    stream = make_stream(100, axes=("x", "y", "z"))
    group = run(stream, "daqp", "clarabel", passes=1, paced=False)
    found = {row.backend: row for row in group.rows}
    for name in ("daqp", "clarabel"):
        assert found[name].error < 1e-6
        assert max(found[name].violation.values()) < 1e-6
        assert found[name].status == {"solved": 100}
    assert found["analytic"].error > 1.0
    assert found["analytic"].violation["command"] > 1.0
    assert found["analytic"].status["clipped"] > 0
    assert all(row.without_reference == 0 for row in group.rows)
    assert all(row.active_share == group.facts.active_share > 0.1 for row in group.rows)
    assert group.facts.certified == 100
    assert group.facts.residual < 1e-7


def test_an_error_is_told_in_its_size(make_stream, run, off):
    stream = make_stream(100)
    problem = Replay(stream, 8, "daqp").controller.general.problem
    T = Scaling(problem.qp, list(problem.rows.values())).T
    expected = abs(T.sum(axis=1)[0]) * off.by
    row = rows(run(stream, "off", paced=False), "off")["hot"]
    assert expected > 1e-8
    assert row.error == pytest.approx(expected, rel=1e-3)


def test_cycles_without_a_certified_answer_are_counted(make_stream, run, monkeypatch):
    solve, turn = Reference.__call__, [0]

    def doubtful(self):
        turn[0] += 1
        return None if turn[0] % 10 == 0 else solve(self)

    monkeypatch.setattr(Reference, "__call__", doubtful)
    group = run(make_stream(100), "daqp", paced=False)
    assert group.facts.certified == 90
    assert [row.without_reference for row in group.rows] == [10, 10]
    assert rows(group, "daqp")["hot"].error < 1e-8


def test_who_refuses_is_told_with_the_reason(make_stream, run):
    stream = make_stream(30, settings=("controller.solver.time_limit=1e-3",))
    group = run(stream, "piqp", paced=False)
    assert [row.backend for row in group.rows] == ["analytic"]
    (left,) = group.left_out
    assert (left.backend, left.path, left.horizon, left.axes) == ("piqp", "interpreted", 8, "z")
    assert "limit of time" in left.reason


@pytest.mark.parametrize("least", [10, 60, 130, 200, 350, 500, 650])
def test_a_stop_ends_it_at_once_and_without_a_group(least, make_stream, run):
    asked = [0]

    def stop():
        asked[0] += 1
        return asked[0] > least

    assert run(make_stream(50), stop=stop) is None
    assert asked[0] == least + 1
