"""What a measurement was made on, and which real-time measures were really in force.

Everything is read from the system at the time of the call; nothing is taken from what was asked.
"""

import ctypes
import gc
import os
import platform
import resource
import struct
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scenarios.metrics import versions

Facts = dict[str, Any]

_POLICIES = {
    getattr(os, name): name
    for name in ("SCHED_OTHER", "SCHED_BATCH", "SCHED_IDLE", "SCHED_FIFO", "SCHED_RR")
    if hasattr(os, name)
}
_PR_GET_TIMERSLACK = 30
_CPUS = Path("/sys/devices/system/cpu")
_RT_RUNTIME = Path("/proc/sys/kernel/sched_rt_runtime_us")
_RT_PERIOD = Path("/proc/sys/kernel/sched_rt_period_us")
NOT_ASKED = "not asked for"


def machine(reasons: Mapping[str, str] | None = None) -> Facts:
    """Return kernel, processor, versions, load, and the measures in force now.

    Args:
        reasons: why measures could not be had, by name, where they were asked for.
    """
    return {
        "system": platform.system(),
        "kernel": platform.release(),
        "kernel_version": platform.version(),
        "preemption": _preemption(),
        "architecture": platform.machine(),
        "cpu": _cpu_model(),
        "cores": os.cpu_count(),
        "hypervisor": _hypervisor(),
        "governor": _governor(),
        "isolated_cores": _line(_CPUS / "isolated"),
        "clock_source": _line(
            Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
        ),
        "clock": time.get_clock_info("monotonic").implementation,
        "clock_resolution_ns": round(time.get_clock_info("monotonic").resolution * 1e9),
        "real_time_share": _real_time_share(),
        "load_average": [round(value, 2) for value in os.getloadavg()],
        "threads": threading.active_count(),
        "threads_of_process": _threads(),
        "measures": measures(reasons),
        "versions": versions(),
    }


def measures(reasons: Mapping[str, str] | None = None) -> dict[str, Facts]:
    """Return each measure: whether it is in force, its value as the system tells, and why not.

    ``value`` is plain data; ``reason`` is None where the measure is in force.
    """
    told: dict[str, tuple[bool, Any]] = {
        "affinity": _affinity(),
        "scheduler": _scheduler(),
        "memory_locked": _locked(),
        "garbage_collection": _collection(),
        "timer_slack": _timer_slack(),
        "idle_latency": _idle_latency(),
    }
    reasons = reasons or {}
    return {
        name: {
            "in_force": in_force,
            "value": value,
            "reason": None if in_force else reasons.get(name, NOT_ASKED),
        }
        for name, (in_force, value) in told.items()
    }


def usage() -> Facts:
    """Return the calling thread's page faults and context switches so far, and stolen time [s].

    The difference of two is what disturbed a stretch of a run: a fault is memory that was not
    there, an involuntary switch is somebody else who had the core, stolen time is what a
    hypervisor gave to other machines, summed over all cores.
    """
    spent = resource.getrusage(getattr(resource, "RUSAGE_THREAD", resource.RUSAGE_SELF))
    return {
        "minor_faults": spent.ru_minflt,
        "major_faults": spent.ru_majflt,
        "voluntary_switches": spent.ru_nvcsw,
        "involuntary_switches": spent.ru_nivcsw,
        "stolen_s": _stolen(),
    }


# ---- measures, as the system tells them


def _affinity() -> tuple[bool, Any]:
    if not hasattr(os, "sched_getaffinity"):
        return False, None
    cores = sorted(os.sched_getaffinity(0))
    return len(cores) == 1, cores


def _scheduler() -> tuple[bool, Any]:
    if not hasattr(os, "sched_getscheduler"):
        return False, None
    policy = os.sched_getscheduler(0)
    # "Children do not inherit it" is a bit of the policy.
    name = _POLICIES.get(policy & ~getattr(os, "SCHED_RESET_ON_FORK", 0), str(policy))
    priority = os.sched_getparam(0).sched_priority
    return name in ("SCHED_FIFO", "SCHED_RR"), {"policy": name, "priority": priority}


def _locked() -> tuple[bool, Any]:
    sizes = _status_fields("VmLck", "VmRSS")
    locked, resident = sizes["VmLck"], sizes["VmRSS"]
    if locked is None or resident is None:
        return False, None
    # What is locked is resident; shared pages of the kernel's own count as resident only.
    return locked >= 0.9 * resident > 0, {"locked_kib": locked, "resident_kib": resident}


def _collection() -> tuple[bool, Any]:
    enabled, frozen = gc.isenabled(), gc.get_freeze_count()
    return not enabled and frozen > 0, {"enabled": enabled, "frozen_objects": frozen}


def _timer_slack() -> tuple[bool, Any]:
    libc = ctypes.CDLL(None)
    if not hasattr(libc, "prctl"):
        return False, None
    slack = libc.prctl(_PR_GET_TIMERSLACK, 0, 0, 0, 0)
    # Threads under a real-time policy have none; the kernel ignores the figure, or tells 0.
    return slack <= 1 or _scheduler()[0], {"slack_ns": slack}


def _idle_latency() -> tuple[bool, Any]:
    """Return the latency that processors may take to wake up, where the kernel tells it."""
    try:
        raw = Path("/dev/cpu_dma_latency").read_bytes()[:4]
        allowed = struct.unpack("i", raw)[0]
    except (OSError, struct.error):
        return False, None
    return allowed == 0, {"allowed_us": allowed}


# ---- facts


def _stolen() -> float:
    try:
        with Path("/proc/stat").open(encoding="utf-8") as stat:
            return int(stat.readline().split()[8]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0


def _preemption() -> str:
    version = platform.version()
    if _line(Path("/sys/kernel/realtime")) == "1":
        return "PREEMPT_RT"
    for word in ("PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT"):
        if word in version:
            return word
    return "none told"


def _cpu_model() -> str:
    return _cpu_info("model name") or platform.processor() or "not told"


def _hypervisor() -> bool | None:
    flags = _cpu_info("flags")
    return None if flags is None else "hypervisor" in flags.split()


def _governor() -> str:
    told = _line(_CPUS / "cpu0" / "cpufreq" / "scaling_governor")
    return told or "not told: the kernel has no cpufreq here"


def _real_time_share() -> float | None:
    """Return the share of a core that real-time threads may take before they are throttled."""
    runtime, period = _line(_RT_RUNTIME), _line(_RT_PERIOD)
    if not runtime or not period:
        return None
    return 1.0 if int(runtime) < 0 else int(runtime) / int(period)


def _threads() -> int | None:
    try:
        return len(list(Path("/proc/self/task").iterdir()))
    except OSError:
        return None


def _cpu_info(field: str) -> str | None:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    for line in text.splitlines():
        name, _, value = line.partition(":")
        if name.strip() == field:
            return value.strip()
    return None


def _status_fields(*names: str) -> dict[str, int | None]:
    """Return sizes [KiB] from the process's status, None where the system does not tell them."""
    found: dict[str, int | None] = dict.fromkeys(names)
    try:
        text = Path("/proc/self/status").read_text(encoding="utf-8")
    except OSError:
        return found
    for line in text.splitlines():
        name, _, value = line.partition(":")
        if name in found:
            found[name] = int(value.split()[0])
    return found


def _line(path: Path) -> str | None:
    try:
        return path.read_text(encoding="utf-8").strip()
    except OSError:
        return None
