"""The plant of one axis as it truly is: another stiffness, delay or lag than the model's."""

from __future__ import annotations

from dataclasses import dataclass
from math import floor

import numpy as np

from qpmpc.arrays import Array
from qpmpc.contact import contact_model
from qpmpc.errors import ModelError
from qpmpc.margins.system import System


@dataclass(frozen=True)
class TruePlant:
    """What stands between the command and the measurements of one axis."""

    stiffness: float
    """K_s of the tissue [N/m]."""
    velocity_damping: float
    """K2 of the velocity loop [1/s]."""
    delay: float
    """From a command to the torque that it causes; any time, not only whole cycles [s]."""
    lag: float = 0.0
    """Time constant of a first-order lag after it [s]."""
    damping: float = 0.0
    """Of the tissue, in parallel to its stiffness [N s/m]."""
    gain: float = 1.0
    """True acceleration over the commanded one: the inertia in the robot's model over its own."""

    def __post_init__(self) -> None:
        for name in ("delay", "damping"):
            if not getattr(self, name) >= 0:
                raise ModelError(f"{name} must not be negative, got {getattr(self, name)}")
        if not self.gain > 0:
            raise ModelError(f"gain must be positive, got {self.gain}")

    def sampled(self, period: float) -> System:
        """Return the plant from instant to instant, by exact hold.

        Inputs: velocity of the tissue v_e [m/s] and disturbing acceleration d [m/s^2], both held
        over a period, then the command u [m/s^2]. Outputs: force [N], velocity of the tool [m/s].

        Raises:
            ModelError: a figure is out of range.
        """
        cycles = floor(self.delay / period + 1e-9)
        late = min(max(self.delay - cycles * period, 0.0), period)
        A, held = _hold(self, period)
        n, registers = A.shape[0], cycles + (late > 0)
        command = self.gain * held[:, 2:]
        older = np.zeros((n, 1))
        if late > 0:  # the command before goes on for a part of the period
            rest, new = _hold(self, period - late)
            older = self.gain * (rest @ _hold(self, late)[1][:, 2:])
            command = self.gain * new[:, 2:]
        full = np.zeros((n + registers, n + registers))
        B = np.zeros((n + registers, 3))
        full[:n, :n] = A
        B[:n, :2] = held[:, :2]
        age = np.zeros((n, registers + 1))  # how the command of each age enters
        age[:, cycles : cycles + 1] += command
        if late > 0:
            age[:, cycles + 1 : cycles + 2] += older
        B[:n, 2:] = age[:, :1]
        full[:n, n:] = age[:, 1:]
        if registers:
            B[n, 2] = 1.0
            full[n + 1 :, n : n + registers - 1] = np.eye(registers - 1)
        C, D = np.zeros((2, n + registers)), np.zeros((2, 3))
        C[0, :2], C[1, 1], D[0, 0] = (1.0, self.damping), 1.0, -self.damping
        return System(full, B, C, D, period)


def _hold(plant: TruePlant, time: float) -> tuple[Array, Array]:
    """Return states after ``time`` from states and held inputs v_e, d, u."""
    made = contact_model(plant.stiffness, plant.velocity_damping, time, lag=plant.lag)
    return made.model.A, np.hstack([made.tissue, made.load, made.model.B])
