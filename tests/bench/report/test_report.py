"""From folders to one file: what is taken, what is refused, and what the page holds."""

from __future__ import annotations

import itertools
import json
import os
import re
import shutil

import numpy as np
import pytest

from bench.report import ReportError, write_report
from bench.report.folders import read_folders
from bench.report.page import plotly_script
from bench.report.runs import read_run
from scenarios import ScenarioError


def page(*folders, tmp_path) -> str:
    path = tmp_path / "page.html"
    write_report(folders, path)
    return path.read_text(encoding="utf-8")


def visible(text: str) -> str:
    """The page without its scripts and data."""
    return re.sub(r"<(script|style).*?</\1>", "", text, flags=re.DOTALL)


# ---- the page


def test_the_page_needs_nothing_from_elsewhere(make, tmp_path):
    text = page(make(), tmp_path=tmp_path)
    assert re.findall(r"""<[^>]*\b(?:src|href)=["'](?!#)""", visible(text)) == []
    policy = re.search(r'http-equiv="Content-Security-Policy" content="([^"]*)"', text)[1]
    assert policy.startswith("default-src &#x27;none&#x27;; script-src &#x27;sha256-")
    assert "unsafe-eval" not in policy
    assert "http" not in policy
    assert len(text) < 8 * 2**20
    assert text.count('id="plotly"') == 1


def test_the_same_folders_give_the_same_bytes(make, tmp_path):
    folder = make()
    assert page(folder, tmp_path=tmp_path) == page(folder, tmp_path=tmp_path)


def test_headings_are_in_order_and_every_figure_has_its_words(make, tmp_path, changes):
    text = visible(page(make(change=changes.troubled), tmp_path=tmp_path))
    levels = [int(level) for level in re.findall(r"<h(\d)", text)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after - before <= 1 for before, after in itertools.pairwise(levels))
    for name in re.findall(r'data-figure="([\w-]+)"', text):
        words = re.search(rf'<figcaption id="words-{name}">(.*?)</figcaption>', text, re.DOTALL)[1]
        assert re.search(r"\d", words), name
        assert f'id="title-{name}"' in text
    for table in re.findall(r"<table>.*?</table>", text, re.DOTALL):
        assert "<caption>" in table
        assert 'scope="col"' in table
        assert 'scope="row"' in table


def test_the_figures_of_the_run_stand_beside_those_of_the_paper(make, tmp_path):
    folder = make()
    summary = json.loads((folder / "summary.json").read_text())
    text = visible(page(folder, tmp_path=tmp_path))
    rows = re.search(r"<caption>Contact force error\..*?</table>", text, re.DOTALL)[0]
    for axis, paper in (("x", "50 %"), ("y", "75 %"), ("z", "91 %")):
        row = re.search(rf'<th scope="row">{axis}</th>(.*?)</tr>', rows, re.DOTALL)[1]
        cells = re.findall(r"<td>(.*?)</td>", row)
        figures = summary["axes"][axis]
        assert cells[0] == f"{figures['uncompensated']['rms']:.3f}"
        assert cells[2] == f"{figures['compensated']['rms']:.3f}"
        assert cells[5] == f"{figures['reduction']['rms']:.2f} %"
        assert cells[8] == paper


def test_several_runs_are_columns(make, tmp_path):
    one, other = make("one"), make("other", lambda log: log.force.__iadd__(0.1))
    text = visible(page(one, other, tmp_path=tmp_path))
    heads = re.findall(r'<th scope="col">(one|other|paper)</th>', text)
    assert heads[:3] == ["one", "other", "paper"]
    assert "Keys that differ" not in text
    assert "All runs have the same configuration" in text
    third = make("third", settings=("controller.horizon=12",))
    text = visible(page(one, third, tmp_path=tmp_path))
    row = re.search(r'<th scope="row">controller.horizon</th>(.*?)</tr>', text, re.DOTALL)[1]
    assert re.findall(r"<td>(.*?)</td>", row) == ["8", "12"]


def test_keys_that_nobody_has_heard_of_have_a_table_and_absent_ones_none(make, tmp_path, edit):
    folder = make()

    def change(summary):
        summary["contact_losses"] = {"count": 7, "longest_s": 0.125, "by_axis": {"z": 3}}
        summary["controller"] = "impedance"
        for key in ("violations", "saturation", "timing", "paper", "source", "versions"):
            del summary[key]
        summary["axes"]["z"]["compensated"]["p95"] = 0.5

    edit(folder / "summary.json", change)
    text = visible(page(folder, tmp_path=tmp_path))
    assert "<caption>contact losses</caption>" in text
    assert re.search(r"longest s</th><td>0.125<", text)
    assert re.search(r"controller</th><td>impedance<", text)
    assert "in the paper" in text
    other = make("other")
    text = visible(page(folder, other, tmp_path=tmp_path))
    assert "controlled, p95 [N]" in text


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"rows": 100, "stopped": "interrupted"}, "did not reach its end: interrupted, after 100"),
        ({"rows": 0, "stopped": "interrupted"}, "No cycle was run"),
        ({"cycles": 70_000}, "every 5 cycles"),
    ],
)
def test_what_has_to_be_known_is_said_first(how, said, make, tmp_path):
    text = visible(page(make(**how), tmp_path=tmp_path))
    assert said in re.search(r'<div class="notes" role="note">(.*?)</div>', text, re.DOTALL)[1]


def test_a_trip_is_told_and_led_to(make, tmp_path, changes):
    text = visible(page(make(change=changes.trip), tmp_path=tmp_path))
    assert "The protection tripped at 0.2999 s: force" in text
    assert re.search(r'data-at="force"[^>]*>protection tripped: force, 0\.300 s<', text)


def test_events_are_where_the_log_has_them(make, tmp_path, changes):
    text = visible(page(make(change=changes.troubled), tmp_path=tmp_path))
    events = re.findall(
        r'<button[^>]*data-from="([^"]*)"[^>]*data-to="([^"]*)"[^>]*>([^<]*)<', text
    )
    told = {label.rsplit(",", 1)[0]: label for _, _, label in events}
    assert told["largest force error, z"].endswith(", 0.060 s")
    assert told["force on z beyond its bound by 1 N"].endswith(", 0.060 s")
    assert told["slowest cycle, 2000 µs"].endswith(", 0.020 s")
    assert told["first solve late"].endswith(", 0.010 s")
    for low, high, label in events:
        at = float(re.search(r"([\d.]+) s$", label)[1])
        assert float(low) == pytest.approx(at - 0.25, abs=1e-3)
        assert float(high) == pytest.approx(at + 0.25, abs=1e-3)


HOSTILE = "</script><script>alert(1)</script>"


def test_what_a_run_says_is_escaped(make, tmp_path, edit):
    folder = make("<b>run", settings=(f"description={json.dumps(HOSTILE)}",))
    edit(folder / "summary.json", lambda s: s.update({HOSTILE: HOSTILE, "scenario": HOSTILE}))
    text = page(folder, tmp_path=tmp_path)
    assert HOSTILE not in text
    assert "alert(1)</script>" not in text
    assert "<b>" not in visible(text)
    assert text.count("<script") == 3


def test_a_configuration_of_another_version_costs_only_the_bounds(make, tmp_path):
    folder = make()
    config = (folder / "config.toml").read_text()
    (folder / "config.toml").write_text(f"[novelty]\nkey = 1\n\n{config}".replace("name =", "#", 1))
    text = visible(page(folder, tmp_path=tmp_path))
    assert "Bounds are not shown, this version does not understand them" in text
    assert 'data-figure="force"' in text


# ---- what is refused


def refused(folder, said):
    with pytest.raises(ScenarioError) as error:
        read_folders([folder])
    assert "\n" not in str(error.value)
    assert re.search(said, str(error.value)), str(error.value)


@pytest.mark.parametrize("file", ["config.toml", "summary.json", "log.parquet"])
def test_half_a_folder_is_refused(file, make):
    folder = make()
    (folder / file).unlink()
    refused(folder, f"no {re.escape(file)}: not the whole folder" if file != "x" else "")


@pytest.mark.parametrize("file", ["summary.json", "log.parquet"])
@pytest.mark.parametrize("keep", [0, 10, 0.5, 0.98])
def test_a_file_that_was_cut_off_is_refused(file, keep, make):
    path = make() / file
    whole = path.read_bytes()
    path.write_bytes(whole[: int(keep * len(whole)) if keep < 1 else keep])
    refused(path.parent, "cut off")


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda s: s.pop("axes"), "not the summary of a run"),
        (lambda s: s.update(axes=[1]), "not the summary of a run"),
        (lambda s: s.update(scenario=7), "not the summary of a run"),
        (lambda s: s.update(cycles=99), "400 cycles, summary.json says 99: not of the same run"),
    ],
)
def test_a_summary_that_is_none_is_refused(change, said, make, edit):
    folder = make()
    edit(folder / "summary.json", change)
    refused(folder, said)


@pytest.mark.parametrize("text", ["[]", "3", "null", '{"a": NaN}', "[" * 100_000, "\xff"])
def test_what_is_no_json_object_is_refused(text, make):
    folder = make()
    (folder / "summary.json").write_text(text, encoding="latin-1")
    refused(folder, "summary.json: not ")


def test_a_log_with_uneven_instants_is_refused(make):
    def jump(log):
        log.time[200:] += 0.5

    refused(make(change=jump), "not one period apart")


def test_places_without_results_are_refused(tmp_path):
    refused(tmp_path / "nothing", "no such folder; name one that run, compare or bench wrote")
    (tmp_path / "file").write_text("")
    refused(tmp_path / "file", "not a folder")
    refused(tmp_path, "no results of run, compare, bench latency or bench deadline")


def test_a_folder_named_twice_is_refused(make):
    folder = make()
    with pytest.raises(ReportError, match="more than once"):
        read_folders([folder, folder / ".." / folder.name])


def test_folders_of_the_same_name_are_told_apart(make):
    found, _ = read_folders([make("a/run"), make("b/run")])
    assert [run.name for run in found] == ["a/run", "b/run"]


def test_no_other_file_is_replaced(make, tmp_path):
    folder = make()
    precious = tmp_path / "precious.html"
    precious.write_text("mine")
    with pytest.raises(ReportError, match="exists and is no report"):
        write_report([folder], precious)
    assert precious.read_text() == "mine"
    with pytest.raises(ReportError, match="is a folder"):
        write_report([folder], tmp_path)
    with pytest.raises(ReportError, match="nothing to report on"):
        write_report([], tmp_path / "new.html")
    assert not (tmp_path / "new.html").exists()


def test_a_report_that_cannot_be_written_leaves_nothing(make, tmp_path, monkeypatch):
    folder, path = make(), tmp_path / "there" / "report.html"

    def full(*_, **__):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fdopen", full)
    with pytest.raises(ReportError, match="cannot be written: No space left"):
        write_report([folder], path)
    assert list(path.parent.iterdir()) == []


# ---- comparisons and measurements


@pytest.fixture
def comparison(make, tmp_path):
    make("c/analytic")
    make("c/qpsolvers-quadprog")
    rows = [
        {"backend": "analytic", "controller": "mpc", "command_error": 12.5},
        {"backend": "qpsolvers:quadprog", "controller": "mpc", "command_error": 1e-14},
        {"backend": "casadi", "controller": "mpc", "error": "refused: <too large>"},
    ]
    (tmp_path / "c" / "compare.json").write_text(json.dumps({"rows": rows}))
    return tmp_path / "c"


def test_a_comparison_is_its_runs(comparison, tmp_path):
    found, notes = read_folders([comparison])
    assert [run.name for run in found] == ["analytic", "qpsolvers:quadprog"]
    assert notes == ["casadi: refused: <too large>"]
    text = visible(page(comparison, tmp_path=tmp_path))
    assert "casadi: refused: &lt;too large&gt;" in text
    row = re.search(r"largest error of the command \[m/s²\]</th>(.*?)</tr>", text, re.DOTALL)[1]
    assert re.findall(r"<td>(.*?)</td>", row) == ["12.5", "1e-14"]


def test_rivals_are_found_under_their_own_names(make, tmp_path):
    make("c/mpc")
    make("c/impedance")
    make("c/mpc-daqp")
    rows = [
        {"backend": "daqp", "controller": "mpc"},
        {"backend": None, "controller": "impedance"},
    ]
    (tmp_path / "c" / "compare.json").write_text(json.dumps({"rows": rows}))
    found, _ = read_folders([tmp_path / "c"])
    assert [run.name for run in found] == ["mpc-daqp", "impedance"]


def test_a_comparison_that_every_backend_refused_is_refused(tmp_path):
    rows = [{"backend": "casadi", "error": "refused"}]
    (tmp_path / "compare.json").write_text(json.dumps({"rows": rows}))
    refused(tmp_path, "no run in it: casadi: refused")


@pytest.mark.parametrize("text", ["{}", '{"rows": 1}', '{"rows": [1]}', '{"rows": []}', "{"])
def test_a_broken_comparison_is_refused(text, comparison):
    (comparison / "compare.json").write_text(text)
    refused(comparison, r"compare\.json: (has no rows|not JSON)")


def deadline(folder, **changes):
    times = {"p50": 8.0, "p99": 9.0, "p999": 50.0, "p9999": 60.0, "max": 61.0}
    row = {"name": "qpsolvers:a b", "kind": "backend", "cycles": 2000, "response_us": times}
    empty = {"name": "empty", "kind": "empty", "cycles": 2000, "response_us": times, "misses": 3}
    told = {
        "format": "pulsempc.deadline/1", "scenario": "latency", "seed": 0, "cycles": 2000,
        "complete": True, "deadline_us": 1000.0, "mode": "hot", "machine": {"cpu": "<cpu>"},
        "rows": [empty, row, {"name": "piqp", "cycles": 0, "error": "refused"}],
    }  # fmt: skip
    folder.mkdir()
    (folder / "deadline.json").write_text(json.dumps(told | changes))
    table = (
        "       Value     Percentile TotalCount 1/(1-Percentile)\n\n"
        "    7000.000 0.000000000000          1           1.00\n"
        "    8000.000 0.500000000000       1000           2.00\n"
        "   61000.000 1.000000000000       2000\n#[Mean = 1]\n"
    )
    for name in ("empty", "qpsolvers-a-b"):
        (folder / f"response-{name}.hgrm").write_text(table)
    return folder


def test_a_deadline_run_is_read(tmp_path):
    (bench,), _ = read_folders([deadline(tmp_path / "d")])
    rarity, value = bench.curves["qpsolvers:a b"]
    np.testing.assert_allclose(rarity, [1, 2, 4000])
    np.testing.assert_allclose(value, [7, 8, 61])
    text = visible(page(tmp_path / "d", tmp_path=tmp_path))
    assert "piqp: refused" in text
    assert "empty: median 8 µs, p99.9 50 µs, slowest 61 µs, beyond 1000 µs: 3 cycles." in text
    assert "&lt;cpu&gt;" in text


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"format": "pulsempc.deadline/2"}, "format is 'pulsempc.deadline/2', expected"),
        ({"format": None}, "expected 'pulsempc.deadline/1'"),
        ({"rows": {}}, "no rows with names"),
        ({"rows": [{"cycles": 1}]}, "no rows with names"),
        ({"deadline_us": "1"}, "deadline_us is no number"),
    ],
)
def test_a_deadline_run_of_another_version_is_refused(changes, said, tmp_path):
    refused(deadline(tmp_path / "d", **changes), said)


@pytest.mark.parametrize("text", ["1.0 x 3\n", "1.0 0.5\n", "\xff"])
def test_a_broken_percentile_table_is_refused(text, tmp_path):
    folder = deadline(tmp_path / "d")
    (folder / "response-empty.hgrm").write_text(text, encoding="latin-1")
    refused(folder, r"response-empty\.hgrm: not a percentile table")


def test_a_curve_that_is_missing_is_told(tmp_path):
    folder = deadline(tmp_path / "d")
    (folder / "response-empty.hgrm").unlink()
    (bench,), _ = read_folders([folder])
    assert list(bench.curves) == ["qpsolvers:a b"]
    assert bench.notes == ("response-empty.hgrm is not there: no curve for it.",)


def test_a_latency_file_of_another_version_is_refused(tmp_path):
    (tmp_path / "latency.json").write_text('{"schema": "pulsempc.latency/9"}')
    refused(tmp_path, "schema is 'pulsempc.latency/9', not 'pulsempc.latency/1'")


# ---- the rest


def test_plotly_is_embedded_once_and_cannot_end_its_element():
    script = plotly_script()
    assert len(script) > 10**6
    assert b"plotly" in script[:200].lower()


def test_a_run_is_read_as_it_was_written(make, changes):
    run = read_run(make(change=changes.trip), "run")
    assert (run.cycles, run.counted, run.axes) == (400, 301, ("x", "y", "z"))
    codes, names = run.codes("trip")
    assert names[codes[299]] == "none"
    assert names[codes[300]] == "force"
    assert run.values("no such column") is None
    assert run.codes("time") is None
    assert run.values("trip") is None


def test_a_folder_may_be_moved(make, tmp_path):
    folder = make()
    shutil.move(folder, tmp_path / "elsewhere")
    page(tmp_path / "elsewhere", tmp_path=tmp_path)
