"""``pulsempc margins`` and ``pulsempc tune``: how far from the edge, and away from it."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import tomli_w
import tyro
from rich.console import Console

from bench.margins import assess, demand
from bench.margins_table import margin_lines, margin_table, tuning_lines
from bench.progress import Reporter
from bench.verbs._asked import FAILED, Asked, load
from qpmpc.margins import Quality, tune
from scenarios import ScenarioError
from scenarios.results import to_json

_arg = tyro.conf.arg
_POINTS = 9
"""Values in a range that is looked at."""
_MOST = 200


@dataclass(frozen=True, kw_only=True)
class Margins(Asked):
    """Compute margins, ranges of stability and rejection of a scenario's controller.

    For example, `pulsempc margins paper`, or
    `pulsempc margins paper --stiffness 0.5:2 --set controller.model.stiffness=5000 --json`.
    """

    stiffness: Annotated[str, _arg(metavar="LOW:HIGH[:N]")] = "0.25:4"
    """True stiffness over that of the cell, N values of equal ratio."""
    later: Annotated[str, _arg(metavar="LOW:HIGH[:N]")] = "0:0.002:5"
    """Delay beyond that of the scenario, N values of equal distance [s]."""
    duration: Annotated[float | None, _arg(metavar="S")] = None
    """How much of the motion is looked at [s]."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print the figures as JSON, and nothing else, on standard output."""
    setpoint: tyro.conf.Suppress[Path | None] = None

    def run(self) -> int:
        """Compute and show; return the exit code: 1 where the loop is unstable as it is."""
        stiffness = values("--stiffness", self.stiffness, _POINTS, ratio=True)
        later = values("--later", self.later, _POINTS, ratio=False)
        told = assess(load(self), stiffness, later)
        if self.json:
            sys.stdout.write(to_json(told))
        else:
            console = Console()
            console.print(margin_table(told))
            for line in margin_lines(told):
                console.print(line, highlight=False, soft_wrap=True)
        return 0 if told["nominal"]["stable"] else FAILED


@dataclass(frozen=True, kw_only=True)
class Tune(Asked):
    """Search observer noises and weights for a margin that is asked for.

    For example, `pulsempc tune paper --stiffness 0.8:1.25 --sensitivity 2 --model`; what it
    prints is TOML for a scenario, and the same for `--set`.
    """

    sensitivity: Annotated[float, _arg(metavar="MS")] = 2.0
    """Largest sensitivity Ms that may be left, of each loop."""
    stiffness: Annotated[str, _arg(metavar="LOW:HIGH[:N]")] = "0.8:1.25:5"
    """True stiffness over that of the cell for which this has to hold."""
    later: Annotated[str, _arg(metavar="LOW:HIGH[:N]")] = "0:0:1"
    """Delay beyond that of the scenario for which it has to hold [s]."""
    model: tyro.conf.FlagCreatePairsOff[bool] = False
    """Whether the model's stiffness may be turned, too."""
    evaluations: Annotated[int, _arg(metavar="N")] = 1500
    """Controllers that are looked at."""
    duration: Annotated[float | None, _arg(metavar="S")] = None
    """How much of the motion is looked at [s]."""
    json: tyro.conf.FlagCreatePairsOff[bool] = False
    """Print what was found as JSON, and nothing else, on standard output."""
    setpoint: tyro.conf.Suppress[Path | None] = None

    def run(self) -> int:
        """Search and show; return the exit code: 1 where the margin cannot be kept."""
        stiffness = values("--stiffness", self.stiffness, 5, ratio=True)
        later = values("--later", self.later, 2, ratio=False)
        if not 1 <= self.evaluations <= 100_000:
            raise ScenarioError(f"--evaluations: must be from 1 to 100000, got {self.evaluations}")
        if not 1 < self.sensitivity < np.inf:
            raise ScenarioError(f"--sensitivity: must exceed 1, got {self.sensitivity:g}")
        scenario = load(self)
        asked = demand(scenario, stiffness, later, self.sensitivity)
        with Reporter(quiet=self.json) as reporter:
            found = tune(
                scenario.controller,
                asked,
                scenario.cell.period,
                model=self.model,
                evaluations=self.evaluations,
                report=lambda done, total: reporter("tuning", done, total),
            )
        before, after = _quality(found.before), _quality(found.after)
        changed = dict(found.changed)
        if self.json:
            told = {
                "scenario": scenario.name, "sensitivity": self.sensitivity, "met": found.met,
                "changed": {f"controller.{key}": value for key, value in changed.items()},
                "before": before, "after": after, "evaluations": found.evaluations,
            }  # fmt: skip
            sys.stdout.write(to_json(told))
        else:
            console = Console()
            console.print(tomli_w.dumps(_tree(changed)), end="", highlight=False, markup=False)
            for line in tuning_lines(changed, before, after):
                console.print(line, highlight=False, markup=False, soft_wrap=True)
        if found.met:
            return 0
        print(
            f"pulsempc: Ms <= {self.sensitivity:g} was not reached over that range; a narrower "
            "range, a larger Ms or more --evaluations may be",
            file=sys.stderr,
        )
        return FAILED


def values(option: str, text: str, count: int, *, ratio: bool) -> list[float]:
    """Return the values of a range that is written ``low:high`` or ``low:high:n``.

    Raises:
        ScenarioError: it is no such range.
    """
    parts = text.split(":")
    wanted = f"{option}: must be LOW:HIGH or LOW:HIGH:N"
    if len(parts) not in (2, 3):
        raise ScenarioError(f"{wanted}, got '{text}'")
    try:
        low, high = float(parts[0]), float(parts[1])
        count = int(parts[2]) if len(parts) == 3 else count
    except ValueError:
        raise ScenarioError(f"{wanted}, got '{text}'") from None
    least, kind = (1e-6, "positive") if ratio else (0.0, "not negative")
    if not least <= low <= high < 1e6:
        raise ScenarioError(f"{option}: LOW must be {kind} and not above HIGH, got '{text}'")
    if not 1 <= count <= _MOST:
        raise ScenarioError(f"{option}: N must be from 1 to {_MOST}, got {count}")
    each = np.geomspace(low, high, count) if ratio else np.linspace(low, high, count)
    return [round(value, 9) for value in each.tolist()]


def _quality(found: Quality) -> dict[str, float | None]:
    whole = bool(np.isfinite(found.sensitivity))
    return {
        "sensitivity": found.sensitivity if whole else None,
        "error": found.error,
        "radius": found.radius,
    }


def _tree(changed: dict[str, float]) -> dict[str, object]:
    """Return keys with dots as tables within tables."""
    tree: dict[str, object] = {}
    for key, value in changed.items():
        *path, name = f"controller.{key}".split(".")
        here = tree
        for part in path:
            here = here.setdefault(part, {})  # type: ignore[assignment]
        here[name] = value
    return tree
