"""Classical margins of a loop transfer: gain, phase, delay, and the largest sensitivity."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from qpmpc.arrays import Array
from qpmpc.margins.system import Complex

Transfer = Callable[[Array], Complex]
"""From frequencies ``(n,)`` [rad/s] to the loop transfer; the closed loop is 1 / (1 + L)."""


@dataclass(frozen=True)
class Margins:
    """How far a stable loop is from -1. Infinite where nothing takes it there."""

    gain_up: float
    """Factor above 1 by which the loop's gain may grow until it is unstable."""
    gain_down: float
    """Factor below 1 to which it may fall; 0: to nothing."""
    phase: float
    """Smallest phase by which it may turn, either way [rad]."""
    delay: float
    """Smallest time by which it may be later [s]."""
    sensitivity: float
    """Ms, the largest ``|1 / (1 + L)|``: 1/Ms is the distance from -1."""
    peak: float
    """Frequency of that [rad/s]."""
    crossovers: tuple[float, ...]
    """Where ``|L| = 1`` [rad/s]."""


def margins(
    transfer: Transfer, period: float, *, lowest: float = 0.01, points: int = 2000
) -> Margins:
    """Return the margins of a loop that is stable when closed; that is not checked.

    Crossings are found on a grid and then to machine precision; two that lie between neighbours of
    the grid may be missed.

    Args:
        transfer: see `Transfer`.
        period: sampling period [s]; the grid ends at pi / period.
        lowest: where it begins [rad/s].
        points: of the grid.
    """
    omega = grid(period, lowest, points)
    L = transfer(omega)

    def one(function: Callable[[complex], float]) -> Callable[[float], float]:
        return lambda w: float(function(complex(transfer(np.array([w]))[0])))

    gain = [
        _root(one(lambda v: np.log(abs(v))), a, b) for a, b in _changes(np.log(np.abs(L)), omega)
    ]
    up, down = np.inf, 0.0
    at = [_root(one(lambda v: v.imag), a, b) for a, b in _changes(L.imag, omega)]
    for value in [*(complex(transfer(np.array([w]))[0]) for w in at), complex(L[-1])]:
        if value.real < 0:
            factor = -1.0 / value.real
            up, down = (min(up, factor), down) if factor > 1 else (up, max(down, factor))
    phase, delay = np.inf, np.inf
    for w in gain:
        angle = np.angle(-transfer(np.array([w]))[0])  # from -1, in (-pi, pi]
        phase = min(phase, abs(angle))
        delay = min(delay, (angle % (2 * np.pi)) / w)
    peak, sensitivity = _peak(transfer, omega, L)
    return Margins(up, down, float(phase), float(delay), sensitivity, peak, tuple(gain))


def grid(period: float, lowest: float = 0.01, points: int = 2000) -> Array:
    """Return frequencies from ``lowest`` to pi / period, evenly in their logarithm [rad/s]."""
    return np.geomspace(lowest, np.pi / period, points)


def _changes(values: Array, omega: Array) -> list[tuple[float, float]]:
    """Return neighbours between which the sign changes."""
    where = np.flatnonzero(np.signbit(values[:-1]) != np.signbit(values[1:]))
    return [(float(omega[i]), float(omega[i + 1])) for i in where]


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    if function(low) * function(high) >= 0:  # at the end of the grid, to rounding
        return high
    return float(brentq(function, low, high, xtol=1e-14 * high, rtol=1e-14))


def _peak(transfer: Transfer, omega: Array, L: Complex) -> tuple[float, float]:
    distance = np.abs(1 + L)
    i = int(np.argmin(distance))
    low, high = omega[max(i - 1, 0)], omega[min(i + 1, omega.size - 1)]
    found = minimize_scalar(
        lambda w: float(abs(1 + transfer(np.array([w]))[0])),
        bounds=(low, high), method="bounded", options={"xatol": 1e-9 * high},
    )  # fmt: skip
    if found.fun < distance[i]:
        return float(found.x), float(1.0 / found.fun)
    return float(omega[i]), float(1.0 / distance[i])
