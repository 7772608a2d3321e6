"""The same as `qpmpc.structured.engine`, in C: compiled for the sizes of a part, once for each."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qpmpc.arrays import Array
from qpmpc.native.toolchain import compile_library
from qpmpc.status import Status
from qpmpc.structured.activeset import EQUAL, ITERATIONS, LINEAR, LOOSEST, TOLERANCE
from qpmpc.structured.passes import Passes
from qpmpc.structured.program import StagePart, StructuredProgram

_STATUS = (Status.SOLVED, Status.FAILED, Status.INFEASIBLE, Status.ITERATION_LIMIT)
"""In the order of the C text's."""
_REMEMBERED = 64
"""Arrays whose address is kept; the vectors of a solver are a dozen."""
_INTEGERS = ("horizon", "moves", "limit")
_NUMBERS = ("tolerance", "loosest", "equal_room", "linear_share")
_POINTERS = (
    "F", "F_held", "G", "read", "output", "output_weight", "decision_weight", "price", "give",
    "rows", "variables", "outputs",
    "closed", "closed_t", "gain", "inverse", "root", "noise", "covariance", "weak",
    "state", "multiplier",
    "q", "l", "u", "feed", "decision", "value", "spare", "slope", "after", "step", "before",
    "seen_gain", "seen_weight", "seen", "equal", "met",
)  # fmt: skip


class _Part(ctypes.Structure):
    """``Part`` of the C text, field by field."""

    _fields_ = (
        *((name, ctypes.c_int64) for name in _INTEGERS),
        *((name, ctypes.c_double) for name in _NUMBERS),
        *((name, ctypes.c_void_p) for name in _POINTERS),
        ("steps", ctypes.c_int64),
    )


class CompiledEngine:
    """See `qpmpc.structured.engine.Engine`; all memory is numpy's, and made once."""

    def __init__(self, program: StructuredProgram, part: StagePart, iterations: int | None) -> None:
        """Factor and compile.

        Raises:
            CompilerUnavailableError, CompilationError, CacheError: see `compile_library`.
        """
        library = _library(part.n, part.m, len(part.read), len(part.output))
        self._memory = _memory(program, part)
        self._c = _Part(
            horizon=part.horizon, moves=part.moves, limit=iterations or ITERATIONS,
            tolerance=TOLERANCE, loosest=LOOSEST, equal_room=EQUAL, linear_share=LINEAR,
        )  # fmt: skip
        for name in _POINTERS:
            setattr(self._c, name, self._memory[name].ctypes.data)
        self._solve = _function(library, "solve", 5, ctypes.c_int)
        self._minimise = _function(library, "minimise", 2)
        self._outputs = _function(library, "outputs", 2)
        self._output_gradient = _function(library, "output_gradient", 2)
        self._rows = _function(library, "rows", 2)
        self._gradient = _function(library, "gradient", 3)
        self._whiten = _function(library, "whiten", 2)
        self._this, self._at = ctypes.byref(self._c), _Addresses()

    def forget(self) -> None:
        """See `Engine`."""
        self._memory["state"].fill(0)
        self._memory["multiplier"].fill(0)

    def solve(self, q: Array, l: Array, u: Array, x: Array, y: Array) -> tuple[Status, int]:  # noqa: E741
        """See `Engine`."""
        flag = self._solve(
            self._this, self._at(q), self._at(l), self._at(u), self._at(x), self._at(y)
        )
        return _STATUS[flag], self._c.steps

    def minimise(self, q: Array, out: Array) -> None:
        """See `Engine`."""
        self._minimise(self._this, self._at(q), self._at(out))

    def outputs(self, x: Array, out: Array) -> None:
        """See `Engine`."""
        self._outputs(self._this, self._at(x), self._at(out))

    def output_gradient(self, error: Array, out: Array) -> None:
        """See `Engine`."""
        self._output_gradient(self._this, self._at(error), self._at(out))

    def rows(self, x: Array, out: Array) -> None:
        """See `Engine`."""
        self._rows(self._this, self._at(x), self._at(out))

    def gradient(self, x: Array, y: Array, out: Array) -> None:
        """See `Engine`."""
        self._gradient(self._this, self._at(x), self._at(y), self._at(out))

    def whiten(self, g: Array, out: Array) -> None:
        """See `Engine`."""
        self._whiten(self._this, self._at(g), self._at(out))


def _function(
    library: ctypes.CDLL, name: str, vectors: int, result: type[ctypes.c_int] | None = None
) -> Callable[..., int]:
    function = library[name]
    function.argtypes, function.restype = [ctypes.c_void_p] * (1 + vectors), result
    return function


@cache
def _library(states: int, inputs: int, readings: int, outputs: int) -> ctypes.CDLL:
    sizes = {"STATES": states, "INPUTS": inputs, "READINGS": readings, "OUTPUTS": outputs}
    text = resources.files("qpmpc.structured").joinpath("core.c").read_text(encoding="utf-8")
    head = "".join(f"#define {name} {size}\n" for name, size in sizes.items())
    return compile_library(head + text, name="structured").handle


class _Addresses:
    """Where arrays lie; numpy takes a microsecond to tell, so it is remembered."""

    def __init__(self) -> None:
        self._known: dict[int, tuple[Array, ctypes.c_void_p]] = {}

    def __call__(self, array: Array) -> ctypes.c_void_p:
        """Return the address of a contiguous array."""
        found = self._known.get(id(array))
        if found is not None:
            return found[1]
        address = ctypes.c_void_p(array.ctypes.data)
        if len(self._known) < _REMEMBERED:
            self._known[id(array)] = array, address  # as long as it is here its number is its own
        return address


def _memory(program: StructuredProgram, part: StagePart) -> dict[str, NDArray[Any]]:
    passes = Passes(part)
    factor, N, n, m = passes.factor, part.horizon, part.n, part.m
    k, p, size = len(part.read), len(part.output), part.rows.size
    root = np.zeros_like(factor.inverse)
    root[: part.moves] = np.linalg.cholesky(factor.inverse[: part.moves])
    curved = np.isfinite(part.linear) & (part.quadratic > 0)
    constant: dict[str, Any] = {
        "F": part.dynamics.F, "F_held": part.dynamics.F_held, "G": part.dynamics.G,
        "read": part.read, "output": part.output, "output_weight": part.output_weight,
        "decision_weight": part.decision_weight, "price": part.linear,
        "give": np.where(curved, 0.5 / np.where(curved, part.quadratic, 1.0), 0.0),
        "closed": factor.closed, "closed_t": factor.closed.transpose(0, 2, 1),
        "gain": factor.gain, "inverse": factor.inverse, "root": root, "noise": factor.noise,
        "covariance": factor.covariance, "weak": passes.noise,
    }  # fmt: skip
    numbers = {
        "rows": part.rows, "variables": program.variables(part), "outputs": program.outputs(part),
        "seen": np.zeros(size),
    }  # fmt: skip
    work = {
        "multiplier": size, "q": N * m, "l": size, "u": size, "feed": N * m, "decision": N * m,
        "value": size, "spare": N * p, "slope": size, "after": size, "step": size, "before": size,
        "seen_gain": size * n, "seen_weight": size,
    }  # fmt: skip
    return {
        **{name: np.array(value, dtype=np.float64, order="C") for name, value in constant.items()},
        **{name: np.array(value, dtype=np.int64, order="C") for name, value in numbers.items()},
        **{name: np.zeros(max(count, 1)) for name, count in work.items()},
        **{name: np.zeros(N * k, dtype=np.int8) for name in ("state", "equal", "met")},
    }
