"""Whole control cycles against a deadline, in closed loop, backend beside backend and empty loop.

Cycle k is released at ``origin + k * period`` whatever came before. Its measurement is there by
then; what counts is the response, from that intended release until the command is handed over. Then
the controller gets ready for the next cycle, and the plant is simulated in what is left.

A plant that is simulated takes time of this process that a real one would not. Where it ends after
the next release, the releases to come are put off by what it took, ordinarily takes at the most, so
that the controller has what it would have beside a real one; this is counted and told. Whatever the
plant took beyond that is a disturbance like any other, and the next cycle begins late.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from bench.cycles import Cycles
from bench.machine import Facts, usage
from bench.realtime import NS, Clock, Pacer
from bench.subjects import Controlled, Empty, Still, Subject
from plant.errors import PlantError
from qpmpc.errors import BackendSetupError
from scenarios import Scenario, ScenarioError
from scenarios.approach import recovery
from scenarios.cycle import ControlCycle
from scenarios.experiment import (
    Assembly,
    Report,
    assemble,
    hold_still,
    make_controller,
    require_backend,
)
from scenarios.loop import Stop

BLOCK = 2000
"""Cycles that one subject runs before the next one does: disturbances hit all alike."""
WARM_UP = 500
"""Cycles of each subject that are run before any is counted."""
PAUSE = 100_000_000
"""Before each turn [ns]: who left the core no pause, and made others starve, must not be paid for
by who comes next (see `real_time_share` of `bench.machine`)."""
LEAD_IN = 20
"""Cycles at the start of each block that are not counted: another's data fill the caches."""


@dataclass(eq=False)
class Entry:
    """One row of the result: a subject, its cycles, and what disturbed them."""

    subject: Subject
    cycles: Cycles
    plant: int = 0
    """What the plant ordinarily takes [ns]: the median of the warm-up."""
    usage: Facts = field(default_factory=dict)
    """Page faults, switches and stolen time during its blocks, see `bench.machine.usage`."""
    stopped: str | None = None
    """Why it ended before its time: what failed."""


@dataclass(frozen=True)
class Refusal:
    """A backend that does not take the problem."""

    name: str
    reason: str


@dataclass(eq=False)
class Race:
    """Everything that takes turns in one run."""

    scenario: Scenario
    entries: list[Entry]
    refused: list[Refusal]
    deadline: float
    """From the intended release [s]."""
    cycles: int
    """That are to be counted, of each."""
    complete: bool = False


def cycles_in_all(cycles: int) -> int:
    """Return how many cycles a subject runs so that ``cycles`` are counted."""
    return WARM_UP + cycles + LEAD_IN * -(-cycles // BLOCK)


def enter(
    scenario: Scenario, backends: Sequence[str], cycles: int, deadline: float, report: Report
) -> Race:
    """Make the subjects: the empty loop, the plant alone, and a controller for each backend.

    Each has a plant of its own; all see the same motion, noise, setpoint and bounds.

    Args:
        scenario: its duration is what the cycles need.
        backends: names.
        cycles: to be counted.
        deadline: of the response [s].
        report: told as things are made.

    Raises:
        ScenarioError, QpmpcError, PlantError: what is asked for cannot be had. A backend that
        refuses the problem is told in the result.
    """
    if scenario.setpoint.live is not None:
        raise ScenarioError("setpoint.live: what is sent cannot be shared by several runs at once")
    require_backend(scenario, "backends")
    period = scenario.cell.period
    total = cycles_in_all(cycles)
    scenario = replace(scenario, duration=total * period)
    sizes = cycles, round(period * NS), round(deadline * NS)
    race = Race(scenario, [Entry(Empty(), Cycles(*sizes))], [], deadline, cycles)
    made: Assembly | None = None
    for backend in backends:
        own = replace(scenario, backend=backend)
        try:
            if made is None:
                made = assemble(own, report)
                cell, controller = made.cell, made.controller
            else:
                cell = made.another_cell()
                controller = make_controller(own, cell, made.setpoint, made.schedule)
        except BackendSetupError as error:
            if len(backends) == 1:
                raise
            race.refused.append(Refusal(backend, str(error)))
            continue
        cycle = ControlCycle(
            cell,
            controller,
            made.setpoint,
            made.schedule,
            recovery(own, made.schedule),
            beats=made.beats,
        )
        subject = Controlled(backend, cell, cycle, made.setpoint.force, total)
        race.entries.append(Entry(subject, Cycles(*sizes)))
    if made is not None:
        still = made.another_cell()
        hold_still(still, made.setpoint)
        race.entries.insert(1, Entry(Still(still), Cycles(*sizes)))
    return race


def run(
    race: Race, clock: Clock, *, spin: float, report: Report, stop: Stop, ready: Callable[[], None]
) -> None:
    """Let the subjects take turns, block by block, until all cycles are counted.

    Nothing is printed or reported within a block.

    Args:
        race: of `enter`; its entries are filled.
        clock: paced by the wall, or with its waits left out.
        spin: how long before a release a sleep is to end [s].
        report: told after each block.
        stop: asked once per cycle whether to stop.
        ready: called once everything has warmed up, before the first block that counts.
    """
    pacer = Pacer(clock, race.entries[0].cycles.period, round(spin * NS))
    for entry in race.entries:
        first = Cycles(WARM_UP, entry.cycles.period, entry.cycles.deadline)
        if not _block(entry, first, pacer, stop, lead_in=0, count=WARM_UP):
            return
        entry.plant = int(np.median(first.plant)) if first.count else 0
    ready()
    turns = -(-race.cycles // BLOCK)
    for turn in range(turns):
        count = min(BLOCK, race.cycles - turn * BLOCK)
        # Who runs after whom changes, so that nobody always inherits the same caches.
        start = turn % len(race.entries)
        for entry in race.entries[start:] + race.entries[:start]:
            before = usage()
            whole = _block(entry, entry.cycles, pacer, stop, lead_in=LEAD_IN, count=count)
            _add(entry.usage, before)
            if not whole:
                return
        report("cycles", min((turn + 1) * BLOCK, race.cycles), race.cycles)
    race.complete = not race.refused and all(entry.stopped is None for entry in race.entries)


def _block(
    entry: Entry, cycles: Cycles, pacer: Pacer, stop: Stop, *, lead_in: int, count: int
) -> bool:
    """Run a block of an entry's cycles, the first ones uncounted; return whether to go on."""
    if entry.stopped is not None:
        return True
    subject, deadline, period = entry.subject, cycles.deadline, cycles.period
    behind, now = False, pacer.clock.now
    pacer.start(lead=PAUSE)
    try:
        for i in range(lead_in + count):
            if stop():
                return False
            release, late = pacer.wait()
            begin = release + late
            subject.respond((deadline - late) / NS)
            done = now()
            subject.settle()
            settled = now()
            subject.advance()
            ended = now()
            following = release + period
            put_off = min(ended - settled, entry.plant) if ended > following else 0
            pacer.put_off(put_off)
            if i >= lead_in:
                cycles.note(
                    late=late, timer=pacer.timer,
                    begin=begin, done=done, settled=settled, ended=ended,
                    solve=subject.solve, status=subject.status, source=subject.source,
                    behind=behind, put_off=put_off,
                )  # fmt: skip
            behind = ended - max(settled, following) > put_off
    except PlantError as error:
        entry.stopped = f"{error} (cycle {cycles.count})"
    return True


def _add(total: Facts, before: Facts) -> None:
    for name, value in usage().items():
        total[name] = total.get(name, 0) + value - before[name]
