"""A folder of files named by the content they were made from, which only its owner can fill.

What lies in it is loaded into the process, so the folder must be the user's own and closed to the
writing of others; anything else is refused, not mended. Each file ends with the digest of what
stands before it: one that was cut short or damaged is not loaded but made anew.
"""

from __future__ import annotations

import hashlib
import os
import stat
import tempfile
from contextlib import suppress
from pathlib import Path

from qpmpc.native.errors import CacheError

VARIABLE = "PULSEMPC_CACHE"
"""Environment variable that names the folder in place of the usual one."""
DIGEST = hashlib.sha256().digest_size
"""Bytes of the digest at the end of each file."""
_OTHERS_WRITE = stat.S_IWGRP | stat.S_IWOTH


def folder() -> Path:
    """Return the cache's folder, made with mode 0700 if it is not there.

    It is ``$PULSEMPC_CACHE``, or ``pulsempc`` in ``$XDG_CACHE_HOME`` or ``~/.cache``.

    Raises:
        CacheError: it cannot be made, is no folder, belongs to someone else, or others may write
            to it.
    """
    path = _named()
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
    except OSError as error:
        raise CacheError(path, f"cannot be made ({error.strerror})") from error
    if not stat.S_ISDIR(found.st_mode):
        raise CacheError(path, "is no folder (a link is not followed)")
    _require_own(path, found)
    return path


def _named() -> Path:
    if named := os.environ.get(VARIABLE):
        return Path(named).absolute()
    if base := os.environ.get("XDG_CACHE_HOME"):
        return Path(base).absolute() / "pulsempc"
    try:
        return Path.home() / ".cache" / "pulsempc"
    except RuntimeError as error:
        raise CacheError("~/.cache/pulsempc", f"no home folder; set {VARIABLE}") from error


def _require_own(path: Path, found: os.stat_result) -> None:
    if found.st_uid != os.geteuid():
        raise CacheError(path, f"belongs to user {found.st_uid}, not to {os.geteuid()}")
    if found.st_mode & _OTHERS_WRITE:
        raise CacheError(path, f"others may write to it (mode {stat.S_IMODE(found.st_mode):04o})")


def sound(path: Path) -> bool:
    """Whether a file of the cache is there and whole.

    Raises:
        CacheError: it is not the user's own, or others may write to it.
    """
    try:
        handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW)
    except OSError:
        return False
    with os.fdopen(handle, "rb") as file:
        _require_own(path, os.fstat(file.fileno()))
        content = file.read()
    return hashlib.sha256(content[:-DIGEST]).digest() == content[-DIGEST:]


def store(made: Path, path: Path) -> None:
    """Seal a file that was made beside the cache with its digest and put it in place, at once.

    Whoever looks meanwhile sees the old file or the new one; of two who make the same, one wins.
    """
    content = made.read_bytes()
    with made.open("ab") as file:
        file.write(hashlib.sha256(content).digest())
        file.flush()
        os.fsync(file.fileno())
    made.chmod(0o700)
    made.replace(path)


def workplace(where: Path) -> tempfile.TemporaryDirectory[str]:
    """Return a folder inside the cache's for files under way; it goes with its context.

    Raises:
        CacheError: it cannot be made.
    """
    try:
        return tempfile.TemporaryDirectory(prefix="making-", dir=where)
    except OSError as error:
        raise CacheError(where, f"cannot be written to ({error.strerror})") from error


def discard(path: Path) -> None:
    """Remove a file that turned out to be of no use, if it is there."""
    with suppress(OSError):
        path.unlink()
