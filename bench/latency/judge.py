"""Whether the answers are right: certified ones beside those of the lanes, outside the clock."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.instances import active_rows
from bench.latency.lanes import Lane
from bench.latency.result import Stream as StreamFacts
from bench.reference import Reference
from bench.stream import Replay, Stream
from qpmpc import Problem
from scenarios.loop import Stop

Array = NDArray[np.float64]


class Standard:
    """The certified answer of every cycle of a stream at one horizon."""

    def __init__(self, stream: Stream, horizon: int) -> None:
        """Set up; `certify` fills it."""
        self._stream, self._horizon = stream, horizon
        self.replay = Replay(stream, horizon, "analytic")
        problem = self.problem
        self.increments = np.full((stream.cycles, problem.model.n_inputs), np.nan)
        """First increment, ``(K, n_u)`` [m/s^2]; NaN where none is certified."""
        self.excess = np.zeros((stream.cycles, problem.qp.m))
        """What each row gives way, ``(K, m)``."""
        self.active = np.zeros((stream.cycles, problem.qp.m), dtype=np.bool_)
        """Which rows act, ``(K, m)``."""
        self._residuals = np.full(stream.cycles, np.nan)

    @property
    def problem(self) -> Problem:
        """It holds the vectors of the cycle that `replay` is in."""
        return self.replay.controller.general.problem

    def certify(self, stop: Stop) -> bool:
        """Solve every cycle; return whether it got to the end."""
        reference, problem = Reference(self.replay.controller), self.problem
        for k, _ in self.replay.steps(0, self._stream.cycles):
            if stop():
                return False
            solution = reference()
            if solution is not None:
                previous = self.replay.previous[k]
                self.increments[k] = problem.command(solution.x, previous) - previous
                self.excess[k] = solution.slack
                self.active[k] = active_rows(solution.y)
                self._residuals[k] = solution.residuals.scaled
        return True

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which cycles have a certified answer, ``(K,)``."""
        return np.asarray(np.isfinite(self._residuals), dtype=np.bool_)

    @property
    def acting(self) -> NDArray[np.bool_]:
        """In which cycles a row acts, ``(K,)``."""
        return np.asarray(self.active.any(axis=1), dtype=np.bool_)

    def share(self, window: slice) -> float | None:
        """Return the share of cycles in which a row acts, among those that are certified."""
        known = self.known[window]
        return float(self.acting[window][known].mean()) if known.any() else None

    def facts(self) -> StreamFacts:
        """Return what goes into the result."""
        known = self.known
        return StreamFacts(
            axes=self._stream.axes,
            horizon=self._horizon,
            cycles=self._stream.cycles,
            certified=int(known.sum()),
            residual=float(np.nanmax(self._residuals)) if known.any() else None,
            active_share=self.share(slice(None)),
            active={
                name: float(self.active[known][:, rows].any(axis=1).mean())
                for name, rows in self.problem.rows.items()
                if known.any()
            },
        )


@dataclass(frozen=True)
class Verdict:
    """What is to be said of a lane's answers."""

    error: float | None
    without_reference: int
    violation: dict[str, float]
    status: dict[str, int]
    source: dict[str, int]


def judge(lane: Lane, standard: Standard, start: int, end: int, stop: Stop) -> Verdict | None:
    """Compare the answers of a lane with the certified ones; None where it was stopped."""
    problem, replay = standard.problem, lane.replay
    worst, without = -1.0, 0
    beyond = dict.fromkeys(problem.rows, 0.0)
    status: Counter[str] = Counter()
    source: Counter[str] = Counter()
    lane.begin(start)
    for k, _ in standard.replay.steps(start, end):
        if stop():
            return None
        if replay.changes:
            replay.change(k)
        step = lane.ask(replay.measurements[k], replay.previews[k])
        decision = step.decision.reshape(-1)
        lane.follow(k)
        lane.prepare()
        status[str(step.status)] += 1
        source[str(step.source)] += 1
        if np.isnan(standard.increments[k]).any():
            without += 1
            continue
        previous = replay.previous[k]
        increment = problem.command(decision, previous) - previous
        worst = max(worst, float(np.abs(increment - standard.increments[k]).max()))
        rows = problem.A @ decision
        excess = np.maximum(np.maximum(rows - problem.u, problem.l - rows), 0.0)
        excess -= standard.excess[k]
        for name, where in problem.rows.items():
            beyond[name] = max(beyond[name], float(excess[where].max()))
    return Verdict(worst if worst >= 0 else None, without, beyond, dict(status), dict(source))
