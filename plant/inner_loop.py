"""Robot_Tool's inner loop: computed torque in operational space, eqs. (2)-(6) of the paper."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.linalg.lapack import dgesv, dposv

from plant.arm_model import ArmModel
from plant.config import ToolConfig
from plant.interface import JointSpace
from plant.viper import FloatArray


class InnerLoop:
    """Makes the tool a unit mass per axis with damping K2, as far as its model is right.

        tau = M q'' + h + J' F_measured + friction,    q'' = J^-1 ([f*; alpha] - J' q')
        f* = u - K2 v              on force-controlled axes, position held on the others
        alpha                      orientation held

    J' F_measured cancels the contact force: without it eq. (5) does not hold (reading 1).

    An arm of more than six joints has a choice of q'' for the same tip. It takes the one of least
    kinetic energy that leads it back to the posture in which it began, with damping:

        q'' = r + M^-1 J' L ([f*; alpha] - J' q' - J r),   L = (J M^-1 J')^-1
        r = k (q_begin - q) - d q'
    """

    def __init__(
        self,
        arm: ArmModel,
        config: ToolConfig,
        *,
        coulomb: FloatArray,
        viscous: FloatArray,
        lead: float,
        force_axes: NDArray[np.intp],
    ) -> None:
        """Prepare.

        Args:
            arm: the model the loop believes in.
            config: gains.
            coulomb, viscous: friction that is compensated, ``(n,)`` [N m], [N m s/rad].
            lead: from the encoders' reading to the middle of the time the torque acts [s].
            force_axes: which axes follow the command, 0 to 2 for x to z, in the order of the
                columns of `joint_space`; the others hold position.
        """
        self._model, self._tip = arm.model, arm.tip
        self._data = arm.model.createData()
        self._coulomb, self._viscous, self._lead = coulomb, viscous, lead
        self._sign_gain = 1.0 / config.friction_velocity
        self._axes = np.asarray(force_axes)
        free = np.isin(np.arange(3), self._axes).astype(np.float64)
        held = 1.0 - free
        stiffness = np.concatenate(
            [held * config.position_stiffness, [config.orientation_stiffness] * 3]
        )
        damping = np.concatenate(
            [
                free * config.velocity_damping + held * config.position_damping,
                [config.orientation_damping] * 3,
            ]
        )
        # From command, pose error and twist to the acceleration that is wanted of the tip.
        follow = np.vstack([np.diag(free), np.zeros((3, 3))])
        self._gains = np.hstack([follow, np.diag(stiffness), -np.diag(damping)])
        self._velocity_damping = config.velocity_damping
        self._columns = np.eye(6)[:, self._axes]
        self._friction, self._led_friction = np.diag(viscous), np.diag(lead * viscous)
        self._inputs = np.zeros(15)
        self._command, self._error = self._inputs[:3], self._inputs[3:9]
        self.twist = self._inputs[9:]
        """Velocity and angular velocity of the tip, ``(6,)`` [m/s, rad/s]."""
        self._goal = np.zeros(6)
        n = arm.model.nv
        self._redundant = n > 6
        self._posture_stiffness = config.posture_stiffness
        self._posture_damping = config.posture_damping
        self._rest, self._pull = np.zeros(n), np.zeros(n)
        self._q, self._zero = np.zeros(n), np.zeros(n)
        self.qdot = np.zeros(n)
        """Joint speeds at the last `observe`, ``(n,)`` [rad/s]."""
        self._speed_limit = arm.model.velocityLimit.copy()
        self._torque_limit = arm.model.effortLimit.copy()
        for limit in (self._speed_limit, self._torque_limit):
            limit.setflags(write=False)
        self._held, self._place = np.eye(3), np.zeros(3)
        pose = self._data.oMf[self._tip]  # views into pinocchio's memory, up to date by themselves
        self._rotation, self._translation = pose.rotation, pose.translation
        self.J = np.zeros((6, n))
        """Jacobian of the tip at the last `observe`, linear rows first, ``(6, n)``."""
        self.position = np.zeros(3)
        """Tip at the last `observe`, ``(3,)`` [m]."""

    def hold(self) -> None:
        """Take pose and posture of the last `observe` as those to be held."""
        self._rest[:] = self._q
        self._held = self._rotation.copy()
        self._place = self._translation.copy()

    def observe(self, q: FloatArray, qdot: FloatArray) -> None:
        """Take in the encoders' joint angles and speeds, ``(n,)`` each [rad], [rad/s]."""
        model, data = self._model, self._data
        self._q[:], self.qdot[:] = q, qdot
        pin.forwardKinematics(model, data, self._q, self.qdot, self._zero)
        pin.computeJointJacobians(model, data)
        pin.updateFramePlacement(model, data, self._tip)
        self.J = pin.getFrameJacobian(model, data, self._tip, _WORLD_ALIGNED)
        self.position = self._translation.copy()
        np.dot(self.J, self.qdot, out=self.twist)

    def torque(self, command: FloatArray, force: FloatArray) -> FloatArray:
        """Return joint torques ``(n,)`` [N m], not saturated, for the last `observe`.

        Args:
            command: u, acceleration command ``(3,)`` [m/s^2].
            force: measured contact force y ``(3,)`` [N].
        """
        model, data, error = self._model, self._data, self._error
        np.subtract(self._place, self.position, out=error[:3])
        error[3:] = pin.log3(self._held @ self._rotation.T)
        self._command[:] = command
        goal = np.dot(self._gains, self._inputs, out=self._goal)
        goal -= pin.getFrameClassicalAcceleration(model, data, self._tip, _WORLD_ALIGNED).vector
        acceleration = self._resolve(goal)
        torque = pin.rnea(model, data, self._q, self.qdot, acceleration)
        torque += np.dot(force, self.J[:3])
        # Friction is compensated for the speed that the joint will have when the torque arrives:
        # with the speed measured now, each reversal is answered with the wrong sign for that time.
        acceleration *= self._lead
        speed = np.add(acceleration, self.qdot, out=acceleration)
        torque += self._viscous * speed
        speed *= self._sign_gain
        torque += self._coulomb * np.tanh(speed, out=speed)
        return np.asarray(torque)

    def _resolve(self, goal: FloatArray) -> FloatArray:
        """Return joint accelerations ``(n,)`` for those of the tip, ``(6,)``, less J' q'."""
        if not self._redundant:
            return np.asarray(dgesv(self.J, goal)[2])
        pull = np.subtract(self._rest, self._q, out=self._pull)
        pull *= self._posture_stiffness
        pull -= self._posture_damping * self.qdot
        goal -= np.dot(self.J, pull)
        pull += np.dot(self._inverse(), goal)
        return pull.copy()

    def _inverse(self) -> FloatArray:
        """Return the inverse of J that moves the joints with least kinetic energy, ``(n, 6)``."""
        inertia = pin.crba(self._model, self._data, self._q)
        easy = dposv(inertia, self.J.T)[1]  # M^-1 J'; crba's upper triangle is what is read
        return np.asarray(dposv(np.dot(self.J, easy), easy.T)[1].T)

    def joint_space(self, force: FloatArray, previous: FloatArray) -> JointSpace:
        """Return linear maps from tip to joints, and limits, for the last `observe`.

        The torques are those of `torque`. Compensated Coulomb friction counts as it is now, and the
        change of Coriolis forces with the tip's speed is left out: both are constant offsets.

        Args:
            force: measured contact force y ``(3,)`` [N].
            previous: the command about which the torque is linearised, ``(3,)`` [m/s^2].
        """
        axes = self._axes
        velocity = self.twist[axes]
        if self._redundant:
            speed_gain = self._inverse()[:, axes]
        else:
            speed_gain = dgesv(self.J, self._columns)[2]
        inertia = pin.crba(self._model, self._data, self._q)
        inertia += self._led_friction
        command_gain = np.dot(inertia, speed_gain)
        velocity_gain = np.dot(self._friction, speed_gain)
        velocity_gain -= self._velocity_damping * command_gain
        force_gain = self.J[axes].T
        torque = self.torque(previous, force)
        torque -= np.dot(command_gain, previous[axes])
        torque -= np.dot(velocity_gain, velocity)
        torque -= np.dot(force_gain, force[axes])
        return JointSpace(
            speed_gain,
            self.qdot - np.dot(speed_gain, velocity),
            command_gain,
            velocity_gain,
            force_gain,
            torque,
            self._speed_limit,
            self._torque_limit,
        )


_WORLD_ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
