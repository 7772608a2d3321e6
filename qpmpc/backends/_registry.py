"""The table of backends; apart from ``__init__`` so that a backend's file can import it."""

from __future__ import annotations

from typing import TypeVar

from qpmpc.backends.base import Backend

_table: dict[str, type[Backend]] = {}
B = TypeVar("B", bound=Backend)


def register(kind: type[B]) -> type[B]:
    """Enter a backend class under its ``name`` (a class decorator); a later one replaces it."""
    _table[kind.name] = kind
    return kind


def registered() -> dict[str, type[Backend]]:
    """Return the table, a copy."""
    return dict(_table)
