"""Robot_Tool's inner loop: computed torque in operational space, eqs. (2)-(6) of the paper."""

import numpy as np
import pinocchio as pin

from plant.arm_model import ArmModel
from plant.config import ToolConfig
from plant.viper import FloatArray


class InnerLoop:
    """Makes the tool a unit mass per axis with damping K2, as far as its model is right.

        tau = M q'' + h + J' F_measured + friction,    q'' = J^-1 ([f*; alpha] - J' q')
        f* = u - K2 v              on force-controlled axes, position held on the others
        alpha                      orientation held

    J' F_measured cancels the contact force: without it eq. (5) does not hold (reading 1).
    """

    def __init__(
        self,
        arm: ArmModel,
        config: ToolConfig,
        *,
        coulomb: FloatArray,
        viscous: FloatArray,
        lead: float,
        force_axes: FloatArray,
    ) -> None:
        """Prepare.

        Args:
            arm: the model the loop believes in.
            config: gains.
            coulomb, viscous: friction that is compensated, ``(6,)`` [N m], [N m s/rad].
            lead: from the encoders' reading to the middle of the time the torque acts [s].
            force_axes: which axes follow the command, ``(3,)`` bool; the others hold position.
        """
        self._model, self._tip = arm.model, arm.tip
        self._data = arm.model.createData()
        self._config, self._coulomb, self._viscous = config, coulomb, viscous
        self._lead = lead
        self._free = np.asarray(force_axes, dtype=bool)
        self._zero, self._goal = np.zeros(6), np.zeros(6)
        self._rotation, self._place = np.eye(3), np.zeros(3)
        self.J = np.zeros((6, 6))
        """Jacobian of the tip at the last `observe`, linear rows first, ``(6, 6)``."""
        self.position = np.zeros(3)
        """Tip at the last `observe`, ``(3,)`` [m]."""
        self.velocity = np.zeros(3)
        """Its velocity, ``(3,)`` [m/s]."""
        self._q, self._qdot = np.zeros(6), np.zeros(6)

    def hold(self) -> None:
        """Take the pose of the last `observe` as the one to be held."""
        pose = self._data.oMf[self._tip]
        self._rotation = pose.rotation.copy()
        self._place = pose.translation.copy()

    def observe(self, q: FloatArray, qdot: FloatArray) -> None:
        """Take in the encoders' joint angles and speeds, ``(6,)`` each [rad], [rad/s]."""
        model, data = self._model, self._data
        self._q[:], self._qdot[:] = q, qdot
        pin.forwardKinematics(model, data, self._q, self._qdot, self._zero)
        pin.computeJointJacobians(model, data)
        pin.updateFramePlacement(model, data, self._tip)
        self.J[:] = pin.getFrameJacobian(model, data, self._tip, _WORLD_ALIGNED)
        self.position[:] = data.oMf[self._tip].translation
        np.dot(self.J[:3], self._qdot, out=self.velocity)

    def torque(self, command: FloatArray, force: FloatArray) -> FloatArray:
        """Return joint torques ``(6,)`` [N m], not saturated, for the last `observe`.

        Args:
            command: u, acceleration command ``(3,)`` [m/s^2].
            force: measured contact force y ``(3,)`` [N].
        """
        model, data, c, goal = self._model, self._data, self._config, self._goal
        drift = pin.getFrameClassicalAcceleration(model, data, self._tip, _WORLD_ALIGNED)
        v = self.velocity
        goal[:3] = np.where(
            self._free,
            command - c.velocity_damping * v,
            c.position_stiffness * (self._place - self.position) - c.position_damping * v,
        )
        E = self._rotation @ data.oMf[self._tip].rotation.T
        omega = self.J[3:] @ self._qdot
        for i, (j, k) in enumerate(((2, 1), (0, 2), (1, 0))):  # sine of the error's angle times axis
            tilt = 0.5 * (E[j, k] - E[k, j])
            goal[3 + i] = c.orientation_stiffness * tilt - c.orientation_damping * omega[i]
        goal -= drift.vector
        acceleration = np.linalg.solve(self.J, goal)
        torque = pin.rnea(model, data, self._q, self._qdot, acceleration)
        torque += self.J[:3].T @ force
        # Friction is compensated for the speed that the joint will have when the torque arrives:
        # with the speed measured now, each reversal is answered with the wrong sign for that time.
        speed = self._qdot + self._lead * acceleration
        torque += self._viscous * speed
        torque += self._coulomb * np.tanh(speed / c.friction_velocity)
        return np.asarray(torque)


_WORLD_ALIGNED = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
