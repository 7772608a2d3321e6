"""The prediction matrices Psi, Upsilon and Theta (eqs. (10), (11)) for any (A, B, C)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from qpmpc.arrays import Array, matrix
from qpmpc.errors import ModelError
from qpmpc.models import LinearModel


@dataclass(frozen=True, eq=False)
class Prediction:
    """Outputs over the horizon, ``y_hat = Psi x(k) + Upsilon u(k-1) + Theta z``.

    ``y_hat`` stacks y(k+1) ... y(k+N), outputs of one step side by side. The decision ``z`` stacks
    the increments Delta u(k) ... Delta u(k+N_u-1) — or the absolute commands, where the matrices
    were built by `absolute_prediction`, and then Upsilon is zero.
    """

    Psi: Array
    """Free response to the state, ``(N * n_outputs, n)``: rows C A, C A^2, ..., C A^N."""
    Upsilon: Array
    """Response to the command held at u(k-1), ``(N * n_outputs, n_inputs)``: the step response."""
    Theta: Array
    """Response to the decision, ``(N * n_outputs, N_u * n_inputs)``: lower block-Toeplitz."""


def prediction(
    model: LinearModel,
    horizon: int,
    control_horizon: int | None = None,
    output: ArrayLike | None = None,
) -> Prediction:
    """Build Psi, Upsilon and Theta for command *increments* (reading 5 of ``docs/mathematics.md``).

        Psi_i = C A^i,   Upsilon_i = sum_{j<i} C A^j B,   Theta_{i,j} = Upsilon_{i-j+1}  (i >= j)

    Args:
        model: (A, B, C).
        horizon: N >= 1, steps that are predicted.
        control_horizon: N_u in 1..N, increments that are free, the later ones being zero; N if
            not given.
        output: another output matrix in place of ``model.C``, ``(n_outputs, n)``: velocity rows
            are the same construction as force rows.

    Raises:
        ModelError: N or N_u out of range. ShapeError: ``output`` does not fit the states.
    """
    moves = check_horizons(horizon, control_horizon)
    Psi, markov = _responses(model, horizon, output)
    step = np.cumsum(markov, axis=0)
    n_y, n_u = step.shape[1:]
    return Prediction(Psi, step.reshape(horizon * n_y, n_u), _toeplitz(step, moves))


def absolute_prediction(
    model: LinearModel,
    horizon: int,
    control_horizon: int | None = None,
    output: ArrayLike | None = None,
) -> Prediction:
    """Build the same for *absolute* commands: eq. (10) read to the letter, Theta times u.

    The Toeplitz blocks are then the pulse response C A^i B, and the command stays at its last
    value after N_u steps. Arguments and errors as for `prediction`.
    """
    moves = check_horizons(horizon, control_horizon)
    Psi, markov = _responses(model, horizon, output)
    n_y, n_u = markov.shape[1:]
    Theta = _toeplitz(markov, moves)
    tail = np.cumsum(markov, axis=0)
    for i in range(moves, horizon):  # the last free command is held from step N_u on
        rows = slice(i * n_y, (i + 1) * n_y)
        Theta[rows, (moves - 1) * n_u :] = tail[i - moves + 1]
    return Prediction(Psi, np.zeros((horizon * n_y, n_u)), Theta)


def check_horizons(horizon: int, control_horizon: int | None) -> int:
    """Return N_u, N if not given.

    Raises:
        ModelError: N or N_u out of range.
    """
    if horizon < 1:
        raise ModelError(f"horizon must be at least 1 step, got {horizon}")
    moves = horizon if control_horizon is None else control_horizon
    if not 1 <= moves <= horizon:
        raise ModelError(f"control_horizon must lie in 1..{horizon} (the horizon), got {moves}")
    return moves


def _responses(model: LinearModel, horizon: int, output: ArrayLike | None) -> tuple[Array, Array]:
    """Return Psi ``(N * n_y, n)`` and the Markov parameters C A^i B ``(N, n_y, n_u)``."""
    C = model.C if output is None else matrix("output", output, columns=model.n_states)
    n_y = C.shape[0]
    Psi = np.empty((horizon * n_y, model.n_states))
    markov = np.empty((horizon, n_y, model.n_inputs))
    power = C
    for i in range(horizon):
        markov[i] = power @ model.B
        power = power @ model.A
        Psi[i * n_y : (i + 1) * n_y] = power
    return Psi, markov


def _toeplitz(blocks: Array, moves: int) -> Array:
    horizon, n_y, n_u = blocks.shape
    Theta = np.zeros((horizon * n_y, moves * n_u))
    column = blocks.reshape(horizon * n_y, n_u)
    for j in range(moves):
        Theta[j * n_y :, j * n_u : (j + 1) * n_u] = column[: (horizon - j) * n_y]
    return Theta
