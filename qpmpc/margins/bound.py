"""What no controller can do better: predict over the delay what it cannot know."""

from __future__ import annotations

import numpy as np

from qpmpc.arrays import Array
from qpmpc.kalman import subsystems


def prediction_error(
    A: Array, C: Array, W: Array, V: Array, *, output: Array, cycles: int
) -> Array:
    """Return the steady standard deviation of outputs predicted ``cycles`` ahead, ``(n_y,)``.

    A command that is decided on the measurements up to k and acts from k + cycles on cannot
    influence what of the output at k + cycles these measurements do not tell: whatever the
    controller, the RMS of the error is no less. It holds in the world of the model: Gaussian noise
    of covariance W and V, and nothing else known of the disturbance.

    Args:
        A, C: state matrix and measured rows.
        W, V: covariance of process and measurement noise.
        output: rows of the outputs, ``(n_y, n)``.
        cycles: how far ahead; 0: the estimate itself.

    Raises:
        ObserverError: what is measured does not determine what does not decay by itself.
    """
    P = np.zeros_like(A)
    for part in subsystems(A, C, W, V):
        P[np.ix_(part.states, part.states)] = part.P / np.outer(part.state_scale, part.state_scale)
    for _ in range(cycles):
        P = A @ P @ A.T + W
    return np.asarray(np.sqrt(np.diag(output @ P @ output.T)))
