"""Numbers and indices as the generated C reads them: one structure, every field on a cache line."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from qpmpc.arrays import Array

LANES = 8
"""Numbers in a block of the C text."""
LINE = 64
"""Bytes of a cache line, and of a block."""
Type = Literal["block", "double", "int"]
Bytes = NDArray[np.uint8]
_BYTES: dict[Type, int] = {"block": 64, "double": 8, "int": 4}


@dataclass(frozen=True, eq=False)
class Field:
    """One member of a C structure."""

    name: str
    type: Type
    data: NDArray[np.float64] | NDArray[np.int32]
    """Its content, flat."""

    @property
    def count(self) -> int:
        """Entries of the C array; one at least, as C knows no empty ones."""
        return max(self.data.nbytes // _BYTES[self.type], 1)


def padded(size: int) -> int:
    """Return the multiple of `LANES` that holds ``size`` numbers."""
    return -(-size // LANES) * LANES


def columns(name: str, M: Array) -> Field:
    """Return ``M (rows, columns)`` column by column, each in whole blocks."""
    data = np.zeros((M.shape[1], padded(M.shape[0])))
    data[:, : M.shape[0]] = M.T
    return Field(name, "block", data.ravel())


def across(name: str, M: Array) -> Field:
    """Return ``M (rows, columns)`` row by row, each in whole blocks."""
    return columns(name, M.T)


def blocks(name: str, x: Array) -> Field:
    """Return a vector in whole blocks."""
    return columns(name, x[:, None])


def plain(name: str, x: Array) -> Field:
    """Return numbers one after the other."""
    return Field(name, "double", np.array(x, dtype=np.float64).ravel())


def integers(name: str, x: NDArray[np.integer] | Sequence[int]) -> Field:
    """Return indices or marks."""
    return Field(name, "int", np.array(x, dtype=np.int32).ravel())


def stacked(parts: Sequence[Array]) -> Array:
    """Return matrices one below the other, each padded to whole blocks."""
    width = parts[0].shape[1]
    rows = []
    for part in parts:
        rows += [part, np.zeros((padded(part.shape[0]) - part.shape[0], width))]
    return np.vstack(rows)


def declaration(structure: str, fields: Sequence[Field]) -> str:
    """Return the C text of a structure."""
    lines = [f"  {f.type} {f.name}[{f.count}] __attribute__((aligned({LINE})));" for f in fields]
    return "\n".join([f"struct {structure} {{", *lines, "};\n"])


def image(fields: Sequence[Field]) -> Bytes:
    """Return the structure's content, as it lies in memory."""
    sizes = [-(-max(f.data.nbytes, 1) // LINE) * LINE for f in fields]
    memory = aligned(sum(sizes))
    at = 0
    for field, size in zip(fields, sizes, strict=True):
        memory[at : at + field.data.nbytes] = field.data.view(np.uint8)
        at += size
    return memory


def aligned(size: int) -> Bytes:
    """Return ``size`` bytes of zero that begin on a cache line."""
    room = np.zeros(size + LINE, dtype=np.uint8)
    start = -room.ctypes.data % LINE
    return room[start : start + size]
