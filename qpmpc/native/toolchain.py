"""From C text to a loaded library, by the system's own compiler, once for each content."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from qpmpc.native.cache import discard, folder, sound, store, workplace
from qpmpc.native.errors import CacheError, CompilationError, CompilerUnavailableError

OPTIMISED = ("-std=gnu11", "-O3", "-march=native", "-fno-math-errno")
"""Fast for this processor, and honest about NaN: no ``-ffast-math``."""
_ALWAYS = ("-shared", "-fPIC")
_COMPILERS = ("cc", "gcc", "clang")
_PATIENCE = 300.0
"""Seconds after which a compiler is taken for hung."""
_FORMAT = "1"
"""Of the files in the cache; another one makes all of them anew."""


@dataclass(frozen=True)
class Library:
    """A library that is loaded into this process."""

    handle: ctypes.CDLL
    """Its functions, by name."""
    path: Path
    """Where it lies."""
    compiled: bool
    """Whether the compiler ran for it, or it was in the cache."""


def compile_library(
    source: str,
    *,
    name: str = "library",
    flags: Sequence[str] = OPTIMISED,
    libraries: Sequence[str] = ("-lm",),
    depends: Iterable[str | bytes] = (),
) -> Library:
    """Compile C text and load it, or load what was compiled from the same before.

    The same means: text, flags, the compiler and its version, the processor (for ``native``
    flags), and whatever else the text was written for. No shell is involved.

    Args:
        source: C text, one translation unit.
        name: what its file is called, before the digest.
        flags: of the compiler.
        libraries: behind the text on the command line: ``-lm``, or a file to link with.
        depends: versions or contents of what the text was written for (headers, a library).

    Raises:
        CompilerUnavailableError: there is no compiler. CompilationError: it refuses the text.
        CacheError: the folder of compiled libraries cannot be used.
    """
    command, version = compiler()
    native = any("native" in flag for flag in flags)
    key = _digest(
        [_FORMAT, source, *command, version, "flags", *flags, "libraries", *libraries, "depends"],
        [processor() if native else platform.machine(), *depends],
    )
    path = folder() / f"{name}-{key}.so"
    compiled = not sound(path)
    if compiled:
        _compile(source, path, command, flags, libraries)
    try:
        return Library(ctypes.CDLL(str(path)), path, compiled)
    except OSError as error:
        discard(path)
        raise CacheError(path.parent, f"{path.name} cannot be loaded ({error})") from error


def compiler() -> tuple[tuple[str, ...], str]:
    """Return the command of the C compiler and what it says of its version.

    ``$CC`` if that is set, else the first of cc, gcc and clang that is on the path.

    Raises:
        CompilerUnavailableError: there is none that can be run.
    """
    named = os.environ.get("CC")
    candidates = [shlex.split(named)] if named else [[each] for each in _COMPILERS]
    tried = [words[0] for words in candidates if words]
    for words in candidates:
        program = shutil.which(words[0]) if words else None
        if program is not None:
            return (program, *words[1:]), _version((program, *words[1:]))
    raise CompilerUnavailableError(tried)


@cache
def _version(command: tuple[str, ...]) -> str:
    """Ask a compiler for its version, once in a process."""
    try:
        answer = _run([*command, "--version"])
    except OSError as error:
        raise CompilerUnavailableError([command[0]], f"it cannot be run ({error})") from error
    if answer.returncode != 0:
        raise CompilerUnavailableError([command[0]], "it does not tell its version")
    return answer.stdout


def _compile(
    source: str,
    path: Path,
    command: Sequence[str],
    flags: Sequence[str],
    libraries: Sequence[str],
) -> None:
    with workplace(path.parent) as place:
        text, made = Path(place, "source.c"), Path(place, "made.so")
        text.write_text(source, encoding="utf-8")
        line = [*command, *flags, *_ALWAYS, "-o", str(made), str(text), *libraries]
        try:
            answer = _run(line)
        except subprocess.TimeoutExpired as error:
            raise CompilationError(command[0], f"error: not done in {_PATIENCE:g} s") from error
        except OSError as error:
            raise CompilerUnavailableError([command[0]], f"it cannot be run ({error})") from error
        if answer.returncode != 0 or not made.exists():
            raise CompilationError(command[0], answer.stderr.replace(f"{place}{os.sep}", ""))
        try:
            store(made, path)
        except OSError as error:
            raise CacheError(path.parent, f"cannot be written to ({error.strerror})") from error


def _run(line: Sequence[str]) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        line,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        errors="replace",
        timeout=_PATIENCE,
        env={**os.environ, "LC_ALL": "C"},
        check=False,
    )


def _digest(*groups: Iterable[str | bytes]) -> str:
    """Return the digest of all parts, each with its length before it."""
    digest = hashlib.sha256()
    for group in groups:
        for part in group:
            content = part.encode() if isinstance(part, str) else part
            digest.update(len(content).to_bytes(8, "little") + content)
    return digest.hexdigest()[:40]


@cache
def processor() -> str:
    """Return what code for the ``native`` processor depends on: its kind and its instructions."""
    told = Path("/proc/cpuinfo")
    lines: list[str] = []
    if told.is_file():
        wanted = ("model", "cpu family", "vendor_id", "flags", "Features", "CPU ")
        first = told.read_text(encoding="utf-8", errors="replace").split("\n\n", 1)[0]
        lines = [line for line in first.splitlines() if line.startswith(wanted)]
    return "\n".join([platform.machine(), platform.processor(), *lines])
