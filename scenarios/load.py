"""From TOML to a `Scenario` and back: strict, every error with the key it is about."""

import json
import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import reduce
from importlib import resources
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, get_args, get_type_hints

import tomli_w
from pydantic import TypeAdapter, ValidationError

from plant.config import SensorConfig
from plant.sensors import SENSORS
from scenarios.config import Scenario
from scenarios.consistency import check_consistent
from scenarios.errors import ScenarioError, ScenarioKeyError, UnknownScenarioError, nearest
from scenarios.motion.config import MotionConfig

Table = dict[str, Any]
_AXES = ("x", "y", "z")
_NO_BOUNDS = ("margin", "friction", "largest_error", "time")
"""Keys beside the bounds that must be finite."""
_FILES = ("motion.file", "motion.beats", "setpoint.file", "cell.arm.file")
"""Keys that name a file, relative to the scenario's own place."""


def shipped() -> dict[str, Path]:
    """Scenarios that come with the package: name to TOML file."""
    folder = Path(str(resources.files("scenarios")))
    return {path.stem: path for path in sorted(folder.glob("*.toml"))}


def load_scenario(
    name: str,
    *,
    top: Mapping[str, Any] | None = None,
    motion: Path | None = None,
    beats: Path | None = None,
    setpoint: Path | None = None,
    settings: Sequence[str] = (),
) -> Scenario:
    """Load a shipped scenario by name, or any by the path of its TOML file.

    Args:
        name: "paper", ... or a path.
        top: values for top-level keys (duration, seed, backend), in place of the file's.
        motion: CSV file of a recorded motion, in place of the file's motion but for its axes.
        beats: CSV file of beat times, in place of the file's.
        setpoint: CSV file of a recorded wish, in place of the file's setpoint.
        settings: texts ``key.path=value``, the value in TOML's notation, applied last.

    Raises:
        UnknownScenarioError: there is no such scenario. ScenarioKeyError: a key or value is
        wrong. ScenarioError: the file cannot be read.
    """
    path = _locate(name)
    table = _read(path)
    _check_keys(table, Scenario, path.name)
    table.setdefault("name", path.stem)
    _find_files(table, path.parent)
    moved = table.get("motion", {})
    if motion is not None and beats is not None:
        raise ScenarioError(
            "--motion and --beats exclude each other: a recording has its own beats"
        )
    if motion is not None:
        moved = {"file": str(motion.resolve())} | {k: moved[k] for k in ("axes",) if k in moved}
    if beats is not None:
        moved = {k: v for k, v in moved.items() if k != "file"} | {"beats": str(beats.resolve())}
    if moved:
        table["motion"] = moved
    if setpoint is not None:
        held = set(_AXES) - set(table.get("axes", _AXES))  # where the wish is only the start
        kept = {k: v for k, v in table.get("setpoint", {}).items() if k in {*held, "preview"}}
        table["setpoint"] = kept | {"file": str(setpoint.resolve())}
    table |= top or {}
    keys = [_apply_setting(table, text) for text in settings]
    try:
        return check_scenario(table, path.name)
    except ScenarioKeyError as error:
        told = f"{error.key}."
        if any(told.startswith(f"{key}.") or f"{key}.".startswith(told) for key in keys):
            raise ScenarioKeyError("--set", error.key, error.reason) from None
        raise


def check_scenario(table: Table, source: str) -> Scenario:
    """Turn a table of keys into a `Scenario`; ``source`` is what errors call the place.

    Raises:
        ScenarioKeyError: an unknown key, a wrong type, a value out of range, or values that do
        not fit one another.
    """
    _check_keys(table, Scenario, source)
    try:
        _fill_in_noise(table)
        _fill_in_periods(table)
        # Strict, and through JSON: there an array may become a tuple, but "1" no number.
        scenario = _ADAPTER.validate_json(json.dumps(table, default=str), strict=True)
    except ValidationError as error:
        # Of the alternatives of a key the one that got furthest is the one that was meant.
        first = max(error.errors(), key=lambda e: len(e["loc"]))
        raise ScenarioKeyError(source, _dotted(first["loc"]), _reason(first)) from None
    _check_finite(table, source, ())
    check_consistent(scenario, source)
    return scenario


def dump_scenario(scenario: Scenario) -> str:
    """Return the scenario as TOML, with every key, that `load_scenario` reads back."""
    return tomli_w.dumps(_table(scenario))


_ADAPTER = TypeAdapter(Scenario)


def _fill_in_noise(table: Table) -> None:
    """Tell the observer the noise of the sensor that is in the cell, unless the scenario does."""
    model = table.get("cell", {}).get("sensor", {}).get("model", SensorConfig().model)
    observer = table.setdefault("controller", {}).setdefault("observer", {})
    if isinstance(model, str) and model in SENSORS:
        observer.setdefault("force_noise", SENSORS[model].deviation)


def _fill_in_periods(table: Table) -> None:
    """Tell the learning controller the periods of the motion, unless the scenario does."""
    motion, learning = table.get("motion", {}), table["controller"].setdefault("ilc", {})
    default = MotionConfig()
    for key, rate in (("heart_period", "heart_rate"), ("breath_period", "respiration_rate")):
        told = motion.get(rate, getattr(default, rate))
        if isinstance(told, int | float) and told > 0 and isinstance(learning, dict):
            learning.setdefault(key, 1.0 / told)


def _locate(name: str) -> Path:
    known = shipped()
    if name in known:
        return known[name]
    path = Path(name)
    if path.suffix == ".toml" or path.is_file():
        return path
    raise UnknownScenarioError(name, known)


def _read(path: Path) -> Table:
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScenarioError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ScenarioError(f"{path}: not a text file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise ScenarioError(f"{path}: not TOML: {error}") from None


def _find_files(table: Table, folder: Path) -> None:
    """Make the names of files in a table absolute, relative ones from ``folder`` on."""
    for place in _FILES:
        *parts, key = place.split(".")
        named: Any = table
        for part in parts:
            named = named.get(part) if isinstance(named, dict) else None
        if isinstance(named, dict) and isinstance(named.get(key), str):
            named[key] = str((folder / named[key]).resolve())


def _apply_setting(table: Table, text: str) -> str:
    """Set one key; return its dotted path."""
    key, separator, value = text.partition("=")
    parts = key.strip().split(".")
    if not separator or not all(parts):
        raise ScenarioError(f"--set {text}: expected key.path=value")
    try:
        parsed = tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        parsed = value.strip()  # a bare word is taken as text
    nested: Any = parsed
    for part in reversed(parts):
        nested = {part: nested}
    _check_keys(nested, Scenario, "--set")
    _find_files(nested, Path())
    parsed = reduce(lambda inner, part: inner[part], parts, nested)
    target = table
    for part in parts[:-1]:
        target = target.setdefault(part, {})
        if not isinstance(target, dict):
            raise ScenarioKeyError("--set", key, f"'{part}' is not a table")
    target[parts[-1]] = parsed
    return ".".join(parts)


def _check_keys(table: Any, kind: Any, source: str, path: tuple[str, ...] = ()) -> None:
    """Refuse keys that no field has, at any depth, with the nearest one that exists."""
    if not is_dataclass(kind) or not isinstance(table, dict):
        if isinstance(table, list):  # an array of tables, e.g. the steps of the setpoint
            for i, item in enumerate(table):
                _check_keys(item, _element(kind), source, (*path, str(i)))
        return
    hints = {key: _record(hint) for key, hint in get_type_hints(kind).items()}
    names = [f.name for f in fields(kind)]
    for key, value in table.items():
        if key not in names:
            raise ScenarioKeyError(
                source, ".".join((*path, key)), f"unknown key{nearest(key, names)}"
            )
        if _always_record(get_type_hints(kind)[key]) and not isinstance(value, dict):
            raise ScenarioKeyError(source, ".".join((*path, key)), "must be a table of keys")
        _check_keys(value, hints[key], source, (*path, key))


def _record(kind: Any) -> Any:
    """Return the record among the alternatives of a union, anything else as it is."""
    if isinstance(kind, UnionType):
        return next((k for k in get_args(kind) if is_dataclass(k)), kind)
    return kind


def _always_record(kind: Any) -> bool:
    """Whether a key's value can only be a table: of a record, or of one that may be left out."""
    kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    return all(is_dataclass(k) or k is NoneType for k in kinds)


def _element(kind: Any) -> Any:
    """Return the type of the elements of ``tuple[X, ...]``, None for anything else."""
    arguments = get_args(kind)
    return arguments[0] if arguments else None


def _check_finite(value: Any, source: str, path: tuple[str, ...]) -> None:
    """Refuse NaN anywhere, and infinity where it is no bound."""
    if isinstance(value, dict):
        for key, item in value.items():
            _check_finite(item, source, (*path, key))
    elif isinstance(value, list | tuple):
        for i, item in enumerate(value):
            _check_finite(item, source, (*path, str(i)))
    elif isinstance(value, float):
        bound = "bounds" in path[:2] or path[0] == "bounds_steps"
        bound &= not path[-1].endswith(_NO_BOUNDS)
        if math.isnan(value) or (math.isinf(value) and not bound):
            raise ScenarioKeyError(source, ".".join(path), f"must be a finite number, got {value}")


def _dotted(location: tuple[int | str, ...]) -> str:
    # Where a key has alternatives, the location names the alternative: a type, not a key.
    parts = [str(part) for part in location]
    keys = [p for p in parts if "[" not in p and not p[:1].isupper() and not p.endswith("float")]
    return ".".join(keys) or "(file)"


def _reason(error: Any) -> str:
    if error["type"] == "missing":
        return "is missing"
    message = error["msg"].removeprefix("Input ").removeprefix("should ")
    given = error["input"]
    if error["type"] in ("too_long", "too_short") and isinstance(given, list):
        least = error["ctx"].get("min_length", error["ctx"].get("max_length"))
        what = "at least" if error["type"] == "too_short" else "at most"
        return f"must have {what} {least} values, got {json.dumps(given)}"
    shown = json.dumps(given) if not isinstance(given, dict) else "a table"
    return f"must {message}, got {shown}" if error["msg"].startswith("Input should") else message


def _table(record: Any) -> Table:
    """Return a record as nested tables of TOML values, without the keys that are None."""
    result: Table = {}
    for f in fields(record):
        value = getattr(record, f.name)
        if is_dataclass(value):
            result[f.name] = _table(value)
        elif isinstance(value, tuple) and value and is_dataclass(value[0]):
            result[f.name] = [_table(item) for item in value]
        elif value is not None:
            result[f.name] = list(value) if isinstance(value, tuple) else value
    return result
