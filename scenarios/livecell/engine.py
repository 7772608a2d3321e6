"""A running experiment: one period after the other, and commands between them."""

from collections.abc import Callable
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from time import perf_counter

import numpy as np

from plant.cell import Cell, heart_programme
from plant.errors import UnstableSimulationError
from plant.interface import Measurement, Truth
from plant.own_arm import tool_arm
from qpmpc.config import PerAxis
from qpmpc.fallback import Source
from qpmpc.kinds import controller_kind
from qpmpc.protocol import ForceControl
from qpmpc.status import Status
from qpmpc.step import Step
from scenarios.approach import ContactState, Recovery, recovery
from scenarios.config import Scenario
from scenarios.consistency import band
from scenarios.cycle import ControlCycle
from scenarios.experiment import told_beats
from scenarios.livecell.commands import Act, Command, Event, Kind, Set
from scenarios.livecell.endless import BEAT_WITHIN, EarlyBeat, early_beat, endless
from scenarios.livecell.handover import Handover
from scenarios.livecell.recording import LONGEST, Recording
from scenarios.livecell.ring import COLUMNS, Ring
from scenarios.livecell.wish import RunningWish
from scenarios.livecell.workshop import Changed, Refusal, Workshop, another_controller, changed
from scenarios.motion import load_motion
from scenarios.motion.config import AXES
from scenarios.physics import physics_loop
from scenarios.schedule import Schedule
from scenarios.setpoint import Setpoint

DROPOUT, SOLVER_FAILURE = 0.02, 0.1
"""How long the sensor says nothing, and the solver has no answer [s]."""
_STIFFENING = 0.005
"""Largest relative change of the tissue's stiffness in a cycle [-]."""
_STATUS = {status: float(i) for i, status in enumerate(Status)}
_SOURCE = {source: float(i) for i, source in enumerate(Source)}


def as_live(scenario: Scenario) -> Scenario:
    """Return the scenario as it runs live: from its first setpoint and its first bounds on."""
    setpoint, bounds = scenario.setpoint, scenario.controller.bounds
    if setpoint.file is not None:
        laid = Setpoint(setpoint, scenario.axes, 1, 1, scenario.cell.period)
        start = dict(zip(AXES, laid.start.tolist(), strict=True))
        setpoint = replace(setpoint, file=None, **start)
    force = PerAxis(**{axis: band(bounds.force, axis) for axis in AXES})
    return replace(
        scenario,
        setpoint=replace(setpoint, steps=(), live=None),
        bounds_steps=(),
        controller=replace(scenario.controller, bounds=replace(bounds, force=force)),
    )


class Engine:
    """The cell, its controllers, and what is shown of them."""

    def __init__(
        self, scenario: Scenario, ring: Ring, out: Path, *, workshop: Workshop | None = None
    ) -> None:
        """Put it together, at rest at the start of the motion.

        Args:
            scenario: its duration is that of the motion, which then goes over into its beginning.
            ring: what each cycle is written into.
            out: where folders of recordings are made.
            workshop: what makes things beside the loop.

        Raises:
            ScenarioError, QpmpcError, PlantError: what the scenario asks for cannot be had.
        """
        self.scenario = scenario = as_live(scenario)
        """As it is in force, or coming into force."""
        self.period = scenario.cell.period
        self._ring, self._out = ring, out
        self._workshop = workshop or Workshop()
        controller_kind(scenario.controller.kind)
        motion = load_motion(scenario.motion, scenario.duration, self.period, scenario.seed)
        self._motion = endless(motion)
        self._tool = tool_arm(scenario.cell)
        self._programme = heart_programme(scenario.cell, self._motion)
        self._library = physics_loop(self._tool.joints).binary
        self._wanted = scenario
        self._latest: dict[str, Set] = {}
        self._events: list[Event] = []
        self._recording: Recording | None = None
        self.paused = False
        self._steps_asked = self._k = self._fails_until = 0
        self._begin()

    @property
    def resting(self) -> bool:
        """Whether no cycle is to be run now."""
        return self.paused and not self._steps_asked

    @property
    def command(self) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        """What was applied last, ``(3,)`` [m/s^2]."""
        return self._handover.command

    @property
    def under_way(self) -> bool:
        """Whether a controller is coming into force."""
        return self._handover.under_way

    def take(self, command: Command) -> None:
        """Take a command; what comes of it is told by `events`."""
        if isinstance(command, Set):
            self._set(command)
        else:
            self._acts[command]()

    def events(self) -> list[Event]:
        """Return what has happened since this was asked last."""
        told, self._events = self._events, []
        return told

    def close(self) -> None:
        """Finish: what is being recorded is written."""
        if self._recording is not None:
            self._keep()
        self._workshop.close()
        self._take_in()

    def idle(self) -> None:
        """Do what is to be done between cycles; to be called where none is run, too."""
        self._take_in()
        self._ring.tell(paused=self.paused, recording=self._recording is not None)

    def cycle(self, late: float = 0.0) -> None:
        """Run one period; ``late``: by how much it was released too late [s]."""
        self.idle()
        self._steps_asked = max(0, self._steps_asked - 1)
        k, cell, handover = self._k, self._cell, self._handover
        row = k % len(self._motion.time)
        self._beats()
        self._wish.advance()
        self._approach_stiffness()
        failing = k < self._fails_until
        begin = perf_counter()
        try:
            measurement = cell.measure()
            measured = perf_counter()
            step = handover.decide(row, measurement, 0.0 if failing else None)
            decided = perf_counter()
            cell.apply(handover.command)
        except UnstableSimulationError as error:
            self._stop(str(error))
            return
        applied = perf_counter()
        if handover.prepare():
            self._note(f"{self._name()} in force")
        end = perf_counter()
        known = np.isfinite(measurement.force[self._index])
        self._force[known] = measurement.force[self._index][known]
        self._show(
            measurement, cell.truth(), step, late,
            (decided - measured + end - applied, measured - begin + applied - decided),
        )  # fmt: skip
        self._k = k + 1

    def _begin(self) -> None:
        """Start anew, as the scenario is now."""
        scenario = self.scenario
        setpoint = scenario.setpoint
        start = np.array([setpoint.x, setpoint.y, setpoint.z])
        self._cell = Cell(
            scenario.cell, self._motion, force=start, seed=scenario.seed, axes=scenario.axes,
            heart=self._programme, library=self._library, tool=self._tool,
            contraction=self._motion.contraction, repeats=True,
        )  # fmt: skip
        self._stiffness = self._wished_stiffness = scenario.cell.contact.stiffness
        self._made_stiffness = self._stiffness
        self._joints = self._cell.joint_space(np.zeros(3), np.zeros(3))
        self._index = np.array([AXES.index(axis) for axis in scenario.axes])
        self._wish = RunningWish(setpoint, scenario.axes, scenario.controller.horizon, self.period)
        self._told = told_beats(self._motion, len(self._motion.time))
        self._early: EarlyBeat | None = None
        cycle, looking_after = self._cycle_of(scenario, another_controller(scenario, self._joints))
        self._force = start[self._index] * (scenario.cell.contact.gap == 0)
        cycle.controller.reset(self._force)
        cycle.recovery = looking_after
        self._handover = Handover(cycle, self.period)
        self._k, self._fails_until = 0, 0
        self._tripped = False
        self._ring.tell(time=0.0, tripped=False)

    def _cycle_of(
        self, scenario: Scenario, controller: ForceControl
    ) -> tuple[ControlCycle, Recovery | None]:
        schedule = Schedule(scenario)
        self._low, self._high = schedule.first_command
        cycle = ControlCycle(self._cell, controller, self._wish, schedule, beats=self._told)
        return cycle, recovery(scenario, schedule)

    # ---- commands

    @property
    def _acts(self) -> dict[Act, Callable[[], None]]:
        return {
            Act.EARLY_BEAT: self._order_beat,
            Act.DROPOUT: self._drop_out,
            Act.SOLVER_FAILURE: self._fail_solver,
            Act.PAUSE: lambda: self._pause(True),
            Act.RESUME: lambda: self._pause(False),
            Act.STEP: self._step,
            Act.RESET: self._reset,
            Act.RECORD: self._record,
            Act.KEEP: self._keep,
        }

    def _set(self, asked: Set) -> None:
        before, joints = self._wanted, self._joints
        self._latest[asked.key] = asked

        def make() -> Changed | None:
            if self._latest[asked.key] is not asked:
                return None  # a slider has moved on meanwhile
            scenario = changed(self._wanted, asked)
            other = scenario.controller != before.controller or scenario.backend != before.backend
            made = another_controller(scenario, joints) if other else None
            self._wanted = scenario
            return Changed(scenario, made)

        self._workshop.order(make)

    def _order_beat(self) -> None:
        if self._early is not None:
            self._tell(Kind.REFUSED, "an early beat is under way")
            return
        cell, motion, programme, now = self.scenario.cell, self._motion, self._programme, self._k
        self._workshop.order(lambda: early_beat(cell, motion, programme, now))

    def _drop_out(self) -> None:
        self._cell.silence(round(DROPOUT / self.period))
        self._note(f"force sensor silent for {DROPOUT * 1e3:g} ms")

    def _fail_solver(self) -> None:
        self._fails_until = self._k + round(SOLVER_FAILURE / self.period)
        self._note(f"no answer in time for {SOLVER_FAILURE * 1e3:g} ms")

    def _pause(self, paused: bool) -> None:
        self.paused, self._steps_asked = paused, 0

    def _step(self) -> None:
        if self.paused:
            self._steps_asked += 1
        else:
            self._tell(Kind.REFUSED, "a single step needs a pause first")

    def _reset(self) -> None:
        if self._recording is not None:
            self._keep()
        self._begin()
        self._note("started anew")

    def _record(self) -> None:
        if self._recording is not None:
            self._tell(Kind.REFUSED, "recording already")
            return
        present = dict(zip(self.scenario.axes, self._wish.present.tolist(), strict=True))
        scenario = replace(self.scenario, setpoint=replace(self.scenario.setpoint, **present))
        about = self._handover.cycle.controller.about()
        self._recording = Recording(scenario, self._cell.joints, about.compilation)
        self._tell(Kind.TOLD, f"recording, {LONGEST:g} s at most")

    def _keep(self) -> None:
        recording, self._recording = self._recording, None
        if recording is None or not recording.log.cycles:
            self._tell(Kind.REFUSED, "nothing was recorded")
            return
        folder = self._out / f"{recording.scenario.name}-live-{datetime.now():%Y%m%d-%H%M%S-%f}"
        self._workshop.order(lambda: recording.write(folder))

    # ---- what comes out of the workshop

    def _take_in(self) -> None:
        if self._handover.under_way:
            return  # one after the other
        made = self._workshop.collect()
        if made is None:
            return
        if isinstance(made, Refusal):
            self._tell(Kind.REFUSED, made.reason)
        elif isinstance(made, Path):
            self._tell(Kind.TOLD, f"recorded in {made}")
        elif isinstance(made, EarlyBeat):
            self._play(made)
        elif isinstance(made, Changed):
            self._change(made)

    def _change(self, made: Changed) -> None:
        before, scenario = self.scenario, made.scenario
        self.scenario = scenario
        if scenario.setpoint != before.setpoint:
            self._wish.aim(scenario.setpoint)
            wished = ", ".join(f"{value:g}" for value in self._wish.target)
            self._note(f"setpoint {wished} N")
        stiffness = scenario.cell.contact.stiffness
        if stiffness != before.cell.contact.stiffness:
            self._wished_stiffness = stiffness
            self._note(f"tissue {stiffness:g} N/m")
        if made.controller is not None:
            coming, looking_after = self._cycle_of(scenario, made.controller)
            self._handover.begin(coming, self._force, looking_after)
            self._note(f"{self._name()} comes")

    def _play(self, beat: EarlyBeat) -> None:
        if not self._k < beat.begin < self._k + round(BEAT_WITHIN / self.period):
            self._tell(Kind.REFUSED, "the early beat was not ready in time")
            return
        self._early = beat
        self._cell.follow(beat.programme)
        self._told[beat.peak % len(self._told)] = True
        self._note(f"early beat at {beat.peak * self.period:.2f} s")

    def _beats(self) -> None:
        """Leave an early beat behind when it is over."""
        beat = self._early
        if beat is not None and self._k >= beat.end:
            self._early = None
            self._told[beat.peak % len(self._told)] = False
            self._cell.follow(self._programme)

    def _approach_stiffness(self) -> None:
        if self._stiffness == self._wished_stiffness:
            return
        ratio = self._wished_stiffness / self._stiffness
        most = 1.0 + _STIFFENING
        if 1.0 / most <= ratio <= most:
            self._stiffness = self._wished_stiffness
        else:
            self._stiffness *= min(max(ratio, 1.0 / most), most)
        self._cell.stiffen(self._stiffness / self._made_stiffness)

    # ---- what is shown

    def _show(
        self,
        measurement: Measurement,
        truth: Truth,
        step: Step,
        late: float,
        times: tuple[float, float],
    ) -> None:
        ring, handover, index = self._ring, self._handover, self._index
        looking_after = handover.cycle.recovery
        contact = looking_after.watch.state if looking_after else ContactState.PRESSING
        row = ring.next_row()
        row[COLUMNS["time"]] = measurement.time
        setpoint = row[COLUMNS["setpoint"]]
        setpoint[:] = np.nan
        setpoint[index] = self._wish.present
        row[COLUMNS["force"]], row[COLUMNS["measured"]] = truth.force, measurement.force
        row[COLUMNS["command"]] = handover.command
        row[COLUMNS["cycle_time"]], row[COLUMNS["solve_time"]] = times[0], step.times.solve
        row[COLUMNS["late"]] = late
        row[COLUMNS["status"]], row[COLUMNS["source"]] = _STATUS[step.status], _SOURCE[step.source]
        row[COLUMNS["contact"]], row[COLUMNS["share"]] = float(contact), handover.share
        ring.joint_angle[: truth.joint_angle.size] = truth.joint_angle
        ring.tell(
            time=measurement.time, touching=truth.touching, joints=truth.joint_angle.size,
            tripped=truth.trip is not None,
        )  # fmt: skip
        ring.seal()
        if truth.trip is not None and not self._tripped:
            self._tripped = True
            self._tell(Kind.FAILED, f"the protection tripped: {truth.trip.cause}; reset to go on")
        recording = self._recording
        if recording is not None:
            applied = handover.command[index]
            recording.record(
                measurement, truth, step,
                setpoint=self._wish.present.copy(), command=applied, contact=contact,
                saturated=bool(((applied <= self._low) | (applied >= self._high)).any()),
                cycle_time=times[0], plant_time=times[1],
            )  # fmt: skip
            if recording.full:
                self._keep()

    def _stop(self, why: str) -> None:
        self.paused, self._steps_asked = True, 0
        self._tell(Kind.FAILED, f"{why}; reset to go on")

    def _name(self) -> str:
        kind = controller_kind(self.scenario.controller.kind)
        return f"{kind.name} with {self.scenario.backend}" if kind.takes_backend else kind.name

    def _note(self, text: str) -> None:
        self._tell(Kind.TOLD, text)
        if self._recording is not None:
            self._recording.note(text)

    def _tell(self, kind: Kind, text: str) -> None:
        self._events.append(Event(kind, text, self._k * self.period))
