"""The setpoint of a running experiment: moved to what is wished for at a bounded rate."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scenarios.config import LiveConfig, SetpointConfig
from scenarios.motion import Axis

Array = NDArray[np.float64]


class RunningWish:
    """Wished contact force; nothing is known ahead, so the preview is constant."""

    def __init__(
        self, start: SetpointConfig, axes: Sequence[Axis], horizon: int, period: float
    ) -> None:
        """Begin with the setpoint of a scenario, of ``axes``; ``period`` of control [s]."""
        self._axes, self._most = tuple(axes), LiveConfig(port=1024).largest_rate * period
        self.target = self._of(start)
        """What is wished for, ``(n_axes,)`` [N]."""
        self._preview = np.tile(self.target, (horizon + 1, 1))

    @property
    def present(self) -> Array:
        """The setpoint of this cycle, ``(n_axes,)`` [N]."""
        present: Array = self._preview[0]
        return present

    def aim(self, wished: SetpointConfig) -> None:
        """Wish for another force."""
        self.target = self._of(wished)

    def advance(self) -> None:
        """Go on by a cycle."""
        if np.array_equal(self._preview[0], self.target):
            return
        change = self.target - self._preview[0]
        self._preview += np.clip(change, -self._most, self._most)
        reached = np.abs(change) <= self._most
        self._preview[:, reached] = self.target[reached]

    def preview(self, k: int) -> Array:  # noqa: ARG002
        """Return the present setpoint for the whole horizon, ``(N + 1, n_axes)`` [N]."""
        return self._preview

    def _of(self, config: SetpointConfig) -> Array:
        return np.array([getattr(config, axis) for axis in self._axes], dtype=np.float64)
