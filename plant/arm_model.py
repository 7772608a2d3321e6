"""One arm as a mechanical model: frames, solids, inertias, home, and the pinocchio model.

All of it follows from the figures in ``plant.viper``. ``plant.mjcf`` writes the same frames and
inertias for MuJoCo, so that the two engines agree to rounding error.

Frames. Body i (1 to 6) turns with joint i about its own z axis, which is z of Denavit-Hartenberg
frame i-1; body 0 is the fixed base. At zero angle, body i+1 sits in body i at ``Rz(offset_i)
Tz(d_i) Tx(a_i) Rx(alpha_i)``, and the flange sits so in body 6.

Inertias (all estimated). Each link is a handful of solid cylinders, capsules and square bars along
the Denavit-Hartenberg lengths, and its mass is spread evenly over their volume, overlaps counted
twice. The same solids are drawn in the MJCF: what is seen is what is weighed.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from plant.chain import TIP_NAME, Arm, Inertia, Link, Solid
from plant.errors import PlantError
from plant.viper import ArmSpec, EndEffector, FloatArray, Station


@dataclass(frozen=True, eq=False)
class ArmModel:
    """Pinocchio model of one arm in the world's frame; it knows no friction and no contact."""

    model: Any
    """``pinocchio.Model`` of its joints; armature and limits are set."""
    tip: int
    """Frame id of the contact point, named as in ``TIP_NAME``, world-aligned at home."""


def dh_table(spec: ArmSpec) -> FloatArray:
    """Standard Denavit-Hartenberg parameters, rows (a, alpha, d, offset), shape (6, 4) [m, rad]."""
    right = np.pi / 2.0
    d1, a1, a2, a3, d4, d6 = (
        float(length.si) for length in (spec.d1, spec.a1, spec.a2, spec.a3, spec.d4, spec.d6)
    )
    return np.array(
        [
            [a1, -right, d1, 0.0],
            [a2, 0.0, 0.0, 0.0],
            [a3, -right, 0.0, -np.pi],
            [0.0, right, d4, 0.0],
            [0.0, -right, 0.0, 0.0],
            [0.0, 0.0, d6, -np.pi],
        ]
    )


def body_placements(spec: ArmSpec) -> FloatArray:
    """Pose of each body in the one before it at zero joint angle, shape (7, 4, 4) [m].

    Entries 0 to 5 place bodies 1 to 6, entry 6 places the flange in body 6.
    """
    placements = np.tile(np.eye(4), (7, 1, 1))
    for placement, (a, alpha, d, offset) in zip(placements[1:], dh_table(spec), strict=True):
        turn = rotation("z", offset)
        placement[:3, :3] = turn @ rotation("x", alpha)
        placement[:3, 3] = turn @ np.array([a, 0.0, d])
    return placements


def base_placement(station: Station) -> FloatArray:
    """Pose of the base in the world, shape (4, 4) [m]."""
    placement = np.eye(4)
    placement[:3, :3] = rotation("z", float(station.base_yaw.si))
    placement[0, 3] = float(station.base_x.si)
    return placement


def tip_placement(station: Station) -> FloatArray:
    """Pose of the contact point in the flange, world-aligned at home, shape (4, 4) [m]."""
    effector = station.effector
    flange_at_home = rotation("z", float(station.base_yaw.si)) @ rotation(
        "y", float(effector.pitch.si)
    )
    placement = np.eye(4)
    placement[:3, :3] = flange_at_home.T
    placement[:3, 3] = [-float(effector.rise.si), 0.0, float(effector.reach.si)]
    return placement


def home_configuration(spec: ArmSpec, station: Station) -> FloatArray:
    """Joint angles that bring the contact point home with the elbow up, shape (6,) [rad].

    q1 = q4 = q6 = 0 leaves a planar arm of two links, solved in closed form.

    Raises:
        PlantError: the contact point is out of reach, beside the arm's plane, or at home a joint
            would leave its range.
    """
    yaw, pitch = float(station.base_yaw.si), float(station.effector.pitch.si)
    base = base_placement(station)
    flange_to_tip = tip_placement(station)[:3, 3] + [0.0, 0.0, float(spec.d6.si)]
    goal = rotation("z", yaw).T @ (station.home_tip.si - base[:3, 3])
    shoulder = np.array([float(spec.a1.si), 0.0, float(spec.d1.si)])
    x, y, z = goal - rotation("y", pitch) @ flange_to_tip - shoulder

    upper, a3, d4 = float(spec.a2.si), float(spec.a3.si), float(spec.d4.si)
    fore, distance = np.hypot(a3, d4), np.hypot(x, z)
    if not abs(upper - fore) < distance < upper + fore or abs(y) > 1e-9:
        raise PlantError(f"the {station.name} arm cannot reach its contact point in its plane")
    at_shoulder = np.arccos((upper**2 + distance**2 - fore**2) / (2.0 * upper * distance))
    at_elbow = np.arccos((upper**2 + fore**2 - distance**2) / (2.0 * upper * fore))
    upper_elevation = np.arctan2(z, x) + at_shoulder
    fore_elevation = upper_elevation + at_elbow - np.pi
    q2 = -upper_elevation
    q23 = np.pi / 2.0 - fore_elevation + np.arctan2(a3, d4)
    q = np.array([0.0, q2, q23 - q2, 0.0, pitch - q23, 0.0])
    outside = np.flatnonzero((q < spec.lower) | (q > spec.upper))
    if outside.size:
        raise PlantError(f"home of the {station.name} arm: joint {outside[0] + 1} out of range")
    return q


def link_solids(spec: ArmSpec) -> tuple[tuple[Solid, ...], ...]:
    """Solids of the base and of links 1 to 6, each in its body's frame (seven tuples)."""
    d1, a1, a2, a3, d4, d6 = (
        float(length.si) for length in (spec.d1, spec.a1, spec.a2, spec.a3, spec.d4, spec.d6)
    )
    r0, r1, r2, r3, r4, r5, r6 = spec.link_radius.si.tolist()
    waist, split = 0.45 * d1, 0.45 * d4  # where link 1 sits on the base, and link 4 on link 3
    prong = 0.8 * r4  # link 4 ends in a fork that holds link 5
    return (
        (
            Solid("box", "joint", (0, 0, 0), (0, 0, 0.03), r0),
            Solid("cylinder", "shell", (0, 0, 0.03), (0, 0, waist), 0.85 * r0),
        ),
        (
            Solid("cylinder", "shell", (0, 0, waist), (0, 0, d1), r1),
            Solid("capsule", "shell", (0, 0, 0.9 * d1), (a1, 0, d1), 0.8 * r1),
            Solid("cylinder", "joint", (a1, -1.1 * r1, d1), (a1, 1.1 * r1, d1), 0.75 * r1),
        ),
        (
            Solid("capsule", "shell", (0, 0, 0), (a2, 0, 0), r2),
            Solid("cylinder", "joint", (a2, 0, -1.2 * r2), (a2, 0, 1.2 * r2), 0.8 * r2),
        ),
        (
            Solid("capsule", "shell", (0, 0, 0), (-a3, 0, 0), r3),
            Solid("cylinder", "shell", (-a3, r3, 0), (-a3, -split, 0), r3),
        ),
        (
            Solid("cylinder", "joint", (0, 0, split), (0, 0, 0.5 * d4), 0.9 * r4),
            Solid("cylinder", "shell", (0, 0, 0.5 * d4), (0, 0, 0.8 * d4), r4),
            Solid("capsule", "shell", (0, prong, 0.75 * d4), (0, prong, d4), 0.35 * r4),
            Solid("capsule", "shell", (0, -prong, 0.75 * d4), (0, -prong, d4), 0.35 * r4),
        ),
        (
            Solid("cylinder", "joint", (0, 0, -prong), (0, 0, prong), 0.8 * r5),
            Solid("cylinder", "shell", (0, 0, 0), (0, 0.7 * d6, 0), 0.9 * r5),
        ),
        (Solid("cylinder", "steel", (0, 0, 0.7 * d6), (0, 0, d6), r6),),
    )


def effector_solids(effector: EndEffector) -> tuple[Solid, ...]:
    """Solids of what the flange carries, in the flange's frame."""
    reach, rise = float(effector.reach.si), float(effector.rise.si)
    if effector.kind == "instrument":
        sensor, tip_radius = 0.25 * reach, 0.004
        return (
            Solid("cylinder", "steel", (0, 0, 0), (0, 0, sensor), 0.018),
            Solid("capsule", "steel", (0, 0, sensor), (0, 0, reach - tip_radius), tip_radius),
        )
    return (
        Solid("box", "steel", (0, 0, 0), (0, 0, reach), 0.012),
        Solid("cylinder", "steel", (0, 0, reach), (-0.4 * rise, 0, reach), 0.02),
        Solid("cylinder", "tissue", (-0.4 * rise, 0, reach), (-rise, 0, reach), 0.035),
    )


def mass_properties(mass: float, solids: tuple[Solid, ...]) -> Inertia:
    """Mass [kg] spread evenly over the volume of solids, as centre of mass and inertia."""
    starts = np.array([solid.start for solid in solids], dtype=np.float64)
    ends = np.array([solid.end for solid in solids], dtype=np.float64)
    lengths = np.linalg.norm(ends - starts, axis=1)
    axes, centres = (ends - starts) / lengths[:, None], (ends + starts) / 2.0
    moments = np.array(
        [_moments(solid, length) for solid, length in zip(solids, lengths, strict=True)]
    )
    density = mass / moments[:, 0].sum()
    volumes = moments[:, 0]
    com = volumes @ centres / volumes.sum()
    tensor = np.zeros((3, 3))
    for (volume, axial, transverse), axis, centre in zip(moments, axes, centres, strict=True):
        arm = centre - com
        tensor += transverse * np.eye(3) + (axial - transverse) * np.outer(axis, axis)
        tensor += volume * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Inertia(mass, com, density * tensor)


def link_inertias(spec: ArmSpec) -> tuple[Inertia, ...]:
    """Mass properties of the base and of links 1 to 6, each in its body's frame (seven)."""
    masses = spec.link_mass.si.tolist()
    return tuple(map(mass_properties, masses, link_solids(spec)))


def effector_inertia(effector: EndEffector) -> Inertia:
    """Mass properties of what the flange carries, in the flange's frame."""
    return mass_properties(float(effector.mass.si), effector_solids(effector))


def viper_arm(spec: ArmSpec, station: Station) -> Arm:
    """Return a Viper where it stands, with what it carries."""
    placements, inertias, solids = body_placements(spec), link_inertias(spec), link_solids(spec)
    bodies = [Link(*body) for body in zip(placements[:6], inertias[1:], solids[1:], strict=True)]
    effector = station.effector
    return Arm(
        name=station.name,
        base=Link(base_placement(station), inertias[0], solids[0]),
        links=tuple(bodies),
        effector=Link(placements[6], effector_inertia(effector), effector_solids(effector)),
        effector_name=effector.kind,
        tip=tip_placement(station),
        home=home_configuration(spec, station),
        lower=spec.lower,
        upper=spec.upper,
        speed=spec.joint_speed.si,
        torque_limit=spec.torque_limit.si,
        armature=spec.armature.si,
        coulomb=spec.coulomb_friction.si,
        viscous=spec.viscous_friction.si,
    )


def build_arm_model(arm: Arm, inertia_error: float | Sequence[float] = 0.0) -> ArmModel:
    """Pinocchio model of one arm where it stands, with what it carries.

    Args:
        arm: see there.
        inertia_error: e > -1; masses, inertias and armatures are (1 + e) times the true ones, to
            study a controller whose model is wrong; one for all, or one for each link and, as the
            last, for what the flange carries [-].

    Raises:
        PlantError: there are neither one nor as many errors.
    """
    count = arm.joints + 1
    errors = np.atleast_1d(np.asarray(inertia_error, dtype=np.float64))
    if errors.size not in (1, count):
        raise PlantError(f"imperfections.inertia_error: {errors.size} values, must be 1 or {count}")
    scale = 1.0 + np.broadcast_to(errors, (count,))
    model = pin.Model()
    parent, before = 0, pin.SE3(arm.base.placement)
    for i, link in enumerate(arm.links):
        parent = model.addJoint(
            parent,
            pin.JointModelPZ() if link.slides else pin.JointModelRZ(),
            before * pin.SE3(link.placement),
            f"{arm.name}_joint{i + 1}",
            arm.torque_limit[i : i + 1],
            arm.speed[i : i + 1],
            arm.lower[i : i + 1],
            arm.upper[i : i + 1],
        )
        before = pin.SE3.Identity()
        if link.inertia is not None:
            model.appendBodyToJoint(parent, _scaled(link.inertia, scale[i]), before)
    end = pin.SE3.Identity()
    if arm.effector is not None and arm.effector.inertia is not None:
        end = pin.SE3(arm.effector.placement)
        model.appendBodyToJoint(parent, _scaled(arm.effector.inertia, scale[-1]), end)
    model.armature = scale[:-1] * arm.armature
    tip = model.addFrame(
        pin.Frame(TIP_NAME[arm.name], parent, end * pin.SE3(arm.tip), pin.FrameType.OP_FRAME)
    )
    return ArmModel(model, tip)


def rotation(axis: Literal["x", "y", "z"], angle: float) -> FloatArray:
    """Rotation by ``angle`` [rad] about a coordinate axis, shape (3, 3)."""
    i = "xyz".index(axis)
    j, k = (i + 1) % 3, (i + 2) % 3
    matrix = np.eye(3)
    matrix[j, j] = matrix[k, k] = np.cos(angle)
    matrix[k, j], matrix[j, k] = np.sin(angle), -np.sin(angle)
    return matrix


def _scaled(inertia: Inertia, scale: float) -> Any:
    return pin.Inertia(scale * inertia.mass, inertia.com, scale * inertia.tensor)


def _moments(solid: Solid, length: float) -> tuple[float, float, float]:
    """Volume [m^3], axial and transverse second moment about the centre [m^5] at unit density."""
    r = solid.radius
    if solid.shape == "box":
        bar = 4.0 * r**2 * length
        return bar, bar * 2.0 / 3.0 * r**2, bar * (r**2 / 3.0 + length**2 / 12.0)
    tube = np.pi * r**2 * length
    axial, transverse = tube * r**2 / 2.0, tube * (r**2 / 4.0 + length**2 / 12.0)
    if solid.shape == "cylinder":
        return tube, axial, transverse
    ball = 4.0 / 3.0 * np.pi * r**3
    return (
        tube + ball,
        axial + ball * 2.0 / 5.0 * r**2,
        transverse + ball * (2.0 / 5.0 * r**2 + length**2 / 4.0 + 3.0 / 8.0 * length * r),
    )
