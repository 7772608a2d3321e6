"""Margins of a scenario's controller: of the plant as it is, and over a range of others."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from plant.sensors import SENSORS
from qpmpc.augment import parabola, with_disturbance
from qpmpc.config import ObserverConfig
from qpmpc.contact import contact_model
from qpmpc.margins import (
    Demand,
    Loop,
    TruePlant,
    force_law,
    margins,
    prediction_error,
    stable_range,
)
from scenarios import Scenario
from scenarios.motion import load_motion
from scenarios.motion.config import AXES

Array = NDArray[np.float64]
Row = dict[str, Any]

_BINS = 60
"""Bands of frequency in which the power of a motion is gathered."""
VELOCITY_NOISE = ObserverConfig().velocity_noise
"""Standard deviation of the measured velocity, whatever an observer is told of it [m/s]."""
HARMONICS = 10
"""Of the heart, at which rejection is told."""
_FURTHER = 64.0
"""Factor by which stiffness is searched beyond the one that is there, either way."""
_LATER = 0.02
"""How much later the delay is searched [s]."""


@dataclass(frozen=True, eq=False)
class Motion:
    """What the motion of a scenario is made of, by frequency."""

    omega: Array
    """``(n,)`` [rad/s]."""
    rms: Array
    """Of each axis at each frequency, ``(n, n_axes)`` [m]."""
    jerk_drift: Array
    """Change of each axis' jerk per cycle, RMS, ``(n_axes,)`` [m/s^3]."""


def true_plant(scenario: Scenario) -> TruePlant:
    """Return the linear plant of one axis that is behind a scenario's cell.

    Friction, saturation, flexible joints, encoders, the sampling of the inner loop and the coupling
    of the axes are not in it; of inertias that are wrong link by link, the mean is.
    """
    cell, imperfections = scenario.cell, scenario.cell.imperfections
    return TruePlant(
        stiffness=cell.contact.stiffness,
        velocity_damping=cell.tool.velocity_damping,
        delay=imperfections.delay * cell.period,
        lag=imperfections.torque_lag,
        damping=cell.contact.damping,
        gain=1.0 + float(np.mean(imperfections.inertia_error)),
    )


def motion_of(scenario: Scenario) -> Motion:
    """Return the motion of a scenario by frequency, on the axes under force control.

    Raises:
        ScenarioError: a file of it cannot be read.
    """
    period = scenario.cell.period
    motion = load_motion(scenario.motion, scenario.duration, period, scenario.seed)
    index = [AXES.index(axis) for axis in scenario.axes]
    position = motion.position[:, index]
    position = (position - position.mean(axis=0)) * np.hanning(len(position))[:, None]
    power = np.abs(np.fft.rfft(position, axis=0)[1:]) ** 2
    power *= motion.position[:, index].var(axis=0) / power.sum(axis=0, keepdims=True).clip(1e-300)
    frequency = np.fft.rfftfreq(len(position), period)[1:]
    edges = np.geomspace(max(frequency[0], 0.05), 0.5 / period, _BINS)
    band = np.digitize(frequency, edges)
    omega, rms = [], []
    for each in np.unique(band):
        here = power[band == each]
        total = here.sum()
        weights = here.sum(axis=1) / total if total > 0 else None
        omega.append(2 * np.pi * np.average(frequency[band == each], weights=weights))
        rms.append(np.sqrt(here.sum(axis=0)))
    change = np.diff(motion.acceleration[:, index], n=2, axis=0) / period
    drift = np.sqrt(np.mean(change**2, axis=0)) if len(change) else np.zeros(len(index))
    return Motion(np.array(omega), np.array(rms), drift)


def assess(
    scenario: Scenario, stiffness: Sequence[float], later: Sequence[float]
) -> dict[str, Any]:
    """Return everything that ``pulsempc margins`` tells.

    Args:
        scenario: see there.
        stiffness: true stiffness over that of the cell, each a row.
        later: delay beyond that of the scenario [s], each a row.

    Raises:
        QpmpcError: there is no such controller.
    """
    config, period = scenario.controller, scenario.cell.period
    law, plant, motion = force_law(config, period), true_plant(scenario), motion_of(scenario)
    noise = SENSORS[scenario.cell.sensor.model].deviation, VELOCITY_NOISE

    def row(changed: TruePlant) -> Row:
        return _row(Loop(changed, law), motion, noise, scenario)

    def stable(changed: TruePlant) -> bool:
        return Loop(changed, law).stable

    K = plant.stiffness
    return {
        "scenario": scenario.name,
        "model_stiffness": config.model.stiffness,
        "plant": {name: getattr(plant, name) for name in TruePlant.__dataclass_fields__},
        "sensor": scenario.cell.sensor.model,
        "nominal": row(plant),
        "stable": {
            "stiffness": stable_range(
                lambda k: stable(replace(plant, stiffness=k)),
                K, K / _FURTHER, K * _FURTHER,
            ),
            "delay": stable_range(
                lambda d: stable(replace(plant, delay=d)), plant.delay, 0.0, plant.delay + _LATER
            ),
            "gain": stable_range(lambda g: stable(replace(plant, gain=g)), plant.gain, 0.01, 100.0),
        },
        "stiffness": [
            {"ratio": ratio, **row(replace(plant, stiffness=ratio * K))} for ratio in stiffness
        ],
        "later": [{"later": t, **row(replace(plant, delay=plant.delay + t))} for t in later],
        "lower_bound": _lower_bound(scenario, plant, motion, noise),
    }  # fmt: skip


def _row(loop: Loop, motion: Motion, noise: tuple[float, float], scenario: Scenario) -> Row:
    """Return the figures of one loop; None where it is not stable."""
    found: Row = {"stable": loop.stable, "radius": loop.closed.radius}
    names = ("gain_up", "gain_down", "phase_deg", "delay", "sensitivity", "peak_hz",
             "rejection", "rms", "reduction", "noise_rms", "increment_rms")  # fmt: skip
    if not loop.stable:
        return found | dict.fromkeys(names)
    classical = margins(loop.transfer, loop.law.period)
    rejection = loop.rejection(motion.omega)[:, None] * loop.plant.stiffness
    moved = np.sqrt(np.sum((rejection * motion.rms) ** 2, axis=0))
    force, increment = loop.noise(*noise)
    rms = np.hypot(moved, force)
    still = loop.plant.stiffness * np.sqrt(np.sum(motion.rms**2, axis=0))
    at = rhythm(scenario)
    return found | {
        "gain_up": _finite(classical.gain_up),
        "gain_down": classical.gain_down,
        "phase_deg": _finite(np.degrees(classical.phase)),
        "delay": _finite(classical.delay),
        "sensitivity": classical.sensitivity,
        "peak_hz": classical.peak / (2 * np.pi),
        "rejection": {
            f"{f:g}": float(r)
            for f, r in zip(at, loop.rejection(2 * np.pi * np.array(at)), strict=True)
        },
        "rms": dict(zip(scenario.axes, rms.tolist(), strict=True)),
        "reduction": {
            axis: float(100 * (1 - r / s)) if s > 0 else None
            for axis, r, s in zip(scenario.axes, rms, still, strict=True)
        },
        "noise_rms": force,
        "increment_rms": increment,
    }


def rhythm(scenario: Scenario) -> list[float]:
    """Return the frequencies of respiration and of the heart's harmonics [Hz]."""
    highest = 0.5 / scenario.cell.period
    heart = [n * scenario.motion.heart_rate for n in range(1, HARMONICS + 1)]
    return [f for f in (scenario.motion.respiration_rate, *heart) if f < highest]


def _lower_bound(
    scenario: Scenario, plant: TruePlant, motion: Motion, noise: tuple[float, float]
) -> Row:
    """Return the RMS error that no controller can go below, by axis [N].

    The robot is perfect and the model true; of the tissue nothing is known but that its jerk
    changes, from cycle to cycle, by as much as it does in this motion. Who knows the rhythm knows
    more.
    """
    period = scenario.cell.period
    contact = contact_model(plant.stiffness, plant.velocity_damping, period)
    model = with_disturbance(contact.model, contact.tissue, parabola(period))
    n = model.n_states
    measured = np.eye(n)[:2]
    cycles = int(plant.delay / period + 1e-9) + 1
    found = {}
    for axis, drift in zip(scenario.axes, motion.jerk_drift.tolist(), strict=True):
        W = np.diag([1e-12, 1e-18, 0.0, 0.0, max(drift, 1e-6) ** 2])
        error = prediction_error(
            model.A, measured, W, np.diag(np.square(noise)), output=model.C, cycles=cycles
        )
        found[axis] = float(error[0])
    return {"cycles": cycles, "jerk_drift": motion.jerk_drift.tolist(), "rms": found}


def demand(
    scenario: Scenario, stiffness: Sequence[float], later: Sequence[float], sensitivity: float
) -> Demand:
    """Return what a tuning for a scenario has to keep: each stiffness with each delay.

    Args:
        scenario: see there; all its axes count, by the sum of their power.
        stiffness: true stiffness over that of the cell.
        later: delay beyond that of the scenario [s].
        sensitivity: Ms.
    """
    plant, motion = true_plant(scenario), motion_of(scenario)
    return Demand(
        [
            replace(plant, stiffness=ratio * plant.stiffness, delay=plant.delay + t)
            for ratio in stiffness
            for t in later
        ],
        sensitivity,
        motion.omega,
        np.sqrt(np.sum(motion.rms**2, axis=1)),
        SENSORS[scenario.cell.sensor.model].deviation,
        VELOCITY_NOISE,
    )


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
