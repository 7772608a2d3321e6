"""An arm as both engines get it: a chain of links that turn or slide, where it stands in the cell.

The Viper's is made in ``plant.arm_model``, one from a user's file in ``plant.own_arm``.
``plant.arm_model.build_arm_model`` makes the pinocchio model of it, ``plant.mjcf`` MuJoCo's bodies,
from the same numbers, so that the two engines agree to rounding error.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from plant.viper import FloatArray

TIP_NAME = {"heart": "heart_surface", "tool": "tool_tip"}
"""Name of the contact point of each arm: a site in MuJoCo, a frame in pinocchio."""


@dataclass(frozen=True)
class Solid:
    """A solid of uniform density around the axis from ``start`` to ``end``, in the body's frame."""

    shape: Literal["cylinder", "capsule", "box"]
    """``capsule``: with half spheres beyond both ends; ``box``: a bar of square section."""
    material: Literal["shell", "joint", "steel", "tissue"]
    start: tuple[float, float, float]
    """[m]"""
    end: tuple[float, float, float]
    """[m]"""
    radius: float
    """Radius, or half the side of the square [m]."""


@dataclass(frozen=True, eq=False)
class Shape:
    """A primitive of MuJoCo's that is drawn and weighs nothing, in the body's frame."""

    kind: str
    """MuJoCo's name of it: sphere, capsule, ellipsoid, cylinder, box."""
    size: FloatArray
    """Its three sizes, as MuJoCo has them, ``(3,)`` [m]."""
    placement: FloatArray
    """``(4, 4)`` [m]."""


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass properties of one body in the body's frame."""

    mass: float
    """[kg]"""
    com: FloatArray
    """Centre of mass, shape (3,) [m]."""
    tensor: FloatArray
    """Rotational inertia about the centre of mass, shape (3, 3) [kg m^2]."""


@dataclass(frozen=True, eq=False)
class Link:
    """A body, and the joint about whose axis it turns, or along which it slides: its own z."""

    placement: FloatArray
    """In the body before it (of the base: in the world) where its joint stands at zero,
    ``(4, 4)`` [m]."""
    inertia: Inertia | None
    """None: nothing but a joint; the next link moves on it."""
    drawn: tuple[Solid | Shape, ...] = ()
    """What is seen of it."""
    slides: bool = False
    """Whether its joint slides; angles and torques of such a joint are lengths and forces."""


@dataclass(frozen=True, eq=False)
class Arm:
    """One arm of n joints where it stands, with what it carries. Arrays are ``(n,)``."""

    name: Literal["heart", "tool"]
    """Prefix of all names of this arm."""
    base: Link
    """What stands still; its inertia has no effect."""
    links: tuple[Link, ...]
    """From the base to the one that carries the end-effector."""
    effector: Link | None
    """What is fixed to the last link; None: nothing."""
    effector_name: str
    """Its name in MuJoCo, behind the arm's."""
    tip: FloatArray
    """Pose of the contact point in the end-effector, or in the last link where there is none;
    world-aligned at home, ``(4, 4)`` [m]."""
    home: FloatArray
    """Joint angles that bring the tip to the cell's contact point [rad]."""
    lower: FloatArray
    """Lower ends of the joints' ranges [rad]."""
    upper: FloatArray
    """Upper ends [rad]."""
    speed: FloatArray
    """Rated speeds [rad/s]."""
    torque_limit: FloatArray
    """Torques at which the motors saturate [N m]."""
    armature: FloatArray
    """Rotor inertias, seen at the joints [kg m^2]."""
    coulomb: FloatArray
    """Coulomb friction [N m]."""
    viscous: FloatArray
    """Viscous friction [N m s/rad]."""

    @property
    def joints(self) -> int:
        """How many joints it has."""
        return len(self.links)


def rotation_between(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the smallest rotation that takes one unit vector ``(3,)`` to another, ``(3, 3)``."""
    axis, cosine = np.cross(start, end), float(start @ end)
    if cosine < -1.0 + 1e-12:  # half a turn, about any axis across
        across = np.cross(start, np.eye(3)[int(np.abs(start).argmin())])
        across /= np.linalg.norm(across)
        return np.asarray(2.0 * np.outer(across, across) - np.eye(3))
    skew = np.array([[0.0, -axis[2], axis[1]], [axis[2], 0.0, -axis[0]], [-axis[1], axis[0], 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1.0 + cosine))
