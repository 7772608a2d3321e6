"""The report as its readers meet it: in Chromium, wide and narrow, light and dark, on paper."""

from __future__ import annotations

import json
import re

import pytest

from bench.report import write_report

pytestmark = pytest.mark.browser
WIDTHS = (1280, 390)
MEBI = 2**20


def time_range(page, figure: str) -> list[float]:
    """What a figure shows, once it has been drawn anew."""
    page.locator(f"#plot-{figure}").scroll_into_view_if_needed()
    page.wait_for_timeout(300)
    return page.evaluate(f"document.getElementById('plot-{figure}').layout.xaxis.range")


def ink(page) -> str:
    return page.evaluate("getComputedStyle(document.body).color")


@pytest.fixture(scope="module")
def report(results):
    return results / "run" / "report.html"


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("which", ["run", "compare", "latency", "deadline"])
def test_every_report_opens_without_a_complaint_and_fits(
    which, width, results, visit, *, shot, all_drawn
):
    page = visit(results / which / "report.html", width=width)
    all_drawn(page)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    empty = page.evaluate(
        "[...document.querySelectorAll('.plot')]"
        ".filter(p => !p.querySelector('.scatterlayer path')).map(p => p.id)"
    )
    assert empty == []
    assert page.locator("#problem").is_hidden()
    shot(page, f"{which}-{width}", full_page=True)


def test_a_report_is_small_and_soon_there(report, visit):
    assert report.stat().st_size < 8 * MEBI
    page = visit(report)
    ready = int(page.evaluate("document.documentElement.dataset.ready"))
    print(f"{report.stat().st_size / MEBI:.1f} MB, interactive after {ready} ms")


def test_zoom_is_linked(report, visit, shot, all_drawn):
    page = visit(report)
    all_drawn(page)
    figures = page.evaluate(
        "[...document.querySelectorAll('#time .plot')].map(p => p.dataset.figure)"
    )
    assert {"force", "error", "command", "velocity", "torque", "status"} <= set(figures)
    whole = time_range(page, "force")
    box = page.locator("#plot-force .nsewdrag").first.bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + 0.4 * box["width"], middle)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.5 * box["width"], middle, steps=5)
    page.mouse.up()
    zoomed = time_range(page, "force")
    span = whole[1] - whole[0]
    assert zoomed[0] == pytest.approx(whole[0] + 0.4 * span, abs=0.02 * span)
    assert zoomed[1] == pytest.approx(whole[0] + 0.5 * span, abs=0.02 * span)
    for figure in figures:
        assert time_range(page, figure) == pytest.approx(zoomed)
    assert float(page.locator("#time-from").input_value()) == pytest.approx(zoomed[0], abs=1e-3)
    shot(page, "zoomed")
    page.locator("[data-move=all]").click()
    assert time_range(page, "torque") == pytest.approx(whole)


def test_zoomed_in_every_cycle_is_drawn(report, visit):
    page = visit(report)
    page.locator("#time-from").fill("9")
    page.locator("#time-to").fill("9.05")
    page.locator("#time-to").press("Enter")
    assert time_range(page, "error") == pytest.approx([9, 9.05])
    x = page.evaluate("Array.from(document.getElementById('plot-error').data[0].x)")
    assert x == pytest.approx([9 - 1e-3 + k * 1e-3 for k in range(len(x))], abs=1.1e-3)
    assert len(x) >= 51


def test_no_peak_is_lost_where_a_pixel_stands_for_many_cycles(report, visit, results):
    import numpy as np  # noqa: PLC0415
    import pyarrow.parquet as pq  # noqa: PLC0415

    log = pq.read_table(results / "run" / "log.parquet")
    page = visit(report, width=390)
    time_range(page, "torque")
    for k in range(6):
        drawn = page.evaluate(f"Array.from(document.getElementById('plot-torque').data[{k}].y)")
        true = log[f"torque_{k + 1}"].to_numpy()
        assert len(drawn) < len(true) / 10
        np.testing.assert_allclose([min(drawn), max(drawn)], [true.min(), true.max()], rtol=1e-6)


def test_an_event_leads_to_its_instant(report, visit):
    page = visit(report)
    button = page.locator(".events button").first
    at = float(re.search(r"([\d.]+) s$", button.inner_text())[1])
    button.click()
    low, high = time_range(page, button.get_attribute("data-at"))
    assert low <= at <= high
    assert high - low == pytest.approx(0.5)


def test_the_theme_follows_the_system_and_the_button(report, visit, shot, all_drawn, until):
    page = visit(report, color_scheme="dark")
    all_drawn(page)
    dark = ink(page)
    line = "getComputedStyle(document.querySelector('#plot-error .js-line')).stroke"
    stroke = page.evaluate(line)
    assert page.locator("#theme").inner_text() == "Light theme"
    shot(page, "run-dark")
    page.locator("#theme").click()
    time_range(page, "error")
    assert ink(page) != dark
    assert page.evaluate(line) != stroke
    assert page.locator("#theme").inner_text() == "Dark theme"
    page.reload()
    until(page, "document.documentElement.dataset.ready")
    assert ink(page) != dark  # it is remembered


def test_everything_is_reached_by_keyboard(report, visit, all_drawn):
    page = visit(report)
    all_drawn(page)
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "Skip to the content"
    assert page.locator(".skip").bounding_box()["x"] >= 0
    reached = []
    while page.evaluate("document.activeElement !== document.body") and len(reached) < 200:
        told = page.evaluate(
            "(() => { const e = document.activeElement; return [e.id || e.dataset.move"
            " || e.dataset.at || e.textContent, getComputedStyle(e).outlineStyle] })()"
        )
        reached.append(told[0])
        assert told[1] != "none", told  # where the focus is can be seen
        page.keyboard.press("Tab")
    order = ["theme", "At a glance", "error", "time-from", "time-to", "out", "in", "earlier"]
    places = [reached.index(name) for name in order]
    assert places == sorted(places)
    for figure in ("force", "error", "status"):
        assert f"save-{figure}" in reached
    page.locator("[data-move=in]").focus()
    page.keyboard.press("Enter")
    low, high = time_range(page, "force")
    assert high - low == pytest.approx(7.5, abs=0.1)


def test_a_line_is_hidden_and_shown_from_the_legend(report, visit):
    page = visit(report)
    count = "document.getElementById('plot-force').data.length"
    time_range(page, "force")
    before = page.evaluate(count)
    held = page.locator("#legend-force button", has_text="held still")
    held.press("Space")
    time_range(page, "force")
    assert held.get_attribute("aria-pressed") == "false"
    assert page.evaluate(count) == before - 3
    held.press("Space")
    time_range(page, "force")
    assert page.evaluate(count) == before


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("which", ["run", "compare", "latency", "deadline"])
def test_axe_finds_nothing_serious(which, scheme, results, visit, *, axe, all_drawn):
    page = visit(results / which / "report.html", color_scheme=scheme, reduced_motion="reduce")
    all_drawn(page)
    assert axe.check(page) == []


def test_axe_finds_nothing_serious_on_a_phone(report, visit, axe, all_drawn):
    page = visit(report, width=390, has_touch=True, is_mobile=True)
    all_drawn(page)
    assert axe.check(page) == []


def test_on_paper_it_is_light_and_within_the_margins(report, visit, shot, all_drawn):
    page = visit(report, width=794, height=1123, color_scheme="dark")
    all_drawn(page)
    screen = ink(page)
    page.emulate_media(media="print")
    page.wait_for_timeout(800)
    assert ink(page) != screen
    assert page.locator("#timebar").is_hidden()
    assert page.locator("nav").is_hidden()
    widths = page.evaluate(
        "[...document.querySelectorAll('.plot .main-svg')].map(s => s.clientWidth)"
    )
    assert max(widths) <= 680
    shot(page, "paper", full_page=True)
    page.emulate_media(media="screen")
    page.wait_for_timeout(800)
    assert ink(page) == screen


HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"


def test_what_a_scenario_says_is_text(results, visit, tmp_path, all_drawn):
    folder = tmp_path / "<img src=x onerror=alert(3)>"
    folder.mkdir()
    for file in ("summary.json", "log.parquet", "config.toml", "beats.csv"):
        (folder / file).write_bytes((results / "run" / file).read_bytes())
    config = (folder / "config.toml").read_text()
    written = json.dumps(HOSTILE)
    config = re.sub("^description = .*$", f"description = {written}", config, flags=re.MULTILINE)
    (folder / "config.toml").write_text(config)
    summary = json.loads((folder / "summary.json").read_text())
    summary |= {"scenario": HOSTILE, "stopped": HOSTILE, "complete": False, "backend": HOSTILE}
    summary[HOSTILE] = {HOSTILE: HOSTILE}
    summary["versions"][HOSTILE] = HOSTILE
    summary["trip"] = {"cause": HOSTILE, "time": 1.0}
    (folder / "summary.json").write_text(json.dumps(summary))
    path = tmp_path / "hostile.html"
    write_report([folder, results / "run"], path)
    page = visit(path)
    all_drawn(page)
    assert page.locator("img").count() == 0
    assert page.locator("h1").inner_text().startswith(HOSTILE)
    assert HOSTILE in page.inner_text("header")
    page.locator("#plot-force").scroll_into_view_if_needed()
    page.locator("#plot-force").hover()
    page.wait_for_timeout(300)


def test_nothing_foreign_runs_even_if_it_gets_in(report, visit, tmp_path, complained):
    """The policy stands behind the escaping: an inline script of somebody else's is refused."""
    path = tmp_path / "broken.html"
    text = report.read_text().replace("<h1>", "<script>document.title = 'taken'</script><h1>")
    path.write_text(text)
    page = visit(path)
    assert page.title() != "taken"
    assert len(complained) == 1
    assert "Content Security Policy" in complained.pop()


def test_without_scripts_the_figures_are_words(report, visit):
    page = visit(report, wait=False, java_script_enabled=False)
    assert page.locator("noscript p").is_visible()
    assert page.locator("table").count() > 5
    assert "RMS" in page.locator("#words-error").inner_text()
    assert page.locator("#timebar").is_hidden()


def test_a_figure_is_saved(report, visit):
    page = visit(report)
    time_range(page, "force")
    with page.expect_download() as started:
        page.locator("#save-force").click()
    assert started.value.suggested_filename == "force.svg"


def test_a_finger_scrolls_over_a_figure_and_does_not_zoom(report, visit, all_drawn):
    page = visit(report, width=390, height=844, has_touch=True, is_mobile=True)
    all_drawn(page)
    before = time_range(page, "error")
    page.evaluate("document.getElementById('plot-error').scrollIntoView({block: 'center'})")
    page.wait_for_timeout(500)
    box, top = page.locator("#plot-error").bounding_box(), page.evaluate("scrollY")
    touch, x, y = page.context.new_cdp_session(page), box["x"] + 150, box["y"] + 400
    send = "Input.dispatchTouchEvent"
    touch.send(send, {"type": "touchStart", "touchPoints": [{"x": x, "y": y}]})
    for k in range(1, 16):
        touch.send(send, {"type": "touchMove", "touchPoints": [{"x": x, "y": y - 20 * k}]})
        page.wait_for_timeout(16)
    touch.send(send, {"type": "touchEnd", "touchPoints": []})
    page.wait_for_timeout(500)
    assert page.evaluate("scrollY") > top + 100
    assert time_range(page, "error") == before
