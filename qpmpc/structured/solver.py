"""Between a QP in stages and its engines: scaling before, the library's check after."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from qpmpc.arrays import Array
from qpmpc.backends import Fact, Limits, RawSolution
from qpmpc.errors import BackendSetupError
from qpmpc.native.errors import CacheError, CompilationError, CompilerUnavailableError
from qpmpc.residuals import Check
from qpmpc.solver import NO_LIMITS, TOLERANCE, Solver
from qpmpc.split import worst
from qpmpc.status import Status
from qpmpc.structured.compiled import CompiledEngine
from qpmpc.structured.engine import Engine, NumpyEngine
from qpmpc.structured.program import StructuredProgram
from qpmpc.structured.scaling import StructuredScaling

Compiled = Literal["auto", "on", "off"]
"""Whether engines are compiled: where a compiler is there, always (or an error), never."""
NAME = "riccati"
"""What the solver of the structured form is called."""


def engines(
    program: StructuredProgram, compiled: Compiled, iterations: int | None = None
) -> list[Engine]:
    """Return an engine for each part.

    Raises:
        CompilerUnavailableError, CompilationError, CacheError: ``on``, and it cannot be.
    """
    if compiled != "off":
        try:
            return [CompiledEngine(program, part, iterations) for part in program.parts]
        except (CompilerUnavailableError, CompilationError, CacheError):
            if compiled == "on":
                raise
    return [NumpyEngine(program, part, iterations) for part in program.parts]


class Assembled:
    """The parts of a QP in stages as one: products with its matrices, which are nowhere."""

    def __init__(self, program: StructuredProgram, compiled: Compiled) -> None:
        """Factor each part; errors as for `engines`."""
        self._engines = engines(program, compiled)
        self._none = np.zeros(program.n), np.zeros(program.m)

    @property
    def compiled(self) -> bool:
        """Whether compiled code does the work."""
        return all(isinstance(engine, CompiledEngine) for engine in self._engines)

    def rows(self, x: Array, out: Array) -> Array:
        """Return ``A x``, in ``out``."""
        for engine in self._engines:
            engine.rows(x, out)
        return out

    def slope(self, x: Array, out: Array) -> Array:
        """Return ``P x``, in ``out``."""
        return self._gradient(x, self._none[1], out)

    def pull(self, y: Array, out: Array) -> Array:
        """Return ``A' y``, in ``out``."""
        return self._gradient(self._none[0], y, out)

    def _gradient(self, x: Array, y: Array, out: Array) -> Array:
        for engine in self._engines:
            engine.gradient(x, y, out)
        return out

    def outputs(self, x: Array, out: Array) -> Array:
        """Return ``Theta x``, in ``out``."""
        for engine in self._engines:
            engine.outputs(x, out)
        return out

    def output_gradient(self, error: Array, out: Array) -> Array:
        """Return ``Theta' error``, in ``out``."""
        for engine in self._engines:
            engine.output_gradient(error, out)
        return out

    def minimise(self, q: Array, out: Array) -> Array:
        """Return ``-P^{-1} q``, in ``out``."""
        for engine in self._engines:
            engine.minimise(q, out)
        return out

    def whiten(self, g: Array, out: Array) -> Array:
        """Return ``T' g`` with ``T' P T = I``, in ``out``."""
        for engine in self._engines:
            engine.whiten(g, out)
        return out


class _Scales(StructuredScaling):
    """The scaling, with what the check asks of it."""

    def __init__(self, program: StructuredProgram, products: Assembled) -> None:
        super().__init__(program)
        self._products, self._work = products, np.zeros(program.n)

    def gradient(self, g: Array, out: Array) -> Array:
        self._products.whiten(g, out)
        out *= self.size
        return out

    def level(self) -> float:
        self.gradient(self.q, self._work)
        return float(np.abs(self._work).max(initial=0.0)) / self.c


class _Parts:
    """The engines that solve, which answer together."""

    def __init__(self, program: StructuredProgram, compiled: Compiled, limits: Limits) -> None:
        self._engines, self._of = engines(program, compiled, limits.iterations), program.parts
        self._answer = RawSolution(Status.SOLVED, np.zeros(program.n), np.zeros(program.m), 0)

    def __len__(self) -> int:
        return len(self._engines)

    def forget(self) -> None:
        for engine in self._engines:
            engine.forget()

    def prepare(self) -> None:
        """Nothing can be done before the vectors are there."""

    def facts(self) -> list[Mapping[str, Fact]]:
        """Return sizes and the engine of each part."""
        return [
            {
                "solver": NAME,
                "compiled": isinstance(engine, CompiledEngine),
                "states": part.n,
                "inputs": part.m,
                "horizon": part.horizon,
            }
            for engine, part in zip(self._engines, self._of, strict=True)
        ]

    def solve(self, q: Array, l: Array, u: Array) -> RawSolution:  # noqa: E741
        answer = self._answer
        answer.status, answer.iterations = Status.SOLVED, 0
        for engine in self._engines:
            status, steps = engine.solve(q, l, u, answer.x, answer.y)
            answer.iterations += steps
            answer.status = worst(answer.status, status)
        return answer


class StructuredSolver(Solver):
    """A `Solver` for QPs in stages: set up once, then it sees vectors, which may be long."""

    def __init__(
        self,
        program: StructuredProgram,
        products: Assembled,
        *,
        limits: Limits = NO_LIMITS,
        compiled: Compiled = "auto",
    ) -> None:
        """Scale and factor.

        Args:
            program: the QP. products: of the same.
            limits: of iterations; each part has as many.
            compiled: as for `engines`.

        Raises:
            BackendSetupError: a limit of time, which there is not, or one that is not positive.
        """
        if limits.time is not None:
            raise BackendSetupError(NAME, "has no limit of time (it has: iterations)")
        if limits.iterations is not None and not limits.iterations > 0:
            raise BackendSetupError(
                NAME, f"limit of iterations must be positive, got {limits.iterations}"
            )
        scaling = _Scales(program, products)
        self._set_up(
            NAME,
            scaling,
            _Parts(scaling.qp, compiled, limits),
            Check(program, scaling, TOLERANCE, products),
            heeds_rows=True,
            again=True,
        )

    def replace_rows(self, A: Array) -> None:  # noqa: ARG002
        """Refuse: there is no matrix of rows to be replaced.

        Raises:
            BackendSetupError: always.
        """
        raise BackendSetupError(NAME, "the structured form has no rows that change")
