"""Two measurements beside each other: what changed, and what the machine may have changed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from bench.latency.result import Result, Row

DRIFT = 0.03
"""Relative difference below which two measurements are not told apart: as much lies between two
processes that run the same code, by where things come to lie in memory."""
Verdict = Literal["faster", "slower", "not told apart"]
Key = tuple[str, str, int, str, str]
_SAME = ("cpu", "cores", "kernel", "preemption", "governor")
_MEASURES = ("affinity", "scheduler", "memory_locked")


@dataclass(frozen=True)
class Pair:
    """One row in both results. Ratios are those of the second to the first, of the step."""

    backend: str
    path: str
    horizon: int
    axes: str
    mode: str
    p50_us: tuple[float, float]
    ratio_p50: float
    ratio_p999: float | None
    ratio_floor_p50: float | None
    """Of the least times: what the machine adds is mostly taken out."""
    ratio_floor_p999: float | None
    noise: float
    """How far the medians of the passes of one result lie apart, the larger of the two, relative
    to its median."""
    verdict: Verdict
    """Told apart only where every pass of one result was faster than every pass of the other, and
    the least times differ in the same direction by more than `DRIFT`."""
    error: tuple[float | None, float | None]
    misses: tuple[int, int]


@dataclass(frozen=True)
class LatencyComparison:
    """What `pulsempc bench compare` tells."""

    pairs: list[Pair]
    only_first: list[Key]
    only_second: list[Key]
    differences: dict[str, tuple[Any, Any]]
    """Facts of machine and measurement that are not the same."""

    def summary(self) -> dict[str, Any]:
        """Return it as plain data."""
        return asdict(self)


def compare_results(first: Result, second: Result) -> LatencyComparison:
    """Pair the rows of two results by backend, path, horizon, axes and mode."""
    mine, theirs = _by_key(first), _by_key(second)
    return LatencyComparison(
        [_pair(key, mine[key], theirs[key]) for key in mine if key in theirs],
        [key for key in mine if key not in theirs],
        [key for key in theirs if key not in mine],
        _differences(first, second),
    )


def _by_key(result: Result) -> dict[Key, Row]:
    return {(row.backend, row.path, row.horizon, row.axes, row.mode): row for row in result.rows}


def _pair(key: Key, first: Row, second: Row) -> Pair:
    a, b = first.step_us, second.step_us
    floor = _ratio(a.floor_p50, b.floor_p50)
    p50 = _ratio(a.p50, b.p50)
    return Pair(
        *key,
        p50_us=(a.p50 or 0.0, b.p50 or 0.0),
        ratio_p50=p50 if p50 is not None else 1.0,
        ratio_p999=_ratio(a.p999, b.p999),
        ratio_floor_p50=floor,
        ratio_floor_p999=_ratio(a.floor_p999, b.floor_p999),
        noise=max(_spread(first), _spread(second)),
        verdict=_verdict(first.pass_p50_us, second.pass_p50_us, floor),
        error=(first.error, second.error),
        misses=(first.misses, second.misses),
    )


def _ratio(first: float | None, second: float | None) -> float | None:
    return second / first if first and second is not None else None


def _spread(row: Row) -> float:
    medians = sorted(row.pass_p50_us)
    middle = medians[len(medians) // 2]
    return (medians[-1] - medians[0]) / middle if middle else 0.0


def _verdict(first: list[float], second: list[float], floor: float | None) -> Verdict:
    if floor is not None and max(second) < min(first) and floor < 1.0 / (1.0 + DRIFT):
        return "faster"
    if floor is not None and min(second) > max(first) and floor > 1.0 + DRIFT:
        return "slower"
    return "not told apart"


def _differences(first: Result, second: Result) -> dict[str, tuple[Any, Any]]:
    """Return what could explain a ratio other than the code."""
    found: dict[str, tuple[Any, Any]] = {}

    def note(name: str, mine: object, theirs: object) -> None:
        if mine != theirs:
            found[name] = (mine, theirs)

    note("scenario", first.scenario, second.scenario)
    note("seed", first.seed, second.seed)
    note("period_us", first.period_us, second.period_us)
    for name in _SAME:
        note(name, first.machine.get(name), second.machine.get(name))
    for name in _MEASURES:
        note(name, _in_force(first.machine, name), _in_force(second.machine, name))
    mine, theirs = (_table(result.machine, "versions") for result in (first, second))
    for package in dict.fromkeys((*mine, *theirs)):
        note(package, mine.get(package), theirs.get(package))
    cycles = [{(s.axes, s.horizon): s.cycles for s in r.streams} for r in (first, second)]
    for which in dict.fromkeys((*cycles[0], *cycles[1])):
        if which in cycles[0] and which in cycles[1]:
            note(f"cycles of {which[0]}, N = {which[1]}", *(one[which] for one in cycles))
    return found


def _in_force(machine: Mapping[str, Any], measure: str) -> object:
    told = _table(machine, "measures").get(measure)
    return told.get("in_force") if isinstance(told, Mapping) else None


def _table(machine: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    found = machine.get(name)
    return found if isinstance(found, Mapping) else {}
