"""The setpoint over a run, with the preview that the reference needs."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scenarios.config import SetpointConfig
from scenarios.errors import DataFileError, DataTooShortError
from scenarios.motion import Axis
from scenarios.table import read_table

Array = NDArray[np.float64]
_AXES: tuple[Axis, ...] = ("x", "y", "z")
_LARGEST = 1e3
"""Force beyond which a file is not in newtons [N]."""


class Setpoint:
    """Wished contact force at every control instant, and beyond the end for the last preview."""

    def __init__(
        self, config: SetpointConfig, axes: Sequence[Axis], cycles: int, horizon: int, period: float
    ) -> None:
        """Lay the setpoint out.

        Args:
            config: start and changes, or the file that has them.
            axes: which axes, in the order of the columns.
            cycles, horizon: steps of the run and of the preview.
            period: control period [s].

        Raises:
            DataFileError: the file cannot be used. DataTooShortError: it ends before the run.
        """
        length = cycles + horizon
        self.force = (
            _laid_out(config, axes, length, period)
            if config.file is None
            else _recorded(Path(config.file), axes, cycles, length, period)
        )
        """Setpoint, ``(cycles + horizon, n_axes)`` [N]."""
        self.start = np.array([getattr(config, axis) for axis in _AXES], dtype=np.float64)
        """Where it begins, on all three axes, ``(3,)`` [N]."""
        self.start[[_AXES.index(axis) for axis in axes]] = self.force[0]
        self._horizon = horizon
        self._unseen = None if config.preview else np.zeros((horizon + 1, len(axes)))

    def preview(self, k: int) -> Array:
        """Return s(k) ... s(k+N), ``(N + 1, n_axes)`` [N], valid until the next call.

        Where nothing is known ahead, s(k) stands for all of them.
        """
        if self._unseen is not None:
            self._unseen[:] = self.force[k]
            return self._unseen
        return self.force[k : k + self._horizon + 1]


def _laid_out(config: SetpointConfig, axes: Sequence[Axis], length: int, period: float) -> Array:
    force = np.tile([float(getattr(config, axis)) for axis in axes], (length, 1))
    for step in config.steps:
        start, end = round(step.time / period), round((step.time + step.ramp) / period)
        for j, axis in enumerate(axes):
            value = getattr(step, axis)
            if value is None or start >= length:
                continue
            ramp = np.linspace(force[start, j], value, end - start, endpoint=False)
            force[start:, j] = value
            force[start:end, j] = ramp[: length - start]
    return force


def _recorded(path: Path, axes: Sequence[Axis], cycles: int, length: int, period: float) -> Array:
    """Read a wish of any sampling: straight between its rows, held after the last one."""
    table = read_table(path, ("t", *axes), min_rows=2)
    time = table.values[:, 0] - table.values[0, 0]
    large = np.argwhere(np.abs(table.values[:, 1:]) > _LARGEST)
    if large.size:
        row, column = large[0]
        reason = (
            f"column {axes[column]!r} is {table.values[row, column + 1]:g} N; at most "
            f"{_LARGEST:g} N can be wished for (is it in newtons?)"
        )
        raise DataFileError(path, int(table.lines[row]), reason)
    # half a nanosecond of slack: times printed with nine decimals are rounded
    if (cycles - 1) * period > time[-1] + 0.5e-9:
        longest = float(time[-1]) + period
        reason = (
            f"the recorded setpoint lasts {time[-1]:.6g} s, the run {cycles * period:.6g} s; "
            f"a run of at most {np.floor(longest * 1e3) / 1e3:.6g} s can follow it"
        )
        raise DataTooShortError(path, longest, cycles * period, reason)
    instants = np.arange(length) * period
    return np.column_stack([np.interp(instants, time, values) for values in table.values[:, 1:].T])
