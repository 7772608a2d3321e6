"""What is timed: one backend on one path, driven through recorded cycles."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bench.latency.result import Way
from bench.realtime import Clock, Pacer
from bench.stream import Replay
from qpmpc import Step
from scenarios.loop import Stop

Array = NDArray[np.float64]
Nanoseconds = NDArray[np.int64]
STAGES = ("prepare", "update", "build", "solve", "step", "response", "lateness")


class Lane(Protocol):
    """One backend on one path."""

    backend: str
    path: Way
    tells: bool
    """Whether update, build and solve can be told apart."""
    replay: Replay

    @property
    def prepare(self) -> Callable[[], object]:
        """What needs no measurement, after a command."""
        ...

    @property
    def step(self) -> Callable[[Array, Array], object]:
        """From measurement and preview to what `stages` reads."""
        ...

    def begin(self, k: int) -> None:
        """Be where the recording was before cycle ``k``."""
        ...

    def follow(self, k: int) -> None:
        """Take the recorded command of cycle ``k`` for the one applied."""
        ...

    def stages(self, answer: object) -> tuple[float, float, float]:
        """Return the times of update, build and solve within a step [s], where it `tells` them."""
        ...

    def ask(self, measurement: Array, preview: Array) -> Step:
        """Decide as `step` does, and tell everything; not timed."""
        ...


class Interpreted:
    """The controller as everybody calls it: `Controller.step`."""

    path: Way = "interpreted"
    tells = True

    def __init__(self, backend: str, replay: Replay) -> None:
        """Take the controller of a replay."""
        self.backend, self.replay = backend, replay
        self._general = replay.controller.general
        self.prepare: Callable[[], object] = self._general.prepare
        self.step: Callable[[Array, Array], object] = self._general.step

    def begin(self, k: int) -> None:
        """Be where the recording was before cycle ``k``."""
        self.replay.begin(k)

    def follow(self, k: int) -> None:
        """Take the recorded command of cycle ``k`` for the one applied."""
        self._general.command[:] = self.replay.previous[k + 1]

    def stages(self, answer: object) -> tuple[float, float, float]:
        """Return what the step itself tells."""
        assert isinstance(answer, Step)
        return answer.times.update, answer.times.build, answer.times.solve

    def ask(self, measurement: Array, preview: Array) -> Step:
        """Decide as `step` does."""
        return self._general.step(measurement, preview)


class CompiledCall(Interpreted):
    """The one call of generated C, of a controller that has one; a step's record is not made."""

    path: Way = "compiled"
    tells = False

    def __init__(self, backend: str, replay: Replay) -> None:
        """Take the compiled step of a replay's controller."""
        super().__init__(backend, replay)
        compiled = self._general.compiled
        assert compiled is not None, "the replay was to be compiled"
        self.prepare, self.step = compiled.prepare, compiled.step


class Times:
    """Times of all passes, allocated ahead: ``(passes, instances)`` a stage [ns]."""

    def __init__(self, passes: int, instances: int) -> None:
        self.of: dict[str, Nanoseconds] = {
            stage: np.zeros((passes, instances), dtype=np.int64) for stage in STAGES
        }


def drive(
    lane: Lane,
    start: int,
    end: int,
    *,
    clock: Clock,
    pacer: Pacer | None = None,
    into: tuple[Times, int] | None = None,
    stop: Stop,
) -> bool:
    """Send a lane through cycles ``start`` ... ``end`` - 1; return whether it got to the end.

    Args:
        lane: see there.
        start, end: cycles of the recording.
        clock: read around each stage.
        pacer: releases each cycle at its time; none: one cycle after the other.
        into: where times go, and in which row; nowhere if not given.
        stop: asked in every cycle, outside the clock.
    """
    replay, now = lane.replay, clock.now
    prepare, step, follow = lane.prepare, lane.step, lane.follow
    stages = lane.stages if lane.tells else None
    measurements, previews = replay.measurements, replay.previews
    change = replay.change if replay.changes else None
    rows = None if into is None else [into[0].of[stage][into[1]] for stage in STAGES]
    lane.begin(start)
    if pacer is not None:
        pacer.start()
    release = 0
    for i, k in enumerate(range(start, end)):
        if stop():
            return False
        measurement, preview = measurements[k], previews[k]
        if pacer is not None:
            release, _ = pacer.wait()
        began = changed = now()
        if change is not None:
            change(k)
            changed = now()
        answer: object = step(measurement, preview)
        decided = now()
        follow(k)
        applied = now()
        prepare()
        prepared = now()
        if rows is not None:
            prepare_, update, build, solve, step_, response, lateness = rows
            prepare_[i], step_[i] = prepared - applied, decided - began
            if stages is not None:
                updated, built, solved = stages(answer)
                update[i] = round(1e9 * updated) + changed - began
                build[i], solve[i] = round(1e9 * built), round(1e9 * solved)
            if pacer is not None:
                response[i], lateness[i] = decided - release, began - release
        answer = None  # what it held is given back here, not within the next step
    return True
