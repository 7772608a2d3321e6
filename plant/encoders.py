"""Encoders on the tool's motors: angles in steps, speeds as a drive makes them from these."""

import math
from typing import Any

import numpy as np

from plant.config import ImperfectionConfig
from plant.memory import Memory


class Encoders:
    """What the drives know of the motors' angles and speeds.

    With a resolution or a filter, at each physics step (which is a drive's own period):

        angle   resolution * round(true angle / resolution)
        speed   speed + a (difference of the angle / step - speed),   a = 1 - exp(-step / filter)

    Without either they tell the truth. ``stepping.c`` does what `read` does.
    """

    def __init__(self, block: Memory, data: Any, flaws: ImperfectionConfig) -> None:
        """Prepare; `begin` has to follow.

        Args:
            block: what it shares with the physics loop.
            data: of MuJoCo; the motors are its last joints.
            flaws: see there.
        """
        self._step, self._resolution = float(block["timestep"]), flaws.encoder_resolution
        filtered = flaws.velocity_filter
        self._share = -math.expm1(-self._step / filtered) if filtered > 0 else 1.0
        self.exact = not (flaws.encoder_resolution or filtered)
        """Whether they tell the truth, and `read` is not needed."""
        block["encoded"] = not self.exact
        block["resolution"], block["speed_share"] = self._resolution, self._share
        n = block["encoder_angle"].size
        self._q, self._qdot = data.qpos[-n:], data.qvel[-n:]
        self.angle = self._q if self.exact else block["encoder_angle"]
        """Joint angles, ``(n,)`` [rad]."""
        self.speed = self._qdot if self.exact else block["encoder_speed"]
        """Joint speeds, ``(n,)`` [rad/s]."""

    def begin(self) -> None:
        """Start anew where the motors are, at rest."""
        if not self.exact:
            self._count()
            self.speed[:] = 0.0

    def read(self) -> None:
        """Take in the angles of this instant, one physics step after the last ones."""
        before = self.angle.copy()
        self._count()
        self.speed += self._share * ((self.angle - before) / self._step - self.speed)

    def _count(self) -> None:
        if self._resolution:
            self.angle[:] = np.rint(self._q / self._resolution) * self._resolution
        else:
            self.angle[:] = self._q
