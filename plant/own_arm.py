"""Robot_Tool: the Viper, or an arm of one's own from an MJCF or URDF file.

The file is compiled by MuJoCo (``plant.arm_file``), its chain of joints taken out of that
(``plant.file_chain``), what it does not say of the joints is taken from the configuration, and
where it stands is found (``plant.posture``). From the `Arm` that comes of it both engines' models
are made, as for the Viper.
"""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from plant.arm_file import read_arm_file
from plant.arm_model import (
    build_arm_model,
    effector_inertia,
    effector_solids,
    rotation,
    tip_placement,
    viper_arm,
)
from plant.chain import Arm, Link, Shape, rotation_between
from plant.config import ArmConfig, CellConfig, PerJoint
from plant.errors import ArmError
from plant.file_chain import FileChain
from plant.posture import Stance, find_stance
from plant.viper import CONTACT_POINT, TOOL, VIPER_S650, FloatArray

_SINGULAR = 0.02
"""Conditioning of a home below which it counts as singular [m/rad]."""
_WEIGHTLESS = 1e-9
"""Inertia that no combination of joints may fall below [kg m^2]."""


def tool_arm(config: CellConfig) -> Arm:
    """Return Robot_Tool as a cell has it, where it stands, with motors as weak as they are.

    Raises:
        ArmError: an arm of one's own cannot be used, and why.
    """
    arm = _viper() if config.arm is None else own_arm(config.arm)
    share = config.imperfections.torque_limit
    return arm if share == 1.0 else replace(arm, torque_limit=share * arm.torque_limit)


@cache
def _viper() -> Arm:
    return viper_arm(VIPER_S650, TOOL)


def own_arm(config: ArmConfig) -> Arm:
    """Return the arm of a file where it stands in the cell.

    Raises:
        ArmError: the file cannot be read or has no such arm; a figure is not known; or the arm
            cannot press straight down on the cell's contact point.
    """
    chain = FileChain(read_arm_file(Path(config.file)), config.tip)
    return _stand(_with_figures(chain, config), chain, config)


def _with_figures(chain: FileChain, config: ArmConfig) -> Arm:
    """Return the arm of a chain in its own world, its home unknown, with all its figures."""
    base, links = chain.links()
    n = len(links)
    figures = _figures(chain, config)
    ranges = _ranges(chain, config)
    tip = np.linalg.inv(chain.end) @ chain.tip
    effector = None
    if config.instrument:
        own = TOOL.effector
        effector = Link(tip, effector_inertia(own), effector_solids(own))
        tip = np.eye(4)
        tip[:3, 3] = tip_placement(TOOL)[:3, 3]
    arm = Arm(
        "tool", base, links, effector, "instrument", tip, np.zeros(n), ranges[:, 0], ranges[:, 1],
        *figures,
    )  # fmt: skip
    return arm if any(link.drawn for link in links) else _draw(arm)


def _figures(chain: FileChain, config: ArmConfig) -> tuple[FloatArray, ...]:
    """Return speed, torque limit, armature, Coulomb and viscous friction of the joints."""
    model, dofs, n = chain.file.model, chain.dofs, len(chain.joints)
    known = {
        "joint_speed": np.array([chain.file.speeds.get(name, 0.0) for name in chain.names]),
        "torque_limit": _torque_limits(model, chain.joints),
        "armature": model.dof_armature[dofs].copy(),
        "coulomb_friction": model.dof_frictionloss[dofs].copy(),
        "viscous_friction": model.dof_damping[dofs].copy(),
    }
    told: dict[str, PerJoint | None] = {key: getattr(config, key) for key in known}
    loss = known["coulomb_friction"] + known["viscous_friction"]
    quiet = told["coulomb_friction"] is None and told["viscous_friction"] is None
    for key, values, asked in (
        ("joint_speed", known["joint_speed"], told["joint_speed"] is None),
        ("torque_limit", known["torque_limit"], told["torque_limit"] is None),
        ("armature", known["armature"], told["armature"] is None),
        ("coulomb_friction", loss, quiet),
    ):
        missing = np.flatnonzero(values <= 0.0)
        if asked and missing.size:
            none = " (0: none)" if key in ("armature", "coulomb_friction") else ""
            raise _unknown(chain, key, int(missing[0]), none)
    figures = []
    for key, value in told.items():
        figures.append(known[key] if value is None else _each(key, value, n))
        if key in ("joint_speed", "torque_limit") and figures[-1].min() <= 0.0:
            raise ArmError(f"cell.arm.{key}", "must be greater than 0")
    return tuple(figures)


def _torque_limits(model: Any, joints: list[int]) -> FloatArray:
    """What motors and joints allow, the least of it; 0 where the file has no limit."""
    limits = np.full(len(joints), np.inf)
    for i, j in enumerate(joints):
        if model.jnt_actfrclimited[j]:
            limits[i] = np.abs(model.jnt_actfrcrange[j]).min()
    for a in range(model.nu):
        driven = model.actuator_trntype[a] == int(mujoco.mjtTrn.mjTRN_JOINT)
        if not driven or int(model.actuator_trnid[a, 0]) not in joints:
            continue
        i, gear = joints.index(int(model.actuator_trnid[a, 0])), abs(model.actuator_gear[a, 0])
        if model.actuator_forcelimited[a]:
            limits[i] = min(limits[i], gear * np.abs(model.actuator_forcerange[a]).min())
        plain = model.actuator_gaintype[a] == int(mujoco.mjtGain.mjGAIN_FIXED)
        plain &= model.actuator_biastype[a] == int(mujoco.mjtBias.mjBIAS_NONE)
        if plain and model.actuator_ctrllimited[a]:
            most = abs(model.actuator_gainprm[a, 0]) * np.abs(model.actuator_ctrlrange[a]).min()
            limits[i] = min(limits[i], gear * most)
    return np.where(np.isfinite(limits), limits, 0.0)


def _ranges(chain: FileChain, config: ArmConfig) -> FloatArray:
    """Return the joints' ranges ``(n, 2)``, in angles of MuJoCo's."""
    model, n = chain.file.model, len(chain.joints)
    if config.joint_range is not None:
        ranges = np.array(config.joint_range, dtype=np.float64)
        if len(ranges) != n:
            raise ArmError(
                "cell.arm.joint_range",
                f"must have {n} pairs, one a joint, got {len(ranges)}",
            )
    else:
        ranges = model.jnt_range[chain.joints].copy()
        free = np.flatnonzero(model.jnt_limited[chain.joints] == 0)
        if free.size:
            raise _unknown(chain, "joint_range", int(free[0]), "")
    empty = np.flatnonzero(~(ranges[:, 0] < ranges[:, 1]))
    if empty.size:
        low, high = ranges[empty[0]]
        raise ArmError(
            "cell.arm.joint_range",
            f"of joint '{chain.names[empty[0]]}' is empty: {low:g} to {high:g}",
        )
    return np.asarray(ranges)


def _each(key: str, told: PerJoint, n: int) -> FloatArray:
    """Return one value for each joint."""
    values = np.array(told, dtype=np.float64)
    if values.ndim == 1 and len(values) != n:
        raise ArmError(f"cell.arm.{key}", f"must be one number or {n}, got {len(values)}")
    return np.broadcast_to(values, (n,)).copy()


def _unknown(chain: FileChain, key: str, joint: int, more: str) -> ArmError:
    n = len(chain.joints)
    wanted = f"give {n} pairs" if key == "joint_range" else f"give one number or {n}"
    return ArmError(
        f"cell.arm.{key}",
        f"{chain.file.name} has none for joint '{chain.names[joint]}': {wanted}{more}",
    )


def _draw(arm: Arm) -> Arm:
    """Return an arm whose links are seen as bars from joint to joint."""
    following = [link.placement for link in arm.links[1:]]
    following.append(arm.effector.placement if arm.effector is not None else arm.tip)
    links = []
    for link, after in zip(arm.links, following, strict=True):
        length = float(np.linalg.norm(after[:3, 3]))
        if length > 0.01 and link.inertia is not None:
            middle = np.eye(4)
            direction = after[:3, 3] / length
            middle[:3, :3] = rotation_between(np.array([0.0, 0.0, 1.0]), direction)
            middle[:3, 3] = after[:3, 3] / 2.0
            bar = Shape("capsule", np.array([0.04, length / 2.0, 0.0]), middle)
            links.append(replace(link, drawn=(bar,)))
        else:
            links.append(link)
    return replace(arm, links=tuple(links))


def _stand(arm: Arm, chain: FileChain, config: ArmConfig) -> Arm:
    """Return the arm with its base in the cell and its home.

    Raises:
        ArmError: there is no posture for it.
    """
    point, base, model = CONTACT_POINT.si, _given_base(config), chain.file.model
    guess, near = None, ""
    if config.home is not None:
        guess, near = np.array(config.home, dtype=np.float64), " near the given one"
        if guess.size != arm.joints:
            raise ArmError("cell.arm.home", f"must have {arm.joints} angles, got {guess.size}")
    elif model.nkey:
        guess, near = model.key_qpos[0, chain.angles].copy(), " near the file's first keyframe"
    stance = find_stance(build_arm_model(arm), point, base, guess)
    x, y, z = point.tolist()
    place = f"presses straight down on the contact point ({x:g}, {y:g}, {z:g} m)"
    if stance is None:
        where = "from the given base" if base is not None else "with its base on the floor"
        raise ArmError("cell.arm.home", f"no posture{near} {place} {where}")
    if stance.conditioning < _SINGULAR:
        raise ArmError(
            "cell.arm.home",
            f"the posture{near} that {place} is singular, or nearly so (gain "
            f"{stance.conditioning:.2g}, needs {_SINGULAR:g} m/rad): give another",
        )
    own = build_arm_model(arm)
    inertia = pin.crba(own.model, own.model.createData(), stance.home)
    if not np.linalg.eigvalsh(inertia)[0] > _WEIGHTLESS:
        raise ArmError(
            "cell.arm.armature", f"{chain.file.name}: a joint moves no inertia, and has no armature"
        )
    return _at(arm, stance)


def _given_base(config: ArmConfig) -> FloatArray | None:
    if config.base is None:
        if config.base_yaw is not None:
            raise ArmError("cell.arm.base_yaw", "no effect without cell.arm.base")
        return None
    x, y, _ = CONTACT_POINT.si - config.base
    yaw = float(np.arctan2(y, x)) if config.base_yaw is None else config.base_yaw
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = rotation("z", yaw), config.base
    return base


def _at(arm: Arm, stance: Stance) -> Arm:
    """Return the arm in a stance, its tip world-aligned at home."""
    base = replace(arm.base, placement=stance.base @ arm.base.placement)
    turned = base.placement[:3, :3]
    for link, angle in zip(arm.links, stance.home.tolist(), strict=True):
        turned = turned @ link.placement[:3, :3]
        if not link.slides:
            turned = turned @ rotation("z", angle)
    if arm.effector is not None:
        turned = turned @ arm.effector.placement[:3, :3]
    tip = arm.tip.copy()
    tip[:3, :3] = turned.T
    return replace(arm, base=base, tip=tip, home=stance.home)
