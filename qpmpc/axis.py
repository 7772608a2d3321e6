"""The model of one axis as observer and prediction see it: contact, delay, lag, disturbance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from qpmpc.arrays import Array
from qpmpc.augment import constant, parabola, ramp, with_delay, with_disturbance
from qpmpc.config import Disturbance, ModelConfig, ObserverConfig
from qpmpc.construction import NUMPY, Construction
from qpmpc.errors import UnknownNameError
from qpmpc.models import LinearModel

Quantity = Literal["force", "velocity", "acceleration", "jerk"]


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
    prior: Array
    """Standard deviation of each state as known beforehand, infinite where not known, ``(n,)``."""
    gate: Array
    """How far each measurement may be off what is expected, ``(n_measured,)``."""
    quantities: tuple[Quantity, ...]
    """What each state is, ``n`` names."""


def axis_model(
    model: ModelConfig,
    observer: ObserverConfig,
    period: float,
    *,
    tool_velocity: bool = True,
    construction: Construction = NUMPY,
) -> AxisModel:
    """Augment the contact model of one axis as the configuration says.

    Args:
        model, observer: see there.
        period: sampling period [s].
        tool_velocity: whether the tool's velocity must be among the states; without it the
            ``constant`` and ``ramp`` models know only the velocity relative to the tissue.
        construction: who builds the contact model.
    """
    kind = observer.disturbance
    if kind not in get_args(Disturbance):
        raise UnknownNameError("disturbance", kind, get_args(Disturbance))
    from_force = kind in ("constant", "ramp")
    contact = construction.contact(
        model.stiffness,
        model.velocity_damping,
        period,
        lag=model.lag,
        separate_tool=from_force and tool_velocity,
    )
    augmented = with_delay(contact.model, model.delay)
    quantities: list[Quantity] = ["force", "velocity"]
    quantities += ["velocity"] * (from_force and tool_velocity)
    quantities += ["acceleration"] * ((model.lag > 0) + model.delay)
    n = augmented.n_states
    noise, prior = np.zeros(n), np.full(n, np.inf)
    noise[0] = _UNMODELLED_FORCE
    if kind == "none":
        noise[:2] = _TAKEN_AS_MEASURED
    elif kind == "constant":
        augmented = with_disturbance(augmented, contact.load, constant())
        noise, prior = np.append(noise, observer.input_drift), np.append(prior, np.inf)
        quantities += ["acceleration"]
    elif kind == "ramp":
        augmented = with_disturbance(augmented, contact.load, ramp(period))
        noise = np.append(noise, [0.0, observer.input_slope_drift])
        prior = np.append(prior, [np.inf, observer.tissue_jerk])
        quantities += ["acceleration", "jerk"]
    elif kind in RHYTHMIC:
        augmented = with_disturbance(augmented, contact.load, constant())
        noise, prior = np.append(noise, observer.input_drift), np.append(prior, np.inf)
        quantities += ["acceleration"]
    else:
        augmented = with_disturbance(augmented, contact.tissue, parabola(period))
        augmented = with_disturbance(augmented, contact.load, constant())
        noise = np.append(noise, [0.0, 0.0, observer.tissue_jerk_drift, observer.input_drift])
        prior = np.append(
            prior, [np.inf, observer.tissue_acceleration, observer.tissue_jerk, np.inf]
        )
        quantities += ["velocity", "acceleration", "jerk", "acceleration"]
    if model.damping > 0:
        augmented = _damped(augmented, model.damping, n if kind == "fused" else None)
    force, velocity = augmented.C, _widened(contact.velocity, augmented.n_states)
    uses_velocity = tool_velocity or not from_force
    if from_force and tool_velocity:
        noise[2] = observer.input_drift * period
    # The force that the tool's motion causes is computed: nothing is wrong with single values.
    force_noise, gate = (
        (_FORCE_OF_THE_TOOL, np.inf)
        if kind in RHYTHMIC
        else (observer.force_noise, observer.force_gate)
    )
    sensors = [force_noise, observer.velocity_noise][: 1 + uses_velocity]
    return AxisModel(
        augmented,
        velocity,
        np.vstack([force, velocity][: 1 + uses_velocity]),
        np.diag(noise**2),
        np.diag(np.square(sensors)),
        prior,
        np.array([gate, np.inf][: 1 + uses_velocity]),
        tuple(quantities),
    )


RHYTHMIC: tuple[Disturbance, ...] = ("tracked", "beats")
"""Disturbances in which the tissue's motion is no state but a previewed signal."""
_FORCE_OF_THE_TOOL = 1e-3
"""Standard deviation of the force that the tool's own motion causes [N]: it is computed from the
encoders, so there is next to no noise in it."""
_UNMODELLED_FORCE = 1e-6
"""Change of the force per cycle that no model explains [N]: keeps the Riccati equation regular."""
_TAKEN_AS_MEASURED = 1e3
"""Noise so large that force and velocity [N, m/s] are taken as they are measured."""


def _damped(model: LinearModel, damping: float, tissue: int | None) -> LinearModel:
    """Return the model whose output is spring and damper, ``y = F + (B / K) F'``.

    Args:
        model: its output is the spring's force, its second state the velocity that loads it.
        damping: B [N s/m].
        tissue: number of the state that is the tissue's velocity, where there is one.
    """
    C = np.array(model.C)
    C[0, 1] = damping
    if tissue is not None:
        C[0, tissue] = -damping
    return LinearModel(model.A, model.B, C, model.period)


def _widened(row: Array, n: int) -> Array:
    return np.hstack([row, np.zeros((1, n - row.shape[1]))])
