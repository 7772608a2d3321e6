"""The reference trajectory: an exponential approach to a setpoint that may be known ahead."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from qpmpc.arrays import Array
from qpmpc.errors import ModelError

Reference = Callable[[Array, Array], Array]
"""From preview ``(N + 1, n_outputs)`` and output ``(n_outputs,)`` to w ``(N, n_outputs)``."""


class ExponentialReference:
    """Reference over the horizon, ``w(k+i) = s(k+i) - alpha^i (s(k) - y(k))``, i = 1..N.

    ``alpha = exp(-period / time_constant)`` is the paper's decay (its second use of lambda,
    reading 9); a time constant of 0 asks for the setpoint at once.
    """

    def __init__(self, horizon: int, n_outputs: int, period: float, time_constant: float) -> None:
        """Prepare for ``horizon`` steps of ``period`` [s] with ``time_constant`` [s] >= 0."""
        if not time_constant >= 0:
            raise ModelError(f"time_constant must not be negative, got {time_constant} s")
        self.alpha = math.exp(-period / time_constant) if time_constant > 0 else 0.0
        self.decay = self.alpha ** np.arange(1, horizon + 1)
        """alpha^i, i = 1..N, ``(N,)``."""
        self._decay = np.repeat(self.decay[:, None], n_outputs, axis=1)
        self._trajectory = np.empty((horizon, n_outputs))

    def __call__(self, preview: Array, output: Array) -> Array:
        """Return the reference ``(N, n_outputs)``; valid until the next call.

        Args:
            preview: setpoint s(k) ... s(k+N), ``(N + 1, n_outputs)``.
            output: present output y(k), ``(n_outputs,)``.
        """
        w = self._trajectory
        np.multiply(self._decay, output - preview[0], out=w)
        w += preview[1:]
        return w
