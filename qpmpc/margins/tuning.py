"""Observer noises and weights for a margin that is asked for, with the best rejection."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import differential_evolution, minimize
from scipy.stats import qmc

from qpmpc.arrays import Array
from qpmpc.config import ControllerConfig, Disturbance
from qpmpc.errors import ModelError, QpmpcError
from qpmpc.margins.frequency import grid
from qpmpc.margins.law import force_law
from qpmpc.margins.loop import closed_loop
from qpmpc.margins.plant import TruePlant
from qpmpc.margins.system import Complex, System

_POINTS = 400
"""Frequencies at which loops are looked at while searching."""
_RESERVE = 0.99
"""Share of the sensitivity allowed that is used: a peak may lie between the points."""
_EACH = 5
"""Members of the population for each knob."""
_LENIENT, _STRICT = 2.0, 50.0
"""Price of a margin that is missed, in the logarithm, at first and in the end."""
_RINGS = 0.7
"""Magnitude of a pole beyond which it may make a peak."""
_UNSTABLE = 50.0
"""Cost of a loop that is not stable; beyond all others."""

KNOBS: Mapping[Disturbance, Sequence[str]] = {
    "none": (),
    "constant": ("observer.input_drift",),
    "ramp": ("observer.input_slope_drift",),
    "fused": ("observer.input_drift", "observer.tissue_jerk_drift", "observer.velocity_noise"),
}
"""What is turned in the observer, besides the weights of the law."""
WEIGHTS = ("reference_time", "increment_weight")
MODEL = ("model.stiffness",)
"""What is turned in the model, where that is allowed."""
_ROOM = {
    "observer.input_drift": (1e-3, 1e2),
    "observer.input_slope_drift": (1e-3, 1e2),
    "observer.tissue_jerk_drift": (1e-3, 1e2),
    "observer.velocity_noise": (1e-2, 1e3),
    "reference_time": (0.1, 10.0),
    "increment_weight": (1e-3, 10.0),
    "model.stiffness": (0.5, 16.0),
}
"""Factors by which each may be moved, down and up. Against the other direction speaks that a law
that does nothing is robust, too."""


@dataclass(frozen=True, eq=False)
class Demand:
    """What a tuning has to keep, and what it is measured by."""

    plants: Sequence[TruePlant]
    """Each has to be stable, with the margin."""
    sensitivity: float
    """Ms that none of them may exceed."""
    omega: Array
    """Frequencies of the tissue's motion, ``(n,)`` [rad/s]."""
    motion: Array
    """RMS of the motion at each, ``(n,)`` [m]."""
    force_noise: float
    """Standard deviation of the force sensor [N]."""
    velocity_noise: float
    """The same of the measured velocity, as it really is [m/s]."""

    def __post_init__(self) -> None:
        if not self.sensitivity > 1:
            raise ModelError(f"sensitivity must exceed 1, got {self.sensitivity:g}")
        if not self.plants:
            raise ModelError("at least one plant is needed")


@dataclass(frozen=True, eq=False)
class Quality:
    """How a law does on the plants of a demand."""

    sensitivity: float
    """Largest Ms; infinite where a loop is unstable."""
    error: float
    """Largest RMS of the force, over that of the tool held still [-]."""
    radius: float
    """Largest magnitude of a closed-loop pole."""


@dataclass(frozen=True, eq=False)
class Tuned:
    """What a search ended with."""

    config: ControllerConfig
    changed: Mapping[str, float]
    """Keys of the configuration with their new values."""
    before: Quality
    after: Quality
    evaluations: int
    met: bool
    """Whether the margin is kept."""


def tune(
    config: ControllerConfig,
    demand: Demand,
    period: float,
    *,
    model: bool = False,
    evaluations: int = 1500,
    report: Callable[[int, int], None] = lambda _done, _total: None,
) -> Tuned:
    """Search for the knobs that leave the least force under the margin asked for.

    Differential evolution (Storn and Price 1997) in the logarithms of the knobs, begun with the
    configuration as it is, then a simplex from the best. The same arguments give the same result;
    that there is no better one is not promised.

    Args:
        config: where the search begins, and all that is not turned.
        demand: see there.
        period: control period [s].
        model: whether the model's stiffness may be turned, too.
        evaluations: laws that are looked at, about.
        report: called with how many have been.

    Raises:
        QpmpcError: the configuration cannot be had.
    """
    judge = _Judge(demand, period)
    names = [*KNOBS[config.observer.disturbance], *WEIGHTS, *(MODEL if model else ())]
    names = [name for name in names if read(config, name) > 0]
    centre = np.log([read(config, name) for name in names])
    room = [tuple(c + np.log(_ROOM[n])) for c, n in zip(centre, names, strict=True)]
    before = judge(force_law(config, period))
    best, least, count = centre, np.inf, 0

    def cost(knobs: Array) -> float:
        nonlocal best, least, count
        count += 1
        report(min(count, evaluations), evaluations)
        try:
            found = judge(force_law(_turned(config, names, knobs), period))
        except QpmpcError:
            return 2 * _UNSTABLE
        value = _cost(found, demand.sensitivity * _RESERVE, _STRICT)
        if value < least:
            best, least = knobs.copy(), value
        return _cost(found, demand.sensitivity * _RESERVE, price)

    price = _LENIENT
    population = _population(centre, room, names, demand)
    generations = max(1, round(0.7 * evaluations / len(population)) - 1)
    differential_evolution(
        cost, room, init=population, maxiter=generations, seed=0, polish=False, tol=0.0
    )
    price = _STRICT
    minimize(
        cost, best, method="Nelder-Mead", bounds=room,
        options={"maxfev": max(1, evaluations - count), "xatol": 1e-3, "fatol": 1e-4,
                 "initial_simplex": np.vstack([best, best + 0.2 * np.eye(len(names))])},
    )  # fmt: skip
    tuned = _rounded(_turned(config, names, best), names)
    after = judge(force_law(tuned, period))
    return Tuned(
        tuned,
        {name: read(tuned, name) for name in names},
        before,
        after,
        count,
        after.sensitivity <= demand.sensitivity,
    )


def read(config: ControllerConfig, name: str) -> float:
    """Return a number of the configuration by its key."""
    value: Any = config
    for part in name.split("."):
        value = getattr(value, part)
    return float(value)


def _rounded(config: ControllerConfig, names: Sequence[str], digits: int = 4) -> ControllerConfig:
    """Return the configuration with few digits in the numbers that were turned."""
    for name in names:
        config = _set(config, name, float(f"{read(config, name):.{digits}g}"))
    return config


def _turned(config: ControllerConfig, names: Sequence[str], knobs: Array) -> ControllerConfig:
    for name, value in zip(names, np.exp(knobs).tolist(), strict=True):
        config = _set(config, name, value)
    return config


def _set(config: Any, name: str, value: float) -> Any:
    head, _, rest = name.partition(".")
    return replace(config, **{head: _set(getattr(config, head), rest, value) if rest else value})


def _population(
    centre: Array, room: Sequence[tuple[float, float]], names: Sequence[str], demand: Demand
) -> Array:
    """Return where the search begins: everywhere, at the configuration, and where it is calm.

    Calm is a law for the stiffest of the plants with little price on the command, so that the time
    of the reference alone says how fast it is, and an observer that is slow.
    """
    low, high = np.array(room).T
    spread = qmc.LatinHypercube(len(names), seed=0).random(_EACH * len(names))
    calm = np.tile(centre, (4, 1))
    stiffest = max(plant.stiffness for plant in demand.plants)
    for i, name in enumerate(names):
        if name == "model.stiffness":
            calm[:, i] = np.log(stiffest * np.array([1.0, 1.0, 2.0, 2.0]))
        elif name == "reference_time":
            calm[:, i] = np.log([0.05, 0.2, 0.05, 0.2])
        elif name == "increment_weight":
            calm[:, i] -= np.log(100.0)
        elif name != "observer.velocity_noise":
            calm[:, i] -= np.log([3.0, 30.0, 3.0, 30.0])
    return np.vstack([np.clip([centre, *calm], low, high), low + spread * (high - low)])


def _cost(found: Quality, sensitivity: float, price: float) -> float:
    """The error left, in its logarithm; first stability, then the margin."""
    if not np.isfinite(found.sensitivity):
        return _UNSTABLE + found.radius
    return float(np.log(found.error) + price * max(0.0, np.log(found.sensitivity / sensitivity)))


class _Judge:
    """Looks at laws on the same plants and frequencies: the plants' responses are kept."""

    def __init__(self, demand: Demand, period: float) -> None:
        self._demand, self._period = demand, period
        self._grid = grid(period, lowest=1.0, points=_POINTS)
        self._omega = np.concatenate([self._grid, demand.omega])
        self._sampled = [plant.sampled(period) for plant in demand.plants]
        self._responses = [sampled.response(self._omega) for sampled in self._sampled]
        z = np.exp(1j * demand.omega * period)
        self._velocity = demand.motion * np.abs(z - 1) / period  # held over a period

    def __call__(self, law: System) -> Quality:
        response = law.response(self._omega)[:, 0, 1:]
        worst, error, radius = 1.0, 0.0, 0.0
        for plant, sampled, plain in zip(
            self._demand.plants, self._sampled, self._responses, strict=True
        ):
            poles = closed_loop(sampled, law).poles
            radius = max(radius, float(np.abs(poles).max()))
            sensitivity, left = self._look(plant, plain, response)
            sensitivity = max(sensitivity, self._near(poles, sampled, law))
            worst, error = max(worst, sensitivity), max(error, left)
        return Quality(worst if radius < 1 else np.inf, error, radius)

    def _near(self, poles: Complex, sampled: System, law: System) -> float:
        """Return Ms at the frequencies of the poles, where a narrow peak would be."""
        omega = np.angle(poles[np.abs(poles) > _RINGS]) / self._period
        omega = omega[omega > 0]
        if not omega.size:
            return 1.0
        rows = law.B.shape[1] - 1
        forward = sampled.part(slice(0, rows), slice(2, 3)).response(omega)
        back = law.part(slice(0, 1), slice(1, None)).response(omega)
        return float((1.0 / np.abs(1.0 - (back @ forward)[:, 0, 0])).max())

    def _look(self, plant: TruePlant, plain: Complex, law: Complex) -> tuple[float, float]:
        """Return Ms, and the RMS of the force over that of the tool held still."""
        demand, n = self._demand, self._grid.size
        rows = law.shape[1]
        to_force, to_rows = plain[:, 0, 2], plain[:, :rows, 2]
        S = 1.0 / (1.0 - (law * to_rows).sum(axis=1))
        from_tissue = plain[:, 0, 0] + to_force * S * law[:, 0] * plain[:, 0, 0]
        moved = np.sum((np.abs(from_tissue[n:]) * self._velocity) ** 2)
        deviations = np.array([demand.force_noise, demand.velocity_noise])[:rows]
        density = np.abs(to_force * S)[:n] ** 2 * (np.abs(law[:n] * deviations) ** 2).sum(axis=1)
        noise = np.trapezoid(density, self._grid) * self._period / np.pi
        still = plant.stiffness * np.sqrt(np.sum(demand.motion**2))
        return float(np.abs(S[:n]).max()), float(np.sqrt(moved + noise) / still)
