"""The contact between tool and tissue: which force law its three actuators follow, and its force.

MuJoCo evaluates ``-(offset + slope length + slope' speed)`` for each contact actuator at each
physics step, see ``plant.mjcf``. This module sets these coefficients, and reads the force from the
same coefficients, so that what is measured is what the physics applies.

A bilateral contact keeps one law. A unilateral one has it renewed before each physics step, with
the depth of the tool below the surface, the speed into it, and the axes of ``heart_surface``, whose
z is the normal:

    not below the surface    no force
    normal                   K depth + damping, the damping within +-K depth
    lateral                  K (displacement from the anchor) + D speed, at most ``GRIP`` times the
                             normal force; the anchor is where the tool touched

A spring that asks for more drags its anchor along. So the tool sticks to the tissue as long as it
presses, nothing ever pulls, and every force starts and ends at zero, however the tool arrives or
leaves. As long as no limit acts the law is that of the bilateral contact. The normal damping has a
limit because a plain Kelvin-Voigt element pushes before it is touched, pulls when the tool retracts
and jumps by D times speed at touch-down. No limit feeds energy into the arms.
"""

import math
from typing import Any

import numpy as np

from plant.config import ContactConfig
from plant.memory import Memory
from plant.viper import FloatArray

GRIP = 1.0
"""Largest lateral force that a unilateral contact carries, relative to its normal force [-]: chosen
well above the 0.22 of the paper's setpoint, so that the tool slips only when it hardly presses."""


class Contact:
    """The contact actuators of one cell, from `begin` on."""

    def __init__(self, block: Memory, model: Any, data: Any, config: ContactConfig) -> None:
        """Find the actuators.

        Args:
            block: what it shares with the physics loop; ``stepping.c`` does what `follow` does.
            model, data: of MuJoCo; made by ``plant.mjcf.cell_mjcf`` with the same K and D.
            config: see there.
        """
        self._only_pushes = config.unilateral
        self._stiffness, self._damping = config.stiffness, config.damping
        block["stiffness"], block["damping"], block["grip"] = config.stiffness, config.damping, GRIP
        # Views into memory: looking them up costs as much as a small matrix product.
        first = model.actuator("contact_x").id
        own = slice(first, first + 3)
        self._length, self._speed = data.actuator_length[own], data.actuator_velocity[own]
        self._rotation = data.site("heart_surface").xmat.reshape(3, 3)
        self._law = model.actuator_biasprm[own, :3]
        self._offset, self._per_length, self._per_speed = self._law.T
        self._bonded = self._law.copy()
        self._anchor, self._sticks = block["anchor"], block["sticks"]
        self._unilateral, self._touching = block["unilateral"], block["touching"]

    @property
    def unilateral(self) -> bool:
        """Whether it can only push, and `follow` has to be called before each physics step."""
        return bool(self._unilateral)

    @property
    def touching(self) -> bool:
        """Whether the tool is below the surface; always, if bilateral."""
        return bool(self._touching)

    @property
    def depth(self) -> float:
        """How far the tool is below the surface at rest; negative above it [m]."""
        return -float(self._length[2])

    def begin(self) -> None:
        """Start anew where the arms are, with an undeformed contact where their sites coincide."""
        self._law[:] = self._bonded
        self._anchor[:] = 0.0
        self._touching[()] = self._sticks[()] = True
        self._unilateral[()] = self._only_pushes
        if self._only_pushes:
            self.follow()

    def force(self, out: FloatArray) -> None:
        """Write the force that the tool exerts into ``out (3,)`` [N], in the world."""
        along = self._per_length * self._length
        along += self._per_speed * self._speed
        along += self._offset
        np.subtract(0.0, along, out=along)  # negation would turn no force into -0
        np.dot(self._rotation, along, out=out)

    def size(self) -> float:
        """Return the magnitude of the force [N]."""
        square = 0.0
        for law, length, speed in zip(
            self._law.tolist(), self._length.tolist(), self._speed.tolist(), strict=True
        ):
            along = law[1] * length + law[2] * speed + law[0]
            square += along * along
        return math.sqrt(square)

    def follow(self) -> None:
        """Renew the law of a unilateral contact for the positions and speeds of this instant."""
        x, y, z = self._length.tolist()
        if z >= 0.0:
            if self._touching:
                self._law[:] = 0.0
                self._touching[()] = self._sticks[()] = False
            return
        if not self._touching:
            self._anchor[:] = x, y
            self._touching[()] = True
        stiffness, damping, law = self._stiffness, self._damping, self._law
        speed_x, speed_y, speed_z = self._speed.tolist()
        spring, damper = -stiffness * z, -damping * speed_z
        normal = spring + min(max(damper, -spring), spring)
        most = GRIP * normal
        anchor_x, anchor_y = self._anchor.tolist()
        pull_x, pull_y = stiffness * (x - anchor_x), stiffness * (y - anchor_y)
        size = math.sqrt(pull_x * pull_x + pull_y * pull_y)  # rounds as C does; hypot does not
        dragged = size > most
        if dragged:
            pull_x, pull_y = pull_x * most / size, pull_y * most / size
            anchor_x, anchor_y = x - pull_x / stiffness, y - pull_y / stiffness
            self._anchor[:] = anchor_x, anchor_y
        pull_x, pull_y = pull_x + damping * speed_x, pull_y + damping * speed_y
        size = math.sqrt(pull_x * pull_x + pull_y * pull_y)
        slips, yields = size > most, abs(damper) > spring
        if self._sticks and not (dragged or slips or yields):
            return
        law[:] = self._bonded
        law[0, 0], law[1, 0] = stiffness * anchor_x, stiffness * anchor_y
        if slips:
            law[:2] = 0.0
            law[0, 0], law[1, 0] = -pull_x * most / size, -pull_y * most / size
        if yields:
            law[2] = normal, 0.0, 0.0
        self._sticks[()] = not (slips or yields)
