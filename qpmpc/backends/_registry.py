"""The tables of backends; apart from ``__init__`` so that a backend's file can import them."""

from __future__ import annotations

import importlib.metadata
from typing import TypeVar

from qpmpc.backends.base import Backend, BackendInfo, Family

_table: dict[str, type[Backend]] = {}
_families: dict[str, Family] = {}
B = TypeVar("B", bound=Backend)


def register(kind: type[B]) -> type[B]:
    """Enter a backend class under its ``name`` (a class decorator); a later one replaces it."""
    _table[kind.name] = kind
    return kind


def register_family(family: Family) -> None:
    """Enter a family of backends under its ``name``; a later one replaces it."""
    _families[family.name] = family


def registered() -> dict[str, type[Backend]]:
    """Return the table of single backends, a copy."""
    return dict(_table)


def families() -> dict[str, Family]:
    """Return the table of families, a copy."""
    return dict(_families)


def describe(kind: type[Backend]) -> BackendInfo:
    """Return what a class says of itself, and which version of its package is installed."""
    return BackendInfo(
        kind.name,
        kind.summary,
        kind.package,
        version(kind.package),
        f"pip install {kind.package}",
        kind.warm_starts,
        kind.replaces_rows,
        kind.limits,
    )


def version(package: str) -> str | None:
    """Return the version of an installed distribution, or None."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return None
