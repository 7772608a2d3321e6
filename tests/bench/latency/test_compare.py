"""`pulsempc bench compare`: what changed is told from what the machine does anyway."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.latency.compare import compare_results
from bench.latency.result import LeftOut, Percentiles, Result, Row, Stream, Timer


def row(factor=1.0, spread=0.02, **changes):
    times = Percentiles(*(factor * v for v in (10.0, 20.0, 30.0, 40.0, 50.0, 9.0, 12.0, 14.0)))
    medians = [10.0 * factor * (1 + spread * (i - 1) / 2) for i in range(3)]
    fields = {
        "backend": "daqp", "path": "interpreted", "horizon": 8, "axes": "x,y,z", "mode": "hot",
        "passes": 3, "instances": 50, "recorded": 50, "cut": None, "prepare_us": times,
        "update_us": times, "build_us": times, "solve_us": times, "step_us": times,
        "response_us": Percentiles(), "lateness_us": Percentiles(), "pass_p50_us": medians,
        "error": 1e-12, "without_reference": 0, "violation": {}, "active_share": 0.3,
        "ratio_to_analytic": 1.2, "misses": 0, "missed_in_every_pass": 0, "status": {},
        "source": {},
    }  # fmt: skip
    return Row(**(fields | changes))


def result(*rows, machine=None, cycles=50, **changes):
    return replace(
        Result(
            "latency", 0, 1000.0, True, list(rows),
            [LeftOut("ecos", None, None, None, None, "not installed")],
            [Stream("x,y,z", 8, cycles, cycles, 1e-12, 0.3, {})],
            Timer("monotonic_ns", 40.0, 50.0, "clock_nanosleep"),
            machine or {"cpu": "one", "versions": {"numpy": "2"},
                        "measures": {"scheduler": {"in_force": False}}},
        ),
        **changes,
    )  # fmt: skip


def only(first, second):
    (pair,) = compare_results(result(first), result(second)).pairs
    return pair


def test_ratios_are_those_of_the_second_to_the_first():
    pair = only(row(1.0), row(1.5, spread=0.04))
    assert pair.ratio_p50 == pair.ratio_p999 == pair.ratio_floor_p999 == pytest.approx(1.5)
    assert pair.p50_us == (10.0, 15.0)
    assert pair.noise == pytest.approx(0.04)
    assert pair.verdict == "slower"
    assert only(row(1.5), row(1.0)).verdict == "faster"


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (row(1.0, 0.3), row(1.1, 0.3)),  # the passes overlap
        (row(1.0, 0.0), row(1.02, 0.0)),  # less than two processes differ by
        (row(1.0), row(1.0)),
        (row(1.0), replace(row(1.2), step_us=row(1.0).step_us)),  # the least times did not move
    ],
)
def test_what_noise_explains_is_not_told_apart(first, second):
    assert only(first, second).verdict == "not told apart"
    assert only(second, first).verdict == "not told apart"


@given(a=st.floats(0.1, 10), b=st.floats(0.1, 10), s=st.floats(0, 1), t=st.floats(0, 1))
def test_the_other_way_round_says_the_opposite(a, b, s, t):
    opposite = {"faster": "slower", "slower": "faster", "not told apart": "not told apart"}
    first, second = row(a, s), row(b, t)
    there, back = only(first, second), only(second, first)
    assert opposite[there.verdict] == back.verdict
    assert there.ratio_p50 * back.ratio_p50 == pytest.approx(1.0)
    assert there.noise == back.noise


def test_rows_are_paired_by_all_five_keys():
    others = [
        {"backend": "osqp"}, {"path": "compiled"}, {"horizon": 16}, {"axes": "z"}, {"mode": "paced"}
    ]  # fmt: skip
    first = result(row(), *(row(2.0, **change) for change in others))
    second = result(*(row(3.0, **change) for change in others), row(backend="new"))
    found = compare_results(first, second)
    assert len(found.pairs) == 5
    assert all(pair.ratio_p50 == pytest.approx(1.5) for pair in found.pairs)
    assert found.only_first == [("daqp", "interpreted", 8, "x,y,z", "hot")]
    assert found.only_second == [("new", "interpreted", 8, "x,y,z", "hot")]


def test_what_else_differs_is_told():
    first = result(row())
    assert compare_results(first, first).differences == {}
    other = result(
        row(),
        machine={"cpu": "two", "versions": {"numpy": "3", "daqp": "1"},
                 "measures": {"scheduler": {"in_force": True}}},
        cycles=70, seed=4,
    )  # fmt: skip
    found = compare_results(first, other).differences
    assert found["cpu"] == ("one", "two")
    assert found["numpy"] == ("2", "3")
    assert found["daqp"] == (None, "1")
    assert found["scheduler"] == (False, True)
    assert found["seed"] == (0, 4)
    assert found["cycles of x,y,z, N = 8"] == (50, 70)


# --- on the command line -------------------------------------------------------------------------


@pytest.fixture
def files(tmp_path):
    (tmp_path / "a.json").write_text(result(row(), row(mode="paced")).to_json())
    (tmp_path / "b.json").write_text(
        result(row(2.0), row(backend="osqp"), machine={"cpu": "two"}).to_json()
    )
    (tmp_path / "none.json").write_text(result(row(backend="osqp")).to_json())
    (tmp_path / "empty.json").write_text("")
    (tmp_path / "list.json").write_text("[1, 2]")
    (tmp_path / "deep.json").write_text("[" * 100_000)
    (tmp_path / "other.json").write_text('{"scenario": "paper", "rows": []}')
    (tmp_path / "nan.json").write_text(result(row(error=1e300)).to_json().replace("1e+300", "NaN"))
    (tmp_path / "cut.json").write_text(result(row()).to_json()[:900])
    (tmp_path / "picture.json").write_bytes(b"\x89PNG\xff\xfe")
    (tmp_path / "folder.json").mkdir()


def test_a_comparison_is_a_table_and_says_what_else_differs(files, leave, monkeypatch):
    monkeypatch.setenv("COLUMNS", "100")
    code, out, err = leave("bench", "compare", "a.json", "b.json")
    assert (code, err) == (0, "")
    line = next(line for line in out.splitlines() if line.strip().startswith("daqp"))
    assert line.split() == ["daqp", "8", "xyz", "hot", "10.0", "20.0", "2.00", "2.00", "2.00", "2%",
                            "slower"]  # fmt: skip
    for word in ("not the same: cpu: one in A, two in B", "only in A: N = 8, x,y,z, paced: daqp",
                 "only in B: N = 8, x,y,z, hot: osqp"):  # fmt: skip
        assert word in out


def test_json_is_all_there_is_on_standard_output(files, leave):
    code, out, err = leave("bench", "compare", "a.json", "b.json", "--json")
    assert (code, err) == (0, "")
    told = json.loads(out)
    (pair,) = told["pairs"]
    assert (pair["backend"], pair["ratio_p50"], pair["verdict"]) == ("daqp", 2.0, "slower")
    assert told["differences"]["cpu"] == ["one", "two"]


BAD = {
    "missing": (["a.json", "c.json"], ["c.json", "No such file"]),
    "first missing": (["c.json", "a.json"], ["c.json"]),
    "one file": (["a.json"], ["B.json"]),
    "three files": (["a.json", "b.json", "a.json"], []),
    "empty": (["empty.json", "a.json"], ["empty.json", "not JSON"]),
    "a list": (["list.json", "a.json"], ["list.json", "bench latency"]),
    "nested too deep": (["deep.json", "a.json"], ["deep.json", "not JSON"]),
    "of another verb": (["a.json", "other.json"], ["other.json", "bench latency"]),
    "not a number": (["a.json", "nan.json"], ["nan.json", "NaN"]),
    "cut short": (["a.json", "cut.json"], ["cut.json", "not JSON"]),
    "a picture": (["a.json", "picture.json"], ["picture.json", "UTF-8"]),
    "a folder": (["a.json", "folder.json"], ["folder.json"]),
    "nothing in common": (["a.json", "none.json"], ["no row in common"]),
    "unknown option": (["a.json", "b.json", "--fast"], ["--fast"]),
}


@pytest.mark.parametrize(("arguments", "words"), BAD.values(), ids=BAD)
def test_bad_files_are_told_in_one_line(arguments, words, files, refuse):
    said = refuse("bench", "compare", *arguments)
    for word in words:
        assert word in said
