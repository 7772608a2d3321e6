"""Files that are no arm: one line each, naming what is wrong; and none that opens another file."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.arm_file import read_arm_file
from plant.config import ArmConfig
from plant.errors import ArmError, PlantError
from plant.own_arm import own_arm

from . import arm_files
from .arm_files import KEYS, SPEED, six_mjcf, six_urdf


def refused(folder, text: str, **keys: Any) -> str:
    """Read a file that must be refused; return the line."""
    tip = keys.pop("tip", "tool0")
    given_keys = {"joint_speed": SPEED, **KEYS} | keys
    path = arm_files.write(folder, text, "mine.xml")
    with pytest.raises(ArmError) as caught:
        own_arm(ArmConfig(path, tip, **given_keys))
    line = str(caught.value)
    assert "\n" not in line
    assert len(line) < 500
    return line


def joint(text: str) -> dict[str, str]:
    """Joint 3 of the URDF arm with another text inside."""
    return {
        "joint3": '<joint name="joint3" type="revolute"><parent link="link2"/><child link="link3"/>'
        f'<origin xyz="-0.425 0 0"/><axis xyz="0 0 1"/>{text}</joint>'
    }


def other_joint(kind: str, parent: str) -> dict[str, str]:
    """Joint 3 of the URDF arm of another kind, on another link."""
    ends = f'<parent link="{parent}"/><child link="link3"/>'
    return {"joint3": f'<joint name="joint3" type="{kind}">{ends}</joint>'}


LIMIT = '<limit lower="-3" upper="3" effort="100" velocity="3"/>'
LOSS = '<dynamics friction="1" damping="1"/>'
BALL = '<joint type="ball"/>'
MESH = '<geom type="mesh" mesh="x"/>'
SHORT = six_mjcf().replace('<joint name="joint4"', '<!--<joint name="joint4"').replace(
    'frictionloss="1.5" /><body name="link5"', 'frictionloss="1.5" />--><body name="link5"'
)  # fmt: skip
LOOP = '<equality><connect body1="link3" body2="link1" anchor="0 0 0"/></equality>'
COUPLED = '<equality><joint joint1="joint2" joint2="joint3"/></equality>'
TENDON = '<tendon><fixed><joint joint="joint2" coef="1"/></fixed></tendon>'
INCLUDE = "<include file='{}'/>"

MJCF = {
    "not XML": ("<mujoco", "not XML"),
    "empty": ("", "not XML"),
    "a picture": ("\x89PNG\r\n", "not XML"),
    "another language": ("<svg/>", "neither MJCF nor URDF: its root is <svg>"),
    "no arm in it": ("<mujoco/>", "no site or body 'tool0' (it has: none)"),
    "an attribute that is none": (six_mjcf(joint='stiff="1"'), "unrecognized attribute: 'stiff'"),
    "an element that is none": (six_mjcf(body="<bdy/>"), "bdy"),
    "a number that is none": (six_mjcf(joint='ref="nan"'), "<joint> has ref='nan'"),
    "an infinite range": (six_mjcf(joint='margin="-inf"'), "<joint> has margin='-inf'"),
    "a ball joint": (six_mjcf(body=BALL), "is a ball or free"),
    "a spring": (six_mjcf(joint='stiffness="100"'), "joint 'joint3' has a spring"),
    "five joints": (SHORT, "5 joints from the base to 'tool0'"),
    "a loop": (six_mjcf(top=LOOP), "equality constraint '0' acts on the arm"),
    "coupled joints": (six_mjcf(top=COUPLED), "equality constraint '0' acts on the arm"),
    "a tendon": (six_mjcf(top=TENDON), "a tendon acts on the arm"),
    "no mass": (six_mjcf().replace('mass="2.846"', 'mass="0"'), "mass"),
    "negative mass": (six_mjcf().replace('mass="2.846"', 'mass="-1"'), "mass"),
    "an impossible inertia": (
        re.sub(r'(mass="2.846" fullinertia=")[^"]*', r"\g<1>0.02 0.02 5 0 0 0", six_mjcf()),
        "inertia must satisfy",
    ),
    "mass from a mesh": (
        re.sub(r"<inertial[^>]*>", MESH, six_mjcf(), count=1),
        "the mass of body 'link1' would have to come from a mesh",
    ),
    "mass from meshes on purpose": (
        six_mjcf(body=MESH).replace("<compiler", '<compiler inertiafromgeom="true"'),
        "the mass of body 'link3' would have to come from a mesh",
    ),
    "a composite": (six_mjcf(body='<composite type="cable"/>'), "has a <composite>"),
    "a replicate": (six_mjcf(body='<replicate count="1000000000"/>'), "has a <replicate>"),
    "an attached model": (six_mjcf(body='<attach model="x" body="y"/>'), "has a <attach>"),
    "an unknown section": (six_mjcf(top="<plugins/>"), "has a section <plugins>"),
    "names twice": (six_mjcf(body='<body name="link2"/>'), "link2"),
    "a free base": (
        six_mjcf().replace('name="base">', 'name="base"><freejoint/><geom size="0.1"/>'),
        "is a ball or free",
    ),
    "an external entity": (
        '<!DOCTYPE m [<!ENTITY e SYSTEM "/etc/passwd">]>' + six_mjcf(), "document type or entities"
    ),
    "a bomb": (
        '<!DOCTYPE m [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]>' + six_mjcf(), "document type"
    ),
    "an absolute include": (six_mjcf(top=INCLUDE.format("/etc/hosts")), "only files beside it"),
    "an include of a parent": (six_mjcf(top=INCLUDE.format("../x.xml")), "only files beside it"),
    "a hidden include": (six_mjcf(body=INCLUDE.format("a/../../x.xml")), "only files beside it"),
    "an include of nothing": (six_mjcf(top=INCLUDE.format("no.xml")), "no such file"),
    "an include of the folder": (six_mjcf(top=INCLUDE.format(".")), "only files beside it"),
    "an include of itself": (six_mjcf(top=INCLUDE.format("mine.xml")), "twice"),
}  # fmt: skip
URDF = {
    "unlimited": (joint('<limit effort="1" velocity="1"/>' + LOSS), "joint_range"),
    "no effort": (joint('<limit lower="-3" upper="3" velocity="3"/>' + LOSS), "torque_limit"),
    "no speed": (joint('<limit lower="-3" upper="3" effort="9"/>' + LOSS), "joint_speed"),
    "a speed that is none": (
        joint('<limit lower="-3" upper="3" effort="9" velocity="fast"/>'),
        "its velocity is no number",
    ),
    "an empty range": (
        joint('<limit lower="3" upper="3" effort="9" velocity="1"/>' + LOSS), "range"
    ),
    "no friction": (joint(LIMIT), "cell.arm.coulomb_friction"),
    "no inertia": ({"link3": '<link name="link3"/>'}, "mass and inertia"),
    "a mimic": (joint(LIMIT + LOSS + '<mimic joint="joint2"/>'), "acts on the arm"),
    "a joint to nowhere": (other_joint("revolute", "nobody"), "parent or child missing"),
    "xacro": ({"base": '<x:macro xmlns:x="http://www.ros.org/wiki/xacro"/>'}, "is a xacro file"),
    "a floating joint": (other_joint("floating", "link2"), "free joint"),
    "a planar joint": (other_joint("planar", "link2"), "joint_speed"),
}  # fmt: skip


@pytest.mark.parametrize("what", sorted(MJCF))
def test_mjcf_that_is_no_arm_is_refused_in_one_line(what, tmp_path):
    text, told = MJCF[what]
    assert told in refused(tmp_path, text)


@pytest.mark.parametrize("what", sorted(URDF))
def test_urdf_that_is_no_arm_is_refused_in_one_line(what, tmp_path):
    changed, told = URDF[what]
    assert told in refused(tmp_path, six_urdf(**changed), joint_speed=None)


WRONG_KEYS = {
    "tip": ("tool", "cell.arm.tip: mine.xml has no site or body 'tool', did you mean 'tool0'?"),
    "home": ((0.0,) * 5, "cell.arm.home: must have 6 angles, got 5"),
    "base": ((5.0, 0.0, 0.0), "cell.arm.home: no posture presses straight down on the contact"),
    "base_yaw": (1.0, "cell.arm.base_yaw: no effect without cell.arm.base"),
    "joint_range": (((-1.0, 1.0),) * 5, "cell.arm.joint_range: must have 6 pairs"),
    "joint_speed": ((1.0,) * 7, "cell.arm.joint_speed: must be one number or 6, got 7"),
    "torque_limit": (0.0, "cell.arm.torque_limit: must be greater than 0"),
    "armature": (None, "cell.arm.armature: mine.xml has none for joint 'joint1': give one number"),
    "coulomb_friction": ((1.0,), "cell.arm.coulomb_friction: must be one number or 6, got 1"),
}


@pytest.mark.parametrize("key", sorted(WRONG_KEYS))
def test_keys_that_do_not_fit_are_refused_in_one_line(key, tmp_path):
    value, told = WRONG_KEYS[key]
    assert told in refused(tmp_path, six_mjcf(), **{key: value})


def test_an_empty_range_is_refused(tmp_path):
    crossed = ((-1.0, 1.0),) * 5 + ((1.0, -1.0),)
    assert "joint 'joint6' is empty" in refused(tmp_path, six_mjcf(), joint_range=crossed)


def test_a_singular_home_is_refused(tmp_path):
    """The last joint turns about the vertical as the fourth does: one turn is lost."""
    text = arm_files.GANTRY.replace('axis="1 -1 0"', 'axis="0 0 1"')
    keys = {"tip": "end", "joint_speed": 1.0, "armature": None}
    line = refused(tmp_path, text, home=(0.0, 0.0, -0.3, 0.0, 0.5, 0.0), **keys)
    assert "the posture near the given one that presses straight down" in line
    assert "is singular, or nearly so (gain " in line
    assert "is singular" in refused(tmp_path, text, **keys)  # nor is a better one found


def test_joints_that_move_nothing_need_armature(tmp_path):
    """Two joints about one axis on one body, none of them with a rotor."""
    twice = six_mjcf(body='<joint name="again" axis="0 0 1" range="-1 1" damping="1"/>')
    line = refused(tmp_path, twice, armature=0.0, torque_limit=50.0)
    assert "a joint moves no inertia, and has no armature" in line
    path = arm_files.write(tmp_path, twice)
    config = ArmConfig(path, "tool0", joint_speed=SPEED, armature=0.1, torque_limit=50.0)
    assert own_arm(config).joints == 7


def test_a_range_that_cannot_be_left_makes_home_unreachable(tmp_path):
    stuck = ((0.0, 0.1),) * 6
    assert "no posture" in refused(tmp_path, six_mjcf(), joint_range=stuck)


def test_it_cannot_be_read(tmp_path):
    for path in (tmp_path, tmp_path / "none.xml", "/dev/zero", "/dev/null"):
        with pytest.raises(ArmError, match="no such file"):
            own_arm(ArmConfig(str(path), "tool0"))
    big = tmp_path / "big.xml"
    with big.open("wb") as file:
        file.truncate(17 * 2**20)
    with pytest.raises(ArmError, match="larger than 16 MiB"):
        own_arm(ArmConfig(str(big), "tool0"))


def test_what_lies_beside_is_included(tmp_path):
    (tmp_path / "parts").mkdir()
    whole = six_mjcf()
    inner = whole[whole.index('<body name="base">') : whole.index("</worldbody>")]
    (tmp_path / "parts" / "arm.xml").write_text(f"<mujocoinclude>{inner}</mujocoinclude>")
    path = arm_files.write(tmp_path, whole.replace(inner, "<include file='parts/arm.xml'/>"))
    included = own_arm(ArmConfig(path, "tool0", joint_speed=SPEED, **KEYS))
    alone = own_arm(
        ArmConfig(arm_files.write(tmp_path, whole, "whole.xml"), "tool0", joint_speed=SPEED, **KEYS)
    )
    assert included.home.tolist() == alone.home.tolist()


def test_a_link_out_of_the_folder_is_no_file_beside_it(tmp_path):
    inside, outside = tmp_path / "inside", tmp_path / "outside.xml"
    inside.mkdir()
    outside.write_text("<mujocoinclude/>")
    (inside / "link.xml").symlink_to(outside)
    text = six_mjcf(top=INCLUDE.format("link.xml"))
    assert "only files beside it" in refused(inside, text)


FOREIGN = (
    '<asset><mesh name="x" file="/etc/passwd"/><texture name="t" type="2d" file="/etc/shadow"/>'
    '<material name="m" texture="t"/><hfield name="h" file="/dev/zero" size="1 1 1 1"/>'
    '<model name="o" file="/etc/hosts"/><skin file="/dev/zero"/></asset><custom/>'
    '<extension><plugin plugin="evil"/></extension><option timestep="1"/><size memory="1T"/>'
    '<visual><global fovy="1"/></visual><sensor><framepos objtype="site" objname="tool0"/></sensor>'
)


def test_what_names_other_files_is_taken_out_and_the_rest_is_the_same(tmp_path):
    body = '<geom type="mesh" mesh="x" material="m"/><geom type="hfield" hfield="h"/><camera/>'
    plain = six_mjcf().replace("<compiler", '<compiler meshdir="/etc"')
    full = six_mjcf(body=body + '<geom size="0.03" material="m"/>', top=FOREIGN)
    config = ArmConfig(arm_files.write(tmp_path, plain), "tool0", joint_speed=SPEED, **KEYS)
    other = replace(config, file=arm_files.write(tmp_path, full, "full.xml"))
    model = read_arm_file(tmp_path / "full.xml").model
    assert model.nmesh == model.nhfield == model.ntex == model.ncam == model.nsensor == 0
    first, second = own_arm(config), own_arm(other)
    assert first.home.tolist() == second.home.tolist()
    assert [len(link.drawn) for link in second.links] == [0, 0, 1, 0, 0, 0]
    assert sum(len(link.drawn) for link in first.links) > 2  # nothing to see: bars are drawn


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    st.sampled_from(["xml", "urdf"]), st.integers(0, 3000), st.integers(1, 40),
    st.binary(max_size=20),
)  # fmt: skip
def test_a_damaged_file_is_read_or_refused_and_nothing_else(
    tmp_path_factory, form, where, length, put
):
    text = (six_mjcf() if form == "xml" else six_urdf()).encode()
    folder = tmp_path_factory.mktemp("damaged")
    path = folder / "arm.xml"
    path.write_bytes(text[:where] + put + text[where + length :])
    line = ""
    try:
        own_arm(ArmConfig(str(path), "tool0", joint_speed=SPEED, **KEYS))
    except PlantError as error:
        line = str(error)
    assert "\n" not in line
