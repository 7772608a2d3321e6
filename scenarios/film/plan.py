"""Which pictures make up a film: instants, size, view; checked against the run."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from scenarios.errors import ScenarioError, nearest
from scenarios.scene.camera import VIEWS
from scenarios.scene.meshes import Array

KINDS = (".mp4", ".gif", ".png")
_LEAST, _MOST = (480, 320), (3840, 2160)
_FASTEST = 120.0
_LONGEST = 36000
"""Frames of a film: ten minutes at 60 a second."""
_LONGEST_GIF = 1500
"""All of a GIF is held in memory until it is written."""


@dataclass(frozen=True)
class Wish:
    """What was asked for; None where the kind of file decides."""

    out: Path
    fps: float | None = None
    """Frames of the film a second."""
    speed: float | None = None
    """Simulated seconds a second of the film; below 1 is slow motion."""
    start: float | None = None
    """First instant, or that of a still [s]."""
    end: float | None = None
    """Last instant [s]."""
    size: str | None = None
    """``WIDTHxHEIGHT`` [pixels]."""
    camera: str | None = None
    """Name of a view."""


@dataclass(frozen=True, eq=False)
class Plan:
    """What will be drawn."""

    kind: str
    width: int
    height: int
    camera: str
    fps: float
    speed: float
    instants: Array
    """Of each picture ``(n,)`` [s]."""


def plan_film(wish: Wish, start: float, end: float) -> Plan:
    """Fill in what was not asked for, and refuse what cannot be.

    Args:
        wish: see there.
        start, end: of the run [s].

    Raises:
        ScenarioError: of the first thing that is wrong.
    """
    kind = wish.out.suffix.lower()
    if kind not in KINDS:
        raise ScenarioError(
            f"--out {wish.out}: a film is one of {', '.join(KINDS)} by the end of its name"
        )
    width, height = _size(wish.size or {".gif": "960x540"}.get(kind, "1280x720"), kind)
    camera = wish.camera or next(iter(VIEWS))
    if camera not in VIEWS:
        raise ScenarioError(f"--camera: no view '{camera}'{nearest(camera, VIEWS)}")
    if kind == ".png":
        return Plan(kind, width, height, camera, 1.0, 1.0, np.array([_still(wish, start, end)]))
    fps = 25.0 if wish.fps is None else wish.fps
    fastest = 50.0 if kind == ".gif" else _FASTEST
    if not 0.1 <= fps <= fastest:
        raise ScenarioError(f"--fps: {fps:g} is not between 0.1 and {fastest:g} for {kind}")
    speed = 1.0 if wish.speed is None else wish.speed
    if not 1e-3 <= speed <= 1e3:
        raise ScenarioError(f"--speed: {speed:g} is not between 0.001 and 1000")
    first, last = _span(wish, start, end)
    frames = max(1.0, np.ceil((last - first) / speed * fps - 1e-6))
    longest = _LONGEST_GIF if kind == ".gif" else _LONGEST
    if frames > longest:
        raise ScenarioError(
            f"{frames:.0f} frames are more than the {longest} that a {kind} may have: take a "
            "higher --speed, a lower --fps, or a part with --from and --to"
        )
    instants: Array = first + speed / fps * np.arange(int(frames), dtype=np.float64)
    return Plan(kind, width, height, camera, fps, speed, instants)


def _still(wish: Wish, start: float, end: float) -> float:
    for name in ("fps", "speed", "end"):
        if getattr(wish, name) is not None:
            option = {"end": "to"}.get(name, name)
            raise ScenarioError(f"--{option}: a .png is one picture; --from says of which instant")
    instant = (start + end) / 2.0 if wish.start is None else wish.start
    _inside("--from", instant, start, end)
    return instant


def _span(wish: Wish, start: float, end: float) -> tuple[float, float]:
    first = start if wish.start is None else wish.start
    last = end if wish.end is None else wish.end
    _inside("--from", first, start, end)
    if not last > first:
        raise ScenarioError(f"--to: {last:g} s is not after --from, {first:g} s")
    _inside("--to", last, start, end)
    return first, last


def _inside(option: str, instant: float, start: float, end: float) -> None:
    if not start <= instant <= end:
        raise ScenarioError(
            f"{option}: {instant:g} s is outside the run, which goes from {start:g} to {end:g} s"
        )


def _size(text: str, kind: str) -> tuple[int, int]:
    parts = text.lower().split("x")
    if len(parts) != 2 or not all(part.isascii() and part.isdigit() for part in parts):
        raise ScenarioError(f"--size: '{text}' is not WIDTHxHEIGHT, for example 1280x720")
    if any(len(part) > 6 for part in parts):
        raise ScenarioError(f"--size: {text} is larger than {_MOST[0]}x{_MOST[1]}")
    width, height = int(parts[0]), int(parts[1])
    if width < _LEAST[0] or height < _LEAST[1]:
        raise ScenarioError(f"--size: {text} is smaller than {_LEAST[0]}x{_LEAST[1]}")
    if width > _MOST[0] or height > _MOST[1]:
        raise ScenarioError(f"--size: {text} is larger than {_MOST[0]}x{_MOST[1]}")
    if kind == ".mp4" and (width % 2 or height % 2):
        raise ScenarioError(f"--size: {text}: a .mp4 needs even numbers")
    return width, height
