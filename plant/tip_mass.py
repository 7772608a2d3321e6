"""The mass between force sensor and tip: what the sensor reads beside the contact force."""

from typing import Any

import numpy as np

from plant.errors import PlantError
from plant.memory import Memory
from plant.viper import FloatArray


class TipMass:
    """False force of a point mass m at the tip.

    The sensor carries that mass, so it reads F + m (a - g). It is tared at the start: what is left
    of the weight is its change in the sensor's frame. In the world, with R the orientation of the
    instrument and R0 that at the start:

        reading = F + m [a - g + R R0' g]

    a is the mean acceleration over the last physics step, from three positions of the tip: what
    MuJoCo calls the acceleration after a step belongs to its beginning. ``stepping.c`` does what
    `remember` does.
    """

    def __init__(self, block: Memory, model: Any, data: Any, mass: float, carried: float) -> None:
        """Prepare; `begin` has to follow.

        Args:
            block: what it shares with the physics loop.
            model, data: of MuJoCo, made by ``plant.mjcf.cell_mjcf``.
            mass: beyond the sensor [kg].
            carried: all that the flange carries [kg].

        Raises:
            PlantError: the mass is more than that.
        """
        if mass > carried:
            raise PlantError(
                f"imperfections.tip_mass: {mass:g} kg are more than the {carried:g} kg that the "
                "flange carries"
            )
        self.mass = mass
        """[kg]"""
        block["heavy"] = mass > 0
        site = data.site("tool_tip")
        self._tip, self._rotation = site.xpos, site.xmat.reshape(3, 3)
        self._before = block["tip_passed"].reshape(2, 3)
        self._rate = float(1.0 / block["timestep"] ** 2)
        self._gravity, self._weight = model.opt.gravity, np.zeros(3)

    def begin(self) -> None:
        """Start anew where the tip is, at rest, and tare the sensor."""
        self._before[:] = self._tip
        self._weight[:] = self._rotation.T @ self._gravity

    def remember(self) -> None:
        """Keep the position of the tip, before each physics step."""
        self._before[1] = self._before[0]
        self._before[0] = self._tip

    def force(self) -> FloatArray:
        """Return what the sensor reads too much, ``(3,)`` [N], in the world."""
        last, last_but_one = self._before
        acceleration = self._rate * (self._tip - 2.0 * last + last_but_one)
        return np.asarray(
            self.mass * (acceleration - self._gravity + self._rotation @ self._weight)
        )
