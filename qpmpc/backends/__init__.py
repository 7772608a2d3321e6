"""Backends, one file each, found through one registry.

The modules of this folder are imported when a backend is first asked for; each imports its solver
only when an instance is made, so that a missing solver costs nothing until it is chosen.
"""

from __future__ import annotations

import importlib
import pkgutil
from functools import cache

from qpmpc.backends._registry import (
    describe,
    families,
    register,
    register_family,
    registered,
    version,
)
from qpmpc.backends.base import Backend, BackendInfo, Fact, Family, LimitKind, Limits, RawSolution
from qpmpc.errors import BackendUnavailableError, UnknownNameError

__all__ = [
    "Backend",
    "BackendInfo",
    "Fact",
    "Family",
    "LimitKind",
    "Limits",
    "RawSolution",
    "available",
    "backend_class",
    "describe",
    "register",
    "register_family",
]


def available() -> list[BackendInfo]:
    """Return every backend there is, installed or not, by name."""
    _import_all()
    found = [describe(kind) for kind in registered().values()]
    for family in families().values():
        found += family.variants()
    return sorted(found, key=lambda info: info.name)


def backend_class(name: str) -> type[Backend]:
    """Return the backend called ``name``, or ``family:variant``.

    Raises:
        UnknownNameError: there is none. BackendUnavailableError: its solver is not installed.
    """
    _import_all()
    kinds = registered()
    stem, _, variant = name.partition(":")
    if stem in families():
        return families()[stem].backend(variant)
    if name not in kinds:
        raise UnknownNameError("backend", name, [info.name for info in available()])
    kind = kinds[name]
    if version(kind.package) is None:
        raise BackendUnavailableError(name, f"pip install {kind.package}")
    return kind


@cache
def _import_all() -> None:
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
