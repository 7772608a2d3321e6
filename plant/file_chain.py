"""The chain of joints from base to tip in a robot's description, as links of a `plant.chain.Arm`.

Each link gets the frame that turns about its own z axis, or slides along it, and the mass of
everything that is fixed to it. Joints off the way to the tip, of fingers say, are locked where the
file has them.
"""

from collections.abc import Callable
from dataclasses import replace
from difflib import get_close_matches

import mujoco
import numpy as np
from numpy.typing import NDArray

from plant.arm_file import ArmFile
from plant.chain import Inertia, Link, Shape, rotation_between
from plant.errors import ArmError
from plant.viper import FloatArray

_FEWEST, _MOST = 6, 16
_LIGHTEST = 1e-6
"""Mass below which a link has none [kg]."""
_HINGE, _SLIDE = int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)
_KINDS = {
    int(getattr(mujoco.mjtGeom, f"mjGEOM_{kind.upper()}")): kind
    for kind in ("sphere", "capsule", "ellipsoid", "cylinder", "box")
}


class FileChain:
    """The way from base to tip in a compiled description, all its joints at zero."""

    def __init__(self, file: ArmFile, tip: str) -> None:
        self.file, model = file, file.model
        self._data = mujoco.MjData(model)
        body, pose = self._find(tip)
        way = [body]
        while model.body_parentid[way[-1]] > 0:
            way.append(int(model.body_parentid[way[-1]]))
        self.way = way[::-1] if way[-1] > 0 else []
        self.joints = [
            j
            for b in self.way
            for j in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])
        ]
        self.names = [model.joint(j).name or f"number {j + 1}" for j in self.joints]
        self._check(tip)
        self._data.qpos[:] = model.qpos0
        self._data.qpos[self.angles] = 0.0
        mujoco.mj_kinematics(model, self._data)
        self.tip = pose()

    @property
    def angles(self) -> NDArray[np.intp]:
        """Where the joints' angles stand in MuJoCo's."""
        return np.asarray(self.file.model.jnt_qposadr[self.joints])

    @property
    def dofs(self) -> NDArray[np.intp]:
        """Where the joints' speeds stand in MuJoCo's."""
        return np.asarray(self.file.model.jnt_dofadr[self.joints])

    def _find(self, tip: str) -> tuple[int, Callable[[], FloatArray]]:
        """Return the body of a site, or a body itself, and how to get the pose."""
        model, data = self.file.model, self._data
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tip)
        if site >= 0:
            return int(model.site_bodyid[site]), lambda: _pose(
                data.site_xpos[site], data.site_xmat[site]
            )
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tip)
        if body >= 0:
            return int(body), lambda: _pose(data.xpos[body], data.xmat[body])
        names = [model.site(i).name for i in range(model.nsite)]
        names += [model.body(i).name for i in range(1, model.nbody)]
        near = get_close_matches(tip, names, n=1, cutoff=0.5)
        hint = f", did you mean '{near[0]}'?" if near else ""
        known = ", ".join(filter(None, names[:20])) + (", ..." if len(names) > 20 else "")
        raise ArmError(
            "cell.arm.tip",
            f"{self.file.name} has no site or body '{tip}'{hint} (it has: {known or 'none'})",
        )

    def _check(self, tip: str) -> None:
        """Refuse what is no chain of hinges and slides that the motors alone drive."""
        model, name = self.file.model, self.file.name
        for j, joint in zip(self.joints, self.names, strict=True):
            if model.jnt_type[j] not in (_HINGE, _SLIDE):
                raise ArmError(
                    name, f"joint '{joint}' is a ball or free: an arm has hinges and slides"
                )
            if model.jnt_stiffness[j].any():
                raise ArmError(name, f"joint '{joint}' has a spring, which the cell does not model")
        if not _FEWEST <= len(self.joints) <= _MOST:
            raise ArmError(
                name,
                f"{len(self.joints)} joints from the base to '{tip}', an arm that holds position "
                f"and orientation needs {_FEWEST} (and may have {_MOST})",
            )
        for i in range(model.neq):
            bodies = {int(b) for b in self._bound(i)}
            if bodies & set(self.way):
                raise ArmError(
                    name,
                    f"equality constraint '{model.equality(i).name or i}' acts on the arm: closed "
                    "loops and coupled joints are not modelled",
                )
        for i in range(model.nwrap):
            kind, what = model.wrap_type[i], int(model.wrap_objid[i])
            wrapped = {
                int(mujoco.mjtWrap.mjWRAP_JOINT): lambda k: model.jnt_bodyid[k],
                int(mujoco.mjtWrap.mjWRAP_SITE): lambda k: model.site_bodyid[k],
            }
            if int(kind) in wrapped and int(wrapped[int(kind)](what)) in self.way:
                raise ArmError(name, "a tendon acts on the arm: tendons are not modelled")

    def _bound(self, i: int) -> list[int]:
        """Bodies that an equality constraint takes hold of."""
        model = self.file.model
        ends = [int(model.eq_obj1id[i]), int(model.eq_obj2id[i])]
        kind = model.eq_objtype[i]
        if model.eq_type[i] == int(mujoco.mjtEq.mjEQ_JOINT):
            return [int(model.jnt_bodyid[j]) for j in ends if j >= 0]
        if kind == int(mujoco.mjtObj.mjOBJ_SITE):
            return [int(model.site_bodyid[s]) for s in ends if s >= 0]
        if kind == int(mujoco.mjtObj.mjOBJ_BODY):
            return [b for b in ends if b >= 0]
        return []  # of tendons, which are looked at themselves

    def links(self) -> tuple[Link, tuple[Link, ...]]:
        """Return the base and the links, and note where the last one's frame is, `end`.

        Raises:
            ArmError: one has no mass, or not a number.
        """
        model, data = self.file.model, self._data
        groups: list[tuple[list[int], list[int]]] = [([], [])]  # joints, and bodies that they move
        for body in self.way:
            own = [j for j in self.joints if model.jnt_bodyid[j] == body]
            if own:
                groups.append((own, []))
            groups[-1][1].extend(self._fixed_to(body))
        frame = _pose(data.xpos[self.way[0]], data.xmat[self.way[0]])
        base = Link(frame, None, self._drawn(groups[0][1], frame))
        links: list[Link] = []
        for joints, bodies in groups[1:]:
            for j in joints:
                axes = data.xmat[model.jnt_bodyid[j]].reshape(3, 3)
                here = _pose(data.xanchor[j], rotation_between(axes[:, 2], data.xaxis[j]) @ axes)
                slides = bool(model.jnt_type[j] == _SLIDE)
                links.append(Link(np.linalg.inv(frame) @ here, None, slides=slides))
                frame = here
            inertia = self._weigh(bodies, frame)
            if not inertia.mass > _LIGHTEST:
                name = self.names[self.joints.index(joints[-1])]
                raise ArmError(self.file.name, f"what joint '{name}' moves has no mass")
            drawn = self._drawn(bodies, frame)
            links[-1] = replace(links[-1], inertia=inertia, drawn=drawn)
        self.end = frame
        """Where the last link's frame is, in the file's world, ``(4, 4)`` [m]."""
        return base, tuple(links)

    def _fixed_to(self, body: int) -> list[int]:
        """Return a body of the way and what hangs on it off the way, joints of that locked."""
        model, found = self.file.model, [body]
        for b in range(body + 1, model.nbody):
            if model.body_parentid[b] in found and b not in self.way:
                found.append(b)
        return found

    def _weigh(self, bodies: list[int], frame: FloatArray) -> Inertia:
        """Sum of the bodies' mass properties, in a frame of the world."""
        model, data = self.file.model, self._data
        masses = model.body_mass[bodies]
        total = float(masses.sum())
        centre = masses @ data.xipos[bodies] / total if total > 0 else np.zeros(3)
        tensor = np.zeros((3, 3))
        for b, mass in zip(bodies, masses.tolist(), strict=True):
            axes, arm = data.ximat[b].reshape(3, 3), data.xipos[b] - centre
            tensor += axes @ np.diag(model.body_inertia[b]) @ axes.T
            tensor += mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
        turn = frame[:3, :3]
        return Inertia(total, turn.T @ (centre - frame[:3, 3]), turn.T @ tensor @ turn)

    def _drawn(self, bodies: list[int], frame: FloatArray) -> tuple[Shape, ...]:
        model, data = self.file.model, self._data
        inverse = np.linalg.inv(frame)
        return tuple(
            Shape(
                _KINDS[int(model.geom_type[g])],
                model.geom_size[g].copy(),
                inverse @ _pose(data.geom_xpos[g], data.geom_xmat[g]),
            )
            for b in bodies
            for g in range(model.body_geomadr[b], model.body_geomadr[b] + model.body_geomnum[b])
            if int(model.geom_type[g]) in _KINDS
        )


def _pose(position: FloatArray, axes: FloatArray) -> FloatArray:
    placement = np.eye(4)
    placement[:3, :3], placement[:3, 3] = axes.reshape(3, 3), position
    return placement
