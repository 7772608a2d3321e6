"""What is made beside a running experiment: checked scenarios, controllers, beats, folders."""

import threading
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from queue import Empty, SimpleQueue

from plant.errors import PlantError
from qpmpc.backends import backend_class
from qpmpc.errors import QpmpcError
from qpmpc.joints import JointSpace
from qpmpc.kinds import controller_kind
from qpmpc.protocol import ForceControl
from scenarios.config import Scenario
from scenarios.errors import ScenarioError
from scenarios.livecell.commands import SETTABLE, Set
from scenarios.load import check_scenario, dump_scenario

Job = Callable[[], object]
"""Done in the workshop; what it returns comes out of it."""


@dataclass(frozen=True, eq=False)
class Changed:
    """A scenario with other keys, and the controller for it where it takes another."""

    scenario: Scenario
    controller: ForceControl | None


@dataclass(frozen=True)
class Refusal:
    """Why something could not be made."""

    reason: str


class Workshop:
    """Does one job after the other in a thread of its own."""

    def __init__(self, *, threaded: bool = True) -> None:
        """Open it; without a thread of its own a job is done where it is ordered."""
        self._jobs: SimpleQueue[Job | None] = SimpleQueue()
        self._done: SimpleQueue[object] = SimpleQueue()
        self._thread = threading.Thread(target=self._work, daemon=True) if threaded else None
        if self._thread is not None:
            self._thread.start()

    def order(self, job: Job) -> None:
        """Let a job be done; what goes wrong with it comes out as a `Refusal`."""
        if self._thread is None:
            self._do(job)
        else:
            self._jobs.put(job)

    def collect(self) -> object | None:
        """Return the next thing that is done, None if there is none."""
        try:
            return self._done.get_nowait()
        except Empty:
            return None

    def close(self) -> None:
        """Finish what was ordered."""
        if self._thread is not None:
            self._jobs.put(None)
            self._thread.join()
            self._thread = None

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            self._do(job)

    def _do(self, job: Job) -> None:
        try:
            self._done.put(job())
        except (ScenarioError, QpmpcError, PlantError, OSError) as error:
            self._done.put(Refusal(str(error)))


def changed(scenario: Scenario, asked: Set) -> Scenario:
    """Return the scenario with another value for a key.

    Raises:
        ScenarioError: the key may not change while it runs, or the value is none that it may have.
    """
    if asked.key not in SETTABLE:
        raise ScenarioError(f"{asked.key}: cannot be changed while the experiment runs")
    table = tomllib.loads(dump_scenario(scenario))
    *parts, last = asked.key.split(".")
    target = table
    for part in parts:
        target = target[part]
    target[last] = list(asked.value) if isinstance(asked.value, tuple) else asked.value
    return check_scenario(table, "live")


def another_controller(scenario: Scenario, joints: JointSpace) -> ForceControl:
    """Make the controller of a scenario; ``joints``: a typical view of them.

    Raises:
        QpmpcError: it cannot be had.
    """
    return controller_kind(scenario.controller.kind).make(
        scenario.controller,
        scenario.axes,
        scenario.cell.period,
        backend_class(scenario.backend),
        joints=joints,
    )
