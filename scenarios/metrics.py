"""Figures of merit of a run, and the paper's own beside them."""

import importlib.metadata
import platform
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from qpmpc.kinds import controller_kind
from scenarios.approach import touch_down_cap
from scenarios.config import Scenario
from scenarios.experiment import Experiment
from scenarios.log import Log
from scenarios.physics import physics_loop
from scenarios.schedule import BoundName, Schedule

Array = NDArray[np.float64]
Summary = dict[str, Any]

PAPER: Summary = {
    "source": "Dominici, Poignet, Cortesao, Dombre, Tempier, IROS 2009",
    "uncompensated": {
        "x": {"rms": 1.0, "peak_to_peak": 7.0},
        "y": {"rms": 1.6, "peak_to_peak": 10.0},
        "z": {"rms": 3.5, "peak_to_peak": 20.0},
    },
    "reduction": {
        "x": {"claimed": 50.0, "rms": 50.0},
        "y": {"claimed": 75.0, "rms": 75.0},
        "z": {"claimed": 95.0, "rms": 91.0},
    },
}
"""Figures printed in the paper: N, and % of the uncompensated force (reading 12)."""

_PACKAGES = (
    "pulsempc", "numpy", "scipy", "mujoco", "pin",
    "casadi", "clarabel", "daqp", "osqp", "piqp", "qpsolvers",
)  # fmt: skip
_NOISE = 1e-6
"""Share of a bound by which rounding may pass it: no violation."""
_AFTER_TOUCH = 0.1
"""Time after a touch-down whose largest force counts as its peak [s]."""
_ROUNDING = 1e-9
"""The same at a bound of zero, in its unit."""


def summarise(experiment: Experiment) -> Summary:
    """Return everything that goes into ``summary.json``, with stable keys.

    Errors are force minus setpoint, by the true force, over every cycle of the run; without
    compensation, force minus the setpoint at the start. After a trip of the protection no cycle
    counts for errors, saturation, increments and violations. Figures that do not exist (an
    interrupted run) are None.
    """
    scenario, log = experiment.scenario, experiment.log
    kind = controller_kind(scenario.controller.kind)
    end, counted = log.cycles, log.counted
    axes: Summary = {}
    for j, axis in enumerate(log.axes):
        i = "xyz".index(axis)
        held = statistics(log.force_uncompensated[:end, i] - log.setpoint[0, j])
        controlled = statistics(log.force[:counted, i] - log.setpoint[:counted, j])
        axes[axis] = {
            "uncompensated": held,
            "compensated": controlled,
            "reduction": {key: _reduction(held[key], controlled[key]) for key in ("rms", "max")},
        }
    period, wall = scenario.cell.period, experiment.wall_time
    return {
        "scenario": scenario.name,
        "controller": kind.name,
        "backend": scenario.backend if kind.takes_backend else None,
        "backend_facts": [dict(facts) for facts in experiment.backend_facts if facts],
        "form": dict(experiment.form),
        "seed": scenario.seed,
        "cycles": end,
        "complete": experiment.stopped is None,
        "stopped": experiment.stopped,
        "trip": None if log.trip is None else {"cause": str(log.trip.cause), "time": log.trip.time},
        "counted": counted,
        "contact_loss": contact_loss(scenario, log),
        "force_peak": float(log.force_peak[:end].max(initial=0.0)),
        "axes": axes,
        "paper": PAPER,
        "timing": {
            "build_us": _percentiles(log.build_time[:end]),
            "solve_us": _percentiles(log.solve_time[:end]),
            "cycle_us": _percentiles(log.cycle_time[:end]),
            "plant_us": _percentiles(log.plant_time[:end]),
            "misses": int((log.cycle_time[:end] > period).sum()),
            "wall_s": wall,
            "real_time_factor": {
                "compensated": end * period / wall["compensated"] if end else None,
                # a run that was not made, or not to its end, has no speed
                "uncompensated": (
                    end * period / wall["uncompensated"]
                    if experiment.stopped is None and wall["uncompensated"]
                    else None
                ),
            },
        },
        "saturation": {
            "torque": _share(log.torque_saturated[:counted]),
            "command": _share(log.command_saturated[:counted]),
        },
        "increment_rms": {
            axis: _rms(np.diff(log.command[:counted, j], prepend=0.0))
            for j, axis in enumerate(log.axes)
        },
        "torque_increment_rms": _rms(np.diff(log.torque[:counted], axis=0)),
        "violations": violations(log, experiment.schedule, period),
        "status": log.status_counts(),
        "source": log.source_counts(),
        "physics": physics_loop(experiment.log.torque.shape[1]).told,
        "live_setpoint": experiment.live,
        "compiled": asdict(experiment.compilation),
        "versions": versions(),
    }


def statistics(error: Array) -> dict[str, float | None]:
    """RMS, largest and 99th percentile of the magnitude, and peak to peak of a force error [N].

    Of ``(n,)`` samples; None without data.
    """
    if error.size == 0 or np.isnan(error).any():
        return dict.fromkeys(("rms", "max", "p99", "peak_to_peak"))
    size = np.abs(error)
    return {
        "rms": _rms(error),
        "max": float(size.max()),
        "p99": float(np.percentile(size, 99)),
        "peak_to_peak": float(np.ptp(error)),
    }


def violations(log: Log, schedule: Schedule, period: float) -> Summary:
    """How often and how far force, velocity and command were really beyond their bounds.

    By the true force, on the axes under control, against the bounds themselves, not those that the
    controller tightens by its margins: cycles in which any axis is beyond, the worst of them in the
    unit of the bound, and the excess summed over axes and time.
    """
    end = log.counted
    index = ["xyz".index(axis) for axis in log.axes]
    found: dict[BoundName, Array] = {
        "force": log.force[:end, index],
        "velocity": log.tool_velocity[:end, index],
        "command": log.command[:end],
    }
    result: Summary = {}
    for name, values in found.items():
        lower, upper = schedule.over(name, end)
        above, below = values - upper, lower - values
        size = np.maximum(*(np.abs(np.where(np.isfinite(b), b, 0.0)) for b in (lower, upper)))
        noise = np.maximum(_NOISE * size, _ROUNDING)
        above[above <= noise] = 0.0
        below[below <= noise] = 0.0
        excess = np.maximum(above, below)
        result[name] = {
            "count": int((excess > 0).any(axis=1).sum()),
            "worst": float(excess.max(initial=0.0)),
            "integral": float(excess.sum() * period),
        }
    return result


def contact_loss(scenario: Scenario, log: Log) -> Summary | None:
    """How often and how long the tool was off the tissue, and how it came back.

    By what the measured force told, see `scenarios.approach`; how the tool came back is what really
    happened at the last touch before that: its speed and that at which the two met, along the
    normal, and the largest force within the next tenth of a second, or until contact was lost
    again. The cap is that of `scenarios.approach.touch_down_cap`. None where the contact cannot be
    lost.
    """
    if log.contact_events is None:
        return None
    end, period, events = log.cycles, scenario.cell.period, []
    for i, event in enumerate(log.contact_events):
        found = event.found
        entry: Summary = {
            "lost": event.lost * period,
            "found": None if found is None else found * period,
            "duration": ((end if found is None else found) - event.lost) * period,
            "at_start": event.lost == 0,
            "meant": event.meant,
            "speed": None,
            "closing_speed": None,
            "force_peak": None,
        }
        if found is not None:
            off = np.flatnonzero(~log.touching[event.lost : found])
            touch = min(found, event.lost + int(off[-1]) + 1) if off.size else found
            before = max(touch - 1, 0)
            until = min(end, touch + round(_AFTER_TOUCH / period))
            if i + 1 < len(log.contact_events):
                until = min(until, log.contact_events[i + 1].lost)
            rise = float(log.tissue[touch, 2] - log.tissue[before, 2]) / period
            speed = -float(log.tool_velocity[before, 2])
            entry["speed"], entry["closing_speed"] = speed, speed + rise
            entry["force_peak"] = float(log.force_peak[touch : until + 1].max(initial=0.0))
        events.append(entry)
    unmeant = [e for e in events if not e["at_start"] and not e["meant"]]
    return {
        "count": len(unmeant),
        "time": float(sum(e["duration"] for e in unmeant)),
        "speed": max((e["speed"] for e in events if e["speed"] is not None), default=None),
        "force_peak": max(
            (e["force_peak"] for e in events if e["found"] is not None), default=None
        ),
        "touch_down_cap": touch_down_cap(scenario, _largest_speed(log.tissue[:end, 2], period)),
        "events": events,
    }


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that the figures depend on."""
    found = {"python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = "not installed"
    return found


def _largest_speed(place: Array, period: float) -> float:
    return float(np.abs(np.diff(place)).max(initial=0.0)) / period


def _rms(values: Array) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if values.size else None


def _reduction(before: float | None, after: float | None) -> float | None:
    return 100.0 * (1.0 - after / before) if before and after is not None else None


def _share(flags: NDArray[np.bool_]) -> float | None:
    return float(flags.mean()) if flags.size else None


def _percentiles(seconds: Array) -> dict[str, float | None]:
    if not seconds.size:
        return dict.fromkeys(("p50", "p99", "p999", "max"))
    p50, p99, p999 = np.percentile(seconds, [50, 99, 99.9]) * 1e6
    return {"p50": p50, "p99": p99, "p999": p999, "max": float(seconds.max()) * 1e6}
