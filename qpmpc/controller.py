"""The receding-horizon controller: observer, reference, QP, command, once per cycle."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter

import numpy as np
from numpy.typing import ArrayLike

from qpmpc.arrays import Array, all_finite
from qpmpc.backends import Backend, Limits, backend_class
from qpmpc.errors import ModelError, ShapeError
from qpmpc.expectation import Ranges, expected
from qpmpc.fallback import Fallback, Source
from qpmpc.observer import KalmanObserver
from qpmpc.problem import Problem
from qpmpc.reference import Reference
from qpmpc.residuals import Residuals
from qpmpc.solver import NO_LIMITS
from qpmpc.status import Status

_CLIP_TOLERANCE = 1e-6
"""Share of the room between the bounds that a solver's tolerance may cost without a word."""


@dataclass(frozen=True, slots=True)
class Times:
    """Where a step's time went [s]."""

    update: float
    """Observer, reference, vectors of the QP and their scaling."""
    build: float
    """Bringing new rows into the solver, and what a backend that cannot be updated takes to build
    its problem anew; 0 otherwise."""
    solve: float
    """The backend without that."""
    step: float
    """The whole step, from measurement to command."""


@dataclass(frozen=True, slots=True)
class Step:
    """What one cycle decided and how. Arrays are the step's own."""

    status: Status
    """How the solve ended."""
    source: Source
    """Where the command came from: the solve, or what stood in for it."""
    command: Array
    """u(k), to be applied now, ``(n_inputs,)``."""
    decision: Array
    """Increments Delta u(k) ... (absolute commands where so configured), ``(N_u, n_inputs)``."""
    predicted: Array
    """Outputs y(k+1) ... y(k+N) under the decision, ``(N, n_outputs)``."""
    violation: Array
    """What each row of the QP gave way, in its own unit, ``(m,)``."""
    rows: Mapping[str, slice]
    """Where each bound's rows are."""
    residuals: Residuals
    iterations: int
    times: Times

    @property
    def slack(self) -> dict[str, Array]:
        """Violation by the plan of every bound that has rows, by its name, in its unit."""
        return {name: self.violation[rows] for name, rows in self.rows.items()}

    def __repr__(self) -> str:
        return (
            f"Step({self.status}, command={np.array2string(self.command, precision=4)}, "
            f"{self.times.step * 1e6:.0f} us)"
        )


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
    ) -> None:
        """Join the parts; the backend is set up and primed here.

        Args:
            problem: the condensed problem; its model is the observer's.
            observer: the state estimate, reset to the state to begin with.
            reference: for instance an `ExponentialReference`.
            backend: a registered name or a backend class.
            limits: when the backend has to stop, in each cycle.
            smallest_part: see `Solver`.
            deadline: of every step, from its start [s]; none if not given. See `step`.
            ranges: what state and setpoint are expected to be, for backends that prepare for it.

        Raises:
            ModelError: the deadline is not positive.
            UnknownNameError, BackendUnavailableError, BackendSetupError: see `Solver`.
        """
        if deadline is not None and not deadline > 0:
            raise ModelError(f"deadline must be positive, got {deadline} s")
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
        self._prepared = True
        self.command = np.zeros(n_u)
        """The command of the last step, u(k-1) of the next one, ``(n_inputs,)``."""
        self.reset(observer.state.copy())

    def reset(self, state: ArrayLike = 0.0, command: ArrayLike = 0.0) -> None:
        """Start anew from a state estimate ``(n,)`` and the command applied so far."""
        self.observer.reset(state)
        self.command[:] = command
        self._fallback.forget()
        self._prepared = True

    def prepare(self) -> None:
        """Advance the observer under the command just applied; needs no measurement."""
        if not self._prepared:
            self.observer.predict(self.command)
            self.solver.prepare()
            self._prepared = True

    def step(self, measurement: Array, preview: Array, *, deadline: float | None = None) -> Step:
        """Decide the command of this cycle.

        Where no usable answer comes (NaN measured, infeasible, limit reached) the status tells why
        and `Fallback` decides: the last plan goes on, then the clipped closed form, then the
        command is held. What is not finite is not blended into the estimate: the observer goes on
        by prediction alone until a measurement comes.

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
        due = begin + (self.deadline if deadline is None else deadline)
        if measurement.shape != self._measured or preview.shape != self._previewed:
            self._complain(measurement, preview)
        self.prepare()
        problem, previous = self.problem, self.command
        measured = all_finite(measurement)
        state = self.observer.correct(measurement) if measured else self.observer.state
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
        self._prepared = False
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
