"""The contact between tool and tissue: which force law its three actuators follow, and its force.

MuJoCo evaluates ``-(offset + slope length + slope' speed)`` for each contact actuator at each
physics step, see ``plant.mjcf``. This module sets these coefficients, and reads the force from the
same coefficients, so that what is measured is what the physics applies.

A bilateral spring or Kelvin-Voigt element whose stiffness is constant keeps one law. All others
have it renewed before each physics step, with lengths and speeds along the axes of
``heart_surface``, whose z is the normal. K is the stiffness at this instant of the beat.

**Spring, Kelvin-Voigt**, where they only push:

    not below the surface    no force
    normal                   K depth + damping, the damping within +-K depth
    lateral                  K (displacement from the anchor) + D speed, at most ``GRIP`` times the
                             normal force; the anchor is where the tool touched

A spring that asks for more drags its anchor along. So the tool sticks to the tissue as long as it
presses, nothing ever pulls, and every force starts and ends at zero, however the tool arrives or
leaves. As long as no limit acts the law is that of the bilateral contact. The normal damping has a
limit because a plain Kelvin-Voigt element pushes before it is touched, pulls when the tool retracts
and jumps by D times speed at touch-down.

**Standard linear solid**: a spring (1 - relaxation) K beside a Maxwell branch, a spring
relaxation K in series with a dashpot. The strain q of the branch's spring, q' = x' - q / tau, is
integrated exactly for a deformation that is linear over the physics step. Where it only pushes, the
tool leaves the tissue where its force is zero, above a dent that recovers by itself, and meets it
again where the dent then is. Sideways both springs start where the tool touched, and both give way
where together they ask for more than ``GRIP`` times the normal force.

**Hunt-Crossley**: K depth^n (1 + dissipation speed) into the surface, never less than zero.
Sideways elasto-plastic bristles: displaced with the tool they bend, and slip the more the nearer
they are to their largest deflection, that of the friction (Hess-Soom) at this speed:

    b' = v - alpha |v| b / b_most      K b_most = mu(|v|) normal      lateral = K b + D v

with lateral at most mu normal. alpha is 0 up to break_away b_most and where the tool goes back, 1
at b_most. A step of b is implicit, and b never exceeds b_most.

No limit feeds energy into the arms; only a stiffness that rises under load does, which is the
heart's work.
"""

import math
from typing import Any

import numpy as np

from plant.config import ContactConfig
from plant.memory import Memory
from plant.tissue import GRIP, power_coefficient
from plant.viper import FloatArray

LINEAR, SOLID, DENTING = range(3)
"""Kinds of law, ``memory["kind"]``: spring and Kelvin-Voigt are one."""
_KINDS = {
    "spring": LINEAR,
    "kelvin_voigt": LINEAR,
    "standard_linear_solid": SOLID,
    "hunt_crossley": DENTING,
}


class Contact:
    """The contact actuators of one cell, from `begin` on."""

    def __init__(self, block: Memory, model: Any, data: Any, config: ContactConfig) -> None:
        """Find the actuators.

        Args:
            block: what it shares with the physics loop; ``stepping.c`` does what `follow` does.
            model, data: of MuJoCo; made by ``plant.mjcf.cell_mjcf`` with the same K and D.
            config: see there.
        """
        self._block, self._only_pushes = block, config.unilateral
        self._kind = _KINDS[config.law]
        relaxing = config.relaxation if self._kind == SOLID else 0.0
        block["kind"] = self._kind
        block["stiffness"] = (1.0 - relaxing) * config.stiffness
        block["damping"], block["grip"] = config.damping, GRIP
        block["varies"] = config.systolic_stiffening > 0
        if self._kind == SOLID:
            share = float(block["timestep"]) / config.relaxation_time
            block["relaxing"] = relaxing * config.stiffness
            block["keeps"], block["takes"] = math.exp(-share), -math.expm1(-share) / share
            block["recovers"] = math.exp(-share * (1.0 - relaxing))
        if self._kind == DENTING:
            block["coefficient"], block["exponent"] = power_coefficient(config), config.exponent
            block["dissipation"] = config.dissipation
            friction = config.bristles
            block["static_friction"], block["kinetic_friction"] = friction.static, friction.kinetic
            block["stribeck_velocity"] = friction.stribeck_velocity
            block["break_away"] = friction.break_away
        # Views into memory: looking them up costs as much as a small matrix product.
        first = model.actuator("contact_x").id
        own = slice(first, first + 3)
        self._length, self._speed = data.actuator_length[own], data.actuator_velocity[own]
        self._rotation = data.site("heart_surface").xmat.reshape(3, 3)
        self._law = model.actuator_biasprm[own, :3]
        self._offset, self._per_length, self._per_speed = self._law.T
        self._anchor, self._sticks = block["anchor"], block["sticks"]
        self._strain, self._before, self._bristle = (
            block[name] for name in ("strain", "before", "bristle")
        )
        self._unilateral, self._touching = block["unilateral"], block["touching"]
        self._factor, self._factor_step = block["factor"], block["factor_step"]
        self._renewed, self._varies = block["renewed"], block["varies"]

    @property
    def renewed(self) -> bool:
        """Whether `follow` has to be called before each physics step."""
        return bool(self._renewed)

    @property
    def varies(self) -> bool:
        """Whether `beat` has to be told the stiffness in each period."""
        return bool(self._varies)

    @property
    def touching(self) -> bool:
        """Whether the tool is below the surface; always, if bilateral."""
        return bool(self._touching)

    @property
    def depth(self) -> float:
        """How far the tool is below the surface at rest; negative above it [m]."""
        return -float(self._length[2])

    def begin(self, factor: float) -> None:
        """Start anew where the arms are, at rest, undeformed where their sites coincide.

        Args:
            factor: by which the tissue is stiffer than its configuration says.
        """
        self._factor[()], self._factor_step[()] = factor, 0.0
        self._bond()
        self._anchor[:] = self._strain[:] = 0.0
        self._before[:], self._bristle[:] = self._length, self._length[:2]
        self._touching[()] = self._sticks[()] = True
        self._unilateral[()] = self._only_pushes
        self._renewed[()] = self._only_pushes or self._kind != LINEAR or self._varies
        if self._renewed:
            self.follow(0)

    def let_vary(self) -> None:
        """Renew the law from step to step from now on, as `beat` may tell any stiffness."""
        self._varies[()] = True
        if not self._renewed:
            self._renewed[()] = True
            self.follow(0)

    def beat(self, factor: float, step: float) -> None:
        """Take the factor of the stiffness for this control instant, and its change a step."""
        self._factor[()], self._factor_step[()] = factor, step

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

    def follow(self, elapsed: int) -> None:
        """Renew the law for the positions and speeds of this instant.

        Args:
            elapsed: physics steps since it was renewed last, 0 or 1.
        """
        if elapsed:
            self._factor[()] += self._factor_step
        if self._kind == SOLID:
            self._relax(elapsed)
        elif self._kind == DENTING:
            self._dent(elapsed)
        elif self._unilateral:
            self._lean()
        else:
            self._bond()

    def _bond(self) -> None:
        """Both ways, spring and damper."""
        stiffness, damping = float(self._block["stiffness"]), float(self._block["damping"])
        self._law[:] = 0.0, -(stiffness * float(self._factor)), -damping

    def _release(self) -> None:
        if self._touching:
            self._law[:] = 0.0
            self._touching[()] = self._sticks[()] = False

    def _lean(self) -> None:
        """Spring and damper that only push."""
        x, y, z = self._length.tolist()
        if z >= 0.0:
            self._release()
            return
        if not self._touching:
            self._anchor[:] = x, y
            self._touching[()] = True
        stiffness = float(self._block["stiffness"]) * float(self._factor)
        damping, law = float(self._block["damping"]), self._law
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
        if self._sticks and not (dragged or slips or yields or self._block["varies"]):
            return
        self._bond()
        law[0, 0], law[1, 0] = stiffness * anchor_x, stiffness * anchor_y
        if slips:
            law[:2] = 0.0
            law[0, 0], law[1, 0] = -pull_x * most / size, -pull_y * most / size
        if yields:
            law[2] = normal, 0.0, 0.0
        self._sticks[()] = not (slips or yields)

    def _relax(self, elapsed: int) -> None:
        """Spring and Maxwell branch, both ways or only pushing."""
        m, law, strain = self._block, self._law, self._strain
        x, y, z = self._length.tolist()
        spring = float(m["stiffness"]) * float(self._factor)
        branch = float(m["relaxing"]) * float(self._factor)
        if self._touching:
            if elapsed:
                keeps, takes = float(m["keeps"]), float(m["takes"])
                for i, (now, before) in enumerate(
                    zip((x, y, z), self._before.tolist(), strict=True)
                ):
                    strain[i] = keeps * float(strain[i]) + takes * (now - before)
        else:
            if elapsed:
                strain[2] = float(m["recovers"]) * float(strain[2])
            surface = -(float(m["relaxing"]) / float(m["stiffness"])) * float(strain[2])
            if z < surface:
                self._touching[()] = True
                self._anchor[:] = x, y
                strain[0] = strain[1] = 0.0
                strain[2] = float(strain[2]) + (z - surface)
        self._before[:] = x, y, z
        if self._unilateral:
            if not self._touching:
                return
            push = -(spring * z + branch * float(strain[2]))
            if not push > 0.0:
                self._release()
                return
            most = GRIP * push
            bent_x, bent_y = x - float(self._anchor[0]), y - float(self._anchor[1])
            pull_x = spring * bent_x + branch * float(strain[0])
            pull_y = spring * bent_y + branch * float(strain[1])
            size = math.sqrt(pull_x * pull_x + pull_y * pull_y)
            if size > most:
                share = most / size
                self._anchor[:] = x - share * bent_x, y - share * bent_y
                strain[0], strain[1] = share * float(strain[0]), share * float(strain[1])
        anchor_x, anchor_y = self._anchor.tolist()
        law[:] = 0.0, -spring, 0.0
        law[0, 0] = spring * anchor_x - branch * float(strain[0])
        law[1, 0] = spring * anchor_y - branch * float(strain[1])
        law[2, 0] = -(branch * float(strain[2]))

    def _dent(self, elapsed: int) -> None:
        """Hunt-Crossley, and bristles sideways."""
        m, law = self._block, self._law
        x, y, z = self._length.tolist()
        if z >= 0.0:
            self._release()
            return
        before_x, before_y, _ = self._before.tolist()
        move_x, move_y = (x - before_x, y - before_y) if elapsed else (0.0, 0.0)
        bend_x, bend_y = self._bristle.tolist()
        if not self._touching:
            self._touching[()] = True
            move_x = move_y = bend_x = bend_y = 0.0
        self._before[:] = x, y, z
        speed_x, speed_y, speed_z = self._speed.tolist()
        elastic = float(m["coefficient"]) * float(self._factor)
        elastic = elastic * math.pow(-z, float(m["exponent"]))
        rate = 1.0 - float(m["dissipation"]) * speed_z
        pushes = rate > 0.0
        normal = elastic * rate if pushes else 0.0
        stiffness = float(m["stiffness"]) * float(self._factor)
        damping = float(m["damping"])
        pace = math.sqrt(speed_x * speed_x + speed_y * speed_y) / float(m["stribeck_velocity"])
        kinetic, static = float(m["kinetic_friction"]), float(m["static_friction"])
        most = (kinetic + (static - kinetic) / (1.0 + pace * pace)) * normal
        reach = most / stiffness
        bend_x, bend_y = bend_x + move_x, bend_y + move_y
        size = math.sqrt(bend_x * bend_x + bend_y * bend_y)
        holds = float(m["break_away"]) * reach
        if size > holds and move_x * bend_x + move_y * bend_y > 0.0:
            alpha = 1.0
            if size < reach:
                s = (size - holds) / (reach - holds)
                alpha = s * s * (3.0 - 2.0 * s)
            way = math.sqrt(move_x * move_x + move_y * move_y)
            share = reach / (reach + alpha * way)
            bend_x, bend_y, size = share * bend_x, share * bend_y, share * size
        if size > reach:
            bend_x, bend_y = bend_x * reach / size, bend_y * reach / size
        self._bristle[:] = bend_x, bend_y
        pull_x, pull_y = stiffness * bend_x, stiffness * bend_y
        law[:] = 0.0
        total_x, total_y = pull_x + damping * speed_x, pull_y + damping * speed_y
        size = math.sqrt(total_x * total_x + total_y * total_y)
        if size > most:
            law[0, 0], law[1, 0] = -total_x * most / size, -total_y * most / size
        else:
            law[0] = -pull_x, 0.0, -damping
            law[1] = -pull_y, 0.0, -damping
        if pushes:
            law[2] = elastic, 0.0, -(elastic * float(m["dissipation"]))
