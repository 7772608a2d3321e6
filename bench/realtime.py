"""Pacing by absolute deadlines, and what a process can ask Linux for to keep them.

Measures are asked for here and undone at the end; which of them are really in force is read from
the system by `bench.machine`, not believed.
"""

import ctypes
import os
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from scenarios.loop import quiet_memory

NS = 1_000_000_000
"""Nanoseconds in a second."""
_TIMER_ABSTIME = 1
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = 29, 30
_M_TRIM_THRESHOLD, _M_MMAP_MAX = -1, -4
_TRIM_DEFAULT, _MMAP_DEFAULT = 128 * 1024, 65536  # glibc's own
_TRIM_OFF = 2**31 - 1
_LATENCY_REQUEST = Path("/dev/cpu_dma_latency")
_DEFAULT_PRIORITY = 80
"""Above what an ordinary system runs, below the kernel's own threads that must go first (99)."""


# ---- the clock


class Clock(Protocol):
    """What a pacer reads and waits on [ns]; the origin is any."""

    def now(self) -> int:
        """Return the time."""
        ...

    def sleep_until(self, instant: int) -> None:
        """Return at ``instant`` or soon after; at once if it has passed."""
        ...


class SystemClock:
    """The monotonic clock, slept on by absolute time: ``clock_nanosleep(TIMER_ABSTIME)``."""

    now = staticmethod(time.monotonic_ns)

    def __init__(self) -> None:
        """Find the system call; where there is none, `time.sleep` stands in."""
        self._nanosleep = getattr(ctypes.CDLL(None), "clock_nanosleep", None)
        self._until = _Timespec()
        self._reference = ctypes.byref(self._until)
        self.sleeps_by = "time.sleep" if self._nanosleep is None else "clock_nanosleep, absolute"
        """What it waits with."""

    def sleep_until(self, instant: int) -> None:
        """Sleep until an instant of `now`; signals are handled on the way and sleep goes on."""
        if self._nanosleep is None:
            while (left := instant - self.now()) > 0:
                time.sleep(left / NS)
            return
        self._until.tv_sec, self._until.tv_nsec = divmod(instant, NS)
        while self.now() < instant:  # a signal ends the call early
            self._nanosleep(time.CLOCK_MONOTONIC, _TIMER_ABSTIME, self._reference, None)


class SkippingClock:
    """The monotonic clock with its waits left out: an instant waited for is there at once.

    What is computed takes its real time, what is waited costs none: a run as fast as it goes,
    measured against the same releases as a paced one.
    """

    sleeps_by = "waits are skipped"

    def __init__(self) -> None:
        self._skipped = 0

    def now(self) -> int:
        """Return the time, waits that were skipped included."""
        return time.monotonic_ns() + self._skipped

    def sleep_until(self, instant: int) -> None:
        """Be at ``instant``."""
        self._skipped += max(0, instant - self.now())


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


# ---- the pacer


class Pacer:
    """Releases cycle k at ``origin + k * period``, whatever became of the cycles before.

    A cycle that is over before its time waits; one that ran into the next release delays only
    itself, and what it delayed shows as lateness of that release. Nothing drifts, and nothing is
    left out: a stall of ten periods makes ten late releases.
    """

    def __init__(self, clock: Clock, period: int, spin: int) -> None:
        """Prepare.

        Args:
            clock: what to read and wait on.
            period: time between releases [ns].
            spin: how long before a release the sleep is to end; the rest is spent reading the
                clock, as a timer's wake-up is not exact [ns].
        """
        self.period, self.clock, self._spin = period, clock, spin
        self._next = clock.now()
        self.timer = 0
        """How much later than asked the last sleep ended [ns]; -1: there was no time to sleep."""

    def start(self, lead: int = 0) -> int:
        """Make the next release the first of a row, one period and ``lead`` [ns] from now.

        Returns:
            its instant [ns].
        """
        self._next = self.clock.now() + self.period + lead
        return self._next

    def put_off(self, by: int) -> None:
        """Let all releases to come be later by ``by`` [ns]; whoever does this has to tell it."""
        self._next += by

    def wait(self) -> tuple[int, int]:
        """Wait for the next release; return its intended instant and how late it is now [ns]."""
        clock, release = self.clock, self._next
        self._next = release + self.period
        asleep_until = release - self._spin
        now = clock.now()
        if now < asleep_until:
            clock.sleep_until(asleep_until)
            now = clock.now()
            self.timer = now - asleep_until
        else:
            self.timer = -1
        while now < release:
            now = clock.now()
        return release, now - release


# ---- what is asked of the system


@dataclass(frozen=True)
class Measures:
    """What to ask for; each that is refused is told, and the run goes on without it."""

    cpu: int | None = None
    """Core to stay on; the last one that is allowed if not given (interrupts prefer the first)."""
    priority: int = _DEFAULT_PRIORITY
    """Under SCHED_FIFO, 1 ... 99; 0: the scheduler is left alone."""
    heap: int = 64 * 2**20
    """Memory that is taken from the system ahead and kept [bytes]. The stack is touched by the
    cycles that a run leaves uncounted at its start."""


Reasons = dict[str, str]
"""Why a measure could not be had, by its name in `bench.machine.measures`."""
Undo = Callable[[], None]


@contextmanager
def real_time(asked: Measures) -> Iterator[Reasons]:
    """Ask for what keeps a loop's deadlines, one measure after the other; undo all at the end.

    One core (`sched_setaffinity`), SCHED_FIFO, memory locked and touched ahead, no garbage
    collection, timers without slack, a processor that does not sleep deeply.

    Yields:
        the measures that were refused, with the reason.
    """
    steps: tuple[tuple[str, Callable[[], Undo]], ...] = (
        ("affinity", lambda: _stay_on_core(asked.cpu)),
        ("memory_locked", lambda: _lock_memory(asked.heap)),
        ("garbage_collection", _stop_collecting),
        ("timer_slack", _sharpen_timers),
        ("idle_latency", _stay_awake),
        # Last: what comes before runs as an ordinary process.
        ("scheduler", lambda: _schedule(asked.priority)),
    )
    refused: Reasons = {}
    with ExitStack() as undo:
        for name, take in steps:
            try:
                undo.callback(take())
            except OSError as error:
                refused[name] = error.strerror or str(error)
        yield refused


def _stay_on_core(cpu: int | None) -> Undo:
    before = os.sched_getaffinity(0)
    chosen = max(before) if cpu is None else cpu
    if chosen not in before:
        raise OSError(0, f"core {chosen} is not among the allowed ones, {sorted(before)}")
    os.sched_setaffinity(0, {chosen})
    return lambda: os.sched_setaffinity(0, before)


def _schedule(priority: int) -> Undo:
    if not priority:
        raise OSError(0, "not asked for")
    policy, before = os.sched_getscheduler(0), os.sched_getparam(0)
    # Threads and processes that are started later do not inherit it.
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    return lambda: os.sched_setscheduler(0, policy, before)


def _lock_memory(heap: int) -> Undo:
    libc = _libc()
    # Freed memory stays with the process, so that what is touched here is what is used later.
    keeps = hasattr(libc, "mallopt")
    if keeps:
        libc.mallopt(_M_MMAP_MAX, 0)
        libc.mallopt(_M_TRIM_THRESHOLD, _TRIM_OFF)

    def undo() -> None:
        libc.munlockall()
        if keeps:
            libc.mallopt(_M_MMAP_MAX, _MMAP_DEFAULT)
            libc.mallopt(_M_TRIM_THRESHOLD, _TRIM_DEFAULT)

    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE):
        code = ctypes.get_errno()
        undo()
        raise OSError(code, os.strerror(code))
    _touch(libc, heap)
    return undo


def _touch(libc: ctypes.CDLL, size: int) -> None:
    libc.malloc.restype = ctypes.c_void_p
    libc.free.argtypes = [ctypes.c_void_p]
    block = libc.malloc(ctypes.c_size_t(size))
    if block:
        ctypes.memset(block, 0, size)
        libc.free(block)


def _stop_collecting() -> Undo:
    quiet = ExitStack()
    quiet.enter_context(quiet_memory())
    return quiet.close


def _sharpen_timers() -> Undo:
    libc = _libc()
    if not hasattr(libc, "prctl"):
        raise OSError(0, "this system has no prctl")
    before = libc.prctl(_PR_GET_TIMERSLACK, 0, 0, 0, 0)
    if libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0):
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))

    def undo() -> None:
        libc.prctl(_PR_SET_TIMERSLACK, ctypes.c_ulong(before), 0, 0, 0)

    return undo


def _stay_awake() -> Undo:
    """Ask that no processor goes into an idle state it takes time to come back from."""
    request = os.open(_LATENCY_REQUEST, os.O_WRONLY)  # holds as long as the file is open
    try:
        os.write(request, struct.pack("i", 0))
    except OSError:
        os.close(request)
        raise
    return lambda: os.close(request)


def _libc() -> ctypes.CDLL:
    return ctypes.CDLL(None, use_errno=True)
