"""What a million compiled steps do to the process's memory: nothing, as is to be shown."""

from __future__ import annotations

import resource
import tracemalloc
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from bench.stream import Replay, Stream
from qpmpc.native import CompiledStepError
from qpmpc.native.compiled import CompiledStep

_SETTLING = 5_000
"""Cycles before the first look, in which everything is made that will be kept."""
_LOOKS = 10
"""Looks at the memory, evenly over the cycles."""


@dataclass(frozen=True)
class Steady:
    """Memory of the process while one controller goes on and on."""

    backend: str
    cycles: int
    """Compiled steps, each with its `prepare`."""
    interpreted_cycles: int
    """How many of them were handed over to the interpreted path."""
    python_bytes: tuple[int, ...]
    """What Python's allocator holds at each look, the first before all cycles."""
    resident_bytes: tuple[int, ...]
    """What of the process is in memory at each look."""
    page_faults: int
    """Pages that had to be got from the system, from the first look to the last."""


def watch(stream: Stream, backend: str, cycles: int, *, stop: Callable[[], bool]) -> Steady | None:
    """Let a controller meet a stream again and again and look at the memory.

    Args:
        stream: what was recorded.
        backend: which solver.
        cycles: in all.
        stop: asked now and then whether to stop before the end.

    Returns:
        None where ``stop`` asked for the end.

    Raises:
        CompiledStepError: the controller has no compiled step, or bounds that move.
    """
    replay = Replay(stream, stream.scenario.controller.horizon, backend, compiled="on")
    general = replay.controller.general
    if general.compiled is None:
        raise CompiledStepError(general.compilation.reason or "none was made")
    if replay.changes:
        raise CompiledStepError("bounds of the scenario move, which costs memory outside the step")
    tracemalloc.start()
    for _ in range(2):  # what looking itself keeps is there from the second time on
        _go_on(general.compiled, replay, _SETTLING)
        tracemalloc.get_traced_memory()
        _resident()
    handed = general.compilation.interpreted_cycles
    python, resident = [tracemalloc.get_traced_memory()[0]], [_resident()]
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for i in range(_LOOKS):
        if stop():
            tracemalloc.stop()
            return None
        _go_on(general.compiled, replay, cycles * (i + 1) // _LOOKS - cycles * i // _LOOKS)
        python.append(tracemalloc.get_traced_memory()[0])
        resident.append(_resident())
    faults = resource.getrusage(resource.RUSAGE_SELF).ru_minflt - faults
    tracemalloc.stop()
    return Steady(
        backend, cycles, general.compilation.interpreted_cycles - handed,
        tuple(python), tuple(resident), faults,
    )  # fmt: skip


def _go_on(compiled: CompiledStep, replay: Replay, cycles: int) -> None:
    length = len(replay.previews)
    for k in range(cycles):
        compiled.step(replay.measurements[k % length], replay.previews[k % length])
        compiled.prepare()


def _resident() -> int:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * resource.getpagesize()
