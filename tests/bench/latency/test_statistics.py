"""Percentiles by their definition, windows, the clock's cost, the picture."""

from __future__ import annotations

import math

import matplotlib.image
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bench.latency import figure
from bench.latency.figure import draw_latency
from bench.latency.statistics import percentiles, representative, timer_cost
from bench.percentiles import LEVELS, steps

TIMES = arrays(np.int64, st.tuples(st.integers(1, 5), st.integers(1, 60)),
               elements=st.integers(0, 10**7))  # fmt: skip


@given(times=TIMES, named=st.sampled_from(list(LEVELS.items())))
def test_a_percentile_is_the_smallest_sample_that_the_share_does_not_exceed(times, named):
    name, level = named
    value = round(1e3 * getattr(percentiles(times), name))
    samples, share = times.ravel(), level / 100.0
    assert value in samples
    assert np.mean(samples <= value) >= share - 1e-12
    assert np.mean(samples < value) < share


@given(times=TIMES)
def test_floors_are_over_the_least_time_of_each_instance(times):
    found = percentiles(times)
    floor = times.min(axis=0)
    assert found.floor_max == floor.max() / 1e3
    assert found.max == times.max() / 1e3
    assert found.floor_p50 == np.sort(floor)[math.ceil(floor.size / 2) - 1] / 1e3
    assert found.floor_p50 <= found.floor_p999 <= found.floor_max <= found.max
    assert found.p50 <= found.p99 <= found.p999 <= found.p9999 <= found.max


@given(
    acting=arrays(np.bool_, st.integers(1, 80)),
    part=st.floats(0.01, 1.0),
)
def test_a_window_is_as_hard_as_the_whole_as_far_as_one_is(acting, part):
    instances = max(1, int(part * acting.size))
    start = representative(acting, instances)
    assert 0 <= start <= acting.size - instances
    shares = [
        acting[i : i + instances].mean() for i in range(acting.size - instances + 1)
    ]  # by brute force
    least = min(abs(share - acting.mean()) for share in shares)
    assert abs(shares[start] - acting.mean()) == pytest.approx(least)


def test_the_cost_of_the_clock_is_told():
    ticks = iter(np.cumsum([7, 40] * 99 + [7, 25] + [7, 40] * 100).tolist())
    assert timer_cost(lambda: next(ticks), readings=200) == (25.0, 40.0)


def test_a_curve_goes_through_its_percentiles():
    ordered = np.sort(np.random.default_rng(2).lognormal(10, 1, 20_000).astype(np.int64))
    x, y = steps(ordered / 1e3)
    assert x[0] == pytest.approx(1.0, rel=1e-4)
    assert x[-1] == 40_000  # half a step before the end
    assert y[-1] == ordered[-1] / 1e3
    assert (np.diff(x) > 0).all()
    assert (np.diff(y) >= 0).all()
    assert x.size < 2_300
    for share in (0.9, 0.99, 0.999):
        expected = np.percentile(ordered, 100 * share, method="inverted_cdf") / 1e3
        assert np.interp(1 / (1 - share), x, y) == pytest.approx(expected, rel=0.05)


@pytest.fixture
def axes(monkeypatch):
    """The panels of the last picture."""
    kept = []
    save = figure.Figure.savefig

    def savefig(self, path):
        kept[:] = self.axes
        save(self, path)

    monkeypatch.setattr(figure.Figure, "savefig", savefig)
    return kept


def test_the_picture_has_a_panel_a_mode_and_the_deadline(axes, tmp_path):
    rng = np.random.default_rng(1)
    one, two = (rng.integers(10_000, 90_000, (3, 500)) for _ in range(2))
    curves = {"hot": {"daqp": one, "osqp": 2 * two}, "paced": {"daqp": one + 50_000}}
    draw_latency(curves, "a title", 1000.0, tmp_path / "p.png")
    assert matplotlib.image.imread(tmp_path / "p.png").shape[2] == 4
    hot, paced = axes
    assert [line.get_label() for line in hot.lines[:-1]] == ["daqp", "osqp"]
    assert [line.get_label() for line in paced.lines[:-1]] == ["daqp"]
    assert hot.lines[0].get_color() == paced.lines[0].get_color()
    for panel in axes:
        assert panel.lines[-1].get_ydata()[0] == 1000.0
        assert panel.get_xscale() == panel.get_yscale() == "log"
    assert hot.lines[1].get_ydata().max() == (2 * two).max() / 1e3


def test_too_many_curves_are_the_fastest_and_are_said_to_be(axes, tmp_path):
    curves = {f"b{i}": np.full((3, 10), 1000 * (30 - i)) for i in range(20)}
    draw_latency({"hot": curves, "paced": {}}, "many", 1000.0, tmp_path / "p.png")
    (panel,) = axes
    names = [line.get_label() for line in panel.lines[:-1]]
    assert names == [f"b{i}" for i in range(19, 7, -1)]
    assert "the 12 fastest of 20" in panel.get_title()
    looks = {(line.get_color(), line.get_linestyle()) for line in panel.lines[:-1]}
    assert len(looks) == 12
