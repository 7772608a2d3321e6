"""An environment for each peer: made once, made anew when its requirements change."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import venv
from pathlib import Path

from bench.peers.failure import PeerFailure, last_words

_STAMP = "requirements.installed"


def environment(folder: Path, requirements: Path, *, limit: float) -> Path:
    """Return the interpreter of the environment in ``folder``, made if it is not there.

    Requirements are installed line by line, in their order, so that a later one may replace files
    of an earlier one. The Python is the one that runs this.

    Args:
        folder: of the environment.
        requirements: one requirement a line, pinned; comments begin with ``#``.
        limit: seconds that all of it may take.

    Raises:
        PeerFailure: something cannot be installed; the folder is left without its stamp, and the
            next call begins anew.
    """
    wanted = f"{sys.version}\n{requirements.read_text()}"
    python = folder / "bin" / "python"
    stamp = folder / _STAMP
    if python.exists() and stamp.is_file() and stamp.read_text() == wanted:
        return python
    shutil.rmtree(folder, ignore_errors=True)
    folder.parent.mkdir(parents=True, exist_ok=True)
    venv.create(folder, symlinks=True)
    # Our own pip installs into it: the environment needs none.
    pip = [sys.executable, "-I", "-m", "pip", "--python", str(python), "install", "--quiet"]
    for line in requirements.read_text().splitlines():
        requirement = line.partition("#")[0].strip()
        if requirement:
            _run([*pip, "--disable-pip-version-check", requirement], requirement, limit)
    stamp.write_text(wanted)
    return python


def foreign_variables() -> dict[str, str]:
    """Return the variables of a peer's process: ours, without what leads to our packages."""
    ours = ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV")
    variables = {key: value for key, value in os.environ.items() if key not in ours}
    return variables | {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}


def _run(command: list[str], what: str, limit: float) -> None:
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=limit,
            env=foreign_variables(),
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise PeerFailure(f"{what}: not installed in {limit:g} s") from None
    if done.returncode:
        words = last_words(done.stderr) or last_words(done.stdout)
        raise PeerFailure(f"{what}: {words or f'pip ended with exit code {done.returncode}'}")
