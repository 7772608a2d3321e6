"""The setpoint over a run, with the preview that the reference needs."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenarios.config import SetpointConfig
from scenarios.motion import Axis

Array = NDArray[np.float64]


class Setpoint:
    """Wished contact force at every control instant, and beyond the end for the last preview."""

    def __init__(
        self, config: SetpointConfig, axes: Sequence[Axis], cycles: int, horizon: int, period: float
    ) -> None:
        """Lay the setpoint out.

        Args:
            config: start and changes.
            axes: which axes, in the order of the columns.
            cycles, horizon: steps of the run and of the preview.
            period: control period [s].
        """
        self.force = np.tile([float(getattr(config, axis)) for axis in axes], (cycles + horizon, 1))
        """Setpoint, ``(cycles + horizon, n_axes)`` [N]."""
        for step in config.steps:
            start = round(step.time / period)
            for j, axis in enumerate(axes):
                value = getattr(step, axis)
                if value is not None:
                    self.force[start:, j] = value
        self._horizon = horizon

    def preview(self, k: int) -> Array:
        """Return s(k) ... s(k+N), ``(N + 1, n_axes)`` [N], a view."""
        return self.force[k : k + self._horizon + 1]
