"""The folder of a run: all of it or nothing."""

import json
import os
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from scenarios.errors import ScenarioError
from scenarios.experiment import Experiment
from scenarios.load import dump_scenario
from scenarios.metrics import Summary


def check_target(folder: Path) -> None:
    """Refuse a folder that already holds something, before any work is done.

    Raises:
        ScenarioError: it exists and is not empty, or is no folder, or cannot be made.
    """
    if folder.exists() and not folder.is_dir():
        raise ScenarioError(f"{folder}: exists and is no folder; give another --out")
    if folder.is_dir() and any(folder.iterdir()):
        raise ScenarioError(f"{folder}: exists and is not empty; give another --out")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ScenarioError(f"{folder}: cannot be made: {error.strerror}") from None
    if not os.access(folder.parent, os.W_OK):
        raise ScenarioError(f"{folder}: cannot be made: no permission to write {folder.parent}")


def write_run(
    experiment: Experiment, summary: Summary, folder: Path, draw: Callable[[Path], None]
) -> None:
    """Write ``config.toml``, ``summary.json``, ``log.parquet`` and what ``draw`` adds.

    Everything is written beside ``folder`` first and moved into place at the end. Files that the
    motion came from are copied, so that the folder alone repeats the run:
    ``pulsempc run FOLDER/config.toml``.

    Raises:
        ScenarioError: the folder cannot be written.
    """
    try:
        partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
    except OSError as error:
        raise ScenarioError(f"{folder}: cannot be written: {error.strerror}") from None
    try:
        scenario = experiment.scenario
        for key in ("file", "beats"):
            source = getattr(scenario.motion, key)
            if source is not None:
                shutil.copyfile(source, partial / f"{key}.csv")
                copied: dict[str, Any] = {key: f"{key}.csv"}
                scenario = replace(scenario, motion=replace(scenario.motion, **copied))
        (partial / "config.toml").write_text(dump_scenario(scenario), encoding="utf-8")
        (partial / "summary.json").write_text(to_json(summary), encoding="utf-8")
        experiment.log.write(partial / "log.parquet")
        draw(partial)
        partial.chmod(0o755)
        partial.replace(folder)
    except OSError as error:
        raise ScenarioError(f"{folder}: cannot be written: {error.strerror or error}") from None
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def to_json(summary: Summary) -> str:
    """Return a summary as text, the same bytes for the same figures."""
    return json.dumps(summary, indent=2, allow_nan=False) + "\n"
