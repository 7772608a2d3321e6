"""From a control law to a controller: axes, bounds on the command, gaps in what is measured."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from qpmpc.arrays import Array, all_finite
from qpmpc.config import ControllerConfig
from qpmpc.controller import Compilation
from qpmpc.errors import BoundsError, ShapeError, UnknownNameError
from qpmpc.fallback import Source
from qpmpc.force_control import Axis, axis_bounds, check_axes
from qpmpc.joints import JointSpace
from qpmpc.native import CompiledStepError
from qpmpc.protocol import About
from qpmpc.residuals import UNKNOWN
from qpmpc.status import Status
from qpmpc.step import Step, Times

Mask = NDArray[np.bool_]
_MOVABLE = ("command", "rate", "velocity", "force")


class Law(Protocol):
    """A control law for several axes that do not know each other; works in place."""

    def reset(self, force: Array) -> None:
        """Start at rest with the given contact force ``(n_axes,)`` [N]."""
        ...

    def decide(self, force: Array, velocity: Array, setpoint: Array, known: Mask) -> Array:
        """Return the acceleration that is wished for, ``(n_axes,)`` [m/s^2], until the next call.

        Args:
            force: contact force, ``(n_axes,)`` [N].
            velocity: of the tool, ``(n_axes,)`` [m/s].
            setpoint: of this cycle, ``(n_axes,)`` [N].
            known: axes of which both were measured; on the others they are the last that were.
        """
        ...

    def settle(self, command: Array) -> None:
        """Take note of the command that was applied, ``(n_axes,)`` [m/s^2]."""
        ...

    def adopt(self, force: Array) -> None:
        """Let another force count from now on, ``(n_axes,)`` [N]: no jump from the one before."""
        ...


class LawController:
    """A controller of the contact force that follows a `Law`; see `qpmpc.protocol.ForceControl`.

    The command is clipped to its bounds, and the law is told what was applied. A law knows no bound
    on force, velocity or joints. Where a measurement is missing, the law gets the last one that
    was there and is told so; the status of such a cycle is ``failed``.
    """

    bounds_joints = False
    rows: Mapping[str, slice] = {}

    def __init__(
        self,
        law: Law,
        axes: Sequence[Axis],
        config: ControllerConfig,
        moving: Collection[str] = (),
    ) -> None:
        """Join them.

        Args:
            law: for as many axes.
            axes: which of x, y, z, in the order of the vectors of `step`.
            config: its bounds on command and rate are heeded, and its deadline.
            moving: names of bounds that `move` will change.

        Raises:
            QpmpcError: an axis is not one, a bound does not allow rest, or a compiled step is
                required.
        """
        if config.solver.compiled == "on":
            raise CompiledStepError(_NO_QP)
        self.axes = check_axes(axes)
        for name in moving:
            _check_movable(name)
        self._law, self._deadline = law, config.solver.deadline
        n = len(self.axes)
        self._bounds = {
            name: axis_bounds(name, getattr(config.bounds, name), self.axes)
            for name in ("command", "rate")
        }
        for name, (lower, upper) in self._bounds.items():
            _check_rest(name, lower, upper)
        self._command = np.zeros(n)
        self._force, self._velocity = np.zeros(n), np.zeros(n)
        self._known = np.ones(n, dtype=np.bool_)
        self._unpredicted = np.full((1, n), np.nan)
        self._prepared = True

    def reset(self, force: Array) -> None:
        """Start at rest with the given contact force ``(n_axes,)`` [N]."""
        self._force[:] = force
        self._velocity[:] = 0.0
        self._command[:] = 0.0
        self._law.reset(self._force)
        self._prepared = True

    def step(
        self, force: Array, velocity: Array, preview: Array, *, deadline: float | None = None
    ) -> Step:
        """Decide the acceleration command of this cycle; see `ForceControl.step`.

        The first row of ``preview`` is the setpoint of this cycle, the others are not looked at. A
        command that is not there by the deadline is not applied: the last one is held.

        Raises:
            ShapeError: an argument has another shape.
        """
        begin = perf_counter()
        due = self._deadline if deadline is None else deadline
        self._check(force, velocity, preview)
        self.prepare()
        known = np.isfinite(force, out=self._known)
        known &= np.isfinite(velocity)
        np.copyto(self._force, force, where=known)
        np.copyto(self._velocity, velocity, where=known)
        wished = self._law.decide(self._force, self._velocity, preview[0], known)
        status, source = Status.SOLVED, Source.SOLUTION
        if np.count_nonzero(known) < known.size:
            status, source = Status.FAILED, Source.ANALYTIC
        if not all_finite(wished):
            status, source, wished = Status.FAILED, Source.HOLD, self._command
        elif due is not None and perf_counter() - begin > due:
            status, source, wished = Status.LATE, Source.HOLD, self._command
        low, high = self.limits()
        command = np.minimum(np.maximum(wished, low), high)
        if status is Status.SOLVED and np.count_nonzero(command != wished):
            status = Status.CLIPPED
        increment = (command - self._command)[None]
        self._command[:] = command
        self._prepared = False
        took = perf_counter() - begin
        return Step(
            status,
            source,
            command,
            increment,
            self._unpredicted.copy(),
            _NO_ROWS,
            self.rows,
            UNKNOWN,
            0,
            Times(took, 0.0, 0.0, took),
        )

    def prepare(self) -> None:
        """Do what needs no measurement, after the command has been applied."""
        if not self._prepared:
            self._law.settle(self._command)
            self._prepared = True

    def beat(self) -> None:
        """Let the R peak be: no law looks at them."""

    def adopt(self, *, command: Array | None = None, force: Array | None = None) -> None:
        """Go on from what is so in place of what was decided; see `ForceControl.adopt`."""
        if command is not None:
            self._command[:] = command
        if force is not None:
            self._force[:] = force
            self._law.adopt(self._force)

    def limits(self) -> tuple[Array, Array]:
        """Return what the next command may be by command and rate bounds together."""
        (low, high), (fall, rise) = self._bounds["command"], self._bounds["rate"]
        previous = self._command
        # The command bound wins where the last command lies so far outside that both cannot hold.
        return (
            np.minimum(np.maximum(low, previous + fall), high),
            np.maximum(np.minimum(high, previous + rise), low),
        )

    def move(self, name: str, lower: Array, upper: Array) -> None:
        """Change a bound from the next step on; those on force and velocity a law does not know.

        Args:
            name: "command", "rate", "force" or "velocity".
            lower, upper: one value, one an axis, or one a step and axis, of which the first counts.

        Raises:
            UnknownNameError, BoundsError: there is no such bound, or it does not allow rest.
        """
        _check_movable(name)
        if name in self._bounds:
            shape = self._command.shape
            sides = [
                np.broadcast_to(side[0] if side.ndim > 1 else side, shape)
                for side in (np.asarray(lower, np.float64), np.asarray(upper, np.float64))
            ]
            _check_rest(name, *sides)
            self._bounds[name] = np.array(sides)

    def view(self, joints: JointSpace) -> None:
        """Leave the joints be: no law knows them."""

    def about(self) -> About:
        """Return what there is to tell: there is no QP."""
        return About(Compilation(False, _NO_QP, 0))

    def _check(self, force: Array, velocity: Array, preview: Array) -> None:
        shape = self._command.shape
        for name, value in (("force", force), ("velocity", velocity)):
            if value.shape != shape:
                raise ShapeError(name, str(shape), value.shape)
        if preview.ndim != 2 or preview.shape[1:] != shape or not len(preview):
            raise ShapeError("preview", f"(N + 1, {shape[0]})", preview.shape)


_NO_ROWS = np.zeros(0)
_NO_QP = "the controller follows a law and solves no QP"


def _check_movable(name: str) -> None:
    if name not in _MOVABLE:
        raise UnknownNameError("moving bound", name, _MOVABLE)


def _check_rest(name: str, lower: Array, upper: Array) -> None:
    if not ((lower <= 0) & (upper >= 0)).all():
        raise BoundsError(name, f"must contain 0, got [{lower.max():g}, {upper.min():g}]")
