"""Tails, the percentile picture, HDR histograms as the reference implementation reads them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hdrh.histogram import HdrHistogram
from hdrh.log import HistogramLogReader
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.hdr import Histogram, histogram_log
from bench.percentiles import LEVELS, Curve, draw_percentiles, tail

values = st.lists(st.integers(0, 2**40), min_size=1, max_size=200)


# ---- tails


@settings(deadline=None)
@given(found=st.lists(st.integers(0, 10**6), min_size=1, max_size=400))
def test_a_tail_is_the_least_value_with_that_share_at_or_below_it(found: list[int]) -> None:
    told = tail(found)
    for name, level in LEVELS.items():
        enough = [v for v in found if 100 * sum(w <= v for w in found) >= level * len(found)]
        assert told[name] == min(enough)
    assert told["max"] == max(found)


def test_one_slow_cycle_in_five_hundred_is_beyond_p99_and_within_p999() -> None:
    told = tail(np.where(np.arange(60_000) % 500 == 7, 2000.0, 100.0))
    assert [told[q] for q in ("p50", "p99", "p999", "p9999", "max")] == [100, 100, 2000, 2000, 2000]


def test_without_values_there_is_no_tail() -> None:
    assert tail([]) == dict.fromkeys(("p50", "p99", "p999", "p9999", "max"))


# ---- the picture


def test_the_picture_is_drawn_whatever_there_is(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    cases = [
        [],
        [Curve("nothing", np.zeros(0))],
        [Curve("one", np.array([3.0]))],
        [Curve("zeros", np.zeros(10))],
        [Curve("floor", rng.exponential(size=3000), floor=True)]
        + [Curve(f"b{i}", rng.exponential(size=3000) + i) for i in range(8)],
    ]
    for i, curves in enumerate(cases):
        path = tmp_path / f"{i}.png"
        draw_percentiles(curves, path, what="time [us]", title="t", limit=1000.0)
        assert path.read_bytes().startswith(b"\x89PNG")


# ---- histograms


@settings(deadline=None, max_examples=60)
@given(found=values)
def test_the_reference_implementation_reads_what_is_encoded(found: list[int]) -> None:
    read = HdrHistogram.decode(Histogram.of(found).encode())
    own = (
        HdrHistogram(1, max(2, *found), 3)
        if len(found) > 1
        else HdrHistogram(1, max(2, found[0]), 3)
    )
    for value in found:
        own.record_value(value)
    assert read.get_total_count() == len(found)
    assert read.get_max_value() == own.get_max_value()
    for level in (0.0, 50.0, 90.0, 99.0, 99.9, 100.0):
        assert read.get_value_at_percentile(level) == own.get_value_at_percentile(level)


@settings(deadline=None, max_examples=60)
@given(found=values)
def test_every_line_of_the_table_is_true(found: list[int]) -> None:
    """Counts up to a value are exact; the value is the bucket's, three digits are right."""
    lines = Histogram.of(found).percentile_table().splitlines()
    assert lines[0].split() == ["Value", "Percentile", "TotalCount", "1/(1-Percentile)"]
    rows = [line.split() for line in lines[2:] if not line.startswith("#")]
    ordered = sorted(found)
    for row in rows:
        top, level, count = float(row[0]), float(row[1]), int(row[2])
        assert count == sum(value <= top for value in found)
        assert count >= level * len(found) - 1e-6
        right = ordered[max(0, int(np.ceil(level * len(found) - 1e-9)) - 1)]
        assert right <= top <= right * 1.001 + 1
    assert float(rows[-1][1]) == 1.0
    assert int(rows[-1][2]) == len(found)


def test_a_log_of_several_is_read_by_its_tags(tmp_path: Path) -> None:
    told = {"empty": Histogram.of([1, 2, 3]), "qpsolvers: a,b": Histogram.of([10_000_000])}
    text = histogram_log(told, start=1700000000.5, seconds=60.0, comments=["what it is"])
    path = tmp_path / "response.hlog"
    path.write_text(text, encoding="utf-8")
    reader = HistogramLogReader(str(path), HdrHistogram(1, 10**9, 3))
    found = {}
    while (histogram := reader.get_next_interval_histogram()) is not None:
        found[histogram.get_tag()] = histogram
    assert set(found) == {"empty", "qpsolvers:-a-b"}
    assert found["empty"].get_total_count() == 3
    assert found["qpsolvers:-a-b"].get_value_at_percentile(100) == pytest.approx(1e7, rel=1e-3)


@pytest.mark.parametrize("wrong", [[], [-1, 3]])
def test_what_cannot_be_counted_is_refused(wrong: list[int]) -> None:
    with pytest.raises(ValueError, match="needs values"):
        Histogram.of(wrong)
