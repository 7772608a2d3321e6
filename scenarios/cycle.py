"""From measurement to command: what a cycle does between reading the plant and acting on it."""

from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from plant.interface import JointPlant, Measurement, Plant
from qpmpc.protocol import ForceControl
from qpmpc.step import Step
from scenarios.errors import ScenarioError
from scenarios.live import LiveSetpoint
from scenarios.schedule import Schedule
from scenarios.setpoint import Setpoint

Array = NDArray[np.float64]
_AXIS = {"x": 0, "y": 1, "z": 2}


class ControlCycle:
    """A controller with the setpoint and the bounds of its run, asked once per cycle."""

    def __init__(
        self,
        plant: Plant | JointPlant,
        controller: ForceControl,
        setpoint: Setpoint | LiveSetpoint,
        schedule: Schedule,
    ) -> None:
        """Join them.

        Args:
            plant: asked about its joints where these are bounded; not measured, not moved.
            controller, setpoint, schedule: see there.

        Raises:
            ScenarioError: joints are bounded, and the plant tells nothing about them.
        """
        self.controller = controller
        self._setpoint, self._schedule = setpoint, schedule
        every = controller.axes == tuple(_AXIS)
        self._index = slice(None) if every else np.array([_AXIS[a] for a in controller.axes])
        self._joints = None
        if controller.bounds_joints:
            if not isinstance(plant, JointPlant):
                raise ScenarioError(
                    "joints are bounded, but the plant tells nothing about its joints"
                )
            self._joints = plant
        self.command = np.zeros(3)
        """Command of the last cycle, ``(3,)`` [m/s^2]; 0 on axes that are not controlled."""

    def decide(self, k: int, measurement: Measurement, deadline: float | None = None) -> Step:
        """Decide the command of cycle ``k``.

        Args:
            k: counted from the start of the run.
            measurement: of this cycle.
            deadline: what is left from now until the command has to be there [s]; without one, the
                controller's own counts, see `ForceControl.step`.
        """
        due = None if deadline is None else perf_counter() + deadline
        controller, schedule, index = self.controller, self._schedule, self._index
        if schedule.due[k]:
            for name in schedule.moving:
                controller.move(name, *schedule.preview(name, k))
        if self._joints is not None:
            controller.view(self._joints.joint_space(measurement.force, self.command))
        step = controller.step(
            measurement.force[index],
            measurement.velocity[index],
            self._setpoint.preview(k),
            deadline=None if due is None else due - perf_counter(),
        )
        self.command[index] = step.command
        return step
