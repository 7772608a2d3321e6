"""Robot_Heart's programme: joint servo commands that make the tissue follow a motion."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from plant.arm_model import ArmModel
from plant.chain import Arm
from plant.errors import PlantError
from plant.interface import TissueMotion
from plant.mjcf import SERVO_DAMPING, SERVO_STIFFNESS
from plant.posture import reach
from plant.viper import FloatArray

_SIGN_SPEED = 0.005
"""Joint speed over which the feed-forward of Coulomb friction changes sign [rad/s]."""


class UnreachableMotionError(PlantError):
    """Robot_Heart cannot play a motion.

    Attributes:
        time: when it fails first [s].
        joint: number of the joint that fails, from 1; None where no posture reaches the point.
    """

    def __init__(self, time: float, joint: int | None, reason: str) -> None:
        self.time, self.joint = time, joint
        super().__init__(
            f"the motion is beyond Robot_Heart at t = {time:.3f} s: {reason}; "
            "scale it down or check that it is in metres"
        )


@dataclass(frozen=True, eq=False)
class Programme:
    """Where Robot_Heart starts, and what its servos are told at the control instants."""

    q: FloatArray
    """Joint angles at the start, ``(6,)`` [rad]."""
    qdot: FloatArray
    """Joint speeds at the start, ``(6,)`` [rad/s]."""
    ctrl: FloatArray
    """Servo commands with velocity and torque feed-forward, ``(n, 6)`` [rad]."""
    angles: FloatArray
    """Where the joints are meant to be, ``(n, 6)`` [rad]."""


def programme(
    arm: Arm,
    exact: ArmModel,
    motion: TissueMotion,
    *,
    period: float,
    friction: float,
) -> Programme:
    """Turn a motion of the tissue into joint servo commands.

    Inverse kinematics by Newton's method from sample to sample, orientation held as at home; the
    torque feed-forward is that of the exact model without gravity, which the arm carries itself.

    Args:
        arm: with six joints; at home at zero displacement.
        exact: its exact model, in the world's frame.
        motion: of the tissue from home.
        period: between samples [s].
        friction: joint friction as a multiple of the arm's; the servos feed it forward [-].

    Raises:
        UnreachableMotionError: outside the workspace, a joint's range or its speed.
    """
    model, data = exact.model, exact.model.createData()
    frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    pin.framesForwardKinematics(model, data, arm.home)
    goal = pin.SE3(data.oMf[exact.tip])
    origin = goal.translation.copy()
    n = motion.position.shape[0]
    ctrl, path = np.empty((n, 6)), np.empty((n, 6))
    angles, zero, twist, wrench = arm.home.copy(), np.zeros(6), np.zeros(6), np.zeros(6)
    coulomb, viscous = friction * arm.coulomb, friction * arm.viscous
    for k in range(n):
        goal.translation = origin + motion.position[k]
        found = reach(exact, data, goal, angles)
        if found is None:
            raise UnreachableMotionError(
                k * period, None, "no posture of the arm reaches the point"
            )
        angles = found
        J = pin.computeFrameJacobian(model, data, angles, exact.tip, frame)
        twist[:3], wrench[:3] = motion.velocity[k], motion.acceleration[k]
        speeds = np.linalg.solve(J, twist)
        pin.forwardKinematics(model, data, angles, speeds, zero)
        drift = pin.getFrameClassicalAcceleration(model, data, exact.tip, frame).vector
        accelerations = np.linalg.solve(J, wrench - drift)
        torque = pin.rnea(model, data, angles, speeds, accelerations)
        torque = torque - pin.computeGeneralizedGravity(model, data, angles)
        torque += coulomb * np.tanh(speeds / _SIGN_SPEED) + viscous * speeds
        path[k] = angles
        ctrl[k] = angles + (SERVO_DAMPING * speeds + torque) / SERVO_STIFFNESS
        _check(angles, arm.lower, arm.upper, k * period, _ANGLE)
        _check(speeds, -arm.speed, arm.speed, k * period, _SPEED)
        if k == 0:
            start = angles, speeds
        angles = angles + period * speeds
    return Programme(*start, ctrl, path)


_ANGLE = "joint {} would need to stand at {:.0f} deg, its range is {:.0f}..{:.0f} deg"
_SPEED = "joint {} would need to turn at {:.0f} deg/s, its limit is {:.0f}..{:.0f} deg/s"


def _check(
    value: FloatArray, lower: FloatArray, upper: FloatArray, time: float, reason: str
) -> None:
    outside = np.flatnonzero((value < lower) | (value > upper))
    if outside.size:
        j = int(outside[0])
        figures = (float(np.rad2deg(v[j])) for v in (value, lower, upper))
        raise UnreachableMotionError(time, j + 1, reason.format(j + 1, *figures))
