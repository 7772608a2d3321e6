"""Inverse kinematics: the posture that reaches a pose, and where an arm can press straight down."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin

from plant.arm_model import ArmModel
from plant.viper import FloatArray

_TOLERANCE = 1e-10
"""Pose error with which the inverse kinematics is content [m, rad]."""
_ITERATIONS = 30
_DOWN = np.array([0.0, 0.0, -1.0])
_LENGTH = 0.3
"""What a turn of the instrument counts against a displacement, where the two are weighed [m]."""
_SEARCHES, _NEARBY = 150, 40
"""Random postures to start from where there is no guess, and around one that fails."""
_STEPS = 60
_STEP = 0.3
"""Largest step of a joint in one iteration [rad]."""
_DAMPING = 1e-6
_CLEARANCE = 0.5
"""Distance of a joint from its range's end from which on more counts for nothing [rad]."""
_REACH = (0.25, 0.9)
"""Horizontal distances of the base from the contact point that are tried [m]."""
_LOWEST = 0.05
"""Height above the floor that every joint but the first has in a posture that is searched for
[m]."""
_BEYOND = 0.1
"""How far a joint may reach over to the heart's side in such a posture [m]."""


def reach(exact: ArmModel, data: Any, goal: Any, q: FloatArray) -> FloatArray | None:
    """Return the joint angles near ``q (n,)`` that bring the tip to a pose, None if none do.

    A redundant arm moves as little as it can.

    Args:
        exact: the arm.
        data: pinocchio's, of its model.
        goal: ``pinocchio.SE3`` of the tip in the world.
        q: where to start [rad].
    """
    for _ in range(_ITERATIONS):
        pin.framesForwardKinematics(exact.model, data, q)
        error = pin.log6(data.oMf[exact.tip].actInv(goal)).vector
        if np.abs(error).max() < _TOLERANCE:
            return q
        J = pin.computeFrameJacobian(exact.model, data, q, exact.tip, pin.ReferenceFrame.LOCAL)
        try:
            step = np.linalg.solve(J, error) if J.shape[1] == 6 else np.linalg.pinv(J) @ error
        except np.linalg.LinAlgError:
            break
        # Far from the goal a full Newton step may leap into another posture.
        q = q + step * min(1.0, 0.3 / max(np.abs(step).max(), 1e-300))
    return None


@dataclass(frozen=True, eq=False)
class Stance:
    """Where an arm stands and how, so that its tip presses straight down on a point."""

    base: FloatArray
    """Pose of the arm's own world in the cell's, ``(4, 4)`` [m]."""
    home: FloatArray
    """Joint angles, ``(n,)`` [rad]."""
    conditioning: float
    """Least gain from joint speeds to the tip's motion, a turn by 0.3 m counting as much as a
    metre; 0 where the arm is singular [m/rad]."""


def find_stance(
    arm: ArmModel, point: FloatArray, base: FloatArray | None, guess: FloatArray | None
) -> Stance | None:
    """Return a stance in which the tip's z axis points down and its origin is on a point.

    Without a base the arm stands upright on the floor, on the tool's side of the point (x > 0), as
    far away as its posture asks for. Without a guess it takes the best conditioned of those that
    random starts lead to, which do not use the ends of the ranges, the floor, or the heart's side.

    Args:
        arm: in its own world.
        point: in the cell's world, ``(3,)`` [m].
        base: pose of the arm's own world in the cell's, ``(4, 4)`` [m].
        guess: rough joint angles, ``(n,)`` [rad].

    Returns:
        None if there is none.
    """
    search = _Search(arm, point, base)
    if guess is not None:
        return next((s for q in _around(guess) if (s := search.settle(q)) is not None), None)
    best, most = None, 0.0
    for q in _anywhere(search.lower, search.upper):
        stance = search.settle(q)
        if stance is not None and (merit := search.merit(stance)) > most:
            best, most = stance, merit
    return best


class _Search:
    """The conditions on a stance, and Newton's way to it."""

    def __init__(self, arm: ArmModel, point: FloatArray, base: FloatArray | None) -> None:
        self._arm, self._data = arm, arm.model.createData()
        self._point, self._base = point, base
        self._local = point if base is None else (np.linalg.inv(base) @ [*point, 1.0])[:3]
        """Where the tip has to be, in the arm's own world; x and y count only with a base."""
        self._rows = np.array([2, 3, 4] if base is None else [0, 1, 2, 3, 4])
        self.lower = arm.model.lowerPositionLimit
        self.upper = arm.model.upperPositionLimit

    def settle(self, q: FloatArray) -> Stance | None:
        """Go from ``q`` to a posture that meets the conditions, within the ranges."""
        q = np.clip(q, self.lower, self.upper)
        for _ in range(_STEPS):
            error, J = self._error(q)
            if np.abs(error).max() < _TOLERANCE:
                return self._stance(q)
            free = np.ones(q.size, dtype=bool)
            while True:
                A = J * free
                step = A.T @ np.linalg.solve(A @ A.T + _DAMPING * np.eye(len(A)), error)
                stuck = (q >= self.upper) & (step > 0.0) | (q <= self.lower) & (step < 0.0)
                if not stuck.any():
                    break
                free &= ~stuck
            step *= min(1.0, _STEP / max(np.abs(step).max(), 1e-300))
            q = np.clip(q + step, self.lower, self.upper)
        return None

    def merit(self, stance: Stance) -> float:
        """How good a stance is: well conditioned, far from the ranges' ends; 0 in a bad place."""
        q = stance.home
        ends = np.minimum(q - self.lower, self.upper - q).min() / _CLEARANCE
        pin.forwardKinematics(self._arm.model, self._data, q)
        for placement in self._data.oMi.tolist()[2:]:  # the first joint stays where it is
            x, _, z = (stance.base @ [*placement.translation, 1.0])[:3]
            if z < _LOWEST or x < self._point[0] - _BEYOND:
                return 0.0
        away = np.hypot(*(stance.base[:2, 3] - self._point[:2]))
        if self._base is None and not _REACH[0] <= away <= _REACH[1]:
            return 0.0
        return stance.conditioning * min(1.0, float(ends))

    def _error(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What is missing to the conditions, and how joints change it."""
        J = self._jacobian(q)
        tip = self._data.oMf[self._arm.tip]
        axis = tip.rotation[:, 2]
        across = np.cross(axis, _DOWN)
        sine = np.linalg.norm(across)
        turn = across * (np.arctan2(sine, axis @ _DOWN) / sine) if sine > 1e-12 else across
        if sine <= 1e-12 and axis[2] > 0.0:  # it points up: any way round
            turn = np.array([np.pi, 0.0, 0.0])
        error = np.concatenate([self._local - tip.translation, turn])
        return error[self._rows], J[self._rows]

    def _jacobian(self, q: FloatArray) -> FloatArray:
        model, tip = self._arm.model, self._arm.tip
        J = pin.computeFrameJacobian(
            model, self._data, q, tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        pin.updateFramePlacement(model, self._data, tip)
        return np.asarray(J)

    def _stance(self, q: FloatArray) -> Stance:
        J = self._jacobian(q)
        J[3:] *= _LENGTH
        least = float(np.linalg.svd(J, compute_uv=False)[-1])
        if self._base is not None:
            return Stance(self._base, q, least)
        x, y, z = self._data.oMf[self._arm.tip].translation
        yaw = np.pi - np.arctan2(y, x)
        base = np.eye(4)
        base[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
        base[:3, 3] = self._point - base[:3, :3] @ [x, y, z]
        return Stance(base, q, least)


def _around(guess: FloatArray) -> Iterator[FloatArray]:
    yield guess
    rng = np.random.default_rng(0)
    for i in range(_NEARBY):
        yield guess + (0.1 + 0.9 * i / _NEARBY) * rng.uniform(-1.0, 1.0, guess.size)


def _anywhere(lower: FloatArray, upper: FloatArray) -> Iterator[FloatArray]:
    rng = np.random.default_rng(0)
    for _ in range(_SEARCHES):
        yield rng.uniform(np.maximum(lower, -np.pi), np.minimum(upper, np.pi))
