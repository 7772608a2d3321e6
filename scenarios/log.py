"""The log of a run: one row a cycle, preallocated, written once as Parquet."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from plant.interface import Cause, Measurement, Trip, Truth
from qpmpc.fallback import Source
from qpmpc.status import Status
from qpmpc.step import Step
from scenarios.approach import ContactEvent, ContactState
from scenarios.live import Source as SetpointSource
from scenarios.motion import Axis

Array = NDArray[np.float64]
_AXES = ("x", "y", "z")
_STATUSES = tuple(Status)
_CODES = {status: code for code, status in enumerate(_STATUSES)}
_SOURCES = tuple(Source)
_SETPOINT_SOURCES = tuple(source.name.lower() for source in SetpointSource)
_SOURCE_CODES = {source: code for code, source in enumerate(_SOURCES)}
_CONTACTS = tuple(state.name.lower() for state in ContactState)
_TRIPS = ("none", *Cause)


class Log:
    """What happened in each cycle. Columns are time-major arrays of the length of the run."""

    def __init__(
        self, cycles: int, axes: Sequence[Axis], bounds: Sequence[str], joints: int = 6
    ) -> None:
        """Make room for ``cycles`` rows.

        Args:
            cycles: length of the run.
            axes: axes under force control.
            bounds: names of the bounds whose worst violation by the plan is recorded, all that
                have rows, in the order of the rows.
            joints: of the tool.
        """
        n = len(axes)
        self.axes, self.cycles = tuple(axes), 0
        self.bounds = tuple(bounds)
        self.time = np.zeros(cycles)
        self.setpoint = np.zeros((cycles, n))
        self.setpoint_source = np.zeros(cycles, dtype=np.int8)
        self.force = np.zeros((cycles, 3))
        self.force_peak = np.zeros(cycles)
        self.force_measured = np.zeros((cycles, 3))
        self.force_uncompensated = np.full((cycles, 3), np.nan)
        self.force_predicted = np.zeros((cycles, n))
        self.tissue = np.zeros((cycles, 3))
        self.tool = np.zeros((cycles, 3))
        self.tool_velocity = np.zeros((cycles, 3))
        self.command = np.zeros((cycles, n))
        self.torque = np.zeros((cycles, joints))
        self.joint_velocity = np.zeros((cycles, joints))
        self.joint_angle = np.zeros((cycles, 6 + joints), dtype=np.float32)
        self.touching = np.zeros(cycles, dtype=bool)
        self.contact = np.zeros(cycles, dtype=np.int8)
        self.contact_events: Sequence[ContactEvent] | None = None
        """Times off the tissue; None where the contact cannot be lost."""
        self.trip: Trip | None = None
        self.tripped = np.zeros(cycles, dtype=bool)
        self.torque_saturated = np.zeros(cycles, dtype=bool)
        self.command_saturated = np.zeros(cycles, dtype=bool)
        self.slack = np.zeros((cycles, len(self.bounds)))
        self._starts: list[int] | None = None
        self.residual = np.zeros(cycles)
        self.iterations = np.zeros(cycles, dtype=np.int32)
        self.status = np.zeros(cycles, dtype=np.int8)
        self.source = np.zeros(cycles, dtype=np.int8)
        self.build_time = np.zeros(cycles)
        self.solve_time = np.zeros(cycles)
        self.cycle_time = np.zeros(cycles)
        self.plant_time = np.zeros(cycles)

    def record(
        self,
        measurement: Measurement,
        truth: Truth,
        step: Step,
        *,
        setpoint: Array,
        saturated: bool,
        cycle_time: float,
        plant_time: float = 0.0,
        command: Array | None = None,
        contact: ContactState = ContactState.PRESSING,
    ) -> None:
        """Write the next row: the instant of ``measurement``, what was decided, what it took.

        ``cycle_time`` is the controller's share [s], ``plant_time`` that of the plant [s].
        ``command`` is applied in place of the step's where it is given; ``contact``: what the
        measured force tells of the contact.
        """
        k = self.cycles
        self.time[k] = measurement.time
        self.setpoint[k] = setpoint
        self.force[k] = truth.force
        self.force_peak[k] = truth.force_peak
        self.force_measured[k] = measurement.force
        self.force_predicted[k] = step.predicted[0]
        self.tissue[k] = truth.tissue
        self.tool[k] = measurement.position
        self.tool_velocity[k] = measurement.velocity
        self.command[k] = step.command if command is None else command
        self.torque[k] = truth.torque
        self.joint_velocity[k] = truth.joint_velocity
        self.joint_angle[k] = truth.joint_angle
        self.touching[k] = truth.touching
        self.contact[k] = contact
        if truth.trip is not None:
            self.trip, self.tripped[k] = truth.trip, True
        self.torque_saturated[k] = truth.saturated
        self.command_saturated[k] = saturated
        if self.bounds:
            if self._starts is None:
                self._starts = [step.rows[name].start for name in self.bounds]
            np.maximum.reduceat(step.violation, self._starts, out=self.slack[k])
        self.residual[k] = step.residuals.scaled
        self.iterations[k] = step.iterations
        self.status[k] = _CODES[step.status]
        self.source[k] = _SOURCE_CODES[step.source]
        self.build_time[k] = step.times.build
        self.solve_time[k] = step.times.solve
        self.cycle_time[k] = cycle_time
        self.plant_time[k] = plant_time
        self.cycles = k + 1

    @property
    def counted(self) -> int:
        """How many cycles count: those that began before the protection took the tool away."""
        end = self.cycles
        return end if self.trip is None else end - int(self.tripped[:end].sum()) + 1

    def status_counts(self) -> dict[str, int]:
        """How many cycles ended with each status, those that occurred."""
        counts = np.bincount(self.status[: self.cycles], minlength=len(_STATUSES))
        return {str(s): int(c) for s, c in zip(_STATUSES, counts, strict=True) if c}

    def source_counts(self) -> dict[str, int]:
        """How many cycles took their command from each source, those that did not occur too."""
        counts = np.bincount(self.source[: self.cycles], minlength=len(_SOURCES))
        return {str(s): int(c) for s, c in zip(_SOURCES, counts, strict=True)}

    def table(self) -> pa.Table:
        """Return the rows so far; every column's metadata has its unit.

        That of ``trip``, what the protection had tripped on by the end of the row's cycle, has the
        ``time`` [s] too.
        """
        end = self.cycles
        columns: list[tuple[str, str, pa.Array]] = []

        def add(
            name: str, unit: str, values: NDArray[np.generic], tags: Sequence[str] = ()
        ) -> None:
            if tags:
                for j, tag in enumerate(tags):
                    columns.append((f"{name}_{tag}", unit, pa.array(values[:end, j])))
            else:
                columns.append((name, unit, pa.array(values[:end])))

        joints = tuple(str(j + 1) for j in range(self.torque.shape[1]))
        add("time", "s", self.time)
        add("setpoint", "N", self.setpoint, self.axes)
        add("force", "N", self.force, _AXES)
        add("force_peak", "N", self.force_peak)
        add("force_measured", "N", self.force_measured, _AXES)
        add("force_uncompensated", "N", self.force_uncompensated, _AXES)
        add("force_predicted", "N", self.force_predicted, self.axes)
        add("tissue", "m", self.tissue, _AXES)
        add("tool", "m", self.tool, _AXES)
        add("tool_velocity", "m/s", self.tool_velocity, _AXES)
        add("command", "m/s^2", self.command, self.axes)
        add("torque", "N m", self.torque, joints)
        add("joint_velocity", "rad/s", self.joint_velocity, joints)
        # For pictures: half a microradian, which four bytes give, is finer than any pixel.
        add("heart_joint_angle", "rad", self.joint_angle[:, :6], "123456")
        add("joint_angle", "rad", self.joint_angle[:, 6:], joints)
        add("touching", "1", self.touching)
        add("torque_saturated", "1", self.torque_saturated)
        add("command_saturated", "1", self.command_saturated)
        for i, name in enumerate(self.bounds):
            add(f"slack_{name}", _UNITS.get(name, "1"), self.slack[:, i])
        add("residual", "1", self.residual)
        add("iterations", "1", self.iterations)
        for name, names, chosen in (
            ("status", _STATUSES, self.status),
            ("source", _SOURCES, self.source),
            ("contact", _CONTACTS, self.contact),
            ("setpoint_source", _SETPOINT_SOURCES, self.setpoint_source),
            ("trip", _TRIPS, self.tripped * _TRIPS.index(self.trip.cause if self.trip else "none")),
        ):
            labels = pa.array([str(s) for s in names])
            codes = pa.array(chosen[:end].astype(np.int8))
            columns.append((name, "1", pa.DictionaryArray.from_arrays(codes, labels)))
        add("build_time", "s", self.build_time)
        add("solve_time", "s", self.solve_time)
        add("cycle_time", "s", self.cycle_time)
        add("plant_time", "s", self.plant_time)
        more = {"trip": {"time": f"{self.trip.time:.9g}"}} if self.trip else {}
        schema = pa.schema(
            [
                pa.field(name, data.type, metadata={"unit": unit} | more.get(name, {}))
                for name, unit, data in columns
            ]
        )
        return pa.table([data for _, _, data in columns], schema=schema)

    def write(self, path: Path) -> None:
        """Write the rows so far as Parquet."""
        pq.write_table(self.table(), path, compression="zstd")


_UNITS = {
    "force": "N",
    "tangential": "N",
    "velocity": "m/s",
    "joint_speed": "rad/s",
    "joint_torque": "N m",
    "command": "m/s^2",
    "rate": "m/s^2",
}
