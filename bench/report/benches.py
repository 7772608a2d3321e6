"""The folders of ``bench latency`` and ``bench deadline``, read for a report."""

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.deadline_report import FORMAT
from bench.latency.result import Result, read_result
from bench.report.errors import ReportError
from bench.report.runs import read_json

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class LatencyBench:
    """What ``bench latency`` left behind."""

    name: str
    result: Result
    samples: dict[tuple[str, int], dict[tuple[str, str, str], Array]]
    """Axes and horizon to backend, path and mode to the times [us] of all samples: steps where
    hot, responses where paced."""
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class DeadlineBench:
    """What ``bench deadline`` left behind."""

    name: str
    result: dict[str, Any]
    curves: dict[str, tuple[Array, Array]]
    """Name of a row to 1 / (1 - share) and the response [us] there."""
    notes: tuple[str, ...] = ()


def read_latency(folder: Path, name: str) -> LatencyBench:
    """Read the folder of ``bench latency``.

    Raises:
        ScenarioError: ``latency.json`` is broken or of another version.
        ReportError: samples are broken.
    """
    result = read_result(folder / "latency.json")
    samples, notes = {}, []
    for stream in result.streams:
        file = f"times-{stream.axes.replace(',', '')}-N{stream.horizon}.npz"
        path = folder / Path(file).name
        if not path.is_file():
            notes.append(f"{file} is not there: no curves for it.")
            continue
        samples[stream.axes, stream.horizon] = _read_samples(path)
    return LatencyBench(name, result, samples, tuple(notes))


def read_deadline(folder: Path, name: str) -> DeadlineBench:
    """Read the folder of ``bench deadline``.

    Raises:
        ReportError: files are broken or of another version.
    """
    path = folder / "deadline.json"
    result = read_json(path)
    if result.get("format") != FORMAT:
        raise ReportError(path, f"format is {result.get('format')!r}, expected '{FORMAT}'")
    rows = result.get("rows")
    if not isinstance(rows, list) or not all(
        isinstance(row, dict) and isinstance(row.get("name"), str) for row in rows
    ):
        raise ReportError(path, "has no rows with names")
    if not isinstance(result.get("deadline_us"), int | float):
        raise ReportError(path, "deadline_us is no number")
    curves, notes = {}, []
    for row in rows:
        if not row.get("cycles"):
            continue
        file = f"response-{row['name'].replace(':', '-').replace(' ', '-')}.hgrm"
        if not (folder / Path(file).name).is_file():
            notes.append(f"{file} is not there: no curve for it.")
            continue
        curves[row["name"]] = _read_percentiles(folder / Path(file).name)
    return DeadlineBench(name, result, curves, tuple(notes))


def _read_samples(path: Path) -> dict[tuple[str, str, str], Array]:
    found: dict[tuple[str, str, str], Array] = {}
    try:
        with np.load(path, allow_pickle=False) as archive:
            for key in archive.files:
                *head, path_, mode, stage = key.split("/")
                if (mode, stage) in (("hot", "step"), ("paced", "response")) and head:
                    times = np.asarray(archive[key], dtype=np.float64).ravel()
                    found["/".join(head), path_, mode] = 1e-3 * times
    except (OSError, ValueError, EOFError, zipfile.BadZipFile):
        raise ReportError(path, "not the samples of `pulsempc bench latency`") from None
    return found


def _read_percentiles(path: Path) -> tuple[Array, Array]:
    """Read a percentile table in HdrHistogram's format, values in ns."""
    rarity, value = [], []
    try:
        for line in path.read_text(encoding="utf-8").splitlines():
            cells = line.split()
            if not cells or not cells[0][0].isdigit():
                continue
            total = int(cells[2])
            share = float(cells[1])
            # the last value stands half a step before certainty, as in the other curves
            rarity.append(1 / (1 - share) if share < 1 else 2.0 * total)
            value.append(1e-3 * float(cells[0]))
    except (OSError, ValueError, IndexError):
        raise ReportError(path, "not a percentile table") from None
    return np.array(rarity), np.maximum(np.array(value), 1e-3)
