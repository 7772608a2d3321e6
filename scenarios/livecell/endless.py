"""A motion that goes on for ever: its end passes over into its beginning; and a beat in between."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from plant.cell import heart_programme
from plant.config import CellConfig
from plant.playback import Programme
from scenarios.errors import ScenarioError
from scenarios.motion import Motion
from scenarios.motion.record import Array

_BLEND = 1.0
"""Time over which the end passes over into the beginning, at most [s]."""
_BEFORE, _AFTER = 0.06, 0.44
"""What of a motion belongs to the beat at an R peak [s]."""
_FADE = 0.2
"""Share of that over which an added beat begins, and ends."""
_LEAST_GAP, _LEAST_REST = 0.33, 0.26
"""From the R peak before to an early one, and from there to the next [s]."""
BEAT_WITHIN = 3.0
"""How far ahead an early beat may be [s]."""
_LEAD = 0.25
"""What the preparation of an early beat may take [s]."""


def smooth(share: Array) -> tuple[Array, Array, Array]:
    """Return a rise from 0 to 1 with its two derivatives; both are 0 at both ends."""
    s = np.clip(share, 0.0, 1.0)
    return (
        s**3 * (10.0 - 15.0 * s + 6.0 * s**2),
        30.0 * s**2 * (1.0 - s) ** 2,
        60.0 * s * (1.0 - s) * (1.0 - 2.0 * s),
    )


def endless(motion: Motion) -> Motion:
    """Return a shorter motion after whose last sample its first one may come.

    What was the last second, or the last quarter if that is less, is gone: the first second comes
    out of it, position, velocity and acceleration without a jump.
    """
    n = len(motion.time)
    m = min(round(_BLEND / motion.period), n // 4)
    w, slope, curve = (
        part[:, None] / (m * motion.period) ** order
        for order, part in enumerate(smooth(np.arange(m) / max(m, 1)))
    )
    tail = (motion.position, motion.velocity, motion.acceleration)
    p, v, a = (x[: n - m].copy() for x in tail)
    (p0, v0, a0), (p1, v1, a1) = ([x[part] for x in tail] for part in (slice(n - m, n), slice(m)))
    p[:m] = p0 + w * (p1 - p0)
    v[:m] = v0 + w * (v1 - v0) + slope * (p1 - p0)
    a[:m] = a0 + w * (a1 - a0) + 2.0 * slope * (v1 - v0) + curve * (p1 - p0)
    contraction = motion.contraction
    if contraction is not None:
        end, contraction = contraction[n - m :], contraction[: n - m].copy()
        contraction[:m] += (1.0 - w[:, 0]) * (end - contraction[:m])
    beats = motion.beats[motion.beats < (n - m) * motion.period]
    return Motion(motion.period, motion.time[: n - m], p, v, a, beats, contraction)


@dataclass(frozen=True, eq=False)
class EarlyBeat:
    """A programme with one more beat in it."""

    programme: Programme
    begin: int
    """Cycle in which it begins to differ, counted from the start of the run."""
    end: int
    """The same, when it is over."""
    peak: int
    """The cycle of its R peak."""


def early_beat(config: CellConfig, motion: Motion, regular: Programme, now: int) -> EarlyBeat:
    """Put a beat between two, as soon as there is room: the movement of one added to the motion.

    Args:
        config: of the cell.
        motion: endless.
        regular: Robot_Heart's programme for it.
        now: cycle, counted from the start of the run.

    Raises:
        ScenarioError: the motion tells no beats, or there is no room between them.
        UnreachableMotionError: Robot_Heart cannot play it.
    """
    period, n = motion.period, len(motion.time)
    duration = n * period
    if not motion.beats.size:
        raise ScenarioError("no early beat: a recorded motion tells no beats")
    start = now * period
    turn = np.floor(start / duration)
    known = (motion.beats[None] + duration * (turn + np.arange(-1, 3))[:, None]).ravel()
    earliest = start + _LEAD + _BEFORE
    for before, after in pairwise(known):
        peak = max(before + _LEAST_GAP, earliest)
        if peak + _LEAST_REST <= after and peak < start + BEAT_WITHIN:
            break
    else:
        raise ScenarioError("no early beat: there is no room between the beats")
    begin, source = round((peak - _BEFORE) / period), round((float(before) - _BEFORE) / period)
    length = round((_BEFORE + _AFTER) / period)
    rows = (begin + np.arange(length)) % n
    from_ = (source + np.arange(length)) % n
    share = np.arange(length) / (length - 1)
    span = (length - 1) * period
    rise, fall = smooth(share / _FADE), smooth((1.0 - share) / _FADE)
    rate = 1.0 / (_FADE * span)
    w, up, down = rise[0] * fall[0], rise[1] * fall[0], rise[0] * fall[1]
    slope = (up - down) * rate
    curve = (rise[2] * fall[0] - 2.0 * rise[1] * fall[1] + rise[0] * fall[2]) * rate**2
    w, slope, curve = (x[:, None] for x in (w, slope, curve))
    p, v, a = motion.position[from_], motion.velocity[from_], motion.acceleration[from_]
    drift = (p[-1] - p[0]) / span
    p = p - p[0] - drift * (share * span)[:, None]
    v = v - drift
    added = (w * p, w * v + slope * p, w * a + 2.0 * slope * v + curve * p)
    piece = replace(
        motion,
        time=motion.time[:length],
        position=motion.position[rows] + added[0],
        velocity=motion.velocity[rows] + added[1],
        acceleration=motion.acceleration[rows] + added[2],
        contraction=None,
    )
    found = heart_programme(config, piece)
    ctrl, angles = regular.ctrl.copy(), regular.angles.copy()
    ctrl[rows], angles[rows] = found.ctrl, found.angles
    return EarlyBeat(
        replace(regular, ctrl=ctrl, angles=angles), begin, begin + length, round(peak / period)
    )
