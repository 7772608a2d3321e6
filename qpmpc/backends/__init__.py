"""Backends, one file each, found through one registry.

The modules of this folder are imported when a backend is first asked for; each imports its solver
only when an instance is made, so that a missing solver costs nothing until it is chosen.
"""

from __future__ import annotations

import importlib
import importlib.metadata
import pkgutil
from dataclasses import dataclass
from functools import cache

from qpmpc.backends._registry import register, registered
from qpmpc.backends.base import Backend, RawSolution
from qpmpc.errors import BackendUnavailableError, UnknownNameError

__all__ = ["Backend", "BackendInfo", "RawSolution", "available", "backend_class", "register"]


@dataclass(frozen=True)
class BackendInfo:
    """What is known about a backend without making one."""

    name: str
    summary: str
    package: str
    version: str | None
    """Version of the package, or None where it is not installed."""

    @property
    def install(self) -> str:
        """The command that installs the solver."""
        return f"pip install {self.package}"


def available() -> list[BackendInfo]:
    """Return every backend there is, installed or not, by name."""
    _import_all()
    return [
        BackendInfo(name, kind.summary, kind.package, _version(kind.package))
        for name, kind in sorted(registered().items())
    ]


def backend_class(name: str) -> type[Backend]:
    """Return the backend called ``name``.

    Raises:
        UnknownNameError: there is none. BackendUnavailableError: its solver is not installed.
    """
    _import_all()
    kinds = registered()
    if name not in kinds:
        raise UnknownNameError("backend", name, sorted(kinds))
    kind = kinds[name]
    if _version(kind.package) is None:
        raise BackendUnavailableError(name, f"pip install {kind.package}")
    return kind


@cache
def _import_all() -> None:
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")


def _version(package: str) -> str | None:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
