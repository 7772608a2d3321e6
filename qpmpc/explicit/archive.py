"""Enumerations that were made before, in the cache: which rows are active in each region."""

from __future__ import annotations

import hashlib
import io
from dataclasses import fields
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from qpmpc.arrays import Array
from qpmpc.explicit.enumeration import STEPS, THIN, Enumeration
from qpmpc.explicit.regions import Family, region
from qpmpc.native.cache import DIGEST, folder, sound, store, workplace
from qpmpc.native.errors import CacheError
from qpmpc.parametric import Parametric
from qpmpc.program import QuadraticProgram

_FORMAT = "1"
"""Of the files; another one makes all of them anew."""


def name_of(qp: QuadraticProgram, parameters: Parametric, limits: tuple[int, ...]) -> str:
    """Return the name of the file for a QP, what is known of its vectors, and limits."""
    digest = hashlib.sha256(repr((_FORMAT, THIN, STEPS, limits, qp.n, qp.m)).encode())
    for each in (qp.P, qp.A, qp.linear, qp.quadratic):
        digest.update(_rounded(each))
    for part in fields(parameters):
        array: Array = getattr(parameters, part.name)
        digest.update(repr(array.shape).encode() + _rounded(array))
    return f"regions-{digest.hexdigest()[:40]}.npz"


def _rounded(array: Array) -> bytes:
    """Return what rounding leaves alone: three equal axes are equal but for their last digits."""
    size = float(np.abs(array[np.isfinite(array)]).max(initial=0.0)) or 1.0
    return bytes((np.round(array / size, 9) + 0.0).tobytes()) + f"{size:.9g}".encode()


def load(name: str, family: Family) -> Enumeration | None:
    """Return what was stored, or None where it is not there or not whole.

    Raises:
        CacheError: see `qpmpc.native.cache.folder`.
    """
    path = folder() / name
    if not sound(path):
        return None
    try:
        with np.load(io.BytesIO(path.read_bytes()[:-DIGEST]), allow_pickle=False) as file:
            sides, links, told = file["sides"], file["links"], file["told"]
        regions = [region(family, row.tobytes()) for row in sides.astype(np.int8)]
        complete, lost, covered = bool(told[0]), int(told[1]), float(told[2])
    except (OSError, ValueError, KeyError, IndexError, BadZipFile):
        return None
    if sides.shape[1:] != (family.m,) or links.shape[1:] != (3,) or None in regions:
        return None
    kept = [each for each in regions if each is not None]
    edges = [(int(i), int(slot), int(j)) for i, slot, j in links]
    return Enumeration(kept, edges, complete, lost, covered)


def save(name: str, found: Enumeration, rows: int) -> None:
    """Store an enumeration, at once or not at all.

    Raises:
        CacheError: the folder cannot be used, or not be written to.
    """
    place = folder()
    sides = np.array([each.sides for each in found.regions], dtype=np.int8)
    told = np.array([found.complete, found.lost, found.covered], dtype=np.float64)
    with workplace(place) as under_way:
        made = Path(under_way, "made.npz")
        try:
            with made.open("wb") as file:
                np.savez_compressed(
                    file,
                    sides=sides.reshape(len(found.regions), rows),
                    links=np.array(found.links, dtype=np.int32).reshape(-1, 3),
                    told=told,
                )
            store(made, place / name)
        except OSError as error:
            raise CacheError(place, f"cannot be written to ({error.strerror})") from error
