"""What a backend is: set up once from the constant part of a QP, then it sees vectors only."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol

from qpmpc.arrays import Array
from qpmpc.construction import NUMPY, Construction
from qpmpc.native.forms import CompiledForm
from qpmpc.parametric import Parametric
from qpmpc.program import QuadraticProgram
from qpmpc.status import Status

LimitKind = Literal["iterations", "time"]
Fact = bool | int | float | str
"""What a backend tells about itself besides its answers."""


@dataclass(frozen=True)
class Limits:
    """When a solver has to stop, solved or not."""

    iterations: int | None = None
    """In one solve; the solver's own limit if not given."""
    time: float | None = None
    """Of one solve [s]; none if not given."""


@dataclass(slots=True)
class RawSolution:
    """What a solver says: not yet checked, in the variables it was given."""

    status: Status
    x: Array
    """Minimiser, ``(n,)``."""
    y: Array
    """Multipliers of the rows, ``(m,)``, positive at upper bounds, negative at lower ones."""
    iterations: int
    build_time: float = 0.0
    """Part of the call that was spent on building the solver's problem [s]."""


class Backend(Protocol):
    """A way to solve one family of QPs with constant ``P`` and penalties.

    An instance is made from a scaled `QuadraticProgram` (variables and rows of order one); each
    call of `solve` brings new vectors of the same sizes. Arrays of the answer may be overwritten
    by the next call. A subclass in a module of its own in this folder, decorated with
    ``@register``, is all it takes to add a solver.
    """

    name: ClassVar[str]
    """What selects it."""
    package: ClassVar[str]
    """Distribution whose version is reported, installed by ``pip install <package>``."""
    summary: ClassVar[str]
    """One line for ``pulsempc backends``."""
    heeds_rows: ClassVar[bool] = True
    """Whether answers satisfy the rows; the closed form does not look at them."""
    warm_starts: ClassVar[bool] = False
    """Whether a solve begins where the last one ended; `forget` makes it begin from nothing."""
    replaces_rows: ClassVar[bool] = False
    """Whether `replace_rows` takes a new ``A``; where it does not, a new instance is made."""
    limits: ClassVar[frozenset[LimitKind]] = frozenset()
    """Which of the `Limits` the solver has; others are refused before an instance is made."""
    smallest_part: ClassVar[int] = 8
    """Variables below which a component of a QP is not worth a call of its own: packed with others
    up to this size, the call costs less than two."""
    takes_parameters: ClassVar[bool] = False
    """Whether `expect` does anything with what is known of the vectors to come."""
    compiled: ClassVar[CompiledForm | None] = None
    """How a compiled step solves as this backend does; None: it cannot."""
    structured: ClassVar[bool] = False
    """Whether the structured form, an exact active-set method as well, may stand in for it where
    the horizon is long; see ``docs/long-horizons.md``."""
    construction: ClassVar[Construction] = NUMPY
    """Who builds the matrices of the force controller's problem for this backend."""

    def __init__(self, qp: QuadraticProgram, limits: Limits) -> None:
        """Set the solver up and prime it, so that the first `solve` costs what later ones do.

        Raises:
            BackendSetupError: the solver refuses the problem.
        """
        ...

    def replace_rows(self, A: Array) -> None:
        """Take rows ``(m, n)`` in place of the present ones; called where `replaces_rows`."""
        raise NotImplementedError

    def forget(self) -> None:
        """Forget what the next solve would start from; called where an answer fails the check."""
        return

    def expect(self, parameters: Parametric) -> None:  # noqa: ARG002
        """Prepare for the vectors that parameters give; called once, where `takes_parameters`."""
        return

    def prepare(self) -> None:
        """Do what can be done between two solves; called where there is time for it, or never."""
        return

    def facts(self) -> Mapping[str, Fact]:
        """Return what there is to tell beside the answers: sizes, bounds, counts; by name."""
        return {}

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        """Solve for new vectors ``q (n,)``, ``l (m,)``, ``u (m,)``."""
        ...


@dataclass(frozen=True)
class BackendInfo:
    """What is known about a backend without making one."""

    name: str
    summary: str
    package: str
    version: str | None
    """Version of the package, or None where the solver is not installed."""
    install: str
    """The command that installs the solver."""
    warm_starts: bool
    replaces_rows: bool
    limits: frozenset[LimitKind]


class Family(Protocol):
    """Several solvers behind one interface: ``name:variant`` selects one of them."""

    name: str

    def variants(self) -> Iterable[BackendInfo]:
        """Return every variant, installed or not."""
        ...

    def backend(self, variant: str) -> type[Backend]:
        """Return the class of a variant; an empty one means the family's own choice.

        Raises:
            UnknownNameError: there is none. BackendUnavailableError: it is not installed.
        """
        ...
