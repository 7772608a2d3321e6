"""What a backend is: set up once from the constant part of a QP, then it sees vectors only."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

from qpmpc.arrays import Array
from qpmpc.program import QuadraticProgram
from qpmpc.status import Status


@dataclass(slots=True)
class RawSolution:
    """What a solver says: not yet checked, in the variables it was given."""

    status: Status
    x: Array
    """Minimiser, ``(n,)``."""
    y: Array
    """Multipliers of the rows, ``(m,)``, positive at upper bounds, negative at lower ones."""
    iterations: int


class Backend(Protocol):
    """A way to solve one family of QPs with constant ``P``, ``A`` and penalties.

    An instance is made from a scaled `QuadraticProgram` (variables and rows of order one); each
    call of `solve` brings new vectors of the same sizes. Arrays of the answer may be overwritten
    by the next call. A class that has these members, in a module of its own in this folder and
    decorated with ``@register``, is all it takes to add a solver.
    """

    name: ClassVar[str]
    """What selects it."""
    package: ClassVar[str]
    """Distribution whose version is reported, installed by ``pip install <package>``."""
    summary: ClassVar[str]
    """One line for ``pulsempc backends``."""
    heeds_rows: ClassVar[bool]
    """Whether answers satisfy the rows; the closed form does not look at them."""

    def __init__(self, qp: QuadraticProgram) -> None:
        """Set the solver up and prime it, so that the first `solve` costs what later ones do."""
        ...

    def forget(self) -> None:
        """Forget what the next solve would start from; called where an answer fails the check."""
        ...

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Solve for new vectors ``q (n,)``, ``l (m,)``, ``u (m,)``."""
        ...
