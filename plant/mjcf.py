"""MuJoCo model (MJCF) of the cell: two arms, the contact spring between them, and what is drawn.

Names, with ``<arm>`` either ``heart`` or ``tool`` and n the joints of the tool, 6 of a Viper:
bodies ``<arm>_base``, ``<arm>_link1..n``, ``heart_pad``, ``tool_instrument``; joints
``<arm>_joint1..n``; sites ``heart_surface``, ``tool_tip``; camera ``overview``; keyframe ``home``.
Joints 0 to 5 are the heart's, the n behind them the tool's. Actuators, in this order:

    ======= ====================== ==============================================================
    6       ``heart_servo1..6``    torque = SERVO_STIFFNESS (ctrl - q) - SERVO_DAMPING qdot [N m]
    n       ``tool_motor1..n``     ctrl is the torque [N m], cut at the limit, after a lag if any
    3       ``contact_x/y/z``      the contact spring; its ctrl has no effect
    ======= ====================== ==============================================================

Equality constraints ``tool_brake1..n`` hold the tool's joints where ``eq_data`` says; not active
until the cell closes the brakes.

Flexible joints. Bodies ``tool_rotor1..n`` with joints of the same names, behind all others, then
stand for the motors, one turn of theirs for one of the link. Tendons ``tool_spring1..n`` join them
to the tool's joints. Armature, friction, actuators and brakes are theirs. They turn about an axis
of the world: that a rotor is carried along by its link counts for nothing.

Contact. The force that the tool exerts on the tissue is ``y = K (x_tool - x_tissue) + D (v_tool -
v_tissue)``, so pressing down gives a negative y on z. The tool feels ``-y``, and this is what the
contact actuators carry: a positive force on z means that the tissue pushes the tool up. As an
actuator between two sites the spring acts inside ``mj_step``, at the physics rate, equal and
opposite on both arms. ``plant.contact`` makes it unilateral, by its coefficients.

What MuJoCo does with ``refsite``: length and force of each contact actuator are along the axes of
``heart_surface``, which turn with the heart's flange. As K and D are the same on all axes, the
*vector* does not depend on these axes: ``-R`` times the forces of the three actuators, with R the
world orientation of ``heart_surface``, is y in the world, exactly, however the flange turns. Tool
and tissue are pushed at their own sites; the spring force lies on the line between the two, so no
moment is lost; only a damping force across that line leaves one, of force times distance (2 N at
2 mm: 4 mN m). Without R the error is the force times the angle of the flange, below 0.3 mrad under
10 N (measured).
"""

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree as ET

import numpy as np

from plant.chain import TIP_NAME, Arm, Link, Solid
from plant.flexibility import JointSprings
from plant.viper import FloatArray

SERVO_STIFFNESS = 40000.0
"""Position gain of the heart's joint servos [N m/rad]."""
SERVO_DAMPING = 400.0
"""Velocity gain of the heart's joint servos [N m s/rad]."""


def cell_mjcf(
    heart: Arm,
    tool: Arm,
    *,
    timestep: float,
    stiffness: float,
    damping: float,
    friction: float,
    torque_lag: float,
    springs: JointSprings | None = None,
) -> str:
    """MJCF of the whole cell.

    Args:
        heart: Robot_Heart, of six joints.
        tool: Robot_Tool, of n joints.
        timestep: of the physics [s].
        stiffness: K of the contact, on every axis [N/m].
        damping: D of the contact, on every axis [N s/m].
        friction: joint friction of both arms as a multiple of their own, 0 for none [-].
        torque_lag: time constant from torque command to torque of the tool's motors, 0 for
            none [s]. With a lag, the state of the motors is ``data.act``, shape (n,) [N m].
        springs: of the tool's joints; None: rigid.
    """
    root = ET.Element("mujoco", model="pulsempc cell")
    _add(root, "compiler", angle="radian", autolimits="true")
    # Only the joint friction needs the constraint solver: twelve rows, one per joint. Newton mostly
    # needs a single step from a warm start. PGS takes as long (measured, within the noise); CG, or
    # Newton from a cold start, makes the whole step twice as long; a coarse tolerance gains nothing
    # and a limit of one iteration loses accuracy. Looking for islands costs a tenth more.
    option = _add(root, "option", timestep=timestep, integrator="implicitfast", solver="Newton")
    _add(option, "flag", contact="disable", island="disable", autoreset="disable")
    _add_looks(root)
    world = _add(root, "worldbody")
    _add_surroundings(world)
    motors = {arm.name: _motors(arm, timestep, friction) for arm in (heart, tool)}
    motor = "tool_joint" if springs is None else "tool_rotor"
    _add_arm(world, heart, motors["heart"])
    _add_arm(world, tool, motors["tool"] if springs is None else [{}] * tool.joints)
    if springs is not None:
        _add_rotors(world, tool, motors["tool"])
        _add_springs(root, springs)
    actuators = _add(root, "actuator")
    for i in range(1, heart.joints + 1):
        _add(
            actuators,
            "general",
            name=f"heart_servo{i}",
            joint=f"heart_joint{i}",
            gainprm=SERVO_STIFFNESS,
            biastype="affine",
            biasprm=(0.0, -SERVO_STIFFNESS, -SERVO_DAMPING),
        )
    lag = {"dyntype": "filterexact", "dynprm": torque_lag} if torque_lag > 0 else {}
    for i, limit in enumerate(tool.torque_limit.tolist(), start=1):
        _add(
            actuators,
            "general",
            name=f"tool_motor{i}",
            joint=f"{motor}{i}",
            forcerange=(-limit, limit),
            **lag,
        )
    for axis, direction in zip("xyz", np.eye(3), strict=True):
        _add(
            actuators,
            "general",
            name=f"contact_{axis}",
            site=TIP_NAME["tool"],
            refsite=TIP_NAME["heart"],
            gear=(*direction, 0.0, 0.0, 0.0),
            gainprm=0.0,
            biastype="affine",
            biasprm=(0.0, -stiffness, -damping),
        )
    brakes = _add(root, "equality")
    for i in range(1, tool.joints + 1):
        _add(
            brakes,
            "joint",
            name=f"tool_brake{i}",
            joint1=f"{motor}{i}",
            active="false",
            solref=(2.0 * timestep, 1.0),
            solimp=(0.9999, 0.9999, 0.001, 0.5, 2.0),
        )
    _add(
        _add(root, "keyframe"),
        "key",
        name="home",
        qpos=np.concatenate([heart.home, *[tool.home] * (1 if springs is None else 2)]),
        ctrl=np.concatenate([heart.home, np.zeros(tool.joints + 3)]),
    )
    ET.indent(root)
    return ET.tostring(root, encoding="unicode")


def _add_arm(world: ET.Element, arm: Arm, motors: Sequence[Mapping[str, object]]) -> None:
    """Add an arm; ``motors`` are further attributes of its joints."""
    name = arm.name
    # The heart's servos only have to track: its weight is carried.
    extra = {"gravcomp": 1.0} if name == "heart" else {}
    body = _add_body(world, f"{name}_base", arm.base.placement, arm.base)
    waiting: list[tuple[int, FloatArray]] = []
    placement = np.eye(4)
    for j, link in enumerate(arm.links):
        placement = link.placement if not waiting else placement @ link.placement
        waiting.append((j, placement))
        if link.inertia is None:  # several joints move the same body
            continue
        body = _add_body(body, f"{name}_link{j + 1}", placement, link, **extra)
        for i, frame in waiting:
            joint = {**_joint(arm, i), **motors[i]}
            if i != j:
                own = np.linalg.inv(placement) @ frame
                joint |= {"pos": own[:3, 3], "axis": own[:3, 2]}
            _add(body, "joint", **joint)
        waiting = []
    if arm.effector is not None:
        body = _add_body(
            body, f"{name}_{arm.effector_name}", arm.effector.placement, arm.effector, **extra
        )
    _add(body, "site", name=TIP_NAME[name], size=0.003, group=3, **_pose(arm.tip))


def _joint(arm: Arm, j: int) -> dict[str, object]:
    """Return the attributes of an arm's joint ``j``, from 0, but for what its motor brings."""
    return {
        "name": f"{arm.name}_joint{j + 1}",
        **({"type": "slide"} if arm.links[j].slides else {}),
        "range": (arm.lower[j], arm.upper[j]),
    }


def _motors(arm: Arm, timestep: float, friction: float) -> list[dict[str, object]]:
    """Return what each motor brings to the joint that it moves: armature and friction."""
    found: list[dict[str, object]] = []
    for j in range(arm.joints):
        losses: dict[str, object] = {}
        if friction > 0:
            # MuJoCo's stiction is a strong damper: under half the Coulomb torque the tip creeps at
            # 8 mm/s with its default reference and impedance, at 1 um/s with the shortest time
            # constant that it accepts and this impedance, at the same cost.
            losses = {
                "frictionloss": friction * arm.coulomb[j],
                "damping": friction * arm.viscous[j],
                "solreffriction": (2.0 * timestep, 1.0),
                "solimpfriction": (0.999, 0.999, 0.001),
            }
        found.append({"armature": arm.armature[j], **losses})
    return found


def _add_rotors(world: ET.Element, arm: Arm, motors: Sequence[Mapping[str, object]]) -> None:
    """Add the motors on their own, behind both arms, so that the joints' numbers stay."""
    for i, motor in enumerate(motors, start=1):
        place = arm.base.placement[:3, 3]
        body = _add(world, "body", name=f"tool_rotor{i}", pos=place, gravcomp=1.0)
        # MuJoCo wants a body to weigh something; what moves is the armature.
        light = {"mass": 1e-6, "diaginertia": (1e-9, 1e-9, 1e-9)}
        _add(body, "inertial", pos=(0.0, 0.0, 0.0), **light)
        _add(body, "joint", name=f"tool_rotor{i}", axis=(0.0, 0.0, 1.0), **motor)


def _add_springs(root: ET.Element, springs: JointSprings) -> None:
    tendons = _add(root, "tendon")
    both = zip(springs.stiffness.tolist(), springs.damping.tolist(), strict=True)
    for i, (stiffness, damping) in enumerate(both, start=1):
        tendon = _add(
            tendons,
            "fixed",
            name=f"tool_spring{i}",
            stiffness=stiffness,
            damping=damping,
            springlength=0.0,
        )
        _add(tendon, "joint", joint=f"tool_joint{i}", coef=1.0)
        _add(tendon, "joint", joint=f"tool_rotor{i}", coef=-1.0)


def _add_body(
    parent: ET.Element, name: str, placement: FloatArray, link: Link, **extra: float
) -> ET.Element:
    body = _add(parent, "body", name=name, **_pose(placement), **extra)
    if link.inertia is not None:
        i = link.inertia.tensor
        _add(
            body,
            "inertial",
            pos=link.inertia.com,
            mass=link.inertia.mass,
            fullinertia=(i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]),
        )
    for drawn in link.drawn:
        if isinstance(drawn, Solid):
            where: dict[str, object] = {
                "type": drawn.shape,
                "fromto": (*drawn.start, *drawn.end),
                "size": drawn.radius,
                "material": drawn.material,
            }
        else:
            where = {"type": drawn.kind, "size": drawn.size, "material": "shell"}
            where |= _pose(drawn.placement)
        _add(body, "geom", **where, contype="0", conaffinity="0")
    return body


def _add_looks(root: ET.Element) -> None:
    visual = _add(root, "visual")
    _add(visual, "global", offwidth=1920, offheight=1080)
    _add(visual, "headlight", ambient=(0.35, 0.35, 0.35), diffuse=(0.35, 0.35, 0.35))
    _add(visual, "quality", shadowsize=4096)
    _add(visual, "map", znear=0.02)
    asset = _add(root, "asset")
    blue, white, black = (0.55, 0.65, 0.75), (0.93, 0.95, 0.97), (0.16, 0.17, 0.19)
    sizes = {"width": 512, "height": 512}
    _add(asset, "texture", type="skybox", builtin="gradient", rgb1=white, rgb2=blue, **sizes)
    _add(
        asset,
        "texture",
        name="tiles",
        type="2d",
        builtin="checker",
        rgb1=(0.78, 0.80, 0.82),
        rgb2=(0.72, 0.74, 0.77),
        **sizes,
    )
    _add(asset, "material", name="floor", texture="tiles", texrepeat=(8, 8), reflectance=0.08)
    _add(asset, "material", name="shell", rgba=(*white, 1.0), specular=0.4, shininess=0.5)
    _add(asset, "material", name="joint", rgba=(*black, 1.0), specular=0.3, shininess=0.3)
    _add(asset, "material", name="steel", rgba=(0.62, 0.64, 0.67, 1), specular=0.9, shininess=0.9)
    _add(asset, "material", name="tissue", rgba=(0.75, 0.22, 0.22, 1), specular=0.5, shininess=0.6)


def _add_surroundings(world: ET.Element) -> None:
    _add(world, "light", pos=(-0.6, -1.2, 2.2), dir=(0.3, 0.6, -1.0), diffuse=(0.6, 0.6, 0.6))
    _add(
        world,
        "geom",
        name="floor",
        type="plane",
        size=(2.0, 2.0, 0.1),
        material="floor",
        contype="0",
        conaffinity="0",
    )
    # Looks along +y and a little down; x of the picture is x of the world.
    down = np.deg2rad(15.0)
    _add(
        world,
        "camera",
        name="overview",
        pos=(0.0, -1.55, 0.80),
        xyaxes=(1.0, 0.0, 0.0, 0.0, np.sin(down), np.cos(down)),
        fovy=45.0,
    )


def _pose(placement: FloatArray) -> dict[str, FloatArray]:
    return {"pos": placement[:3, 3], "xyaxes": placement[:3, :2].T.ravel()}


def _add(parent: ET.Element, tag: str, **attributes: object) -> ET.Element:
    return ET.SubElement(parent, tag, {key: _text(value) for key, value in attributes.items()})


def _text(value: object) -> str:
    """Attribute as MJCF text; 17 digits give every double back as it was."""
    if isinstance(value, str):
        return value
    return " ".join(f"{number:.17g}" for number in np.asarray(value, dtype=np.float64).ravel())
