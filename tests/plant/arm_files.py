"""Arms of one's own for the tests: the one that is shipped, and some that are written here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import scenarios
from plant.config import ArmConfig

PANDA_FILE = Path(scenarios.__file__).parent / "arms" / "panda.xml"
PANDA = ArmConfig(str(PANDA_FILE), "flange", joint_speed=(2.175,) * 4 + (2.61,) * 3)

# Lengths of a UR5e as its maker publishes them: a, alpha, d of each joint; masses; the rest is made
# up. The frame of each link is the one behind its joint.
_A = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
_ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
_D = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
MASS = (3.761, 8.058, 2.846, 1.37, 1.3, 0.365)
TORQUE = (150.0, 150.0, 150.0, 28.0, 28.0, 28.0)
SPEED, FRICTION, DAMPING = 3.14, 1.5, 0.5
KEYS: dict[str, Any] = {"armature": 0.1}


def six_urdf(**changed: str) -> str:
    """A 6-joint arm in URDF; ``changed`` replaces the text of a link or joint by its name."""
    parts = {"base": '<link name="base"/>'}
    where = (0.0, 0.0, 0.0)  # x, z, roll of the next joint in the link before
    for i, (a, alpha, d) in enumerate(zip(_A, _ALPHA, _D, strict=True), start=1):
        x, z, roll = where
        parent = f"link{i - 1}" if i > 1 else "base"
        parts[f"joint{i}"] = (
            f'<joint name="joint{i}" type="revolute"><parent link="{parent}"/>'
            f'<child link="link{i}"/><origin xyz="{x} 0 {z}" rpy="{roll} 0 0"/><axis xyz="0 0 1"/>'
            f'<limit lower="-6.2" upper="6.2" effort="{TORQUE[i - 1]}" velocity="{SPEED}"/>'
            f'<dynamics friction="{FRICTION}" damping="{DAMPING}"/></joint>'
        )
        m = MASS[i - 1]
        parts[f"link{i}"] = (
            f'<link name="link{i}"><inertial><origin xyz="{a / 2} 0.01 {d / 2}"/>'
            f'<mass value="{m}"/><inertia ixx="{0.01 * m}" iyy="{0.02 * m}" izz="{0.015 * m}"'
            f' ixy="{0.001 * m}" ixz="0" iyz="{-0.001 * m}"/></inertial>'
            '<visual><geometry><mesh filename="package://nowhere/link.dae"/></geometry></visual>'
            "</link>"
        )
        where = (a, d, alpha)
    parts["flange"] = '<link name="tool0"/>'
    parts["fixed"] = (
        '<joint name="fixed" type="fixed"><parent link="link6"/><child link="tool0"/>'
        f'<origin xyz="{where[0]} 0 {where[1]}" rpy="{where[2]} 0 0"/></joint>'
    )
    assert set(changed) <= set(parts), set(changed) - set(parts)
    return f'<robot name="six">{"".join((parts | changed).values())}</robot>'


def six_mjcf(**extra: str) -> str:
    """The same arm in MJCF; ``extra`` adds ``top``, in a ``body``, or to a ``joint``."""
    text, closing = "", ""
    where = (0.0, 0.0, 0.0)
    for i, (a, alpha, d) in enumerate(zip(_A, _ALPHA, _D, strict=True), start=1):
        x, z, roll = where
        m, t = MASS[i - 1], TORQUE[i - 1]
        body = extra.get("body", "") if i == 3 else ""
        joint = extra.get("joint", "") if i == 3 else ""
        text += (
            f'<body name="link{i}" pos="{x} 0 {z}" euler="{roll} 0 0">'
            f'<inertial pos="{a / 2} 0.01 {d / 2}" mass="{m}" fullinertia="{0.01 * m} {0.02 * m}'
            f' {0.015 * m} {0.001 * m} 0 {-0.001 * m}"/>'
            f'<joint name="joint{i}" axis="0 0 1" range="-6.2 6.2" actuatorfrcrange="{-t} {t}"'
            f' damping="{DAMPING}" frictionloss="{FRICTION}" {joint}/>{body}'
        )
        closing += "</body>"
        where = (a, d, alpha)
    site = f'<site name="tool0" pos="{where[0]} 0 {where[1]}" euler="{where[2]} 0 0"/>'
    return (
        f'<mujoco><compiler angle="radian"/><worldbody><body name="base">{text}{site}{closing}'
        f"</body></worldbody>{extra.get('top', '')}</mujoco>"
    )


GANTRY = """<mujoco><compiler angle="degree"/>
<default><geom contype="0"/><joint armature="5" damping="40" frictionloss="10" range="-1 1"/>
<default class="turn"><joint armature="0.05" damping="0.5" frictionloss="0.4" range="-170 170"/>
</default></default>
<worldbody><light pos="0 0 3"/><geom type="plane" size="1 1 1"/>
<body name="frame" pos="0 0 1.2">
 <geom type="box" size="0.1 0.5 0.05"/>
 <body name="carriage">
  <joint name="x" type="slide" axis="1 0 0"/>
  <joint name="y" type="slide" axis="0 1 0" pos="0.1 0 0"/>
  <joint name="z" type="slide" axis="0 0 1" range="-0.8 0.4"/>
  <geom type="box" size="0.05 0.05 0.1" mass="8"/>
  <body name="wrist" pos="0 0 -0.15">
   <joint name="yaw" class="turn" axis="0 0 1"/>
   <joint name="pitch" class="turn" axis="1 1 0" pos="0 0 -0.02" ref="30"/>
   <joint name="roll" class="turn" axis="1 -1 0" pos="0 0.01 -0.02"/>
   <geom type="sphere" size="0.04" mass="1.5"/>
   <frame euler="180 0 0"><site name="end" pos="0 0 0.1"/>
    <geom type="capsule" size="0.01 0.05" pos="0 0 0.05" mass="0.3"/></frame>
   <body name="finger" pos="0.02 0 -0.1">
    <joint name="finger" type="slide" axis="1 0 0" range="0 0.04" ref="0.01"/>
    <geom type="box" size="0.005 0.01 0.03" mass="0.1"/></body>
   <body name="thumb" pos="-0.02 0 -0.1">
    <joint name="thumb" type="slide" axis="-1 0 0" range="0 0.04"/>
    <geom type="box" size="0.005 0.01 0.03" mass="0.1"/></body>
  </body></body></body></worldbody>
<equality><joint joint1="finger" joint2="thumb"/></equality>
<tendon><fixed name="grip"><joint joint="finger" coef="1"/><joint joint="thumb" coef="1"/></fixed>
</tendon>
<actuator><motor joint="x" ctrlrange="-300 300"/><motor joint="y" gear="100" ctrlrange="-3 3"/>
<general joint="z" forcerange="-400 500"/><motor joint="yaw" ctrlrange="-20 20"/>
<motor joint="pitch" ctrlrange="-20 20"/><motor joint="roll" ctrlrange="-20 20"/></actuator>
</mujoco>"""
"""Three slides on one body, three hinges on another, one at 30 deg where MuJoCo starts it, and a
gripper that is coupled in itself."""


def write(folder: Path, text: str, name: str = "arm.xml") -> str:
    """Write a file and return its path."""
    path = folder / name
    path.write_text(text)
    return str(path)


def own(folder: Path, kind: str) -> ArmConfig:
    """The configuration of one of the arms here, its file written into a folder."""
    if kind == "panda":
        return PANDA
    if kind == "gantry":
        return ArmConfig(write(folder, GANTRY, "gantry.xml"), "end", joint_speed=(1.0,) * 6)
    text, name = {
        "urdf": (six_urdf(), "six.urdf"),
        "mjcf": (six_mjcf(), "six.xml"),
    }[kind]
    speed = None if kind == "urdf" else SPEED
    return ArmConfig(write(folder, text, name), "tool0", joint_speed=speed, **KEYS)


KINDS: Sequence[str] = ("panda", "gantry", "urdf", "mjcf")
