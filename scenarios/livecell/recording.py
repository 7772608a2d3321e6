"""A stretch of a running experiment, written as a run is."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from plant.interface import Measurement, Truth
from qpmpc.controller import Compilation
from qpmpc.step import Step
from scenarios.approach import ContactEvent, ContactState
from scenarios.config import Scenario
from scenarios.experiment import Experiment
from scenarios.log import Array, Log
from scenarios.metrics import summarise
from scenarios.results import result_folder, write_run
from scenarios.schedule import Schedule

LONGEST = 120.0
"""Time after which a recording ends by itself [s]."""


class Recording:
    """Rows of a log, and what was changed meanwhile."""

    def __init__(self, scenario: Scenario, joints: int, compilation: Compilation) -> None:
        """Make room.

        Args:
            scenario: as it is now.
            joints: of the tool.
            compilation: of the controller.
        """
        self.scenario, self._compilation = scenario, compilation
        cycles = round(LONGEST / scenario.cell.period)
        # What a plan gave way is left out: other controllers have other bounds.
        self.log = Log(cycles, scenario.axes, (), joints)
        self.changes: list[dict[str, Any]] = []
        self._start: float | None = None
        self._room = cycles

    @property
    def full(self) -> bool:
        """Whether there is no more room."""
        return self.log.cycles >= self._room

    def note(self, what: str) -> None:
        """Remember that something was changed now."""
        self.changes.append({"time": self.log.cycles * self.scenario.cell.period, "what": what})

    def record(
        self,
        measurement: Measurement,
        truth: Truth,
        step: Step,
        *,
        setpoint: Array,
        command: Array,
        contact: ContactState,
        saturated: bool,
        cycle_time: float,
        plant_time: float,
    ) -> None:
        """Write the next row, see `Log.record`."""
        if self._start is None:
            self._start = measurement.time
        self.log.record(
            replace(measurement, time=measurement.time - self._start), truth, step,
            setpoint=setpoint, command=command, contact=contact, saturated=saturated,
            cycle_time=cycle_time, plant_time=plant_time,
        )  # fmt: skip

    def write(self, folder: Path) -> Path:
        """Write a run's folder, and ``live.json`` with the changes; return it.

        Raises:
            ScenarioError: it cannot be written.
        """
        log, scenario = self.log, self.scenario
        duration = log.cycles * scenario.cell.period
        scenario = replace(scenario, duration=duration)
        if scenario.cell.contact.unilateral:
            log.contact_events = _contact_events(log, scenario)
        experiment = Experiment(
            scenario, log, Schedule(scenario), None,
            {"setup": 0.0, "compensated": duration, "uncompensated": 0.0},
            compilation=self._compilation,
        )  # fmt: skip
        with result_folder(folder) as partial:
            write_run(experiment, summarise(experiment), partial)
            text = json.dumps({"changes": self.changes}, indent=2) + "\n"
            (partial / "live.json").write_text(text, encoding="utf-8")
        return folder


def _contact_events(log: Log, scenario: Scenario) -> list[ContactEvent]:
    """Find the times off the tissue in a log."""
    off = log.contact[: log.cycles] != ContactState.PRESSING
    edges = np.diff(off.astype(np.int8), prepend=0, append=0)
    events = []
    for lost, found in zip(np.flatnonzero(edges > 0), np.flatnonzero(edges < 0), strict=True):
        seen = np.flatnonzero(log.contact[lost:found] == ContactState.LOST)
        if not seen.size:
            continue
        meant = False
        if "z" in log.axes:
            wish = float(log.setpoint[lost + int(seen[0]), log.axes.index("z")])
            meant = -wish <= scenario.contact_found_above
        events.append(ContactEvent(int(lost), None if found == log.cycles else int(found), meant))
    return events
