"""Flexible joints: how stiff the springs between motors and links are for a given first mode.

Each motor's rotor turns on its own and is joined to its link by a spring and a damper (Spong, 1987:
the rotors' own motion along with the links counts for nothing):

    M(q) q'' + h(q, q') = K (theta - q) + D (theta' - q') - J' F        links
    B theta''           = tau - friction - K (theta - q) - D (theta' - q')    rotors

Springs are as stiff as the motors are strong, K = c diag(torque limits): both grow with the cube
of a gear's size. c makes the lowest mode of the links, with the rotors held and the arm at home,
that of the given frequency. D = (2 zeta / omega) K, a loss in the gears, gives this mode the given
damping ratio; faster modes are damped more.
"""

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import block_diag, eigh

from plant.arm_model import build_arm_model
from plant.chain import Arm
from plant.errors import PlantError
from plant.viper import FloatArray

_SAG = 0.02
"""Largest angle by which the arm's weight may wind a joint up [rad]."""


@dataclass(frozen=True, eq=False)
class JointSprings:
    """Between rotor and link of each joint."""

    stiffness: FloatArray
    """``(n,)`` [N m/rad]."""
    damping: FloatArray
    """``(n,)`` [N m s/rad]."""


def joint_springs(arm: Arm, *, frequency: float, damping: float, timestep: float) -> JointSprings:
    """Return springs that give an arm its first mode.

    Args:
        arm: see there; its torque limits say how the springs compare.
        frequency: of the first mode at home, rotors held [Hz].
        damping: its damping ratio [-].
        timestep: of the physics [s].

    Raises:
        PlantError: they are too stiff for the physics step, or the springs give way under
            the arm's weight.
    """
    if not (arm.armature > 0).all():
        raise PlantError("imperfections.joint_frequency: a motor without armature has no rotor")
    inertia, weight = link_inertia(arm)
    omega, strength = 2.0 * np.pi * frequency, arm.torque_limit
    lowest = eigh(np.diag(strength), inertia, eigvals_only=True)[0]
    stiffness = omega**2 / lowest * strength
    sag = float(np.abs(weight / stiffness).max())
    if sag > _SAG:
        raise PlantError(
            f"imperfections.joint_frequency: with {frequency:g} Hz the arm's weight winds a joint "
            f"up by {sag:.2g} rad; at least {math.ceil(frequency * math.sqrt(sag / _SAG))} Hz"
        )
    loss = 2.0 * damping / omega
    springs = JointSprings(stiffness, loss * stiffness)
    if (
        growth(springs, inertia, arm.armature, timestep) > 1.0 + 1e-5
    ):  # arm and rotors turn freely: 1, twice
        raise PlantError(
            f"imperfections.joint_frequency: with {frequency:g} Hz and a damping ratio of "
            f"{damping:g} the joints are too stiff for a physics step of {1e6 * timestep:g} us; "
            "more substeps or damping"
        )
    return springs


def growth(
    springs: JointSprings, inertia: FloatArray, rotors: FloatArray, timestep: float
) -> float:
    """Largest factor by which a physics step can make a motion of links and free rotors grow [-].

    MuJoCo's ``implicitfast`` takes damping implicitly, but for what couples two bodies of different
    trees, as a link and its rotor are, and stiffness as it is at the beginning of the step.
    """
    n = rotors.size
    join, zero, one = np.hstack([np.eye(n), -np.eye(n)]), np.zeros((2 * n, 2 * n)), np.eye(2 * n)
    stiff, damp = (join.T * value @ join for value in (springs.stiffness, springs.damping))
    mass = block_diag(inertia, np.diag(rotors)) + timestep * np.diag(np.diag(damp))
    slower = timestep * np.linalg.solve(mass, np.hstack([stiff, damp]))
    speed = np.hstack([zero, one]) - slower
    angle = np.hstack([one, zero]) + timestep * speed
    return float(np.abs(np.linalg.eigvals(np.vstack([angle, speed]))).max())


def link_inertia(arm: Arm) -> tuple[FloatArray, FloatArray]:
    """Inertia of the links at home without rotors, and torques that bear their weight.

    In the joints' space, ``(n, n)`` [kg m^2] and ``(n,)`` [N m].
    """
    model = build_arm_model(arm).model
    data = model.createData()
    upper = np.triu(pin.crba(model, data, arm.home))
    inertia = upper + np.triu(upper, 1).T - np.diag(arm.armature)
    return inertia, np.asarray(pin.computeGeneralizedGravity(model, data, arm.home))
