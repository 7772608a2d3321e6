"""Numbers of a page in one compact text: columns, and a header that says what they are for."""

import base64
import hashlib
import json
import struct
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray


class Payload:
    """Columns of numbers; equal ones are kept once.

    Encoded: length of the header (uint32), header in JSON padded to four bytes, columns; all
    deflated, in base 64. Bytes of floats are laid out by significance, which packs a tenth better.
    """

    def __init__(self) -> None:
        self._known: dict[bytes, int] = {}
        self._blobs: list[bytes] = []
        self._told: list[dict[str, Any]] = []

    def add(self, values: NDArray[Any]) -> int:
        """Keep a column ``(n,)``, floats as float32 and the rest as uint16; return its number."""
        kind = "f" if np.issubdtype(values.dtype, np.floating) else "u"
        blob = np.ascontiguousarray(values, dtype="<f4" if kind == "f" else "<u2").tobytes()
        key = kind.encode() + hashlib.sha256(blob).digest()
        if key not in self._known:
            self._known[key] = len(self._blobs)
            self._told.append({"kind": kind, "length": int(values.size)})
            self._blobs.append(blob if kind == "u" else _by_significance(blob))
        return self._known[key]

    def encode(self, header: dict[str, Any]) -> str:
        """Return columns and ``header`` as text of letters, digits, ``+``, ``/`` and ``=``."""
        told = json.dumps(header | {"columns": self._told}, allow_nan=False).encode()
        told += b" " * (-len(told) % 4)
        return packed(b"".join([struct.pack("<I", len(told)), told, *self._blobs]))


def packed(raw: bytes) -> str:
    """Return bytes deflated, in base 64."""
    return base64.b64encode(zlib.compress(raw, 6)).decode()


def _by_significance(blob: bytes) -> bytes:
    return np.frombuffer(blob, dtype=np.uint8).reshape(-1, 4).T.tobytes()
