"""The bounds over a run: constant, or changing in time with the preview that a plan needs."""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from qpmpc.config import Band, PerAxis
from scenarios.config import AxesChange, Scenario
from scenarios.errors import ScenarioError
from scenarios.motion import Axis

Array = NDArray[np.float64]
BoundName = Literal["force", "velocity", "command"]
_CHANGING: tuple[BoundName, ...] = ("force", "velocity")


class Schedule:
    """Bounds on force, velocity and command at every control instant, for the controlled axes."""

    def __init__(self, scenario: Scenario) -> None:
        """Lay the bounds out over the run and one horizon more."""
        config, axes = scenario.controller.bounds, scenario.axes
        cycles, horizon = scenario.cycles, scenario.controller.horizon
        length = cycles + horizon + 1
        self._horizon = horizon
        self._bounds: dict[BoundName, tuple[Array, Array]] = {}
        for name in get_args(BoundName):
            lower, upper = _sides(getattr(config, name), axes)
            steady = name not in _CHANGING or all(
                getattr(step, name) is None for step in scenario.bounds_steps
            )
            # What does not change is not stored for every cycle.
            lay = np.broadcast_to if steady else _repeated
            shape = (length, len(axes))
            self._bounds[name] = lay(lower, shape), lay(upper, shape)
        changed: set[BoundName] = set()
        period = scenario.cell.period
        for step in scenario.bounds_steps:
            k, last = round(step.time / period), round((step.time + step.ramp) / period)
            for name in _CHANGING:
                change = getattr(step, name)
                for j, axis in enumerate(axes):
                    band = getattr(change, axis) if isinstance(change, AxesChange) else change
                    if band is not None:
                        changed.add(name)
                        for side, value in zip(self._bounds[name], band, strict=True):
                            _turn(side[:, j], k, last, value)
        for name in changed:
            lower, upper = self._bounds[name]
            margin = getattr(config, f"{name}_margin")
            crossed = (lower + margin > upper - margin).any(axis=1)
            if crossed.any():
                when = float(crossed.argmax()) * period
                raise ScenarioError(
                    f"bounds_steps: the bounds on {name} cross, or leave no room for "
                    f"controller.bounds.{name}_margin, at t = {when:.3f} s"
                )
        changes = np.zeros(length, dtype=np.int64)
        for name in changed:
            for side, start in zip(
                self._bounds[name], _sides(getattr(config, name), axes), strict=True
            ):
                changes[0] += (side[0] != start).any()
                changes[1:] += (side[1:] != side[:-1]).any(axis=1)
        until = np.cumsum(changes)
        self.due: NDArray[np.bool_] = until[horizon : horizon + cycles] > until[:cycles]
        """Whether a cycle's preview is another than that of the one before, ``(cycles,)``; in the
        first cycle, another than the bounds at the start."""
        self.due[0] = until[horizon] > 0
        self.moving = tuple(name for name in _CHANGING if name in changed)
        """Bounds that change during the run."""

    def preview(self, name: BoundName, k: int) -> tuple[Array, Array]:
        """Return lower and upper bound at k+1 ... k+N, ``(N, n_axes)`` each, views."""
        lower, upper = self._bounds[name]
        window = slice(k + 1, k + 1 + self._horizon)
        return lower[window], upper[window]

    @property
    def first_command(self) -> tuple[Array, Array]:
        """Bounds on the command, which do not change, ``(n_axes,)`` each [m/s^2]."""
        lower, upper = self._bounds["command"]
        return lower[0], upper[0]

    def over(self, name: BoundName, cycles: int) -> tuple[Array, Array]:
        """Return lower and upper bound at the first ``cycles`` instants, ``(cycles, n_axes)``."""
        lower, upper = self._bounds[name]
        return lower[:cycles], upper[:cycles]


def _repeated(row: Array, shape: tuple[int, int]) -> Array:
    return np.tile(row, (shape[0], 1))


def _turn(side: Array, k: int, last: int, value: float) -> None:
    """Let one side of a bound move from index ``k`` to ``value`` at index ``last`` and stay."""
    if k >= side.size:
        return
    before = side[k]
    side[k:] = value
    if last > k and np.isfinite(before) and np.isfinite(value):
        ramp = np.linspace(before, value, last - k, endpoint=False)
        side[k:last] = ramp[: side.size - k]


def _sides(band: Band, axes: Sequence[Axis]) -> Array:
    """Lower and upper bound of each axis, ``(2, n_axes)``."""
    if isinstance(band, PerAxis):
        return np.array([getattr(band, axis) for axis in axes], dtype=np.float64).T
    return np.array([band] * len(axes), dtype=np.float64).T
