"""The controller as a linear system: observer, reference and closed form, as they run."""

from __future__ import annotations

import numpy as np

from qpmpc.arrays import Array
from qpmpc.axis import axis_model
from qpmpc.config import ControllerConfig, PerAxis
from qpmpc.errors import ModelError
from qpmpc.margins.system import System
from qpmpc.observer import KalmanObserver
from qpmpc.problem import Problem
from qpmpc.reference import ExponentialReference, Reference


def linear_law(problem: Problem, observer: KalmanObserver, reference: Reference) -> System:
    """Return what a controller of these parts does as long as no bound is active.

    States are the predicted estimate x(k|k-1) and the last command; inputs are setpoint (the same
    over the horizon) and measurement, the output is the command.

    Raises:
        ModelError: the problem is not condensed, or the reference another than the exponential.
    """
    if type(problem) is not Problem or type(reference) is not ExponentialReference:
        raise ModelError("only a condensed problem with an exponential reference has a linear law")
    A, B, L, M = observer.A, observer.B, observer.gain, observer.measured
    C, n, n_u = problem.model.C, problem.model.n_states, problem.model.n_inputs
    maps, n_y = problem.maps, C.shape[0]
    first = (-np.linalg.inv(problem.qp.P) @ maps.gradient)[:n_u]
    decay = np.kron(reference.decay[:, None], np.eye(n_y))
    # Reference minus free response, by what it depends on: s + alpha^i (y - s) - Psi x - Upsilon u
    from_setpoint = first @ (np.tile(np.eye(n_y), (problem.horizon, 1)) - decay)
    from_state = first @ (decay @ C - maps.free[:, :n])
    from_command = -first @ maps.free[:, n:] + (problem.decision == "increment") * np.eye(n_u)
    rest = np.eye(n) - L @ M
    C_law = np.hstack([from_state @ rest, from_command])
    D_law = np.hstack([from_setpoint, from_state @ L])
    zero = np.zeros((n, n_u))
    A_law = np.vstack([np.hstack([A @ rest, zero]) + B @ C_law, C_law])
    B_law = np.vstack([np.hstack([np.zeros((n, n_y)), A @ L]) + B @ D_law, D_law])
    return System(A_law, B_law, C_law, D_law, problem.model.period)


def force_law(config: ControllerConfig, period: float) -> System:
    """Return the linear law of the force controller on one axis.

    Inputs are setpoint [N], force [N], and the tool's velocity [m/s] where it is measured.

    Raises:
        QpmpcError: the configuration cannot be had.
    """
    axis = axis_model(config.model, config.observer, period, tool_velocity=_bounds_velocity(config))
    problem = Problem(
        axis.model,
        config.horizon,
        output_weight=config.force_weight,
        increment_weight=config.increment_weight,
        control_horizon=config.control_horizon,
        decision=config.decision,
    )
    observer = KalmanObserver(axis.model, axis.measured, axis.process_noise, axis.measurement_noise)
    return linear_law(
        problem, observer, ExponentialReference(config.horizon, 1, period, config.reference_time)
    )


def _bounds_velocity(config: ControllerConfig) -> bool:
    """Whether the tool's velocity is among the states as it, or the joints', is bounded."""
    bounds = config.bounds
    band = bounds.velocity
    sides: list[tuple[float, float]] = (
        [band.x, band.y, band.z] if isinstance(band, PerAxis) else [band]
    )
    bounded: Array = np.isfinite([(bounds.joints.speed, bounds.joints.torque), *sides])
    return bool(bounded.any())
