"""What a controller met in a closed loop, kept so that any other controller can meet it again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from plant.cell import Cell
from plant.interface import JointSpace, Measurement, Truth
from qpmpc import ForceController, Step
from qpmpc.backends import Backend
from qpmpc.controller import Compiled
from scenarios import Scenario, ScenarioError, Schedule, Setpoint, control_loop
from scenarios.experiment import Report, assemble, require_backend
from scenarios.loop import Stop

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Stream:
    """One closed loop as its controller saw it, K cycles long.

    Replayed in open loop: whoever is tested gets the recorded measurement and the recorded
    previous command in every cycle, whatever it would have commanded itself. So every backend,
    and every horizon, meets the same cycles, and the state estimates are the same as well.
    """

    scenario: Scenario
    """What was run; its horizon and backend are those of the recording."""
    force: Array
    """Measured contact force on the controlled axes, ``(K, n_axes)`` [N]."""
    velocity: Array
    """Velocity of the tool from its encoders, ``(K, n_axes)`` [m/s]."""
    command: Array
    """Command of each cycle, ``(K, n_axes)`` [m/s^2]."""
    joints: tuple[JointSpace, ...]
    """Of each cycle where joints are bounded, else of the first one alone."""

    @property
    def cycles(self) -> int:
        """K."""
        return len(self.force)

    @property
    def bounds_joints(self) -> bool:
        """Whether joints are bounded, so that the rows are others in every cycle."""
        joints = self.scenario.controller.bounds.joints
        return bool(np.isfinite([joints.speed, joints.torque]).any())

    @property
    def axes(self) -> str:
        """The controlled axes as the command line writes them, "x,y,z"."""
        return ",".join(self.scenario.axes)


def record(scenario: Scenario, *, report: Report, stop: Stop) -> Stream | None:
    """Run the scenario in closed loop on the cell and return what its controller met.

    Off the tissue, too, it is the controller that leads the tool: nothing else is shown to it.

    Returns:
        None where ``stop`` asked for the end before the run was through.

    Raises:
        ScenarioError, QpmpcError, PlantError: what the scenario asks for cannot be had, or the
        simulation failed.
    """
    if scenario.setpoint.live is not None:
        raise ScenarioError(
            "setpoint.live: cycles are recorded as fast as they go, nobody can send a setpoint to "
            "them; give it by setpoint.file"
        )
    require_backend(scenario, "a recording of QPs")
    made = assemble(scenario, report)
    recorder = _Recorder(made.cell, keep_joints=made.controller.bounds_joints)
    commands = np.zeros((scenario.cycles, len(scenario.axes)))

    def note(step: Step) -> None:
        commands[made.log.cycles - 1] = step.command

    complete = control_loop(
        recorder,
        made.controller,
        made.setpoint,
        made.log,
        scenario.cycles,
        schedule=made.schedule,
        watch=note,
        progress=lambda done, total: report("recording", done, total),
        stop=stop,
    )
    if not complete:
        return None
    index = ["xyz".index(axis) for axis in scenario.axes]
    return Stream(
        scenario,
        np.array([m.force[index] for m in recorder.measured]),
        np.array([m.velocity[index] for m in recorder.measured]),
        commands,
        tuple(recorder.joints),
    )


class Replay:
    """One controller that meets a stream: what the loop would hand it, without the loop."""

    def __init__(
        self,
        stream: Stream,
        horizon: int,
        backend: str | type[Backend],
        *,
        compiled: Compiled = "off",
    ) -> None:
        """Build the controller of the stream's scenario for another backend and horizon.

        Args:
            stream: what it will meet.
            horizon: N; all else is as the scenario says.
            backend: a registered name or a backend class.
            compiled: whether its step is a compiled one.

        Raises:
            QpmpcError: there is no such step, or the backend refuses the problem.
        """
        config = stream.scenario.controller
        solver = replace(config.solver, compiled=compiled)
        config = replace(config, horizon=horizon, solver=solver)
        scenario = replace(stream.scenario, controller=config)
        self.horizon = horizon
        period = scenario.cell.period
        self._schedule = Schedule(scenario)
        self._stream, moving = stream, self._schedule.moving
        self.controller = ForceController(
            scenario.controller,
            scenario.axes,
            period,
            backend,
            joints=stream.joints[0],
            moving=moving,
        )
        setpoint = Setpoint(scenario.setpoint, scenario.axes, stream.cycles, horizon, period)
        self.previews = [setpoint.preview(k) for k in range(stream.cycles)]
        if not scenario.setpoint.preview:  # one array for all cycles then
            self.previews = [setpoint.preview(k).copy() for k in range(stream.cycles)]
        """Setpoint s(k) ... s(k+N) of each cycle, ``(N + 1, n_axes)`` [N]."""
        self.measurements = np.array(
            [
                self.controller.measured(force, velocity).copy()
                for force, velocity in zip(stream.force, stream.velocity, strict=True)
            ]
        )
        """What the observer measures, ``(K, n_measured)``."""
        start = np.zeros_like(stream.command[:1])
        self.previous = np.vstack([start, stream.command])
        """u(k-1) of each cycle, and the last command, ``(K + 1, n_axes)`` [m/s^2]."""
        touching = scenario.cell.contact.gap == 0
        self.controller.reset(setpoint.force[0] * touching)
        self.states = self._estimates()
        """Estimate x(k|k-1) before the measurement of each cycle, ``(K, n)``."""
        self.changes = bool(moving) or self.controller.bounds_joints
        """Whether `change` does anything."""

    def begin(self, k: int) -> None:
        """Bring the controller to where it would be before cycle ``k``."""
        general = self.controller.general
        general.reset(self.states[k], self.previous[k])
        general.solver.forget()
        if general.compiled is not None:
            general.compiled.forget()
        for name in self._schedule.moving:
            self.controller.move(name, *self._schedule.preview(name, k))

    def change(self, k: int) -> None:
        """Move the bounds and maps that are others in cycle ``k``, as the loop does."""
        if self._schedule.due[k]:
            for name in self._schedule.moving:
                self.controller.move(name, *self._schedule.preview(name, k))
        if self.controller.bounds_joints:
            self.controller.view(self._stream.joints[k])

    def steps(self, start: int, end: int) -> Iterator[tuple[int, Step]]:
        """Yield every cycle and its step, while the controller's problem holds its vectors."""
        general = self.controller.general
        self.begin(start)
        for k in range(start, end):
            if self.changes:
                self.change(k)
            yield k, general.step(self.measurements[k], self.previews[k])
            general.command[:] = self.previous[k + 1]
            general.prepare()

    def _estimates(self) -> Array:
        observer = self.controller.general.observer
        states = np.empty((self._stream.cycles, observer.state.size))
        for k, measurement in enumerate(self.measurements):
            states[k] = observer.state
            observer.correct(measurement)
            observer.predict(self.previous[k + 1])
        return states


class _Recorder:
    """A plant that passes everything on to the cell, and keeps what its controller may see."""

    def __init__(self, cell: Cell, *, keep_joints: bool) -> None:
        self.period, self._cell, self._keep_joints = cell.period, cell, keep_joints
        self.measured: list[Measurement] = []
        self.joints = [] if keep_joints else [cell.joint_space(np.zeros(3), np.zeros(3))]

    def measure(self) -> Measurement:
        self.measured.append(self._cell.measure())
        return self.measured[-1]

    def apply(self, command: Array | None) -> None:
        self._cell.apply(command)

    def truth(self) -> Truth:
        return self._cell.truth()

    def joint_space(self, force: Array, previous: Array) -> JointSpace:
        found = self._cell.joint_space(force, previous)
        if self._keep_joints:
            self.joints.append(found)
        return found
