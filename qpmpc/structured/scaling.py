"""Rows and cost of a QP in stages brought to order one, as `qpmpc.scaling` does for a dense one.

There the variables are whitened by a Cholesky factor of P, ``T' P T = I``. Here the recursion is
the factor: ``P = M' Lambda M`` gives ``T = M^{-1} Lambda^{-1/2}``. Row norms ``|a T|`` do not
depend on which factor is taken. The decision itself keeps its unit, as nothing here depends on
it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from qpmpc.arrays import Array
from qpmpc.program import INFINITE
from qpmpc.structured.program import StagePart, StructuredProgram
from qpmpc.structured.recursion import recursion


class StructuredScaling:
    """A QP in stages in scaled cost and rows: objective times ``c``, rows times ``E``."""

    def __init__(self, program: StructuredProgram) -> None:
        """Compute the scaling of ``program``; rows of one group share one scale."""
        factors = [recursion(part) for part in program.parts]
        roots = [
            np.sqrt(np.diagonal(f.inverse[: part.moves], axis1=1, axis2=2)).ravel()
            for part, f in zip(program.parts, factors, strict=True)
        ]
        self.size = float(np.concatenate(roots).mean())
        """Mean diagonal of T before it is brought to the size of the decision."""
        self.c = self.size**2
        norms = np.zeros(program.m)
        for part, factor in zip(program.parts, factors, strict=True):
            there = part.rows >= 0
            spread = np.einsum("ka,iab,kb->ik", part.read, factor.covariance, part.read)
            norms[part.rows[there]] = np.sqrt(np.maximum(spread, 0.0))[there] / self.size
        for rows in program.groups:
            norms[rows] = norms[rows].max(initial=0.0)
        self.E = 1.0 / np.where(norms > 0, norms, 1.0)
        """Factor of each row, ``(m,)``."""
        self.qp = replace(program, parts=tuple(self._scaled(p) for p in program.parts))
        """The same QP, scaled."""
        self.q, self.l, self.u = np.zeros(program.n), np.zeros(program.m), np.zeros(program.m)

    def _scaled(self, part: StagePart) -> StagePart:
        E = np.array([self.E[rows[rows >= 0][0]] for rows in part.rows.T])
        return replace(
            part,
            output_weight=self.c * part.output_weight,
            decision_weight=self.c * part.decision_weight,
            read=E[:, None] * part.read,
            linear=self.c * part.linear / E,
            quadratic=self.c * part.quadratic / E**2,
        )

    def update(self, q: Array, l: Array, u: Array) -> None:  # noqa: E741
        """Write the scaled vectors into ``self.q``, ``self.l``, ``self.u``, in place."""
        np.multiply(q, self.c, out=self.q)
        np.multiply(self.E, l, out=self.l)
        np.multiply(self.E, u, out=self.u)
        np.putmask(self.l, l <= -INFINITE, -np.inf)
        np.putmask(self.u, u >= INFINITE, np.inf)

    def unscale(self, z: Array, out: Array) -> Array:
        """Copy a decision ``(n,)``, which has its own unit already."""
        np.copyto(out, z)
        return out
