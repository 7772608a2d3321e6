"""One self-contained HTML file about one or several results: a pure function of their folders."""

import os
import tempfile
from collections.abc import Sequence
from pathlib import Path

from bench.report.compose import compose
from bench.report.errors import ReportError
from bench.report.folders import read_folders
from bench.report.page import GENERATOR

__all__ = ["ReportError", "write_report"]


def write_report(folders: Sequence[Path], path: Path) -> None:
    """Write the report about ``folders`` into the file ``path``, at once or not at all.

    Args:
        folders: of runs, comparisons and measurements, in the order of the columns.
        path: of the HTML file; an older report is replaced, no other file is.

    Raises:
        ReportError: a folder holds no results, or not all of them; or the file cannot be written.
        ScenarioError: a file in a folder is of a version that is not known.
    """
    if not folders:
        raise ReportError(path, "nothing to report on; name a folder that run or bench wrote")
    if path.is_dir():
        raise ReportError(path, "is a folder; name a file for the report")
    if path.exists() and not _is_report(path):
        raise ReportError(path, "exists and is no report; name another file")
    text = compose(*read_folders(folders))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "w", encoding="utf-8") as file:
                file.write(text)
            Path(partial).chmod(0o666 & ~_umask())
            Path(partial).replace(path)
        finally:
            Path(partial).unlink(missing_ok=True)
    except OSError as error:
        raise ReportError(path, f"cannot be written: {error.strerror or error}") from None


def _is_report(path: Path) -> bool:
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            return f'name="generator" content="{GENERATOR}"' in file.read(4096)
    except OSError:
        return False


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
