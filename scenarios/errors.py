"""Errors of the experiments: everything a scenario, its motion or its loop can refuse."""

import difflib
from collections.abc import Iterable
from pathlib import Path


class ScenarioError(Exception):
    """Base of all errors raised by ``scenarios``; its text is one line, fit to be shown."""


class ScenarioKeyError(ScenarioError):
    """A key or value of a scenario is wrong.

    Attributes: ``source``, the file or option it came from; ``key``, its dotted path; ``reason``.
    """

    def __init__(self, source: str, key: str, reason: str) -> None:
        self.source = source
        self.key = key
        self.reason = reason
        super().__init__(f"{source}: {key}: {reason}")


class UnknownScenarioError(ScenarioError):
    """Neither a shipped scenario nor a file.

    Attributes: ``name``; ``valid``, the names of the shipped scenarios.
    """

    def __init__(self, name: str, valid: Iterable[str]) -> None:
        self.name = name
        self.valid = tuple(valid)
        super().__init__(
            f"unknown scenario '{name}'{nearest(name, self.valid)}, or give the path of a TOML file"
        )


class DataFileError(ScenarioError):
    """A file of motion, beats or setpoints cannot be used.

    Attributes: ``path`` of the file; ``line``, the number of the line in it (from 1), or ``None``
    if the fault is not in one line.
    """

    def __init__(self, path: Path, line: int | None, reason: str) -> None:
        self.path = path
        self.line = line
        place = f"{path}: " if line is None else f"{path}: line {line}: "
        super().__init__(place + reason)


class DataTooShortError(ScenarioError):
    """A file of motion, beats or setpoints ends before the run does.

    Attributes: ``path``; ``available``, the longest run it allows [s]; ``requested`` duration [s].
    """

    def __init__(self, path: Path, available: float, requested: float, reason: str) -> None:
        self.path = path
        self.available = available
        self.requested = requested
        super().__init__(f"{path}: {reason}")


def nearest(name: str, valid: Iterable[str]) -> str:
    """Tail of an error line: the valid name nearest to ``name``, and all of them."""
    names = sorted(valid)
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f", did you mean '{near[0]}'?" if near else ""
    return f"{hint} (valid: {', '.join(names)})"
