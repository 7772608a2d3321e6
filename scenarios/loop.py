"""The loop that joins controller and plant, once per cycle."""

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from plant.interface import JointPlant, Plant
from qpmpc.protocol import ForceControl
from qpmpc.step import Step
from scenarios.approach import ContactState, Recovery
from scenarios.cycle import ControlCycle
from scenarios.live import LiveSetpoint
from scenarios.log import Log
from scenarios.schedule import Schedule
from scenarios.setpoint import Setpoint

Array = NDArray[np.float64]
Progress = Callable[[int, int], None]
"""Called now and then with cycles done and cycles in all."""
Watch = Callable[[Step], None]
"""Shown the step of every cycle, while the controller's problem still holds its vectors."""
Stop = Callable[[], bool]
"""Asked once per cycle whether to stop before the end."""
Pace = Callable[[], object]
"""Called at the start of each cycle: returns when its time has come."""

_EVERY = 250
"""Cycles between reports of progress."""


def control_loop(
    plant: Plant | JointPlant,
    controller: ForceControl,
    setpoint: Setpoint | LiveSetpoint,
    log: Log,
    cycles: int,
    *,
    schedule: Schedule,
    recovery: Recovery | None = None,
    beats: NDArray[np.bool_] | None = None,
    watch: Watch | None = None,
    pace: Pace | None = None,
    progress: Progress,
    stop: Stop,
) -> bool:
    """Run ``cycles`` cycles or until ``stop``; return whether the end was reached.

    Args:
        plant: the cell, or anything with its small interface.
        controller: sees measurements only.
        setpoint, log: see there.
        cycles: how many at most.
        schedule: of the bounds; a command on its bound counts as saturated.
        recovery: what looks after a contact that can be lost.
        beats: see `ControlCycle`.
        watch: shown every step, outside the clock.
        pace: see `Pace`; as fast as it goes if not given.
        progress, stop: see `Progress`, `Stop`.
    """
    cycle = ControlCycle(plant, controller, setpoint, schedule, recovery, beats=beats)
    low, high = (side.tolist() for side in schedule.first_command)
    with quiet_memory():
        for k in range(cycles):
            if stop():
                return False
            if pace is not None:
                pace()
            woken = perf_counter()
            measurement = plant.measure()
            begin = perf_counter()
            step = cycle.decide(k, measurement)
            decided = perf_counter()
            plant.apply(cycle.command)
            applied = perf_counter()
            controller.prepare()
            cycle_time = decided - begin + perf_counter() - applied
            applied_command = cycle.applied
            u = applied_command.tolist()
            saturated = any(
                value <= least or value >= most
                for value, least, most in zip(u, low, high, strict=True)
            )
            log.record(
                measurement,
                plant.truth(),
                step,
                setpoint=setpoint.force[k],
                command=applied_command,
                contact=recovery.watch.state if recovery else ContactState.PRESSING,
                saturated=saturated,
                cycle_time=cycle_time,
                plant_time=begin - woken + applied - decided,
            )
            if watch is not None:
                watch(step)
            if k % _EVERY == 0:
                progress(k, cycles)
    progress(cycles, cycles)
    return True


def watch_loop(plant: Plant, force: Array, cycles: int, *, progress: Progress, stop: Stop) -> bool:
    """Run without control and write the true force of each cycle into ``force (cycles, 3)``."""
    command = np.zeros(3)
    with quiet_memory():
        for k in range(cycles):
            if stop():
                return False
            plant.measure()
            force[k] = plant.truth().force
            plant.apply(command)
            if k % _EVERY == 0:
                progress(k, cycles)
    progress(cycles, cycles)
    return True


@contextmanager
def quiet_memory() -> Iterator[None]:
    """Keep the garbage collector out of the loop: with a large heap it costs a tenth of a cycle."""
    enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        gc.unfreeze()
        if enabled:
            gc.enable()
