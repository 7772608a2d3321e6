"""The compiled step of a controller: one call from measurement to command."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from qpmpc.arrays import Array
from qpmpc.fallback import Fallback
from qpmpc.native import toolchain
from qpmpc.native.errors import CompiledStepError
from qpmpc.native.forms import CompiledForm
from qpmpc.native.groups import Whole, groups
from qpmpc.native.pack import aligned
from qpmpc.native.source import write
from qpmpc.observer import KalmanObserver
from qpmpc.problem import Problem
from qpmpc.reference import ExponentialReference
from qpmpc.scaling import Scaling

_MOST = 4_000_000
"""Numbers in the matrices of a problem up to which a compiled step is worth its memory."""


class Code(IntEnum):
    """How a compiled step ended; from `HANDED_OVER` on the interpreted path did the cycle."""

    DECIDED = 0
    """The command is that of a checked answer."""
    CLIPPED = 1
    """The same, clipped to the bounds on the command (`Status.CLIPPED`)."""
    HANDED_OVER = 2
    """The solver found no answer: infeasible, a limit reached, a breakdown."""
    NOT_MEASURED = 3
    """NaN or infinity among what was measured."""
    NOT_FINITE = 4
    """NaN or infinity among the vectors of the QP, or bounds that cross."""
    NOT_CHECKED = 5
    """The answer did not pass the check."""
    TOO_LATE = 6
    """The answer was not there by the deadline."""
    NOT_STEADY = 7
    """The observer's gain is not that of the steady state, or its gate refuses a row."""


def unfit(form: CompiledForm | None, problem: Problem, scaling: Scaling) -> str | None:
    """Return why a problem cannot have a compiled step, or None where it can.

    Args:
        form: of the backend. problem: condensed. scaling: of its QP.
    """
    entries = problem.qp.n * (3 * problem.qp.m + 2 * problem.qp.n + 3 * problem.free.size)
    if form is None:
        return "the backend has no compiled form"
    if problem.mapped:
        return f"rows of {', '.join(problem.mapped)} change in every cycle"
    if entries > _MOST:
        return f"its matrices have {entries} numbers, more than {_MOST}"
    return form.obstacle(scaling)


def obstacle(
    form: CompiledForm | None, whole: Whole, reference: object, limit_of_time: float | None
) -> str | None:
    """Return why a controller cannot have a compiled step, or None where it can."""
    if type(whole.observer) is not KalmanObserver:
        return f"the observer is a {type(whole.observer).__name__}"
    if type(reference) is not ExponentialReference:
        return f"the reference is a {type(reference).__name__}"
    if limit_of_time is not None:
        return "a limit of time is kept by the interpreted path"
    return unfit(form, whole.problem, whole.scaling)


class CompiledStep:
    """A controller's step in one call, on the memory of its interpreted parts.

    What it decides, and all that it leaves behind, is what `Controller.step` decides, to rounding.
    Observer, problem, fallback and command are the same objects, so that cycles of both paths may
    follow on each other in any order.
    """

    def __init__(
        self,
        form: CompiledForm,
        whole: Whole,
        *,
        reference: ExponentialReference,
        fallback: Fallback,
        command: Array,
        prepared: NDArray[np.int64],
        iterations: int,
        interpret: Callable[[Array, Array, float], object],
        figures: Mapping[str, float],
    ) -> None:
        """Generate, compile or load, and connect.

        Args:
            form: how the backend solves in C.
            whole, reference, fallback, command: the controller's parts.
            prepared: whether the observer's state is that of the cycle to come, ``(1,)``.
            iterations: limit of one solve.
            interpret: does a cycle that was handed over.
            figures: tolerances, as macros.

        Raises:
            QpmpcError: there is no compiler, or the solver's library is not one that is known.
        """
        problem = whole.problem
        self._interpret = interpret
        functions = form.functions()
        found = groups(whole)
        program = write(whole, found, form, figures)
        library = toolchain.compile_library(
            program.text, name="step", flags=toolchain.OPTIMISED, depends=functions.depends
        )
        form.verify(library, functions)
        self.binary = library
        self.groups = len(found)
        """How many problems are solved one after the other."""
        handle = library.handle
        handle.memory_size.restype = ctypes.c_size_t
        self.measurement = np.zeros(whole.observer.gain.shape[1])
        """What the next `call` takes as measured, ``(n_measured,)``."""
        self.preview = np.zeros((problem.horizon + 1, problem.model.n_outputs))
        """What the next `call` takes as preview, ``(N + 1, n_outputs)``."""
        self.values = np.zeros(handle.values_size())
        self.counts = np.zeros(1, dtype=np.int64)
        self.interpreted = 0
        """Cycles that were handed over to the interpreted path."""
        self._remaining = np.full(1, np.inf)
        self._until = np.inf
        present = problem.present
        shared: list[np.ndarray] = [
            self.measurement, self.preview, reference.decay,
            present.lower, present.upper, present.low, present.high, present.fall, present.rise,
            self._remaining,
            whole.observer.gate, whole.observer.missing, whole.observer.settled,
            whole.observer.state, command,
            problem.free, problem.q, problem.l, problem.u,
            fallback.plan, fallback.cursor, prepared, self.values, self.counts,
        ]  # fmt: skip
        if not all(a.flags.c_contiguous and a.dtype.itemsize == 8 for a in shared):
            raise CompiledStepError("memory of the controller is not contiguous")
        self._memory = aligned(handle.memory_size())
        self._kept = (shared, program)  # the compiled step reads them
        prototype = ctypes.PYFUNCTYPE(ctypes.c_int, ctypes.c_void_p)  # the GIL is kept: 1 us
        self._pointer = ctypes.c_void_p(self._memory.ctypes.data)
        handle.begin.restype = None
        handle.begin.argtypes = [ctypes.c_void_p] * 5 + [ctypes.c_double]
        handle.begin(
            self._pointer,
            _pointers([a.ctypes.data for a in shared]),
            _pointers([a.ctypes.data for a in program.constants]),
            _pointers([a.ctypes.data for a in program.maps]),
            _pointers(functions.addresses),
            float(iterations),
        )
        self._call = prototype(("step", handle))
        self._forget = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(("forget", handle))
        self._prepare = ctypes.PYFUNCTYPE(None, ctypes.c_void_p)(("prepare", handle))

    def forget(self) -> None:
        """Let the next solve begin from nothing, where it begins from the last active set."""
        self._forget(self._pointer)

    def prepare(self) -> None:
        """Do what needs no measurement, after the command has been applied.

        The observer is advanced, and all that is linear in state and last command is computed.
        """
        self._prepare(self._pointer)

    def attempt(self, measurement: Array, preview: Array, remaining: float) -> int:
        """Decide, unless the cycle has to be handed over; return the `Code`.

        The command is in `Controller.command` then; from `Code.HANDED_OVER` on nothing is decided.

        Args:
            measurement, preview: see `step`.
            remaining: time until the answer has to be there [s]; infinite: any.
        """
        if remaining != self._until:
            self._until = self._remaining[0] = remaining
        self.measurement[:] = measurement
        self.preview[:] = preview
        return int(self._call(self._pointer))

    def step(self, measurement: Array, preview: Array, deadline: float = math.inf) -> int:
        """Decide the command of this cycle and leave it in `Controller.command`.

        Args:
            measurement: what the observer measures, ``(n_measured,)``.
            preview: setpoint s(k) ... s(k+N), ``(N + 1, n_outputs)``.
            deadline: what is left until the answer has to be there [s]; none if not given.

        Returns:
            A `Code`. From `Code.HANDED_OVER` on the interpreted path has decided.
        """
        begin = perf_counter() if deadline < math.inf else 0.0
        code = self.attempt(measurement, preview, deadline)
        if code >= Code.HANDED_OVER:
            self.interpreted += 1
            left = deadline + begin - perf_counter() if deadline < math.inf else deadline
            self._interpret(measurement, preview, left)
        return code


def _pointers(addresses: Sequence[int]) -> ctypes.Array[ctypes.c_void_p]:
    return (ctypes.c_void_p * max(len(addresses), 1))(*addresses)
