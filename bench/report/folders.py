"""What kind of results a folder holds."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench.report.benches import DeadlineBench, LatencyBench, read_deadline, read_latency
from bench.report.errors import ReportError
from bench.report.runs import Run, read_json, read_run

Found = Run | LatencyBench | DeadlineBench


def read_folders(folders: Sequence[Path]) -> tuple[list[Found], list[str]]:
    """Read folders of results, those of comparisons with all their runs; and what is to be said.

    Raises:
        ScenarioError: one is no folder of results, or not whole, or of a version not known.
    """
    found: list[Found] = []
    notes: list[str] = []
    for folder, name in zip(folders, _names(folders), strict=True):
        if not folder.is_dir():
            reason = "not a folder" if folder.exists() else "no such folder"
            raise ReportError(folder, f"{reason}; name one that run, compare or bench wrote")
        if (folder / "compare.json").is_file():
            runs, told = _read_comparison(folder, f"{name}/" if len(folders) > 1 else "")
            found += runs
            notes += told
        elif (folder / "latency.json").is_file():
            found.append(read_latency(folder, name))
        elif (folder / "deadline.json").is_file():
            found.append(read_deadline(folder, name))
        elif any((folder / file).is_file() for file in ("summary.json", "log.parquet")):
            found.append(read_run(folder, name))
        else:
            raise ReportError(
                folder, "no results of run, compare, bench latency or bench deadline in it"
            )
    return found, notes


def _read_comparison(folder: Path, prefix: str) -> tuple[list[Run], list[str]]:
    path = folder / "compare.json"
    rows = read_json(path).get("rows")
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ReportError(path, "has no rows")
    runs: list[Run] = []
    notes: list[str] = []
    left = {sub.name: sub for sub in sorted(folder.iterdir()) if sub.is_dir()}
    for row in rows:
        labels = _labels(row)
        label = next((label for label in labels if _file(label) in left), None)
        if label is None:
            notes.append(f"{labels[-1]}: {row.get('error') or 'its folder is missing'}")
            continue
        extra = {key: row[key] for key in row if key.startswith(("command_error", "without_"))}
        own = read_run(left.pop(_file(label)), prefix + label, {"comparison": extra})
        runs.append(own)
    if not rows:
        raise ReportError(path, "has no rows")
    if not runs:
        raise ReportError(folder, f"no run in it: {'; '.join(notes)}")
    return runs, notes


def _labels(row: dict[str, Any]) -> list[str]:
    """What the folder of a row may be called, the fullest name first."""
    controller, backend = (str(row.get(key) or "") for key in ("controller", "backend"))
    names = [f"{controller}-{backend}", controller, backend]
    return [name for name in names if name.strip("-")] or ["?"]


def _file(label: str) -> str:
    return label.replace(":", "-")


def _names(folders: Sequence[Path]) -> list[str]:
    """Name folders by their own names, with those above where these are the same."""
    paths = [folder.resolve() for folder in folders]
    for depth in range(1, 1 + max((len(path.parts) for path in paths), default=1)):
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    twice = next(path for path in paths if paths.count(path) > 1)
    raise ReportError(twice, "named more than once")
