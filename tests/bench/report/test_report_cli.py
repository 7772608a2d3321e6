"""`pulsempc report`, and the reports that other verbs write."""

from __future__ import annotations

import json
import webbrowser

import pytest

from bench.report import page


def test_one_folder_gets_its_report_inside(make, leave):
    folder = make()
    code, out, err = leave("report", str(folder))
    assert (code, err) == (0, "")
    assert out == f"report: {folder / 'report.html'}\n"
    assert (folder / "report.html").read_text().startswith("<!doctype html>")
    assert leave("report", str(folder))[0] == 0  # an older one is replaced


def test_several_get_one_of_their_own(make, leave, tmp_path):
    one, other = make("one"), make("other")
    code, out, _ = leave("report", str(one), str(other))
    assert code == 0
    assert len(list((tmp_path / "runs").glob("report-*.html"))) == 1
    code, out, _ = leave("report", str(one), str(other), "--out", "deep/er/both.html")
    assert out == "report: deep/er/both.html\n"
    assert (tmp_path / "deep" / "er" / "both.html").exists()


def test_open_shows_it(make, leave, monkeypatch):
    asked = []
    monkeypatch.setattr(webbrowser, "open", lambda url: asked.append(url) or True)
    folder = make()
    assert leave("report", str(folder), "--open")[2] == ""
    assert asked == [(folder / "report.html").as_uri()]
    monkeypatch.setattr(webbrowser, "open", lambda url: False)
    code, _, err = leave("report", str(folder), "--open")
    assert (code, err) == (0, "pulsempc: no browser to open it with\n")


@pytest.fixture
def without_plotly(monkeypatch):
    found = page.importlib.metadata.distribution

    def look(name):
        if name == "plotly":
            raise page.importlib.metadata.PackageNotFoundError(name)
        return found(name)

    monkeypatch.setattr(page.importlib.metadata, "distribution", look)


@pytest.mark.parametrize(
    "arguments",
    [
        ["report"],
        ["report", "nothing"],
        ["report", "."],
        ["report", "run", "nothing"],
        ["report", "run", "run"],
        ["report", "run/summary.json"],
        ["report", "run", "--out", "run"],
        ["report", "run", "--out", "run/summary.json"],
        ["report", "run", "--out", "run/summary.json/report.html"],
        ["report", "--open"],
        ["report", "run", "--colour", "red"],
    ],
    ids=" ".join,
)
def test_what_cannot_be_is_refused_in_one_line(arguments, make, refuse):
    make()
    refuse(*arguments)


def test_without_plotly_it_is_said(make, refuse, without_plotly):
    make()
    assert "pip install plotly" in refuse("report", "run")


def test_a_run_is_kept_where_its_report_fails(leave, tmp_path, without_plotly):
    code, out, err = leave("run", "ideal", "--duration", "0.05", "--out", "kept", "--json")
    assert code == 0
    assert json.loads(out)["cycles"] == 50
    assert "pulsempc: no report: plotly: not installed" in err
    assert (tmp_path / "kept" / "log.parquet").exists()


@pytest.mark.parametrize(
    "command",
    [
        "run ideal --duration 0.05",
        "compare ideal --duration 0.05 --backends analytic,daqp",
        "bench latency --cycles 30 --passes 1 --paced off --backends daqp",
        "bench deadline --cycles 30 --backends analytic",
    ],
    ids=lambda command: command.split(" --")[0],
)
def test_verbs_that_write_results_write_their_report(command, leave, tmp_path):
    code, out, err = leave(*command.split(), "--out", "out", "--json")
    assert (code, err) == (0, "")
    json.loads(out)
    text = (tmp_path / "out" / "report.html").read_text()
    assert "<title>" in text
    assert ".out." not in text  # the name that the folder had while it was written
