"""A real browser, a real run, and what both leave to be looked at."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

SHOTS = Path(__file__).parents[3] / ".browser" / "screenshots"
_FLAGS = (
    "--no-sandbox",  # as root there is none; the pages are our own
    "--use-angle=swiftshader",  # draws in three dimensions without a graphics card
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)


def _missing(what: str) -> None:
    """Skip, or fail where a browser is promised."""
    if os.environ.get("REQUIRE_BROWSER"):
        pytest.fail(f"{what}, and REQUIRE_BROWSER is set")
    pytest.skip(f"{what}; make test-browser says how to get it")


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, headless: CHROMIUM, or the first of its names on the path."""
    try:
        from playwright.sync_api import sync_playwright  # noqa: PLC0415
    except ImportError:
        _missing("playwright is not installed")
    names = ("chromium", "chromium-browser", "google-chrome")
    found = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, names)), None)
    if found is None:
        _missing("no Chromium on the path")
    with sync_playwright() as playwright:
        running = playwright.chromium.launch(executable_path=found, args=list(_FLAGS))
        yield running
        running.close()


@pytest.fixture(scope="session")
def results(tmp_path_factory, environment) -> Path:
    """A folder with the results of `run` over 15,000 cycles, `compare`, and both benches."""
    folder = tmp_path_factory.mktemp("results")
    for command in (
        "run constrained --out run",
        "compare constrained --backends analytic,daqp,clarabel --duration 1.5 --out compare",
        "bench latency --backends daqp --cycles 300 --passes 1 --paced-cycles 100 --out latency",
        "bench deadline --backends analytic,daqp --cycles 600 --out deadline",
    ):
        done = subprocess.run(
            [sys.executable, "-m", "bench", *command.split()],
            cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        assert "no report" not in done.stderr
    return folder


@pytest.fixture
def complained() -> list[str]:
    """What pages said on the console, threw, or asked for; empty at the end, or the test fails."""
    return []


@pytest.fixture
def visit(browser, complained) -> Iterator[Callable[..., Any]]:
    """Open a file as a page of its own; what it complains of, or asks for, fails the test."""
    contexts, complaints = [], complained

    def go(path: Path, *, width: int = 1280, height: int = 900, wait: bool = True, **options: Any):
        context = browser.new_context(viewport={"width": width, "height": height}, **options)
        contexts.append(context)
        page = context.new_page()
        page.on("console", lambda said: complaints.append(f"{said.type}: {said.text}"))
        page.on("pageerror", lambda error: complaints.append(f"error: {error}"))
        page.on("dialog", lambda dialog: complaints.append(f"dialog: {dialog.message}"))
        page.on("request", lambda asked: _note(asked.url, complaints))
        page.goto(path.as_uri())
        if wait:
            _until(page, "document.documentElement.dataset.ready")
        return page

    yield go
    for context in contexts:
        context.close()
    assert complaints == []


def _until(page: Any, what: str) -> None:
    """Wait for an expression to become true; the page's policy forbids Playwright's own way."""
    for _ in range(600):
        if page.evaluate(f"Boolean({what})"):
            return
        page.wait_for_timeout(50)
    raise AssertionError(f"never came true: {what}")


@pytest.fixture(scope="session")
def until() -> Callable[[Any, str], None]:
    """Wait for an expression to become true."""
    return _until


@pytest.fixture(scope="session")
def all_drawn() -> Callable[[Any], None]:
    """Wait until every figure has been drawn once."""
    svg = "p => p.querySelector('.main-svg')"
    return lambda page: _until(page, f"[...document.querySelectorAll('.plot')].every({svg})")


def _note(url: str, complaints: list[str]) -> None:
    if not url.startswith(("file:", "data:", "blob:")):
        complaints.append(f"request: {url}")


@pytest.fixture(scope="session")
def shot() -> Callable[..., None]:
    """Keep a screenshot to be looked at."""
    SHOTS.mkdir(parents=True, exist_ok=True)

    def take(page: Any, name: str, **options: Any) -> None:
        page.screenshot(path=SHOTS / f"{name}.png", **options)

    return take


@pytest.fixture(scope="session")
def axe() -> SimpleNamespace:
    """The accessibility checker: `check(page)` gives what it finds serious."""
    try:
        import axe_playwright_python  # noqa: PLC0415
    except ImportError:
        _missing("axe-playwright-python is not installed")
    script = (Path(axe_playwright_python.__file__).parent / "axe.min.js").read_text("utf-8")

    def check(page: Any) -> list[str]:
        page.evaluate(script)
        found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
        return [
            f"{one['id']}: {one['help']}: {[node['html'][:160] for node in one['nodes'][:3]]}"
            for one in found["violations"]
            if one["impact"] in ("serious", "critical", "moderate")
        ]

    return SimpleNamespace(check=check)
