"""What a measurement of latency leaves behind: records, their JSON and its schema."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le
from pydantic import TypeAdapter, ValidationError

from scenarios import ScenarioError

SCHEMA = "pulsempc.latency/1"
Mode = Literal["hot", "paced"]
Way = Literal["interpreted", "compiled"]
Time = Annotated[float, Ge(0)] | None
Share = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Ge(0)]


@dataclass(frozen=True)
class Percentiles:
    """Of one stage [us]; all None where the stage cannot be told apart on that path.

    p50 ... max are over every timed instance of every pass; the value named is the smallest
    measured one that the share of samples does not exceed. floor_... are over the least time of
    each instance among the passes: what the algorithm takes, without most of what the machine
    adds.
    """

    p50: Time = None
    p99: Time = None
    p999: Time = None
    p9999: Time = None
    max: Time = None
    floor_p50: Time = None
    floor_p999: Time = None
    floor_max: Time = None


@dataclass(frozen=True)
class Row:
    """One backend on one path, at one horizon, on one set of axes, in one mode."""

    backend: str
    path: Way
    """Whether observer, reference, QP and command run in Python, or in one compiled call."""
    horizon: Annotated[int, Ge(1)]
    axes: str
    """Axes under control, "x,y,z"."""
    mode: Mode
    """hot: one cycle after the other; paced: each at its own absolute time."""
    passes: Annotated[int, Ge(1)]
    instances: Annotated[int, Ge(1)]
    """Timed in each pass; samples are passes times instances."""
    recorded: Annotated[int, Ge(1)]
    """Cycles that were recorded."""
    cut: str | None
    """Why there are fewer instances than were recorded; None where there are not."""
    prepare_us: Percentiles
    """What can be done before the measurement arrives."""
    update_us: Percentiles
    """Observer, reference, vectors of the QP and their scaling."""
    build_us: Percentiles
    """Bringing new rows in, and what a solver takes that has to build its problem anew."""
    solve_us: Percentiles
    """The backend without that."""
    step_us: Percentiles
    """The whole, from measurement to command, as the caller sees it."""
    response_us: Percentiles
    """From the release that was intended to the command; paced only."""
    lateness_us: Percentiles
    """From the release that was intended to the start of the step; paced only."""
    pass_p50_us: list[float]
    """Median step of each pass: how far they differ is what the machine adds."""
    error: float | None
    """Largest difference of the first increment from the certified one [m/s^2]."""
    without_reference: Count
    """Instances without a certified answer, left out of ``error`` and ``active_share``."""
    violation: dict[str, float]
    """By how much the plan was beyond a row of each bound, over what the certified plan is, at
    most, in the bound's unit."""
    active_share: Share | None
    """Share of the instances in which at least one row acts."""
    ratio_to_analytic: float | None
    """Median step over that of the closed form on the same path in the same run."""
    misses: Count
    """Samples beyond the period: of the response where paced, of the step where hot."""
    missed_in_every_pass: Count
    """Instances that were beyond it in every pass: the backend's own."""
    status: dict[str, int]
    """How the solves ended, by instances of one pass."""
    source: dict[str, int]
    """Where the commands came from."""


@dataclass(frozen=True)
class LeftOut:
    """What was asked for and has no row, and why."""

    backend: str
    path: Way | None
    horizon: int | None
    axes: str | None
    mode: Mode | None
    reason: str


@dataclass(frozen=True)
class Stream:
    """The cycles that the rows of one horizon and set of axes were measured on."""

    axes: str
    horizon: int
    cycles: int
    certified: Count
    """Cycles whose QP has a certified answer."""
    residual: float | None
    """Largest scaled residual among those answers."""
    active_share: Share | None
    active: dict[str, float]
    """Share of the cycles in which each bound acts."""


@dataclass(frozen=True)
class Timer:
    """The clock that was read, not subtracted from anything."""

    clock: str
    cost_ns: Annotated[float, Ge(0)]
    """Least difference of two readings in a row."""
    cost_p50_ns: Annotated[float, Ge(0)]
    waits_by: str


@dataclass(frozen=True)
class Result:
    """Everything that goes into ``latency.json``."""

    scenario: str
    seed: int
    period_us: Annotated[float, Gt(0)]
    complete: bool
    """False where Ctrl-C ended it: what had been measured until then is whole."""
    rows: list[Row]
    left_out: list[LeftOut]
    streams: list[Stream]
    timer: Timer
    machine: dict[str, Any]
    schema: Literal["pulsempc.latency/1"] = "pulsempc.latency/1"

    def to_json(self) -> str:
        """Return the file's text."""
        return json.dumps(asdict(self), indent=2, allow_nan=False) + "\n"


_ADAPTER = TypeAdapter(Result)


def schema() -> dict[str, Any]:
    """Return the JSON schema of the file, as it follows from the records."""
    found = _ADAPTER.json_schema()
    # Rows of this version always tell who made them.
    found["required"] = [*found["required"], "schema"]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema"} | found


def shipped_schema() -> dict[str, Any]:
    """Return the schema that is shipped beside the code."""
    text = (resources.files("bench") / "latency.schema.json").read_text(encoding="utf-8")
    found: dict[str, Any] = json.loads(text)
    return found


def read_result(path: Path) -> Result:
    """Read a file that `Result.to_json` wrote.

    Raises:
        ScenarioError: it cannot be read, or does not follow the schema; one line.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise ScenarioError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ScenarioError(f"{path}: not a text file in UTF-8") from None
    try:
        found = json.loads(text, parse_constant=_refuse)
    except (ValueError, RecursionError) as error:
        raise ScenarioError(f"{path}: not JSON: {error}") from None
    told = found.get("schema") if isinstance(found, Mapping) else None
    if told != SCHEMA:
        raise ScenarioError(
            f"{path}: not a result of `pulsempc bench latency`: schema is {told!r}, not '{SCHEMA}'"
        )
    try:
        return _ADAPTER.validate_json(text, strict=True)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ScenarioError(f"{path}: {place}: {first['msg']}") from None


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number")
