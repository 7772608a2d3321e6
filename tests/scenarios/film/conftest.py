"""A short run for films, and a skip where nothing draws without a screen."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from scenarios.film.offscreen import NoRendererError, renderer
from scenarios.results import write_run

CYCLES = 300


def pytest_runtest_setup(item: pytest.Item) -> None:
    if item.get_closest_marker("rendering") and renderer() is None:
        pytest.skip(str(NoRendererError()))


@pytest.fixture(scope="session")
def finished(simulate, tmp_path_factory) -> Path:
    """The folder of a run of 0.3 s; not to be written to."""
    run = simulate("paper", duration=1e-3 * CYCLES)
    folder = tmp_path_factory.mktemp("finished") / "run"
    folder.mkdir()
    write_run(run.experiment, run.summary, folder)
    return folder


@pytest.fixture
def folder(finished, tmp_path) -> Path:
    """A copy of it."""
    return Path(shutil.copytree(finished, tmp_path / "run"))
