"""Stribeck friction of the tool's joints, on top of Coulomb and viscous friction.

Friction at rest exceeds Coulomb friction, and the excess fades with speed (Hess and Soom, ASME
Journal of Tribology 112, 1990; see Armstrong-Helouvry, Dupont and Canudas de Wit, Automatica 30,
1994):

    F(v) = [Fc + Fs / (1 + (v / vs)^2)] sign(v) + Fv v

MuJoCo holds a joint with up to ``frictionloss`` while it rests and brakes it with as much while it
moves. `StribeckFriction.renew` makes that limit follow the speed, before each physics step; viscous
friction stays where it is. So a joint sticks as well as with Coulomb friction, under more torque.
"""

from typing import Any

import numpy as np

from plant.memory import Memory
from plant.viper import FloatArray


class StribeckFriction:
    """Friction limits of the tool's motors. ``stepping.c`` does what `renew` does."""

    def __init__(
        self, block: Memory, data: Any, model: Any, *, coulomb: FloatArray, excess: float,
        velocity: float,
    ) -> None:  # fmt: skip
        """Prepare.

        Args:
            block: what it shares with the physics loop.
            data, model: of MuJoCo, made by ``plant.mjcf.cell_mjcf`` with friction.
            coulomb: Coulomb friction that there is, ``(n,)`` [N m].
            excess: of the friction at rest, as a share of it [-].
            velocity: joint speed at which half of the excess is left [rad/s].
        """
        self.present = bool(excess > 0 and coulomb.any())
        """Whether there is any, and `renew` is needed."""
        block["stribeck"] = self.present
        block["coulomb"], block["excess"] = coulomb, excess * coulomb
        block["stribeck_speed"] = velocity
        self._coulomb, self._excess, self._velocity = coulomb, excess * coulomb, velocity
        n = coulomb.size
        self._speeds, self._limits = data.qvel[-n:], model.dof_frictionloss[-n:]

    def renew(self) -> None:
        """Set the limits for the speeds of this instant."""
        share = self._speeds / self._velocity
        np.add(self._coulomb, self._excess / (1.0 + share * share), out=self._limits)
