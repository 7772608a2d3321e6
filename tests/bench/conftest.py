"""The command line, as a process and in this one."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from bench import cli, ownership

ROOT = Path(cli.__file__).parents[1]


def _environment(columns: int = 100) -> dict[str, str]:
    return os.environ | {
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "OPENBLAS_NUM_THREADS": "1",
        "COLUMNS": str(columns),
    }


def _call(*arguments: str, folder: Path, columns: int = 100) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "bench", *arguments],
        cwd=folder,
        env=_environment(columns),
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # Whoever runs the tests in the background may have them ignore Ctrl-C, and the processes that
    # they start as well; a user does not.
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _start(*arguments: str, folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-m", "bench", *arguments],
        cwd=folder,
        env=_environment(),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _said_once(text: str) -> str:
    assert text.startswith("pulsempc: "), text
    assert text.count("\n") == 1, text
    assert text.endswith("\n")
    assert "Traceback" not in text
    return text


@pytest.fixture(scope="session")
def root() -> Path:
    """The folder of the packages."""
    return ROOT


@pytest.fixture(scope="session")
def call() -> Callable[..., subprocess.CompletedProcess[str]]:
    """Run the command line as a process of its own, to its end."""
    return _call


@pytest.fixture(scope="session")
def environment() -> dict[str, str]:
    """What a process of its own needs to find these packages."""
    return _environment()


@pytest.fixture(scope="session")
def start() -> Callable[..., subprocess.Popen[str]]:
    """Start the command line as a process of its own."""
    return _start


@pytest.fixture(scope="session")
def said_once() -> Callable[[str], str]:
    """Check that standard error is one line of ours; return it."""
    return _said_once


@pytest.fixture
def leave(monkeypatch, capsys, tmp_path):
    """Run the command line in this process, in an empty folder: exit code, stdout, stderr.

    A process of its own costs two seconds, and reading the metadata of every package half of one:
    the dozens of bad inputs share this process and do without.
    """
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(ownership, "packages_distributions", dict)

    def run(*arguments):
        with pytest.raises(SystemExit) as left:
            cli.main(list(arguments))
        said = capsys.readouterr()
        return left.value.code, said.out, said.err

    return run


@pytest.fixture
def refuse(leave, tmp_path):
    """Check that arguments are refused in one line and leave nothing behind; return the line."""

    def run(*arguments):
        before = sorted(tmp_path.rglob("*"))
        code, out, err = leave(*arguments)
        assert code == 2
        assert out == ""
        assert sorted(tmp_path.rglob("*")) == before
        return _said_once(err)

    return run
