"""Columns of numbers from a CSV file, with errors that name the line."""

import csv
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenarios.errors import DataFileError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Table:
    """Numbers of a CSV file whose first column is an increasing time."""

    values: Array
    """(n, columns), in the order asked for."""
    lines: NDArray[np.int64]
    """Line of the file each row comes from, from 1, (n,)."""


def read_table(path: Path, columns: tuple[str, ...], min_rows: int) -> Table:
    """Read ``columns`` (by the names in the header; others are ignored) of a CSV file.

    Lines that start with ``#`` and empty lines are skipped. A byte order mark and any kind of line
    end are fine. The first of ``columns`` must strictly increase. Errors: ``DataFileError``.
    """
    numbers, lines = _content(path)
    if not lines:
        raise DataFileError(path, None, f"no data; expected a header {','.join(columns)}")
    reader = csv.reader(lines, strict=True)
    rows: list[list[float]] = []
    places: list[int] = []
    try:
        header = [name.strip() for name in next(reader)]
        indices = _indices(path, numbers[0], header, columns)
        for cells in reader:
            line = numbers[reader.line_num - 1]
            if len(cells) != len(header):
                reason = f"{len(cells)} cells, the header has {len(header)} (decimals need a point)"
                raise DataFileError(path, line, reason)
            rows.append(
                [
                    _number(path, line, name, cells[i])
                    for name, i in zip(columns, indices, strict=True)
                ]
            )
            places.append(line)
    except csv.Error as error:
        raise DataFileError(path, numbers[reader.line_num - 1], f"not CSV: {error}") from None
    if len(rows) < min_rows:
        reason = f"{len(rows)} rows of numbers; at least {min_rows} are needed"
        raise DataFileError(path, None, reason)
    table = Table(np.array(rows), np.array(places))
    _require_increasing(path, table, columns[0])
    return table


def _content(path: Path) -> tuple[list[int], list[str]]:
    """Lines that hold something, and their numbers in the file."""
    try:
        raw = path.read_bytes()
    except FileNotFoundError:
        raise DataFileError(path, None, "no such file; name an existing CSV file") from None
    except IsADirectoryError:
        raise DataFileError(path, None, "is a directory; name a CSV file") from None
    except OSError as error:
        raise DataFileError(path, None, f"cannot be read: {error.strerror}") from None
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = "\0"
    if "\0" in text:
        raise DataFileError(path, None, "is not text in UTF-8; name a CSV file")
    # not splitlines: it also splits at characters that are no line ends in CSV
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    kept = [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    return [number for number, _ in kept], [line for _, line in kept]


def _indices(path: Path, line: int, header: list[str], columns: tuple[str, ...]) -> list[int]:
    wanted = ",".join(columns)
    for name in columns:
        if header.count(name) != 1:
            found = "no" if name not in header else "more than one"
            shown = ",".join(header)[:60]
            reason = f"{found} column {name!r} in the header {shown!r}; expected {wanted}"
            raise DataFileError(path, line, reason)
    return [header.index(name) for name in columns]


def _number(path: Path, line: int, column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    # Python reads 1_000 as a number, CSV does not
    if not math.isfinite(value) or "_" in cell:
        reason = (
            f"column {column!r} is {cell.strip()[:30]!r}; expected a finite number such as 1e-3"
        )
        raise DataFileError(path, line, reason)
    return value


def _require_increasing(path: Path, table: Table, column: str) -> None:
    time = table.values[:, 0]
    wrong = np.flatnonzero(np.diff(time) <= 0.0)
    if wrong.size:
        row = int(wrong[0]) + 1
        reason = (
            f"{column} = {time[row]:.9g} after {time[row - 1]:.9g}; "
            f"{column} must increase from row to row"
        )
        raise DataFileError(path, int(table.lines[row]), reason)
