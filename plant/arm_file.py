"""Read a robot's description, MJCF or URDF, and compile it, without trusting it.

Kinematics, inertias, joints, actuators and primitives are kept. Meshes, textures and whatever else
lies in files of its own is taken out before MuJoCo sees the text, so that nothing is opened but the
file itself and what it includes; and an include must lie beside it.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import mujoco

from plant.errors import ArmError

_LARGEST = 16 * 2**20
"""Size of a file that is read at most [bytes]."""
_SECTIONS = ("compiler", "default", "worldbody", "actuator", "tendon", "equality", "keyframe")
_NOT_NEEDED = (
    "asset", "contact", "custom", "deformable", "extension", "option", "sensor", "size",
    "statistic", "visual",
)  # fmt: skip
_MADE = ("attach", "composite", "flexcomp", "plugin", "replicate")
"""Elements that make bodies or forces in ways that are not read."""
_UNSEEN = ("camera", "light")
_FOREIGN_SHAPES = ("mesh", "hfield", "sdf")
_KEPT = {"fusestatic": "false", "discardvisual": "false"}
"""So that bodies keep their names."""


@dataclass(frozen=True, eq=False)
class ArmFile:
    """A description that MuJoCo has compiled."""

    name: str
    """Of the file."""
    model: Any
    """``mujoco.MjModel``."""
    speeds: Mapping[str, float]
    """Rated speed of each joint that has one, by the joint's name [rad/s]; only URDF has them."""


def read_arm_file(path: Path) -> ArmFile:
    """Read and compile an MJCF or URDF file.

    Raises:
        ArmError: it cannot be read, is neither, or names what cannot be had.
    """
    root = _parse(path)
    speeds: dict[str, float] = {}
    if root.tag == "mujoco":
        _expand(root, path, {path.resolve()})
        _check_numbers(root, path)
        _clean_mjcf(root, path)
    elif root.tag == "robot":
        _check_numbers(root, path)
        speeds = _clean_urdf(root, path)
    else:
        raise ArmError(path.name, f"neither MJCF nor URDF: its root is <{root.tag}>")
    return ArmFile(path.name, _compile(root, path), speeds)


def self_contained(path: Path) -> str:
    """Return the text of an arm's file with all that it includes in its place.

    Raises:
        ArmError: see `read_arm_file`.
    """
    root = _parse(path)
    if root.tag == "mujoco":
        _expand(root, path, {path.resolve()})
    return ET.tostring(root, encoding="unicode")


def _compile(root: ET.Element, path: Path) -> Any:
    """Compile what is left, without the log file that MuJoCo would write a warning into."""
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)  # of inertias, which are looked at at home
    try:
        return mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    except ValueError as error:
        raise ArmError(path.name, " ".join(str(error).split())) from None
    finally:
        mujoco.set_mju_user_warning(before)


def _parse(path: Path) -> ET.Element:
    try:
        if not path.is_file():
            raise ArmError(path.name, f"there is no such file in {path.parent}")
        if path.stat().st_size > _LARGEST:
            raise ArmError(path.name, f"larger than {_LARGEST // 2**20} MiB")
        text = path.read_bytes()
    except OSError as error:
        raise ArmError(path.name, error.strerror or str(error)) from None
    if b"<!DOCTYPE" in text or b"<!ENTITY" in text:
        raise ArmError(path.name, "has a document type or entities, which are not read")
    try:
        return ET.fromstring(text)
    except (ET.ParseError, ValueError, LookupError) as error:
        raise ArmError(path.name, f"not XML: {error}") from None


def _expand(parent: ET.Element, path: Path, seen: set[Path]) -> None:
    """Put what a file includes in the place of each <include>."""
    folder = path.resolve().parent
    for i, child in reversed(list(enumerate(parent))):
        if child.tag != "include":
            _expand(child, path, seen)
            continue
        named = child.get("file", "")
        included = (folder / named).resolve()
        if Path(named).is_absolute() or folder not in included.parents:
            raise ArmError(path.name, f"includes '{named}': only files beside it can be included")
        if included in seen:
            raise ArmError(path.name, f"includes '{named}' twice")
        seen.add(included)
        other = _parse(included)
        _expand(other, path, seen)
        parent[i : i + 1] = list(other)


def _check_numbers(root: ET.Element, path: Path) -> None:
    """Refuse numbers that are none, which MuJoCo takes."""
    for element in root.iter():
        for key, value in element.items():
            if key != "name" and {"nan", "inf"} & {w.lstrip("+-") for w in value.lower().split()}:
                raise ArmError(path.name, f"<{element.tag}> has {key}='{value}'")


def _clean_mjcf(root: ET.Element, path: Path) -> None:
    for section in [s for s in root if s.tag in _NOT_NEEDED]:
        root.remove(section)
    strange = [s.tag for s in root if s.tag not in _SECTIONS]
    if strange:
        raise ArmError(path.name, f"has a section <{strange[0]}>, which is not read")
    weighed = any(c.get("inertiafromgeom") == "true" for c in root.iter("compiler"))
    for compiler in root.iter("compiler"):
        for name in ("meshdir", "texturedir", "assetdir"):
            compiler.attrib.pop(name, None)
        compiler.attrib |= _KEPT
    for parent, tags in (("default", ("mesh", "material", *_UNSEEN)), ("actuator", ("plugin",))):
        for section in root.iter(parent):
            for child in [c for c in section if c.tag in tags]:
                section.remove(child)
    for key in root.iter("key"):
        for name in set(key.attrib) - {"name", "qpos"}:
            del key.attrib[name]
    for element in root.iter():
        for name in ("material",) if element.tag == "geom" else ("material", "mesh", "hfield"):
            element.attrib.pop(name, None)
    for world in root.iter("worldbody"):
        _clean_body(world, path, moves=False, weighed=weighed)


def _clean_body(body: ET.Element, path: Path, *, moves: bool, weighed: bool) -> None:
    """Take meshes out of a body and those on it; where a mass hung on one, refuse."""
    own = list(_own(body))
    tags = {child.tag for _, child in own}
    moves |= bool(tags & {"joint", "freejoint"})
    has_mass = "inertial" in tags and not weighed
    for parent, child in own:
        if child.tag in _MADE:
            raise ArmError(path.name, f"has a <{child.tag}>, which is not read: write it out")
        foreign = child.get("type") in _FOREIGN_SHAPES or {"mesh", "hfield"} & set(child.attrib)
        if child.tag in _UNSEEN:
            parent.remove(child)
        elif child.tag == "geom" and foreign:
            if moves and not has_mass:
                raise ArmError(
                    path.name,
                    f"the mass of body '{body.get('name', '')}' would have to come from a mesh, "
                    "and meshes are not read: give it an <inertial>",
                )
            parent.remove(child)
        elif child.tag == "body":
            _clean_body(child, path, moves=moves, weighed=weighed)


def _own(element: ET.Element) -> Iterator[tuple[ET.Element, ET.Element]]:
    """Go through what belongs to a body, within frames too: each with what it stands in."""
    for child in list(element):
        yield element, child
        if child.tag == "frame":
            yield from _own(child)


def _clean_urdf(root: ET.Element, path: Path) -> dict[str, float]:
    """Keep links and joints; return the joints' rated speeds."""
    speeds = {}
    for child in list(root):
        if "xacro" in child.tag:
            raise ArmError(path.name, "is a xacro file: expand it to URDF first")
        if child.tag not in ("link", "joint"):
            root.remove(child)
    for link in root.iter("link"):
        for seen in [*link.findall("visual"), *link.findall("collision")]:
            for material in seen.findall("material"):
                seen.remove(material)
            if seen.tag == "collision" or seen.find("geometry/mesh") is not None:
                link.remove(seen)
    for joint in root.iter("joint"):
        limit = joint.find("limit")
        try:
            speed = float(limit.get("velocity", "0")) if limit is not None else 0.0
        except ValueError:
            raise ArmError(
                path.name, f"joint '{joint.get('name', '')}': its velocity is no number"
            ) from None
        if speed > 0.0:
            speeds[joint.get("name", "")] = speed
    # A link weighs what the file says, never what its shapes would weigh.
    own = {"inertiafromgeom": "false", **_KEPT}
    ET.SubElement(ET.SubElement(root, "mujoco"), "compiler", own)
    return speeds
