"""The receding-horizon controller: observer, reference, QP, command, once per cycle."""

from __future__ import annotations

from dataclasses import dataclass
from time import perf_counter
from typing import Literal, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from qpmpc.arrays import Array
from qpmpc.backends import Backend, Limits, backend_class
from qpmpc.errors import ModelError, QpmpcError, ShapeError, UnknownNameError
from qpmpc.expectation import Ranges, expected
from qpmpc.fallback import Fallback, Source
from qpmpc.native import CompiledStepError
from qpmpc.native.compiled import Code, CompiledStep, obstacle
from qpmpc.native.groups import Whole
from qpmpc.observer import KalmanObserver
from qpmpc.problem import Problem
from qpmpc.reference import ExponentialReference, Reference
from qpmpc.solver import NO_LIMITS, TOLERANCE
from qpmpc.status import Status
from qpmpc.step import CompiledRecord, Layout, Step, Times

Compiled = Literal["auto", "on", "off"]
"""Whether a step is compiled."""

_CLIP_TOLERANCE = 1e-6
"""Share of the room between the bounds that a solver's tolerance may cost without a word."""


@dataclass(frozen=True)
class Compilation:
    """Which path a controller's cycles take."""

    used: bool
    """Whether there is a compiled step."""
    reason: str | None
    """Why there is none; None where there is."""
    interpreted_cycles: int
    """Cycles that the compiled step handed over to the interpreted one."""


class Controller:
    """A receding-horizon controller for any plant that a linear model describes.

    A cycle is ``step = controller.step(measurement, preview)``, then the command is applied, then
    ``controller.prepare()`` does what needs no measurement. Who leaves `prepare` out gets it done
    at the start of the next step.
    """

    def __init__(
        self,
        problem: Problem,
        observer: KalmanObserver,
        reference: Reference,
        backend: str | type[Backend] = "daqp",
        limits: Limits = NO_LIMITS,
        *,
        smallest_part: int | None = None,
        deadline: float | None = None,
        ranges: Ranges | None = None,
        compiled: Compiled = "auto",
    ) -> None:
        """Join the parts; the backend is set up and primed here, and the step compiled.

        Args:
            problem: the condensed problem; its model is the observer's.
            observer: the state estimate, reset to the state to begin with.
            reference: for instance an `ExponentialReference`.
            backend: a registered name or a backend class.
            limits: when the backend has to stop, in each cycle.
            smallest_part: see `Solver`.
            deadline: of every step, from its start [s]; none if not given. See `step`.
            ranges: what state and setpoint are expected to be, for backends that prepare for it.
            compiled: whether to decide by a compiled step: "auto" where it can be had, "on" or not
                at all, "off" never.

        Raises:
            ModelError: the deadline is not positive.
            UnknownNameError, BackendUnavailableError, BackendSetupError: see `Solver`; ``compiled``
                is none of these.
            CompiledStepError: it is "on", and there is none; the reason is with it.
        """
        if deadline is not None and not deadline > 0:
            raise ModelError(f"deadline must be positive, got {deadline} s")
        if compiled not in get_args(Compiled):
            raise UnknownNameError("choice of compiled", compiled, get_args(Compiled))
        self.problem, self.observer, self.reference = problem, observer, reference
        kind = backend_class(backend) if isinstance(backend, str) else backend
        self.solver = problem.solver(
            kind,
            limits,
            smallest_part,
            parameters=expected(problem, ranges, reference)
            if ranges is not None and kind.takes_parameters
            else None,
        )
        self._fallback = Fallback(problem)
        self.deadline = np.inf if deadline is None else deadline
        """Time from the start of a step by which its answer has to be there [s]; infinite: none."""
        n_u, n_y = problem.model.n_inputs, problem.model.n_outputs
        self._n_u = n_u
        self._C = np.array(problem.model.C)
        self._measured, self._previewed = (observer.gain.shape[1],), (problem.horizon + 1, n_y)
        self._output = np.zeros(n_y)
        self._prepared = np.ones(1, dtype=np.int64)
        self.command = np.zeros(n_u)
        """The command of the last step, u(k-1) of the next one, ``(n_inputs,)``."""
        self.compiled: CompiledStep | None = None
        """The compiled step, where there is one; its `step` is for those who need no record."""
        self._reason: str | None = "switched off"
        if compiled != "off":
            self._compile(required=compiled == "on")
        self.reset(observer.state.copy())

    @property
    def compilation(self) -> Compilation:
        """Whether there is a compiled step, why not, and how often it handed a cycle over."""
        handed = self.compiled.interpreted if self.compiled is not None else 0
        return Compilation(self.compiled is not None, self._reason, handed)

    def reset(self, state: ArrayLike = 0.0, command: ArrayLike = 0.0) -> None:
        """Start anew from a state estimate ``(n,)`` and the command applied so far."""
        self.observer.reset(state)
        self.command[:] = command
        self._fallback.forget()
        self._prepared[0] = 1

    def overrule(self, command: ArrayLike) -> None:
        """Take note that another command ``(n_inputs,)`` is applied than that of the last step.

        Between `step` and `prepare`. The plan of that step is forgotten: it began otherwise.
        """
        self.command[:] = command
        self._fallback.forget()

    def prepare(self) -> None:
        """Advance the observer under the command just applied; needs no measurement."""
        if self.compiled is not None:
            self.compiled.prepare()
        elif not self._prepared[0]:
            self.observer.predict(self.command)
            self.solver.prepare()
            self._prepared[0] = 1

    def step(self, measurement: Array, preview: Array, *, deadline: float | None = None) -> Step:
        """Decide the command of this cycle.

        Where no usable answer comes (nothing measured for too long, infeasible, limit reached) the
        status tells why and `Fallback` decides: the last plan goes on, then the clipped closed
        form, then the command is held. What is not finite is not measured: the observer goes on
        with the rows that are, and decisions with its estimate, for as long as its patience lasts.

        The same stands in where the answer is not there by the deadline (``Status.LATE``), and
        where nothing is left of it no solve is begun. A late answer is not remembered as a plan
        either: it rests on a first move that was never made, while the plan before it goes on as
        it was made. The observer is told what was applied, as ever. Without a deadline no clock
        decides anything.

        Bounds that move and maps that change are set on `problem` before (`Problem.move`,
        `Problem.map`).

        Args:
            measurement: what the observer measures, ``(n_measured,)``.
            preview: setpoint s(k) ... s(k+N), ``(N + 1, n_outputs)``.
            deadline: what is left from now until the answer has to be there [s], not positive if
                nothing is; the controller's own `deadline` if not given.

        Raises:
            ShapeError: an argument has another shape.
        """
        begin = perf_counter()
        remaining = self.deadline if deadline is None else deadline
        if measurement.shape != self._measured or preview.shape != self._previewed:
            self._complain(measurement, preview)
        compiled = self.compiled
        if compiled is None:
            return self._interpret(measurement, preview, begin, remaining)
        code = compiled.attempt(measurement, preview, remaining)
        if code > Code.CLIPPED:
            compiled.interpreted += 1
            return self._interpret(measurement, preview, begin, remaining)
        return CompiledRecord(
            Status.CLIPPED if code else Status.SOLVED,
            compiled.values.copy(),
            self._layout,
            int(compiled.counts[0]),
            perf_counter() - begin,
        )

    def _hand_over(self, measurement: Array, preview: Array, remaining: float) -> None:
        """Decide in place of a compiled step that could not."""
        self._interpret(measurement, preview, perf_counter(), remaining)

    def _interpret(
        self, measurement: Array, preview: Array, begin: float, remaining: float
    ) -> Step:
        """Decide step by step in numpy; ``remaining``: what was left at ``begin`` [s]."""
        due = begin + remaining
        self.prepare()
        problem, previous = self.problem, self.command
        state = self.observer.correct(measurement)
        measured = self.observer.informed
        np.dot(self._C, state, out=self._output)
        problem.update(state, previous, self.reference(preview, self._output))
        updated, built = perf_counter(), 0.0
        if updated > due:
            solution = self.solver.no_answer()
        else:
            if problem.rows_changed:
                self.solver.replace_rows(problem.A)
                problem.rows_changed = False
                built = perf_counter() - updated
            solution = self.solver.solve(problem.q, problem.l, problem.u)
        status = solution.status if measured else Status.FAILED
        if measured and perf_counter() > due:
            status = Status.LATE
        if measured and status is not Status.LATE and solution.usable:
            source, decision = Source.SOLUTION, solution.x.copy()
            violation = solution.slack.copy()
            self._fallback.remember(decision, previous)
            status, command = self._clip(status, problem.command(decision, previous))
        else:
            source, command, decision = self._fallback.decide(previous, measured=measured)
            violation = problem.excess(decision)
        predicted = problem.predict(decision)
        self.command[:] = command
        self._prepared[0] = 0
        now = perf_counter()
        return Step(
            status,
            source,
            command,
            decision.reshape(-1, self._n_u),
            predicted,
            violation,
            problem.rows,
            solution.residuals,
            solution.iterations,
            Times(
                updated - begin + solution.update_time,
                built + solution.build_time,
                solution.solve_time,
                now - begin,
            ),
        )

    def _compile(self, *, required: bool) -> None:
        """Make the compiled step, or note why there is none.

        Raises:
            CompiledStepError: there is none, and it is required.
        """
        problem, solver = self.problem, self.solver
        if type(problem) is not Problem:
            form, self._reason = None, f"the problem is a {type(problem).__name__}"
        else:  # a form is not inherited: what a subclass does in another way is not in it
            form = vars(solver.kind).get("compiled")
            whole = Whole(problem, self.observer, solver.scaling)
            self._reason = obstacle(form, whole, self.reference, solver.limits.time)
        if self._reason is None and form is not None:
            shapes = (problem.moves, self._n_u), (problem.horizon, problem.model.n_outputs)
            self._layout = Layout.of(problem.rows, *shapes, problem.qp.m)
            try:
                self.compiled = CompiledStep(
                    form,
                    whole,
                    reference=cast(ExponentialReference, self.reference),
                    fallback=self._fallback,
                    command=self.command,
                    prepared=self._prepared,
                    iterations=form.iterations(
                        solver.limits.iterations, problem.qp.n + problem.qp.m
                    ),
                    interpret=self._hand_over,
                    figures={"TOLERANCE": TOLERANCE, "CLIP_TOLERANCE": _CLIP_TOLERANCE},
                )
            except QpmpcError as error:
                self._reason = str(error)
        if required and self._reason is not None:
            raise CompiledStepError(self._reason)

    def _clip(self, status: Status, command: Array) -> tuple[Status, Array]:
        """Clip a command to its bounds; say so where that is more than a solver's tolerance."""
        low, high = self.problem.limits(self.command)
        clipped = np.minimum(np.maximum(command, low), high)
        if np.count_nonzero(clipped != command):
            tolerance = _CLIP_TOLERANCE * np.minimum(high - low, 1e12)
            if status is Status.SOLVED and (np.abs(clipped - command) > tolerance).any():
                status = Status.CLIPPED
            command = clipped
        return status, command

    def _complain(self, measurement: Array, preview: Array) -> None:
        if measurement.shape != self._measured:
            raise ShapeError("measurement", str(self._measured), measurement.shape)
        raise ShapeError("preview", str(self._previewed), preview.shape)

    def __repr__(self) -> str:
        return f"Controller({self.problem!r}, backend='{self.solver.backend_name}')"
