"""Where the vectors of a QP come from: affine maps of parameters that are known within bounds."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from qpmpc.arrays import Array, Indices


@dataclass(frozen=True, eq=False)
class Parametric:
    """A family of QPs over parameters ``v`` in ``[-1, 1]^d``.

        q = gradient v + q0,     l = l0 - offset v,     u = u0 - offset v

    What is known about the vectors to come, for backends that prepare for all of them. It is no
    promise: vectors may lie outside.
    """

    gradient: Array
    """``(n, d)``."""
    q0: Array
    """``(n,)``."""
    offset: Array
    """``(m, d)``."""
    l0: Array
    """``(m,)``, may be -inf."""
    u0: Array
    """``(m,)``, may be +inf."""

    @property
    def size(self) -> int:
        """Number of parameters d."""
        return int(self.gradient.shape[1])

    def vectors(self, v: Array) -> tuple[Array, Array, Array]:
        """Return q, l, u for parameters ``(d,)``."""
        offset = self.offset @ v
        return self.gradient @ v + self.q0, self.l0 - offset, self.u0 - offset

    def part(self, variables: Indices, rows: Indices) -> Parametric:
        """Return what some variables and rows see of it, without parameters that move nothing."""
        gradient, offset = self.gradient[variables], self.offset[rows]
        moves = (gradient != 0).any(axis=0) | (offset != 0).any(axis=0)
        return Parametric(
            np.ascontiguousarray(gradient[:, moves]),
            self.q0[variables],
            np.ascontiguousarray(offset[:, moves]),
            self.l0[rows],
            self.u0[rows],
        )
