"""The cell without its arms: the contact model with noise, delay and lag, for cheap evaluations."""

import numpy as np
from numpy.typing import NDArray

from plant.config import CellConfig
from plant.interface import Cause, Measurement, Trip, Truth
from plant.sensors import ForceSensor
from qpmpc.contact import contact_model
from scenarios.motion import Motion

Array = NDArray[np.float64]


class LinearCell:
    """A plant for the loop: a unit mass with damping on a moving spring, per axis.

    Stiffness, damping K2, torque lag, delay and sensor are those of the cell. What it leaves out:
    arms, friction, wrong inertias, saturation. Torques are what the commands alone ask of an arm at
    home. Of the protection it has the limit on force: at a trip the force stays where it is.
    """

    def __init__(
        self, config: CellConfig, motion: Motion, *, force: Array, torque_gain: Array, seed: int
    ) -> None:
        """Begin at rest.

        Args:
            config: of the cell.
            motion: of the tissue.
            force: contact force at the start, ``(3,)`` [N].
            torque_gain: joint torques per command, ``(n_joints, 3)`` [N m s^2/m].
            seed: of the sensor's noise.
        """
        self.period = config.period
        model = contact_model(
            config.contact.stiffness,
            config.tool.velocity_damping,
            config.period,
            lag=config.imperfections.torque_lag,
        )
        self._A, self._B, self._tissue = model.model.A, model.model.B, model.tissue
        self._state = np.zeros((self._A.shape[0], 3))
        self._state[0] = force
        self._position = way = np.asarray(motion.position)
        # The mean over each period moves the tissue from sample to sample exactly.
        self._speed = np.diff(way, axis=0, append=way[-1:]) / config.period
        self._gain = torque_gain
        self._limit = config.protection.force if config.protection.enabled else np.inf
        self._waiting = np.zeros((config.imperfections.delay + 1, 3))
        self._sensor = ForceSensor(config.sensor, config.period, np.random.SeedSequence(seed))
        self._tool, self._torque, self._k = np.zeros(3), np.zeros(len(torque_gain)), 0
        self._trip: Trip | None = None

    def measure(self) -> Measurement:
        """Read the sensors."""
        force = self._sensor.read(self._state[0].copy())
        return Measurement(
            self._k * self.period, force, self._tool.copy(), np.array(self._state[1])
        )

    def apply(self, command: Array | None) -> None:
        """Go on by one period; without a command the last one goes on."""
        if command is not None:
            self._waiting[-1] = command
        self._torque = self._gain @ self._waiting[-1]
        if self._trip is None:
            self._tool += self._state[1] * self.period
            self._state = (
                self._A @ self._state
                + self._B * self._waiting[0]
                + self._tissue * self._speed[min(self._k, len(self._speed) - 1)]
            )
        self._waiting[:-1] = self._waiting[1:]
        self._k += 1
        size = float(np.linalg.norm(self._state[0]))
        if self._trip is None and not size < self._limit:
            self._trip = Trip(Cause.FORCE, self._k * self.period, size, self._limit)

    def truth(self) -> Truth:
        """Return what only the log may see."""
        k = min(self._k, len(self._position) - 1)
        return Truth(
            np.array(self._state[0]), self._position[k], self._torque, False, trip=self._trip
        )
