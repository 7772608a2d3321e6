"""The same scenario with keys changed, one run for each combination of values."""

import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

from scenarios import Scenario, ScenarioError, run_experiment, summarise
from scenarios.experiment import Report
from scenarios.loop import Stop

Row = dict[str, Any]
MOST = 1000
"""Runs of one sweep."""


@dataclass(frozen=True)
class Range:
    """Keys that take the same values together."""

    keys: tuple[str, ...]
    """With dots, of the scenario."""
    values: tuple[Any, ...]


def parse(text: str) -> Range:
    """Return the range that ``KEY=[V, V, ...]`` or ``KEY+KEY=[...]`` says, values as in TOML.

    Raises:
        ScenarioError: it says none.
    """
    wanted = f"--over {text}: must be KEY=[V, V, ...] or KEY+KEY=[V, V, ...]"
    keys, _, values = text.partition("=")
    names = tuple(key.strip() for key in keys.split("+"))
    try:
        found = tomllib.loads(f"values = {values}")
    except tomllib.TOMLDecodeError:
        raise ScenarioError(wanted) from None
    if not all(names) or set(found) != {"values"} or not isinstance(found["values"], list):
        raise ScenarioError(wanted)
    if not found["values"]:
        raise ScenarioError(f"--over {text}: no value is given")
    return Range(names, tuple(found["values"]))


def combinations(ranges: Sequence[Range]) -> list[dict[str, Any]]:
    """Return the values of each run, by key; the last range changes fastest.

    Raises:
        ScenarioError: a key is named twice, or there are too many runs.
    """
    keys = [key for each in ranges for key in each.keys]
    twice = sorted({key for key in keys if keys.count(key) > 1})
    if twice:
        raise ScenarioError(f"--over: names {', '.join(twice)} more than once")
    found = [
        {key: value for each, value in zip(ranges, chosen, strict=True) for key in each.keys}
        for chosen in product(*(each.values for each in ranges))
    ]
    if len(found) > MOST:
        raise ScenarioError(f"--over: {len(found)} runs, at most {MOST}")
    return found


def sweep(
    scenarios: Sequence[tuple[dict[str, Any], Scenario]], report: Report, stop: Stop
) -> Iterator[Row]:
    """Run each and give its row, as soon as it is there.

    Args:
        scenarios: what was changed, and the scenario with it.
        report, stop: as for `run_experiment`.
    """
    for i, (changed, scenario) in enumerate(scenarios, 1):
        if stop():
            return
        experiment = run_experiment(
            scenario, report=_numbered(report, f"run {i} of {len(scenarios)}"), stop=stop
        )
        summary = summarise(experiment)
        if experiment.stopped == "interrupted":
            return
        yield {
            "changed": changed,
            "stopped": summary["stopped"],
            "trip": summary["trip"],
            "axes": {
                axis: {
                    "rms": figures["compensated"]["rms"],
                    "max": figures["compensated"]["max"],
                    "reduction_rms": figures["reduction"]["rms"],
                }
                for axis, figures in summary["axes"].items()
            },
            "increment_rms": summary["increment_rms"],
            "saturation": summary["saturation"],
            "status": summary["status"],
            "source": summary["source"],
        }


def _numbered(report: Report, name: str) -> Callable[[str, int, int], None]:
    def told(stage: str, done: int, total: int) -> None:
        if stage == "compensated":
            report(name, done, total)

    return told
