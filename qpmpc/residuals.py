"""How far an answer is from optimal, computed by the library from the unscaled problem."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from qpmpc.arrays import Array, all_finite
from qpmpc.program import QuadraticProgram


@dataclass(frozen=True, slots=True)
class Residuals:
    """Distances from optimality. The first three are in the QP's own units."""

    primal: float
    """Largest violation of a hard row, in its unit."""
    dual: float
    """Largest entry of ``P x + q + A' y``, in cost per unit of a variable."""
    gap: float
    """Cost minus the dual's: what could be gained at most, where the other two are zero."""
    scaled: float
    """Largest violation of an optimality condition in scaled units, relative to the size of the
    problem: what an answer is judged by."""


UNKNOWN = Residuals(*[float("nan")] * 4)


class Program(Protocol):
    """What the check has to know of a QP beside its products with vectors."""

    @property
    def n(self) -> int:
        """Number of variables."""
        ...

    @property
    def m(self) -> int:
        """Number of rows."""
        ...

    @property
    def linear(self) -> Array:
        """Penalty per unit of violation of each row, ``(m,)``."""
        ...

    @property
    def quadratic(self) -> Array:
        """Penalty per squared unit, ``(m,)``."""
        ...


class Scales(Protocol):
    """What the check has to know of a scaling."""

    c: float
    E: Array

    @property
    def qp(self) -> Program:
        """The scaled program."""
        ...

    def gradient(self, g: Array, out: Array) -> Array:
        """Scale a gradient ``(n,)``, into ``out``."""
        ...

    def level(self) -> float:
        """Return the largest entry of the scaled ``q`` of the last update."""
        ...


class Products(Protocol):
    """The matrices of a QP, told by their products with vectors; each is written into ``out``."""

    def rows(self, x: Array, out: Array) -> Array:
        """Return ``A x``, ``(m,)``."""
        ...

    def slope(self, x: Array, out: Array) -> Array:
        """Return ``P x``, ``(n,)``."""
        ...

    def pull(self, y: Array, out: Array) -> Array:
        """Return ``A' y``, ``(n,)``."""
        ...


class DenseProducts:
    """Products with matrices that are there."""

    def __init__(self, P: Array, A: Array) -> None:
        self._P, self._A, self._At = np.array(P), A, np.ascontiguousarray(A.T)

    def replace_rows(self, A: Array) -> None:
        """Take other rows ``(m, n)``."""
        self._A, self._At = A, np.ascontiguousarray(A.T)

    def rows(self, x: Array, out: Array) -> Array:
        """See `Products`."""
        return np.dot(self._A, x, out=out)

    def slope(self, x: Array, out: Array) -> Array:
        """See `Products`."""
        return np.dot(self._P, x, out=out)

    def pull(self, y: Array, out: Array) -> Array:
        """See `Products`."""
        return np.dot(self._At, y, out=out)


class Check:
    """Computes the residuals of answers to one family of QPs, with memory of its own."""

    def __init__(
        self, qp: Program, scaling: Scales, tolerance: float, products: Products | None = None
    ) -> None:
        """Prepare.

        Args:
            qp: the program in its own units. scaling: of the same.
            tolerance: scaled residual below which the size of the problem is not looked at.
            products: of the program's matrices; those of its ``P`` and ``A`` if not given.
        """
        self._scaling, self._tolerance = scaling, tolerance
        if products is None:
            if not isinstance(qp, QuadraticProgram):
                raise TypeError("a program without matrices needs products")
            products = DenseProducts(qp.P, np.array(qp.A))
        self._products = products
        self._hard = np.isinf(qp.linear)
        self._linear = np.where(self._hard, 0.0, qp.linear)
        self._quadratic = np.where(self._hard, 0.0, qp.quadratic)
        self._scaled_linear = np.where(self._hard, 0.0, scaling.qp.linear)
        self._scaled_quadratic2 = 2.0 * scaling.qp.quadratic
        self._all_hard = bool(self._hard.all())
        self._curved = bool((~self._hard & (qp.quadratic > 0)).any())
        self._firm = np.flatnonzero(self._hard)
        self._firm_scale = scaling.E[self._firm]
        self._beyond = np.zeros(self._firm.size)
        self.slack = np.zeros(qp.m)
        """Violation of each row by the last answer, in its unit, ``(m,)``."""
        self._gradient, self._work = np.zeros(qp.n), np.zeros(qp.n)
        self._Ax, self._over, self._under, self._s, self._price = (np.zeros(qp.m) for _ in range(5))

    def replace_rows(self, A: Array) -> None:
        """Take other rows ``(m, n)``, unscaled, where the matrices are there."""
        if isinstance(self._products, DenseProducts):
            self._products.replace_rows(A)

    def __call__(self, q: Array, l: Array, u: Array, x: Array, y: Array) -> Residuals:  # noqa: E741
        """Return the residuals of ``x (n,)`` with multipliers ``y (m,)``, all unscaled."""
        s, over, under, gradient = self.slack, self._over, self._under, self._gradient
        Ax = self._products.rows(x, self._Ax)
        np.subtract(Ax, u, out=over)
        np.subtract(l, Ax, out=under)
        np.maximum(over, under, out=s)
        np.maximum(s, 0.0, out=s)
        self._products.slope(x, gradient)
        gradient += q
        gap = float(np.dot(x, gradient))
        primal = complementarity = scaled_primal = 0.0
        scaling = self._scaling
        violated = np.count_nonzero(s) > 0  # a third of the time of any()
        if violated:
            beyond = np.take(s, self._firm, out=self._beyond)
            primal = float(beyond.max(initial=0.0))
            beyond *= self._firm_scale
            scaled_primal = float(beyond.max(initial=0.0))
            np.multiply(scaling.E, s, out=self._s)
        else:
            self._s.fill(0.0)
        if violated or np.count_nonzero(y):
            if not all_finite(y):  # comparisons would lose it
                return UNKNOWN
            gradient += self._products.pull(y, self._work)
            gap += self._gap(y, l, u)
            complementarity = self._complementarity(y)
            if complementarity > self._tolerance:
                # Again with both in proportion: as an excuse for a large multiplier a row must be
                # near its bound by its own measure, not by that of the gradient.
                level, reach = self._sizes()
                np.subtract(Ax, u, out=over)
                np.subtract(l, Ax, out=under)
                complementarity = self._complementarity(y, level, reach) * max(level, reach)
        scaled = scaling.gradient(gradient, self._work)
        np.abs(gradient, out=gradient)
        np.abs(scaled, out=scaled)
        return Residuals(
            primal,
            float(gradient.max(initial=0.0)),
            abs(gap),
            self._relative(scaled_primal, float(scaled.max(initial=0.0)), complementarity),
        )

    def _gap(self, y: Array, l: Array, u: Array) -> float:  # noqa: E741
        """Return what rows and multipliers add to ``x' (P x + q)`` in cost minus dual cost."""
        active = np.flatnonzero(y)
        price = y[active]
        gap = float(np.dot(price, np.where(price > 0, u[active], l[active])))
        if self._all_hard:
            return gap
        s = self.slack
        gap += float(np.dot(self._linear, s))
        if not self._curved:
            return gap
        gap += float(np.dot(self._quadratic, s * s))
        excess = np.maximum(np.abs(price) - self._linear[active], 0.0)
        give = self._quadratic[active]
        curved = ~self._hard[active] & (give > 0)
        return gap + float(np.sum(excess[curved] ** 2 / (4.0 * give[curved])))

    def _complementarity(self, y: Array, level: float = 1.0, reach: float = 1.0) -> float:
        """Return how far scaled multipliers and rows are from complementary; uses up the work.

        Args:
            y: multipliers, unscaled.
            level, reach: what multipliers, and distances of rows, are measured in.
        """
        s, price, over, under = self._s, self._price, self._over, self._under
        E = self._scaling.E
        np.divide(y, E, out=price)
        price *= self._scaling.c / level
        # A row away from its bounds must have no multiplier: min(distance, multiplier) is 0 there.
        over *= E
        under *= E
        if reach != 1.0:
            over /= reach
            under /= reach
            s = s / reach
        np.negative(over, out=over)
        np.negative(under, out=under)
        np.minimum(over, price, out=over)
        np.negative(price, out=price)
        np.minimum(under, price, out=under)
        gap = max(float(over.max()), float(under.max()), 0.0)
        if self._all_hard:
            return gap
        # A soft row that gives way by s has the multiplier linear + 2 quadratic s, never more.
        left = np.abs(price, out=price)
        np.multiply(self._scaled_quadratic2, self._s, out=over)
        over += self._scaled_linear
        over /= level
        np.subtract(over, left, out=left)
        left[self._hard] = 0.0
        return max(gap, float(-left.min()), float(np.minimum(left, s, out=under).max()))

    def _relative(self, primal: float, dual: float, gap: float) -> float:
        worst = max(primal, dual, gap)
        if worst <= self._tolerance:
            return worst
        # Relative to the size of the problem: far from the setpoint all figures are large.
        level, reach = self._sizes()
        return max(primal / reach, dual / level, gap / max(level, reach))

    def _sizes(self) -> tuple[float, float]:
        """Return the size of the gradient and of the rows, one at least."""
        level = 1.0 + self._scaling.level()
        np.multiply(self._scaling.E, self._Ax, out=self._over)
        return level, 1.0 + float(np.abs(self._over).max(initial=0.0))
