"""Recorded motion: any sampling made into control-period samples by a C2 spline."""

from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from scenarios.errors import DataFileError, DataTooShortError
from scenarios.motion.record import Array, Motion, control_instants
from scenarios.table import Table, read_table

_LONGEST_GAP = 0.1
"""About the length of a systole [s]: a spline across more than this could invent or hide one."""
_LARGEST_SPAN = 0.2
"""Excursion of an axis beyond which the file is not in metres [m]."""


def read_recording(path: Path, duration: float, period: float) -> Motion:
    """Motion from a CSV file with columns ``t, x, y, z`` (s, m; other columns are ignored).

    The recording may have any sampling, even uneven, and any first time, which becomes 0. Positions
    are displacements in the recording's own frame: the mean over the whole recording is removed,
    the amplitude is left as it is. Velocity and acceleration are those of the interpolating cubic
    spline, so noise of the recording shows in them. ``duration`` and ``period`` [s].

    Errors: ``DataFileError`` for an unusable file, fewer than 4 rows, a gap above 0.1 s that is
    also above four times the median interval, or a span above 0.2 m; ``DataTooShortError``.
    """
    table = read_table(path, ("t", "x", "y", "z"), min_rows=4)
    time = table.values[:, 0] - table.values[0, 0]
    _require_no_gap(path, table, time)
    _require_metres(path, table)
    sampled = control_instants(duration, period)
    # half a nanosecond of slack: times printed with nine decimals are rounded
    if sampled[-1] > time[-1] + 0.5e-9:
        longest = float(time[-1]) + period
        reason = (
            f"the recording lasts {time[-1]:.6g} s, the run {duration:.6g} s; "
            f"a run of at most {np.floor(longest * 1e3) / 1e3:.6g} s can be played"
        )
        raise DataTooShortError(path, longest, duration, reason)
    spline = CubicSpline(time, table.values[:, 1:])
    mean = spline.integrate(0.0, time[-1]) / time[-1]
    return Motion(
        period=period,
        time=sampled,
        position=spline(sampled) - mean,
        velocity=spline(sampled, 1),
        acceleration=spline(sampled, 2),
        beats=np.empty(0),
    )


def _require_no_gap(path: Path, table: Table, time: Array) -> None:
    intervals = np.diff(time)
    limit = max(_LONGEST_GAP, 4.0 * float(np.median(intervals)))
    worst = int(np.argmax(intervals))
    if intervals[worst] > limit:
        reason = (
            f"gap of {intervals[worst]:.3g} s before t = {table.values[worst + 1, 0]:.6g} s; "
            f"gaps must not exceed {limit:.3g} s here"
        )
        raise DataFileError(path, int(table.lines[worst + 1]), reason)


def _require_metres(path: Path, table: Table) -> None:
    spans = np.ptp(table.values[:, 1:], axis=0)
    widest = int(np.argmax(spans))
    if spans[widest] > _LARGEST_SPAN:
        reason = (
            f"column {'xyz'[widest]!r} spans {spans[widest]:.3g} m; at most {_LARGEST_SPAN:g} m "
            "can be played (is it in metres?)"
        )
        raise DataFileError(path, None, reason)
