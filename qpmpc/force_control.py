"""The force controller of the paper, put together from the general parts."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from time import perf_counter
from typing import Literal, get_args

import numpy as np
from scipy.linalg import block_diag

from qpmpc.arrays import Array
from qpmpc.axis import RHYTHMIC, Quantity, axis_model
from qpmpc.backends import Backend, Limits, backend_class
from qpmpc.bounds import Bound, CommandBound, MappedBound, OutputBound, RateBound
from qpmpc.cone import force_cone
from qpmpc.config import Band, ControllerConfig, PerAxis, SoftBoundName
from qpmpc.controller import Controller
from qpmpc.errors import BoundsError, UnknownNameError
from qpmpc.expectation import Ranges
from qpmpc.forms import pose
from qpmpc.joints import JointSpace
from qpmpc.models import LinearModel, stack
from qpmpc.observer import KalmanObserver
from qpmpc.penalties import SoftBound, ordered
from qpmpc.protocol import About
from qpmpc.reference import ExponentialReference
from qpmpc.rhythm.bounds import ShiftedBounds
from qpmpc.rhythm.preview import MotionPreview
from qpmpc.step import Step

Axis = Literal["x", "y", "z"]
_MOVABLE = ("command", "rate", "velocity", "force")
_AT_REST = ("command", "rate", "velocity")
"""Bounds that have to allow zero."""


class ForceController:
    """Controls the contact force on one to three axes; packs measurements for the general parts."""

    def __init__(
        self,
        config: ControllerConfig,
        axes: Sequence[Axis],
        period: float,
        backend: str | type[Backend] = "daqp",
        *,
        joints: JointSpace | None = None,
        moving: Collection[str] = (),
    ) -> None:
        """Build models, observer, problem and solver.

        Args:
            config: see there.
            axes: which of x, y, z, in the order of the vectors of `step`.
            period: control period [s].
            backend: a registered name or a backend class.
            joints: a typical view of the joints, where the configuration bounds them.
            moving: names of bounds that `move` will change.

        Raises:
            QpmpcError: an argument is out of range, or no observer or no backend can be had.
        """
        self.axes = check_axes(axes)
        for bound in moving:
            if bound not in _MOVABLE:
                raise UnknownNameError("moving bound", bound, _MOVABLE)
        kind = backend_class(backend) if isinstance(backend, str) else backend
        self._bounds, self._joints = config.bounds, joints
        bounds = config.bounds
        self.bounds_joints = bool(np.isfinite([bounds.joints.speed, bounds.joints.torque]).any())
        """Whether `view` has to be told the joints before each step."""
        count = len(self.axes)
        axis = axis_model(
            config.model,
            config.observer,
            period,
            tool_velocity=self.bounds_joints
            or "velocity" in moving
            or bool(np.isfinite(axis_bounds("velocity", bounds.velocity, self.axes)).any()),
            construction=kind.construction,
        )
        model = stack([axis.model] * count)
        velocity = block_diag(*[axis.velocity] * count)
        soft = ordered(
            self._soft_bounds(model, velocity, moving),
            model,
            config.horizon,
            output_weight=config.force_weight,
            largest_error=bounds.largest_error,
            control_horizon=config.control_horizon,
            decision=config.decision,
            construction=kind.construction,
        )
        limits = Limits(config.solver.max_iterations, config.solver.time_limit)
        problem, self.form_reason = pose(
            model,
            config.horizon,
            backend=kind,
            form=config.solver.form,
            compiled=config.solver.compiled,
            limits=limits,
            control_horizon=config.control_horizon,
            decision=config.decision,
            output_weight=config.force_weight,
            increment_weight=config.increment_weight,
            bounds=[*self._hard_bounds(moving), *soft],
        )
        observer = KalmanObserver(
            model,
            block_diag(*[axis.measured] * count),
            block_diag(*[axis.process_noise] * count),
            block_diag(*[axis.measurement_noise] * count),
            patience=round(config.observer.patience / period),
            gate=np.tile(axis.gate, count),
            prior=np.tile(axis.prior, count),
        )
        reference = ExponentialReference(config.horizon, count, period, config.reference_time)
        self.ranges = self._ranges(config, axis.quantities, period)
        """What states and setpoint are expected to be; see `qpmpc.expectation`."""
        self.general = Controller(
            problem, observer, reference, kind, limits,
            smallest_part=config.solver.smallest_part, deadline=config.solver.deadline,
            ranges=self.ranges,
            compiled=config.solver.compiled,
        )  # fmt: skip
        self._measurement = np.zeros((count, axis.measured.shape[0]))
        self.preview: MotionPreview | None = None
        """What is known ahead of the tissue's motion, where the disturbance is rhythmic."""
        if config.observer.disturbance in RHYTHMIC:
            self.preview = MotionPreview(
                config.model, config.observer, count, period, config.horizon
            )
            self._shifted = ShiftedBounds(
                problem,
                {b.name: b for b in soft if isinstance(b, OutputBound) and b.name != "velocity"},
            )

    @property
    def rows(self) -> Mapping[str, slice]:
        """Where each bound's rows are in `Step.violation`."""
        return self.general.problem.rows

    def about(self) -> About:
        """Return what there is to tell at the end of a run."""
        form = {"name": self.general.problem.form, "reason": self.form_reason}
        return About(self.general.compilation, form, self.general.solver.facts())

    def reset(self, force: Array) -> None:
        """Start at rest with the given contact force ``(n_axes,)`` [N]."""
        state = np.zeros((len(self.axes), self.general.problem.model.n_states // len(self.axes)))
        if self.preview is None:
            state[:, 0] = force
        else:  # the tool begins where it is, and all the force counts as the tissue's
            self.preview.reset()
        self.general.reset(state.ravel())

    def step(
        self, force: Array, velocity: Array, preview: Array, *, deadline: float | None = None
    ) -> Step:
        """Decide the acceleration command of this cycle.

        Args:
            force: measured contact force, ``(n_axes,)`` [N].
            velocity: the tool's velocity from its encoders, ``(n_axes,)`` [m/s].
            preview: setpoint s(k) ... s(k+N), ``(N + 1, n_axes)`` [N].
            deadline: what is left until the answer has to be there [s], see `Controller.step`.
        """
        known = self.preview
        if known is None:
            return self.general.step(self.measured(force, velocity), preview, deadline=deadline)
        begin = perf_counter()
        known.update(force, velocity)
        self._shifted.shift(known.motion[1:])
        left = self.general.deadline if deadline is None else deadline
        step = self.general.step(
            self.measured(known.tool, velocity),
            preview - known.motion,
            deadline=left - (perf_counter() - begin),
        )
        step.predicted[...] += known.motion[1:]
        return step

    def beat(self) -> None:
        """Tell that an R peak has come since the last step; heeded by ``beats`` alone."""
        if self.preview is not None:
            self.preview.beat()

    def measured(self, force: Array, velocity: Array) -> Array:
        """Return force and velocity as the observer takes them, valid until the next call."""
        self._measurement[:, 0] = force
        if self._measurement.shape[1] > 1:
            self._measurement[:, 1] = velocity
        return self._measurement.reshape(-1)

    def prepare(self) -> None:
        """Do what needs no measurement, after the command has been applied."""
        self.general.prepare()
        if self.preview is not None:
            self.preview.advance()

    def adopt(self, *, command: Array | None = None, force: Array | None = None) -> None:
        """Go on from what is so in place of what was decided or expected.

        Args:
            command: applied in place of that of the last step, ``(n_axes,)`` [m/s^2]; between
                `step` and `prepare`.
            force: contact force that the estimate counts from now on, ``(n_axes,)`` [N]: after
                `step`, that of this cycle; after `prepare`, that of the next.
        """
        if command is not None:
            self.general.overrule(command)
        if force is not None and self.preview is not None:
            self.preview.adopt(force)
        elif force is not None:
            state = self.general.observer.state
            state.reshape(len(self.axes), -1)[:, 0] = force

    def move(self, name: str, lower: Array, upper: Array) -> None:
        """Change a bound from the next step on; margins are kept as configured.

        Args:
            name: "command", "rate", "force" or "velocity".
            lower, upper: one value, one an axis, or one a step and axis.

        Raises:
            UnknownNameError, BoundsError: see `Problem.move`.
        """
        margin = getattr(self._bounds, f"{name}_margin", 0.0)
        sides = _tightened(name, lower, upper, margin)
        if self.preview is not None and name in self._shifted:
            self._shifted.move(name, *sides)
        else:
            self.general.problem.move(name, *sides)

    def view(self, joints: JointSpace) -> None:
        """Take the joints as they are now; before each step, where `bounds_joints`."""
        problem, share = self.general.problem, self._bounds.joints
        if np.isfinite(share.speed):
            problem.map("joint_speed", joints.speed_gain, joints.speed_offset)
        if np.isfinite(share.torque):
            offset = joints.torque_offset
            if self.preview is not None:  # expected for this cycle by the one before
                offset = offset + joints.force_gain @ self.preview.motion[1]
            problem.map("joint_torque", _torque_map(joints), offset)

    def _hard_bounds(self, moving: Collection[str]) -> list[Bound]:
        result: list[Bound] = []
        for kind, band in ((CommandBound, self._bounds.command), (RateBound, self._bounds.rate)):
            sides = axis_bounds(kind.name, band, self.axes)
            low, high = _tightened(kind.name, sides[0], sides[1], 0.0)
            result.append(kind(low, high, moving=kind.name in moving))
        return result

    def _soft_bounds(
        self, model: LinearModel, velocity: Array, moving: Collection[str]
    ) -> list[SoftBound]:
        """Return the soft bounds that are configured, strongest first, without penalties."""
        bounds = self._bounds
        if sorted(bounds.order) != sorted(get_args(SoftBoundName)):
            names = ", ".join(get_args(SoftBoundName))
            raise BoundsError("order", f"must name each of {names} once, got {bounds.order}")
        found: dict[str, SoftBound] = {}
        for name, output, margin in (
            ("force", model.C, bounds.force_margin),
            ("velocity", velocity, bounds.velocity_margin),
        ):
            band = axis_bounds(name, getattr(bounds, name), self.axes)
            if name in moving or np.isfinite(band).any():
                low, high = _tightened(name, band[0], band[1], margin)
                found[name] = OutputBound(name, output, low, high, 1.0, moving=name in moving)
        if bounds.tangential.friction > 0 and np.isinf(bounds.tangential.limit):
            raise BoundsError("tangential", "friction needs a limit, 0 for friction alone")
        if np.isfinite(bounds.tangential.limit):
            found["tangential"] = self._tangential(model)
        if self.bounds_joints:
            found |= self._joint_bounds(model, velocity)
        return [found[name] for name in bounds.order if name in found]

    def _tangential(self, model: LinearModel) -> OutputBound:
        cone = self._bounds.tangential
        if self.axes != get_args(Axis):
            raise BoundsError("tangential", "needs force control on x, y and z, in this order")
        return force_cone(
            "tangential", model.C[:2], -model.C[2:],
            limit=cone.limit, friction=cone.friction, facets=cone.facets, linear=1.0,
        )  # fmt: skip

    def _joint_bounds(self, model: LinearModel, velocity: Array) -> dict[str, SoftBound]:
        joints, share = self._joints, self._bounds.joints
        if joints is None:
            raise BoundsError("joints", "the plant tells nothing about its joints")
        found: dict[str, SoftBound] = {}
        if np.isfinite(share.speed):
            limit = share.speed * joints.speed_limit
            found["joint_speed"] = MappedBound(
                "joint_speed", velocity, joints.speed_gain, -limit, limit, 1.0
            )
        if np.isfinite(share.torque):
            limit = share.torque * joints.torque_limit
            found["joint_torque"] = MappedBound(
                "joint_torque", np.vstack([velocity, model.C]), _torque_map(joints),
                -limit, limit, 1.0, direct=True,
            )  # fmt: skip
        return found

    def _ranges(
        self, config: ControllerConfig, quantities: Sequence[Quantity], period: float
    ) -> Ranges:
        """Return where states and setpoint are expected: within the bounds, as far as there are.

        Force without a bound: up to the largest error that the configuration knows. Velocity
        without one: what takes that error away in the reference time. Acceleration: that of the
        command, also of the tissue and of the error at the input, which the command has to make up
        for. Jerk: what takes the acceleration there in the reference time.
        """
        pace = max(config.reference_time, config.horizon * period)
        error = np.array([[-1.0], [1.0]]) * self._bounds.largest_error
        ranges: dict[str, Array] = {}
        for name, quantity, far in (
            ("force", "force", error),
            ("velocity", "velocity", error / (config.model.stiffness * pace)),
            ("command", "acceleration", np.array([[-np.inf], [np.inf]])),
        ):
            band = axis_bounds(name, getattr(self._bounds, name), self.axes)
            ranges[quantity] = np.where(np.isfinite(band), band, far)
        ranges["jerk"] = ranges["acceleration"] / pace
        each = np.stack([ranges[quantity] for quantity in quantities])  # (n, 2, n_axes)
        return Ranges(each.transpose(2, 0, 1).reshape(-1, 2), ranges["force"].T)


def check_axes(axes: Sequence[Axis]) -> tuple[Axis, ...]:
    """Return the axes as a tuple.

    Raises:
        UnknownNameError: one of them is none.
    """
    for name in axes:
        if name not in get_args(Axis):
            raise UnknownNameError("axis", name, get_args(Axis))
    return tuple(axes)


def axis_bounds(name: str, band: Band, axes: Sequence[Axis]) -> Array:
    """Return lower and upper bound of each axis, ``(2, n_axes)``.

    Raises:
        BoundsError: they cross, or are no numbers; ``name`` is what they are called.
    """
    each = [getattr(band, axis) for axis in axes] if isinstance(band, PerAxis) else None
    sides = np.array(each if each is not None else [band] * len(axes), dtype=np.float64).T
    if np.isnan(sides).any() or (sides[0] > sides[1]).any():
        raise BoundsError(name, f"lower must not exceed upper, got {sides.T.tolist()}")
    return sides


def _tightened(name: str, lower: Array, upper: Array, margin: float) -> tuple[Array, Array]:
    low, high = np.asarray(lower) + margin, np.asarray(upper) - margin
    if (low > high).any():
        raise BoundsError(name, f"a margin of {margin:g} on both sides leaves no room")
    if name in _AT_REST and not ((low <= 0) & (high >= 0)).all():
        raise BoundsError(name, f"must contain 0, got [{low.max():g}, {high.min():g}]")
    return low, high


def _torque_map(joints: JointSpace) -> Array:
    return np.hstack([joints.command_gain, joints.velocity_gain, joints.force_gain])
