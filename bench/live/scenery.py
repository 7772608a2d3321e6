"""The cell in the page: the bodies of `scenarios.scene`, moved by joint angles."""

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from plant.own_arm import tool_arm
from scenarios.config import Scenario
from scenarios.scene.arrows import force_arrow
from scenarios.scene.camera import VIEWS
from scenarios.scene.scene import Scene

Array = NDArray[np.float64]
_SCALE = 0.012
"""Length by force of the arrow [m/N]."""
_FLESH = (176, 72, 66)
_FORCE = (86, 180, 233)


class Scenery:
    """What is drawn, in one state."""

    def __init__(self, server: Any, scenario: Scenario) -> None:
        """Send all bodies to the page."""
        self._scene = scene = Scene(tool_arm(scenario.cell), 64, 64)
        model = scene.model
        api = server.scene
        api.configure_default_lights(enabled=True, cast_shadow=False)
        api.add_grid("/floor", width=3.0, height=3.0, position=(0.0, 0.0, -0.06), cell_size=0.1)
        self._frames = {}
        self._tissue: Any = None
        for i in range(1, model.nbody):
            self._frames[i] = api.add_frame(f"/cell/{model.body(i).name}", show_axes=False)
        for i in range(model.ngeom):
            if model.geom_type[i] == mujoco.mjtGeom.mjGEOM_MESH:
                self._add(api, i)
            elif model.geom_bodyid[i] > 0:
                self._add_solid(api, i)
        self._arrow = api.add_arrows(
            "/force", np.zeros((1, 2, 3), np.float32), _FORCE,
            shaft_radius=0.005, head_radius=0.011, head_length=0.025, visible=False,
        )  # fmt: skip
        self._look(server)

    def pose(self, angles: Array, touching: bool, force: Array, *, tissue: bool) -> None:
        """Move all to where joints and force say.

        Args:
            angles: of all joints, ``(n,)`` [rad].
            touching: whether tool and tissue touch.
            force: contact force, ``(3,)`` [N].
            tissue: whether to send its form, too.
        """
        scene = self._scene
        contact = scene.pose(angles, touching)
        for i, frame in self._frames.items():
            frame.position, frame.wxyz = scene.data.xpos[i], scene.data.xquat[i]
        if tissue:
            self._tissue.vertices = self._vertices(scene.tissue_id)
        arrow = force_arrow(contact.tip, force, _SCALE)
        self._arrow.visible = arrow is not None
        if arrow is not None:
            self._arrow.points = np.array([[arrow.start, arrow.end]], dtype=np.float32)

    def _vertices(self, mesh: int) -> NDArray[np.float32]:
        model = self._scene.model
        start = model.mesh_vertadr[mesh]
        found: NDArray[np.float32] = model.mesh_vert[start : start + model.mesh_vertnum[mesh]]
        return found.astype(np.float32)

    def _place(self, i: int) -> dict[str, Any]:
        model = self._scene.model
        return {"position": model.geom_pos[i], "wxyz": model.geom_quat[i]}

    def _name(self, i: int) -> str:
        model = self._scene.model
        body = int(model.geom_bodyid[i])
        return f"/cell/{model.body(body).name}/{i}" if body else f"/room/{i}"

    def _colour(self, i: int) -> tuple[int, int, int]:
        model = self._scene.model
        material = int(model.geom_matid[i])
        rgba = model.mat_rgba[material] if material >= 0 else model.geom_rgba[i]
        red, green, blue = (int(255 * value) for value in rgba[:3])
        return red, green, blue

    def _add(self, api: Any, i: int) -> None:
        model = self._scene.model
        mesh = int(model.geom_dataid[i])
        is_tissue = mesh == self._scene.tissue_id
        start = model.mesh_faceadr[mesh]
        faces = model.mesh_face[start : start + model.mesh_facenum[mesh]]
        handle = api.add_mesh_simple(
            self._name(i), self._vertices(mesh), faces.astype(np.uint32),
            color=_FLESH if is_tissue else self._colour(i), cast_shadow=False,
            receive_shadow=False, side="double", **self._place(i),
        )  # fmt: skip
        if is_tissue:
            self._tissue = handle

    def _add_solid(self, api: Any, i: int) -> None:
        """Add what an arm of one's own consists of: boxes, cylinders and the like."""
        model = self._scene.model
        size, kind = model.geom_size[i], model.geom_type[i]
        options = {"color": self._colour(i), **self._place(i)}
        solid = mujoco.mjtGeom
        if kind == solid.mjGEOM_BOX:
            api.add_box(self._name(i), dimensions=tuple(2.0 * size), **options)
        elif kind in (solid.mjGEOM_CYLINDER, solid.mjGEOM_CAPSULE):
            api.add_cylinder(self._name(i), radius=size[0], height=2.0 * size[1], **options)
        elif kind in (solid.mjGEOM_SPHERE, solid.mjGEOM_ELLIPSOID):
            api.add_icosphere(self._name(i), radius=float(size.max()), **options)

    def _look(self, server: Any) -> None:
        view = next(iter(VIEWS.values()))
        corners = self._scene.corners()
        middle = 0.5 * (corners.min(axis=0) + corners.max(axis=0))
        turn, tilt = np.deg2rad([view.azimuth, view.elevation])
        forwards = np.array(
            [np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)]
        )
        server.initial_camera.position = middle - 1.45 * forwards
        server.initial_camera.look_at = middle
