"""The folder of a run: all of it or nothing."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from plant.arm_file import self_contained
from scenarios.config import Scenario
from scenarios.errors import ScenarioError
from scenarios.experiment import Experiment
from scenarios.load import dump_scenario
from scenarios.metrics import Summary


@contextmanager
def result_folder(folder: Path) -> Iterator[Path]:
    """Give a folder to write into, beside ``folder``, and move it there at the end.

    It is made at once, so that a place that cannot be written is told before anything is
    simulated; an exception leaves nothing behind.

    Raises:
        ScenarioError: ``folder`` exists and is not empty, or cannot be made.
    """
    if folder.exists() and not folder.is_dir():
        raise ScenarioError(f"{folder}: exists and is no folder; give another --out")
    if folder.is_dir() and any(folder.iterdir()):
        raise ScenarioError(f"{folder}: exists and is not empty; give another --out")
    missing = [above for above in folder.absolute().parents if not above.exists()]
    partial: Path | None = None
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        partial = Path(tempfile.mkdtemp(prefix=f".{folder.name}.", dir=folder.parent))
        yield partial
        partial.chmod(0o777 & ~_umask())
        partial.replace(folder)
        partial = None
        missing = []
    except OSError as error:
        raise ScenarioError(f"{folder}: cannot be written: {error.strerror or error}") from None
    finally:
        if partial is not None:
            shutil.rmtree(partial, ignore_errors=True)
        for above in missing:
            with suppress(OSError):
                above.rmdir()


def write_run(experiment: Experiment, summary: Summary, folder: Path) -> None:
    """Write ``config.toml``, ``summary.json`` and ``log.parquet`` into ``folder``."""
    write_config(experiment.scenario, folder)
    (folder / "summary.json").write_text(to_json(summary), encoding="utf-8")
    experiment.log.write(folder / "log.parquet")


def write_config(scenario: Scenario, folder: Path) -> None:
    """Write ``config.toml`` into ``folder``.

    Files that motion, setpoint and arm came from are copied, so that the folder alone repeats the
    run: ``pulsempc run FOLDER/config.toml``.
    """
    for key in ("file", "beats"):
        source = getattr(scenario.motion, key)
        if source is not None:
            shutil.copyfile(source, folder / f"{key}.csv")
            copied: dict[str, Any] = {key: f"{key}.csv"}
            scenario = replace(scenario, motion=replace(scenario.motion, **copied))
    if scenario.setpoint.file is not None:
        shutil.copyfile(scenario.setpoint.file, folder / "setpoint.csv")
        scenario = replace(scenario, setpoint=replace(scenario.setpoint, file="setpoint.csv"))
    arm = scenario.cell.arm
    if arm is not None:
        name = f"arm{Path(arm.file).suffix}"
        (folder / name).write_text(self_contained(Path(arm.file)), encoding="utf-8")
        cell = replace(scenario.cell, arm=replace(arm, file=name))
        scenario = replace(scenario, cell=cell)
    (folder / "config.toml").write_text(dump_scenario(scenario), encoding="utf-8")


def to_json(summary: Summary) -> str:
    """Return a summary as text, the same bytes for the same figures."""
    return json.dumps(summary, indent=2, allow_nan=False) + "\n"


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
