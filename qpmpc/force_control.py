"""The force controller of the paper, put together from the general parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.linalg import block_diag

from qpmpc.arrays import Array
from qpmpc.augment import constant, parabola, ramp, with_delay, with_disturbance
from qpmpc.backends import Backend
from qpmpc.bounds import Bound, CommandBound, OutputBound, RateBound
from qpmpc.config import ControllerConfig, Disturbance, ModelConfig, ObserverConfig
from qpmpc.contact import contact_model
from qpmpc.controller import Controller, Step
from qpmpc.errors import BoundsError, UnknownNameError
from qpmpc.models import LinearModel, stack
from qpmpc.observer import KalmanObserver
from qpmpc.problem import Problem
from qpmpc.reference import ExponentialReference

Axis = Literal["x", "y", "z"]


@dataclass(frozen=True, eq=False)
class AxisModel:
    """One axis as the observer and the prediction see it."""

    model: LinearModel
    """From u to the contact force, with delay, lag and disturbance as states."""
    velocity: Array
    """Row that reads the tool's velocity, ``(1, n)``."""
    measured: Array
    """Rows that are measured: force, then velocity where it is used, ``(n_measured, n)``."""
    process_noise: Array
    """Covariance of the states' unmodelled change per cycle, ``(n, n)``."""
    measurement_noise: Array
    """Covariance of what is measured, ``(n_measured, n_measured)``."""


def axis_model(
    model: ModelConfig, observer: ObserverConfig, period: float, *, tool_velocity: bool = True
) -> AxisModel:
    """Augment the contact model of one axis as the configuration says.

    Args:
        model, observer: see there.
        period: sampling period [s].
        tool_velocity: whether the tool's velocity must be among the states; without it the
            ``constant`` and ``ramp`` models know only the velocity relative to the tissue.
    """
    kind = observer.disturbance
    if kind not in get_args(Disturbance):
        raise UnknownNameError("disturbance", kind, get_args(Disturbance))
    from_force = kind in ("constant", "ramp")
    contact = contact_model(
        model.stiffness,
        model.velocity_damping,
        period,
        lag=model.lag,
        separate_tool=from_force and tool_velocity,
    )
    augmented = with_delay(contact.model, model.delay)
    n = augmented.n_states
    noise = np.zeros(n)
    noise[0] = _UNMODELLED_FORCE
    if kind == "none":
        noise[:2] = _TAKEN_AS_MEASURED
    elif kind == "constant":
        augmented = with_disturbance(augmented, contact.load, constant())
        noise = np.append(noise, observer.input_drift)
    elif kind == "ramp":
        augmented = with_disturbance(augmented, contact.load, ramp(period))
        noise = np.append(noise, [0.0, observer.input_slope_drift])
    else:
        augmented = with_disturbance(augmented, contact.tissue, parabola(period))
        augmented = with_disturbance(augmented, contact.load, constant())
        noise = np.append(noise, [0.0, 0.0, observer.tissue_jerk_drift, observer.input_drift])
    force, velocity = augmented.C, _widened(contact.velocity, augmented.n_states)
    uses_velocity = tool_velocity or not from_force
    if from_force and tool_velocity:
        noise[2] = observer.input_drift * period
    sensors = [observer.force_noise, observer.velocity_noise][: 1 + uses_velocity]
    return AxisModel(
        augmented,
        velocity,
        np.vstack([force, velocity][: 1 + uses_velocity]),
        np.diag(noise**2),
        np.diag(np.square(sensors)),
    )


_UNMODELLED_FORCE = 1e-6
"""Change of the force per cycle that no model explains [N]: keeps the Riccati equation regular."""
_TAKEN_AS_MEASURED = 1e3
"""Noise so large that force and velocity [N, m/s] are taken as they are measured."""


class ForceController:
    """Controls the contact force on one to three axes; packs measurements for the general parts."""

    def __init__(
        self,
        config: ControllerConfig,
        axes: Sequence[Axis],
        period: float,
        backend: str | type[Backend] = "daqp",
    ) -> None:
        """Build models, observer, problem and solver.

        Args:
            config: see there.
            axes: which of x, y, z, in the order of the vectors of `step`.
            period: control period [s].
            backend: a registered name or a backend class.

        Raises:
            QpmpcError: an argument is out of range, or no observer or no backend can be had.
        """
        self.axes = tuple(axes)
        for name in self.axes:
            if name not in get_args(Axis):
                raise UnknownNameError("axis", name, get_args(Axis))
        count = len(self.axes)
        bounded = bool(np.isfinite(config.bounds.velocity).any())
        axis = axis_model(config.model, config.observer, period, tool_velocity=bounded)
        model = stack([axis.model] * count)
        problem = Problem(
            model,
            config.horizon,
            control_horizon=config.control_horizon,
            decision=config.decision,
            output_weight=config.force_weight,
            increment_weight=config.increment_weight,
            bounds=self._bounds(config, model, block_diag(*[axis.velocity] * count)),
        )
        observer = KalmanObserver(
            model,
            block_diag(*[axis.measured] * count),
            block_diag(*[axis.process_noise] * count),
            block_diag(*[axis.measurement_noise] * count),
        )
        reference = ExponentialReference(config.horizon, count, period, config.reference_time)
        self.general = Controller(problem, observer, reference, backend)
        self._measurement = np.zeros((count, axis.measured.shape[0]))

    def reset(self, force: Array) -> None:
        """Start at rest with the given contact force ``(n_axes,)`` [N]."""
        state = np.zeros((len(self.axes), self.general.problem.model.n_states // len(self.axes)))
        state[:, 0] = force
        self.general.reset(state.ravel())

    def step(self, force: Array, velocity: Array, preview: Array) -> Step:
        """Decide the acceleration command of this cycle.

        Args:
            force: measured contact force, ``(n_axes,)`` [N].
            velocity: the tool's velocity from its encoders, ``(n_axes,)`` [m/s].
            preview: setpoint s(k) ... s(k+N), ``(N + 1, n_axes)`` [N].
        """
        self._measurement[:, 0] = force
        if self._measurement.shape[1] > 1:
            self._measurement[:, 1] = velocity
        return self.general.step(self._measurement.reshape(-1), preview)

    def prepare(self) -> None:
        """Do what needs no measurement, after the command has been applied."""
        self.general.prepare()

    def _bounds(self, config: ControllerConfig, model: LinearModel, velocity: Array) -> list[Bound]:
        b = config.bounds
        intervals = np.array([getattr(b.force, axis) for axis in self.axes])
        for name, (low, high) in (("command", b.command), ("rate", b.rate)):
            if not low <= 0 <= high:
                raise BoundsError(name, f"must contain 0, got [{low:g}, {high:g}]")
        return [
            CommandBound(*b.command),
            RateBound(*b.rate),
            OutputBound("force", model.C, intervals[:, 0], intervals[:, 1], b.force_penalty),
            OutputBound("velocity", velocity, *b.velocity, b.velocity_penalty),
        ]


def _widened(row: Array, n: int) -> Array:
    return np.hstack([row, np.zeros((1, n - row.shape[1]))])
