"""The cell as it is drawn: the bodies of the physics in their shells, on a table, in a light.

A MuJoCo model of its own, apart from the one that is simulated: it has the same bodies and joints,
so joint angles put it into any state, and neither its weight nor its contacts matter.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from plant.arm_model import body_placements, tip_placement, viper_arm
from plant.chain import TIP_NAME, Arm
from plant.mjcf import cell_mjcf
from plant.viper import HEART, TOOL, VIPER_S650
from scenarios.scene.meshes import Array, Mesh, rectangle, slab
from scenarios.scene.shells import Part, arm_shells, instrument, pad_holder
from scenarios.scene.skin import skin
from scenarios.scene.tissue import Tissue

_TISSUE = "tissue skin"
_MATERIALS: Mapping[str, Mapping[str, Any]] = {
    "shell": {"rgba": (0.90, 0.91, 0.92, 1), "specular": 0.35, "shininess": 0.55},
    "light": {"rgba": (0.80, 0.82, 0.84, 1), "specular": 0.25, "shininess": 0.4},
    "joint": {"rgba": (0.135, 0.145, 0.16, 1), "specular": 0.45, "shininess": 0.5},
    "steel": {"rgba": (0.66, 0.68, 0.71, 1), "specular": 0.95, "shininess": 0.85},
    "dark steel": {"rgba": (0.27, 0.285, 0.31, 1), "specular": 0.8, "shininess": 0.7},
    "accent": {"rgba": (0.0, 0.50, 0.72, 1), "specular": 0.4, "shininess": 0.5},
    "tissue": {"rgba": (1, 1, 1, 1), "specular": 0.45, "shininess": 0.65},
    "table": {"rgba": (1, 1, 1, 1), "specular": 0.15, "shininess": 0.3, "reflectance": 0.10},
    "edge": {"rgba": (0.20, 0.215, 0.235, 1), "specular": 0.3, "shininess": 0.3},
    "floor": {"rgba": (0.125, 0.145, 0.17, 1), "specular": 0.0, "shininess": 0.0},
}
_HOLES = 0.025
"""Grid of the table's holes, as on an optical bench [m]."""
_FLOOR = -0.75
_CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))
_FOCUS = np.array([-0.03, 0.0, 0.38])
"""Where the main light is aimed at: shadows are finest around it [m]."""
_BACKGROUND = ((0.27, 0.325, 0.385), (0.085, 0.10, 0.12))
"""Colours of the backdrop, above and below."""


@dataclass(frozen=True)
class Contact:
    """Where tool and tissue are, in the world."""

    tip: Array
    """``(3,)`` [m]"""
    surface: Array
    """The tissue's surface at rest, ``(3,)`` [m]."""


class Scene:
    """The drawn cell in one state."""

    def __init__(self, tool: Arm, width: int, height: int, *, shadows: int = 2048) -> None:
        """Build the model.

        Args:
            tool: Robot_Tool, as the cell has it.
            width, height: of the largest picture that will be taken [pixels].
            shadows: fineness of shadows: points across and down the light's picture of the scene.
        """
        self.tissue = Tissue(0.34 * float(HEART.effector.rise.si))
        self.model = _compile(tool, self.tissue, width, height, shadows=shadows)
        self.data = mujoco.MjData(self.model)
        joints = [self.model.joint(i) for i in range(self.model.njnt)]
        self._address = np.array(
            [j.qposadr[0] for arm in ("heart_joint", "tool_joint") for j in joints if arm in j.name]
        )
        self._tip = self.data.site(TIP_NAME["tool"])
        self._surface = self.data.site(TIP_NAME["heart"])
        model = self.model
        self.tissue_id = i = int(model.mesh(_TISSUE).id)
        vertices, normals = model.mesh_vertadr[i], model.mesh_normaladr[i]
        self._vertices = model.mesh_vert[vertices : vertices + model.mesh_vertnum[i]]
        self._normals = model.mesh_normal[normals : normals + model.mesh_normalnum[i]]
        # MuJoCo keeps meshes in a frame of its own, along their principal axes.
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.mesh_quat[i])
        self._mesh_turn, self._mesh_shift = turn.reshape(3, 3), model.mesh_pos[i].copy()

    def pose(self, angles: Array, touching: bool) -> Contact:
        """Put both arms where their joints say, and let the tissue give way to the tip.

        Args:
            angles: of all joints, those of Robot_Heart first, ``(n,)`` [rad].
            touching: whether tool and tissue touch.
        """
        model, data = self.model, self.data
        data.qpos[self._address] = angles
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
        tip, surface = self._tip.xpos.copy(), self._surface.xpos.copy()
        frame = self._surface.xmat.reshape(3, 3)
        displacement = (tip - surface) @ frame * touching
        skin_now = self.tissue.pressed(displacement)
        self._vertices[:] = (skin_now.vertices - self._mesh_shift) @ self._mesh_turn
        self._normals[:] = skin_now.normals @ self._mesh_turn
        return Contact(tip, surface)

    def corners(self) -> Array:
        """Return the corners of boxes around all that the arms are made of, ``(n, 3)`` [m]."""
        arms = np.flatnonzero(self.model.geom_bodyid > 0)
        boxes = self.model.geom_aabb[arms].reshape(-1, 6)
        turns = self.data.geom_xmat[arms].reshape(-1, 3, 3)
        local = boxes[:, None, :3] + _CORNERS * boxes[:, None, 3:]
        corners: Array = self.data.geom_xpos[arms][:, None] + local @ turns.transpose(0, 2, 1)
        return corners.reshape(-1, 3)


def _compile(tool: Arm, tissue: Tissue, width: int, height: int, *, shadows: int) -> Any:
    # Only where things are matters: friction, lag and stiffness may be any.
    text = cell_mjcf(
        viper_arm(VIPER_S650, HEART), tool,
        timestep=1e-3, stiffness=0.0, damping=0.0, friction=0.0, torque_lag=0.0,
    )  # fmt: skip
    spec = mujoco.MjSpec.from_string(text)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.global_.fovy = FIELD_OF_VIEW
    spec.visual.quality.shadowsize = shadows
    spec.visual.quality.offsamples = 4
    spec.visual.map.znear, spec.visual.map.zfar = 0.02, 30.0
    spec.visual.map.shadowclip = 1.0  # in metres, with this extent
    spec.visual.headlight.ambient[:] = 0.22
    spec.visual.headlight.diffuse[:] = 0.14
    spec.visual.headlight.specular[:] = 0.05
    spec.stat.extent, spec.stat.center[:] = 1.0, _FOCUS
    for item in (*spec.worldbody.geoms, *spec.worldbody.lights, *spec.textures):
        spec.delete(item)
    for material in spec.materials:
        material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = ""
    _add_materials(spec)
    _add_room(spec)
    for name, parts in _dress(spec).items():
        body = spec.body(name)
        for geom in body.geoms:
            spec.delete(geom)
        for material, mesh in _by_material(parts):
            _add_mesh(spec, body, f"{name} {material}", mesh, material)
    placement = tip_placement(HEART)
    geom = _add_mesh(spec, spec.body("heart_pad"), _TISSUE, tissue.mesh, "tissue")
    geom.pos = placement[:3, 3]
    mujoco.mju_mat2Quat(geom.quat, placement[:3, :3].ravel())
    return spec.compile()


def _dress(spec: Any) -> dict[str, Sequence[Part]]:
    """What is drawn in place of a body's solids, by the body's name.

    An arm that is no Viper keeps its solids.
    """
    shells, places = arm_shells(VIPER_S650), body_placements(VIPER_S650)[:6, :3, 3]
    dress: dict[str, Sequence[Part]] = {}
    for arm in ("heart", "tool"):
        links = [spec.body(f"{arm}_link{i}") for i in range(1, 7)]
        if all(
            link is not None and np.allclose(link.pos, place)
            for link, place in zip(links, places, strict=True)
        ):
            dress |= {f"{arm}_{part}": shells[part] for part in shells}
    held = {"tool_instrument": instrument(TOOL.effector), "heart_pad": pad_holder(HEART.effector)}
    return dress | {name: parts for name, parts in held.items() if spec.body(name) is not None}


def _by_material(parts: Iterable[Part]) -> Iterable[tuple[str, Mesh]]:
    groups: dict[str, list[Mesh]] = {}
    for part in parts:
        groups.setdefault(part.material, []).append(part.mesh)
    for material, meshes in groups.items():
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
        yield (
            material,
            Mesh(
                np.concatenate([mesh.vertices for mesh in meshes]),
                np.concatenate([mesh.normals for mesh in meshes]),
                np.concatenate([m.faces + start for m, start in zip(meshes, starts, strict=True)]),
            ),
        )


def _add_mesh(spec: Any, body: Any, name: str, mesh: Mesh, material: str) -> Any:
    added = spec.add_mesh(name=name)
    added.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL  # asks for no volume
    faces = mesh.faces.ravel()
    added.uservert, added.userface = mesh.vertices.ravel(), faces
    added.usernormal, added.userfacenormal = mesh.normals.ravel(), faces
    if mesh.coordinates is not None:
        added.usertexcoord, added.userfacetexcoord = mesh.coordinates.ravel(), faces
    return body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=f"drawn {material}",
        contype=0, conaffinity=0, mass=0.0,
    )  # fmt: skip


def _add_materials(spec: Any) -> None:
    for name, looks in _MATERIALS.items():
        spec.add_material(name=f"drawn {name}", **looks)
    for name, picture in (("tissue", skin()), ("table", _bench(96))):
        height, width, _ = picture.shape
        texture = spec.add_texture(
            name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3
        )
        texture.data = picture.tobytes()
        spec.material(f"drawn {name}").textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = name
    spec.material("drawn table").texrepeat = (1.0 / _HOLES, 1.0 / _HOLES)
    spec.material("drawn table").texuniform = True
    above, below = _BACKGROUND
    spec.add_texture(
        name="backdrop", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, rgb1=above, rgb2=below, width=256,
        height=1536,
    )  # fmt: skip


def _add_room(spec: Any) -> None:
    world = spec.worldbody
    left, right, depth = -0.80, 0.68, 0.36
    top = rectangle((left, right), (-depth, depth), 0.03)
    _add_mesh(spec, world, "table edge", slab(top, -0.04, -0.0005, 0.004), "edge")
    drawn = {"contype": 0, "conaffinity": 0}
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    world.add_geom(
        type=plane, size=((right - left) / 2 - 0.008, depth - 0.008, 0.05),
        pos=((left + right) / 2, 0.0, 0.0), material="drawn table", **drawn,
    )  # fmt: skip
    for x in (left + 0.09, right - 0.09):
        for y in (-depth + 0.09, depth - 0.09):
            world.add_geom(
                type=mujoco.mjtGeom.mjGEOM_CYLINDER, size=(0.03, (-0.04 - _FLOOR) / 2, 0),
                pos=(x, y, (_FLOOR - 0.04) / 2), material="drawn edge", **drawn,
            )  # fmt: skip
    world.add_geom(
        type=plane, size=(6.0, 6.0, 0.1), pos=(0, 0, _FLOOR), material="drawn floor", **drawn
    )
    directional = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    for direction, strength, shadow in (
        ((0.42, 0.55, -1.0), (0.62, 0.60, 0.57), True),  # key, a little warm
        ((-0.8, 0.75, -0.35), (0.20, 0.22, 0.25), False),  # fill, a little cool
        ((-0.15, -0.9, -0.55), (0.30, 0.32, 0.36), False),  # rim, from behind
    ):
        world.add_light(
            pos=_FOCUS - 2.0 * np.array(direction), dir=direction, type=directional,
            diffuse=strength, specular=tuple(0.5 * s for s in strength), castshadow=shadow,
        )  # fmt: skip


def _bench(size: int) -> NDArray[np.uint8]:
    """One cell of the table's surface with its hole, ``(size, size, 3)``."""
    y, x = (np.mgrid[0:size, 0:size] + 0.5) / size - 0.5
    distance = np.hypot(x, y)
    hole = np.clip((0.115 - distance) * size / 2.0, 0.0, 1.0)
    rim = np.clip(1.0 - np.abs(distance - 0.145) * size / 3.0, 0.0, 1.0)
    grey = 0.30 * (1.0 - hole) + 0.035 * hole + 0.07 * rim
    colour = grey[..., None] * np.array([0.94, 1.0, 1.08])
    picture: NDArray[np.uint8] = (255.0 * np.clip(colour, 0.0, 1.0)).astype(np.uint8)
    return picture


FIELD_OF_VIEW = 26.0
"""Vertical angle of the cameras, a long lens [deg]."""
