"""The numbers of the Adept Viper s650 and of the two places where it stands in the cell.

Every figure is a ``Quantity``: value, unit as its source prints it, source, and whether it is an
estimate of ours. ``plant.arm_model`` turns the figures into frames, inertias and a pinocchio model,
``plant.mjcf`` into the MuJoCo model of the cell.

Kinematics. Standard Denavit-Hartenberg frames, ``A_i = Rz(q_i + offset_i) Tz(d_i) Tx(a_i)
Rx(alpha_i)``, in the convention in which the joint ranges are published (ViSP, ``vpViper``):

    ====== ====== ======== ====== =========
    joint  a      alpha    d      offset
    ====== ====== ======== ====== =========
    1      a1     -90 deg  d1     0
    2      a2     0        0      0
    3      a3     -90 deg  0      -180 deg
    4      0      +90 deg  d4     0
    5      0      -90 deg  0      0
    6      0      0        d6     -180 deg
    ====== ====== ======== ====== =========

Joint 1 turns about the vertical; joints 2, 3 (and 5 at q4 = 0) about the base's +y; joints 4, 5, 6
meet in the wrist. With all joints at zero the upper arm lies forward, level, and the forearm points
up. The arm stands straight up at q2 = -90, q3 = 90 deg, and has its upper arm upright and its
forearm level, forward, at q2 = -90, q3 = 180 deg. So -190..45 deg takes the upper arm from 10 deg
below level behind to 45 deg below level in front, and -29..256 deg folds the forearm by up to 119
deg to one side of the stretched arm and 166 deg to the other. With q1 = q4 = q6 = 0 the flange
frame is Ry(q2 + q3 + q5) in the base frame, so that its z axis (out of the flange) points up at 0,
forward at 90, and down at 180 deg.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_SI_FACTOR = {
    "m": 1.0,
    "N": 1.0,
    "kg": 1.0,
    "kg m^2": 1.0,
    "N m": 1.0,
    "N m s/rad": 1.0,
    "deg": np.pi / 180.0,
    "deg/s": np.pi / 180.0,
}


@dataclass(frozen=True)
class Quantity:
    """A figure with its unit and its origin."""

    value: float | tuple[float, ...] | tuple[tuple[float, float], ...]
    """Number, one number per joint or link, or one (low, high) pair per joint, in ``unit``."""
    unit: str
    """Unit as printed in the source."""
    source: str
    """Where the value comes from."""
    estimated: bool = False
    """True for a plausible value of our own, False for a published or measured one."""

    @property
    def si(self) -> FloatArray:
        """The value in SI units (angles in rad), an array of the shape of ``value``."""
        return np.asarray(self.value, dtype=np.float64) * _SI_FACTOR[self.unit]


_ESTIMATE = "estimate: "
_LENGTHS = "ViSP vpViper650; ROS-Industrial adept_viper_s650_support agrees"
_DATA_SHEET = "as given for the Adept Viper s650; not checked against its data sheet"
_FRICTION = (
    "identified on the sister robot from Denso; data with S. Lloyd, R. Irani, M. Ahmadi, "
    "Mech. Mach. Theory 156:104149, 2021 (PSDM)"
)


@dataclass(frozen=True)
class ArmSpec:
    """One arm: six revolute joints, a fixed base and six links."""

    d1: Quantity
    """Height of the shoulder axis (joint 2) above the base."""
    a1: Quantity
    """Offset of the shoulder axis from the axis of joint 1."""
    a2: Quantity
    """Length of the upper arm."""
    a3: Quantity
    """Offset of the forearm axis (joint 4) from the elbow axis (joint 3)."""
    d4: Quantity
    """Length of the forearm, elbow to wrist centre."""
    d6: Quantity
    """Wrist centre to flange."""
    joint_range: Quantity
    """Six (low, high) pairs."""
    joint_speed: Quantity
    """Largest speed of each joint."""
    coulomb_friction: Quantity
    """Coulomb friction of each joint."""
    viscous_friction: Quantity
    """Viscous friction of each joint."""
    armature: Quantity
    """Rotor inertia of each joint, seen at the joint."""
    torque_limit: Quantity
    """Largest torque of each joint."""
    link_mass: Quantity
    """Seven masses: the fixed base, then links 1 to 6."""
    link_radius: Quantity
    """Seven radii of the solids that make up the base and links 1 to 6."""

    @property
    def lower(self) -> FloatArray:
        """Lower ends of the joint ranges, shape (6,) [rad]."""
        return self.joint_range.si[:, 0]

    @property
    def upper(self) -> FloatArray:
        """Upper ends of the joint ranges, shape (6,) [rad]."""
        return self.joint_range.si[:, 1]


VIPER_S650 = ArmSpec(
    d1=Quantity(0.335, "m", _LENGTHS),
    a1=Quantity(0.075, "m", _LENGTHS),
    a2=Quantity(0.270, "m", _LENGTHS),
    a3=Quantity(0.090, "m", _LENGTHS),
    d4=Quantity(0.295, "m", _LENGTHS),
    d6=Quantity(0.080, "m", _LENGTHS),
    joint_range=Quantity(
        ((-170, 170), (-190, 45), (-29, 256), (-190, 190), (-120, 120), (-360, 360)),
        "deg",
        "ViSP vpViper650",
    ),
    joint_speed=Quantity((328, 300, 375, 375, 375, 600), "deg/s", _DATA_SHEET),
    coulomb_friction=Quantity((9.6, 8.9, 6.2, 3.6, 2.4, 1.6), "N m", _FRICTION),
    viscous_friction=Quantity((23.7, 28.7, 10.7, 2.4, 4.5, 1.6), "N m s/rad", _FRICTION),
    armature=Quantity(
        (0.40, 0.45, 0.20, 0.08, 0.07, 0.03),
        "kg m^2",
        _ESTIMATE + "rotor inertia times the square of a gear ratio usual in this size",
        estimated=True,
    ),
    torque_limit=Quantity(
        (150, 180, 90, 45, 40, 25),
        "N m",
        _ESTIMATE + "friction at full speed and a reserve",
        estimated=True,
    ),
    link_mass=Quantity(
        (8.32, 6.59, 5.38, 5.01, 2.22, 0.40, 0.08),
        "kg",
        _ESTIMATE + "28 kg in all, shared out by the size of the links",
        estimated=True,
    ),
    link_radius=Quantity(
        (0.095, 0.085, 0.060, 0.055, 0.042, 0.030, 0.025),
        "m",
        _ESTIMATE + "by eye, so that the arm looks like the robot",
        estimated=True,
    ),
)


@dataclass(frozen=True)
class EndEffector:
    """What a flange carries: sensor and instrument, or bracket and tissue pad."""

    kind: Literal["instrument", "pad"]
    mass: Quantity
    """Mass, spread evenly over the solids that ``plant.arm_model`` builds for the kind."""
    reach: Quantity
    """Distance of the contact point from the flange along the flange's z axis."""
    rise: Quantity
    """Distance of the contact point from the flange along the flange's -x axis."""
    pitch: Quantity
    """q2 + q3 + q5 at home: 90 deg holds the flange forward, 180 deg downwards."""


@dataclass(frozen=True)
class Station:
    """Where one arm stands in the cell and what it carries. The world's z axis points up."""

    name: Literal["heart", "tool"]
    """Prefix of all names of this arm."""
    base_x: Quantity
    """Position of the base on the world's x axis (y = z = 0)."""
    base_yaw: Quantity
    """Rotation of the base about the vertical."""
    effector: EndEffector
    home_tip: Quantity
    """Contact point at home in the world, (x, y, z)."""


_CELL = "chosen: bases 0.92 m apart, contact within reach and no joint near its range or singular"
_EFFECTOR = _ESTIMATE + "a small force sensor with a slim shaft; a bracket with a silicone pad"

CONTACT_POINT = Quantity((0.0, 0.0, 0.42), "m", _CELL)
"""Where instrument and tissue touch at home, in the world."""

HEART = Station(
    name="heart",
    base_x=Quantity(-0.52, "m", _CELL),
    base_yaw=Quantity(0.0, "deg", _CELL),
    effector=EndEffector(
        kind="pad",
        mass=Quantity(0.25, "kg", _EFFECTOR, estimated=True),
        reach=Quantity(0.04, "m", _EFFECTOR, estimated=True),
        rise=Quantity(0.06, "m", _EFFECTOR, estimated=True),
        pitch=Quantity(90.0, "deg", _CELL),
    ),
    home_tip=CONTACT_POINT,
)
"""Robot_Heart: its flange points forward and carries, on a bracket, a pad that faces up."""

TOOL = Station(
    name="tool",
    base_x=Quantity(0.40, "m", _CELL),
    base_yaw=Quantity(180.0, "deg", _CELL),
    effector=EndEffector(
        kind="instrument",
        mass=Quantity(0.15, "kg", _EFFECTOR, estimated=True),
        reach=Quantity(0.12, "m", _EFFECTOR, estimated=True),
        rise=Quantity(0.0, "m", _EFFECTOR, estimated=True),
        pitch=Quantity(180.0, "deg", _CELL),
    ),
    home_tip=CONTACT_POINT,
)
"""Robot_Tool: its flange points down and carries sensor and instrument."""
