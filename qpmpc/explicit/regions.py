"""Critical regions of a soft QP: the optimum as a fixed affine map for each choice of active rows.

What decides is where the rows lie at the minimiser without rows, ``r = -A P^-1 q``, beside their
bounds. Which rows are active there determines multipliers, and so the optimum, by one small matrix
(Bemporad, Morari, Dua, Pistikopoulos, Automatica 38, 2002). The optimality conditions of that
choice are the region's inequalities: a region that contains a point gives the optimum there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve
from scipy.linalg.lapack import dpocon, dpotrf, dpotri

from qpmpc.arrays import Array, Indices
from qpmpc.program import QuadraticProgram

Sides = NDArray[np.int8]
"""Of each row: 0 between its bounds, 1 at the upper one, -1 at the lower one, 2 and -2 beyond."""

Link = tuple[int, int, int]
"""Index of a region, a change of one row there (see `change`), index of the region behind."""

FAR = 1e30
"""Room to a bound that is none."""
_DEFINITE = 1e-10
"""Least eigenvalue, relative to the largest, of a Hessian that is inverted."""
_CONDITION = 1e-11
"""Reciprocal condition of the active rows' equations below which they count as dependent."""


class Family:
    """What all regions of one QP have in common."""

    def __init__(self, qp: QuadraticProgram) -> None:
        """Invert the Hessian.

        Raises:
            numpy.linalg.LinAlgError: it is not positive definite.
        """
        eigenvalues = np.linalg.eigvalsh(qp.P)
        if not eigenvalues[0] > _DEFINITE * eigenvalues[-1]:
            raise np.linalg.LinAlgError("the Hessian is not positive definite")
        self.n, self.m = qp.n, qp.m
        self._inverse = np.asarray(cho_solve(cho_factor(qp.P), np.eye(qp.n)))
        self.linear = np.array(qp.linear)
        """Penalties, ``(m,)``; infinite: hard."""
        self.firm = np.asarray(qp.quadratic <= 0)
        """Rows that pull with their penalty and no more beyond a bound, ``(m,)``."""
        self.give = np.zeros(qp.m)
        """By how much other rows give more for one unit of multiplier beyond a bound, ``(m,)``."""
        np.divide(0.5, qp.quadratic, out=self.give, where=~self.firm)
        self.replace_rows(qp.A)

    @property
    def nbytes(self) -> int:
        """Memory of what regions share [bytes]."""
        return sum(a.nbytes for a in (self.minimiser, self.rows, self.response, self.gram))

    def replace_rows(self, A: Array) -> None:
        """Take other rows ``(m, n)``."""
        # Minimiser without rows and its rows from q; what a unit of each multiplier takes away.
        self.minimiser = -self._inverse
        """From ``q`` to the minimiser without rows, ``(n, n)``."""
        self.rows = np.ascontiguousarray(A @ self.minimiser)
        """From ``q`` to the rows there, ``(m, n)``."""
        self.response = np.ascontiguousarray(self._inverse @ A.T)
        """What a unit of each multiplier takes from the minimiser, ``(n, m)``."""
        self.gram = np.ascontiguousarray(A @ self.response)
        """What a unit of each multiplier takes from the rows, ``(m, m)``."""


@dataclass(frozen=True, slots=True, eq=False)
class Region:
    """The affine map of one choice of active rows.

    The rows that are held, at a bound or beyond it by what their quadratic penalty allows, have the
    multipliers ``sign * pull`` with ``pull = shift - inverse room``, where ``room`` is the distance
    to the bound at the minimiser without rows.
    """

    key: bytes
    """Sides of all rows, a byte each."""
    held: Indices
    """Rows whose multipliers follow from equations, ``(k,)``."""
    sign: Array
    """1 where the upper bound is meant, -1 where the lower one, ``(k,)``."""
    pick: Indices
    """Where the rooms of these bounds are among all: upper ones first, ``(k,)``."""
    inverse: Array
    """``(k, k)``."""
    shift: Array
    """``(k,)``."""
    base: Array
    """Multipliers of rows beyond a bound that pull with their penalty alone, ``(m,)``; else 0."""
    low: Array
    """Least pull, ``(k,)``: 0 at a bound, the penalty beyond it."""
    high: Array
    """Largest pull, ``(k,)``: the penalty at a bound, none beyond it."""
    own: Indices
    """Where the rooms are that are zero by construction: of rows at a bound, ``(at most k,)``."""
    turn: Array | None
    """-1 for the room to a bound that the row is beyond, 1 for all others, ``(2 m,)``; None: 1."""

    @property
    def nbytes(self) -> int:
        """Memory that the region takes [bytes]."""
        arrays = (self.held, self.sign, self.pick, self.inverse, self.shift, self.base,
                  self.low, self.high, self.own)  # fmt: skip
        turn = 0 if self.turn is None else self.turn.nbytes
        return len(self.key) + turn + sum(a.nbytes for a in arrays)

    @property
    def sides(self) -> Sides:
        """Of each row, ``(m,)``."""
        return np.frombuffer(self.key, dtype=np.int8)


def region(family: Family, key: bytes) -> Region | None:
    """Return the region of a choice of active rows, or None where these are dependent.

    Args:
        family: see there. key: sides of the rows, a byte each.
    """
    sides = np.frombuffer(key, dtype=np.int8)
    m, size, sign = family.m, np.abs(sides), np.sign(sides).astype(np.float64)
    beyond = size == 2
    held = np.flatnonzero((size == 1) | (beyond & ~family.firm))
    fixed = beyond & family.firm
    base = np.zeros(m)
    base[fixed] = sign[fixed] * family.linear[fixed]
    s, k = sign[held], held.size
    K = family.gram[np.ix_(held, held)] * np.outer(s, s)
    give = np.where(beyond[held], family.give[held], 0.0)
    K[np.arange(k), np.arange(k)] += give
    inverse = _inverse(K)
    if inverse is None:
        return None
    # K pull = -room + (what the fixed rows take) + give * linear
    right = -s * (family.gram[held] @ base)
    right += np.where(beyond[held], give * np.where(beyond[held], family.linear[held], 0.0), 0.0)
    turn = None
    if beyond.any():
        turn = np.ones(2 * m)
        turn[:m][sides == 2] = -1.0
        turn[m:][sides == -2] = -1.0
    linear = family.linear[held]
    pick = np.where(s > 0, held, held + m)
    return Region(
        key, held, s, pick, inverse, inverse @ right, base, np.where(beyond[held], linear, 0.0),
        np.where(beyond[held], np.inf, linear), pick[~beyond[held]], turn,
    )  # fmt: skip


def _inverse(K: Array) -> Array | None:
    """Return the inverse of a positive definite matrix, or None where it is nearly singular."""
    k = K.shape[0]
    if not k:
        return K
    factor, failed = dpotrf(K, lower=1)
    if failed:
        return None
    condition, _ = dpocon(factor, float(np.abs(K).sum(axis=0).max()), uplo="L")
    if condition < _CONDITION:
        return None
    lower, _ = dpotri(factor, lower=1)
    lower = np.tril(lower)
    return np.ascontiguousarray(lower + np.tril(lower, -1).T)


def change(key: bytes, slot: int) -> bytes | None:
    """Return the key after one row has changed sides, or None where it has no such change.

    Row i has two slots. Between its bounds: ``2 i`` goes to the upper one, ``2 i + 1`` to the
    lower. At a bound: ``2 i`` leaves it to the inside, ``2 i + 1`` goes beyond. Beyond: ``2 i``
    comes back to the bound.
    """
    row, second = divmod(slot, 2)
    side = _side(key[row])
    if side == 0:
        new = -1 if second else 1
    elif abs(side) == 1:
        new = 2 * side if second else 0
    elif second:
        return None
    else:
        new = side // 2
    return key[:row] + bytes((new & 0xFF,)) + key[row + 1 :]


def back(key: bytes, slot: int) -> int:
    """Return the slot that undoes a change, in the region behind it."""
    row, second = divmod(slot, 2)
    side = _side(key[row])
    if side == 0 or abs(side) == 2:
        return 2 * row + (abs(side) == 2)
    return 2 * row + (0 if second else side < 0)


def _side(byte: int) -> int:
    return byte - 256 if byte > 127 else byte
