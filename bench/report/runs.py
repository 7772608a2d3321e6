"""The folder of a run, read for a report."""

import json
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from bench.report.errors import ReportError
from qpmpc.errors import QpmpcError
from scenarios import Scenario, ScenarioError, load_scenario
from scenarios.schedule import BoundName, Schedule

Array = NDArray[np.float64]
FILES = ("config.toml", "summary.json", "log.parquet")
_UNEVEN = 1e-6
"""Share of the period by which instants of the log may differ from even ones."""


@dataclass(frozen=True, eq=False)
class Run:
    """What a run left behind. Columns of the log that are not there are None."""

    name: str
    summary: dict[str, Any]
    log: pa.Table
    config: str
    """Text of ``config.toml``."""
    scenario: Scenario | None
    """None where this version does not understand the configuration."""
    notes: tuple[str, ...] = ()
    """What has to be said about it."""
    extra: dict[str, Any] = field(default_factory=dict)
    """Figures from elsewhere, such as those of a comparison."""

    @property
    def cycles(self) -> int:
        """Rows of the log."""
        return int(self.log.num_rows)

    @cached_property
    def counted(self) -> int:
        """Cycles before the protection took the tool away."""
        told = self.summary.get("counted")
        return min(told, self.cycles) if isinstance(told, int) and told >= 0 else self.cycles

    @cached_property
    def start(self) -> float:
        """Instant of the first row [s]."""
        time = self.values("time")
        return float(time[0]) if time is not None and time.size else 0.0

    @cached_property
    def period(self) -> float:
        """Of the control cycles [s]."""
        if self.scenario is not None:
            return self.scenario.cell.period
        time = self.values("time")
        return float(np.median(np.diff(time))) if time is not None and time.size > 1 else 1e-3

    @cached_property
    def axes(self) -> tuple[str, ...]:
        """Axes under control."""
        return tuple(axis for axis in "xyz" if f"setpoint_{axis}" in self.log.column_names)

    def values(self, name: str) -> Array | None:
        """Return a column of numbers or flags ``(cycles,)``."""
        if name not in self.log.column_names:
            return None
        column = self.log[name]
        if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type)):
            if not pa.types.is_boolean(column.type):
                return None
            column = column.cast(pa.int8())
        found: Array = column.to_numpy(zero_copy_only=False).astype(np.float64)
        return found

    def codes(self, name: str) -> tuple[NDArray[np.int64], list[str]] | None:
        """Return a column of names as codes ``(cycles,)``, and the names."""
        if name not in self.log.column_names:
            return None
        column = self.log[name].combine_chunks()
        if not pa.types.is_dictionary(column.type):
            return None
        if isinstance(column, pa.ChunkedArray):
            column = column.unify_dictionaries().chunk(0)
        codes: NDArray[np.int64] = column.indices.to_numpy(zero_copy_only=False).astype(np.int64)
        return codes, [str(name) for name in column.dictionary.to_pylist()]

    @cached_property
    def schedule(self) -> Schedule | None:
        """The bounds, where the configuration is understood."""
        if self.scenario is None:
            return None
        return Schedule(self.scenario)

    def bounds(self, name: BoundName, axis: str) -> tuple[Array, Array] | None:
        """Return lower and upper bound over the run, ``(cycles,)`` each, infinite where free."""
        if self.schedule is None or self.scenario is None or axis not in self.scenario.axes:
            return None
        j = self.scenario.axes.index(axis)
        lower, upper = self.schedule.over(name, self.cycles)
        if len(lower) < self.cycles:
            return None
        return lower[:, j], upper[:, j]

    def error(self, axis: str) -> Array | None:
        """Force error [N] of the cycles that count."""
        force, setpoint = self.values(f"force_{axis}"), self.values(f"setpoint_{axis}")
        if force is None or setpoint is None:
            return None
        return (force - setpoint)[: self.counted]

    def held(self, axis: str) -> Array | None:
        """Return the contact force of the tool held still [N]; None if it is not known."""
        force = self.values(f"force_uncompensated_{axis}")
        return None if force is None or not force.size or np.isnan(force).any() else force


def read_run(folder: Path, name: str, extra: dict[str, Any] | None = None) -> Run:
    """Read the folder of a run.

    Raises:
        ReportError: files are missing or broken, or do not belong together.
    """
    missing = [file for file in FILES if not (folder / file).is_file()]
    if missing:
        raise ReportError(folder, f"no {' and no '.join(missing)}: not the whole folder of a run")
    summary = read_json(folder / "summary.json")
    if not isinstance(summary.get("scenario"), str) or not isinstance(summary.get("axes"), dict):
        raise ReportError(folder / "summary.json", "not the summary of a run")
    log = _read_log(folder / "log.parquet")
    if summary.get("cycles") != log.num_rows:
        raise ReportError(
            folder,
            f"log.parquet has {log.num_rows} cycles, summary.json says {summary.get('cycles')}: "
            "not of the same run",
        )
    try:
        config = (folder / "config.toml").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        raise ReportError(folder / "config.toml", "cannot be read as text") from None
    scenario, notes = None, []
    try:
        scenario = load_scenario(str(folder / "config.toml"))
        Schedule(scenario)
    except (ScenarioError, QpmpcError) as error:
        scenario = None
        notes.append(f"Bounds are not shown, this version does not understand them: {error}")
    run = Run(name, summary, log, config, scenario, tuple(notes), extra or {})
    _require_even(run, folder)
    return run


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON object.

    Raises:
        ReportError: it cannot be read, or is no object.
    """
    try:
        found = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    except OSError as error:
        raise ReportError(path, error.strerror or str(error)) from None
    except (ValueError, RecursionError):
        raise ReportError(path, "not JSON; was it cut off?") from None
    if not isinstance(found, dict):
        raise ReportError(path, "not a JSON object")
    return found


def _refuse(constant: str) -> None:
    raise ValueError(constant)


def _read_log(path: Path) -> pa.Table:
    try:
        log = pq.read_table(path)
    except (OSError, pa.ArrowException):
        raise ReportError(path, "not a Parquet file; was it cut off?") from None
    if "time" not in log.column_names or not pa.types.is_floating(log["time"].type):
        raise ReportError(path, "no column 'time' of numbers: not the log of a run")
    return log


def _require_even(run: Run, folder: Path) -> None:
    time = run.values("time")
    if time is None or time.size < 2:
        return
    even = run.start + run.period * np.arange(time.size)
    if not np.abs(time - even).max() <= _UNEVEN * run.period * time.size:
        raise ReportError(folder / "log.parquet", "its instants are not one period apart")
