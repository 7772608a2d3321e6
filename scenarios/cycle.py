"""From measurement to command: what a cycle does between reading the plant and acting on it."""

from time import perf_counter
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from plant.interface import JointPlant, Measurement, Plant
from qpmpc.protocol import ForceControl
from qpmpc.step import Step
from scenarios.approach import Recovery
from scenarios.errors import ScenarioError
from scenarios.schedule import Schedule

Array = NDArray[np.float64]
_AXIS = {"x": 0, "y": 1, "z": 2}


class Wish(Protocol):
    """Where a cycle's setpoint comes from."""

    def preview(self, k: int) -> Array:
        """Return s(k) ... s(k+N), ``(N + 1, n_axes)`` [N], valid until the next call."""
        ...


class ControlCycle:
    """A controller with the setpoint and the bounds of its run, asked once per cycle."""

    def __init__(
        self,
        plant: Plant | JointPlant,
        controller: ForceControl,
        setpoint: Wish,
        schedule: Schedule,
        recovery: Recovery | None = None,
        *,
        beats: NDArray[np.bool_] | None = None,
    ) -> None:
        """Join them.

        Args:
            plant: asked about its joints where these are bounded; not measured, not moved.
            controller, setpoint, schedule: see there.
            recovery: what looks after the contact, where it can be lost.
            beats: in which cycles an R peak is told, ``(cycles,)``; none if not given.

        Raises:
            ScenarioError: joints are bounded, and the plant tells nothing about them.
        """
        self.controller = controller
        self._setpoint, self._schedule, self._beats = setpoint, schedule, beats
        self.recovery = recovery
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
        """Decide the command of cycle ``k``, which is in `command` then.

        Off the tissue it may be another than the step's, see `scenarios.approach`.

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
        if self._beats is not None and self._beats[k]:
            controller.beat()
        if self._joints is not None:
            controller.view(self._joints.joint_space(measurement.force, self.command))
        preview, force = self._setpoint.preview(k), measurement.force[index]
        recovery = self.recovery
        if recovery is not None:
            force = recovery.measured(k, measurement, force, preview[0], controller)
        step = controller.step(
            force,
            measurement.velocity[index],
            preview,
            deadline=None if due is None else due - perf_counter(),
        )
        applied = step.command
        if recovery is not None:
            applied = recovery.command(k, applied, self.command[index], controller)
        self.command[index] = applied
        return step

    @property
    def applied(self) -> Array:
        """Command of the last cycle on the controlled axes, ``(n_axes,)`` [m/s^2]."""
        return self.command[self._index]
