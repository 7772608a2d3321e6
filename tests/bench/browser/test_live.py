"""The live cell as its visitors meet it: in Chromium, switched and steered while it runs."""

from __future__ import annotations

import re
import subprocess
import sys
import time

import pytest

pytestmark = pytest.mark.browser
_SAID = re.compile(r"^(log|info|debug|warning): ")
"""What viser and three.js say of themselves; an error is a complaint."""


@pytest.fixture
def address(tmp_path, environment):
    """A live cell, and what it said and left at its end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "bench", "live", "paper", "--duration", "8"],
        cwd=tmp_path, env=environment, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        found = re.search(r"http://\S+:\d+", process.stderr.readline())
        assert found
        yield found[0]
        assert process.poll() is None
    finally:
        process.terminate()
        process.communicate()


@pytest.fixture
def watch(browser, address):
    """Open the page as another visitor; what it complains of fails the test."""
    contexts, complaints = [], []

    def go(width=1280, height=900):
        context = browser.new_context(viewport={"width": width, "height": height})
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda said: complaints.append(f"{said.type}: {said.text}"))
        page.on("pageerror", lambda error: complaints.append(f"error: {error}"))
        page.on("request", lambda asked: _note(asked.url, address, complaints))
        page.goto(address)
        page.locator("#pulsempc-status").wait_for(timeout=60_000)
        return page

    yield go
    for context in contexts:
        context.close()
    assert [said for said in complaints if not _SAID.match(said)] == []


def _note(url, address, complaints):
    if not url.startswith((address, "data:", "blob:")):
        complaints.append(f"request: {url}")


def status(page):
    return page.locator("#pulsempc-status").inner_text()


def until(page, word, patience=20.0):
    end = time.monotonic() + patience
    while word not in status(page):
        assert time.monotonic() < end, f"{word!r} not in {status(page)!r}"
        page.wait_for_timeout(100)


def choose(page, label, option):
    page.get_by_role("combobox", name=label).or_(
        page.locator(f"label:has-text('{label}')").locator("xpath=following::input[1]")
    ).first.click()
    page.get_by_role("option", name=option, exact=True).click()


def force(page):
    """Measured force on z in the status."""
    return float(re.search(r"force (\S+), (\S+), (\S+) N", status(page))[3])


def test_the_backend_is_switched_and_the_force_follows_the_slider(watch, shot):
    other = watch(640, 360)  # drawn without a graphics card: small is quick
    page = watch()
    until(page, "mpc / daqp")
    choose(page, "backend", "osqp")
    until(page, "mpc with osqp in force")
    until(other, "mpc with osqp in force")  # who watches sees the same
    other.context.close()
    assert force(page) == pytest.approx(-10.0, abs=0.5)
    slider = page.locator("label:has-text('z [N]')").locator(
        "xpath=following::input[not(@type='hidden')][1]"
    )
    slider.fill("-5")
    slider.press("Enter")
    until(page, "setpoint 1, 2, -5 N")
    page.wait_for_timeout(2000)
    assert force(page) == pytest.approx(-5.0, abs=0.5)
    speed = float(re.search(r"(\S+) x real time", status(page))[1])
    print(f"{speed:.2f} x real time with the page open")
    page.get_by_role("button", name="Solver failure").click()
    until(page, "no answer in time for 100 ms")
    page.get_by_role("button", name="Pause", exact=True).click()
    until(page, "paused")
    shot(page, "live")
    page.get_by_role("button", name="Go on", exact=True).click()
    until(page, "x real time")
