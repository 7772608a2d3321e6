"""Augment the model, never the algorithm: delays and disturbances become states of (A, B, C).

Prediction matrices, QP, observer and backends never learn what a state stands for. The free
response ``Psi x`` of an augmented model previews the disturbance over the horizon by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from qpmpc.arrays import Array, matrix
from qpmpc.errors import ModelError
from qpmpc.models import LinearModel


def with_delay(model: LinearModel, cycles: int) -> LinearModel:
    """Delay every input by whole cycles: ``x(k+1) = A x(k) + B u(k - cycles)``.

    The ``cycles * n_inputs`` new states, appended in order of age, are the commands that are under
    way: the newest first. The output matrix does not see them.
    """
    if cycles < 0:
        raise ModelError(f"delay must not be negative, got {cycles} cycles")
    if cycles == 0:
        return model
    n, m = model.n_states, model.n_inputs
    registers = cycles * m
    A = np.zeros((n + registers, n + registers))
    A[:n, :n] = model.A
    A[:n, n + registers - m :] = model.B
    A[n + m :, n : n + registers - m] = np.eye(registers - m)
    B = np.zeros((n + registers, m))
    B[n : n + m] = np.eye(m)
    return LinearModel(
        A, B, np.hstack([model.C, np.zeros((model.n_outputs, registers))]), model.period
    )


@dataclass(frozen=True, eq=False)
class Exosystem:
    """Autonomous model of a disturbance: ``w(k+1) = S w(k)``, ``d(k) = H w(k)``."""

    S: Array
    """State matrix, ``(n_w, n_w)``."""
    H: Array
    """Output matrix, ``(n_d, n_w)``."""

    def __post_init__(self) -> None:
        S = matrix("S", self.S)
        matrix("S", S, S.shape[0], S.shape[0])
        object.__setattr__(self, "S", S)
        object.__setattr__(self, "H", matrix("H", self.H, columns=S.shape[0]))


def constant() -> Exosystem:
    """A disturbance that stays as it is: state ``d``."""
    return Exosystem(np.ones((1, 1)), np.ones((1, 1)))


def ramp(period: float) -> Exosystem:
    """A disturbance that goes on at its present rate: states ``d`` and ``dd/dt`` [1/s]."""
    return Exosystem(np.array([[1.0, period], [0.0, 1.0]]), np.array([[1.0, 0.0]]))


def parabola(period: float) -> Exosystem:
    """A disturbance that goes on with its present slope and curvature: ``d, d', d''``."""
    S = np.array([[1.0, period, period**2 / 2], [0.0, 1.0, period], [0.0, 0.0, 1.0]])
    return Exosystem(S, np.array([[1.0, 0.0, 0.0]]))


def oscillator(frequency: float, period: float) -> Exosystem:
    """A sinusoidal disturbance of known frequency [Hz]: states ``d`` and its quadrature."""
    if not 0 < frequency < 0.5 / period:
        raise ModelError(f"frequency must lie in (0, {0.5 / period:g}) Hz, got {frequency}")
    angle = 2 * np.pi * frequency * period
    c, s = np.cos(angle), np.sin(angle)
    return Exosystem(np.array([[c, s], [-s, c]]), np.array([[1.0, 0.0]]))


def combined(*exosystems: Exosystem) -> Exosystem:
    """One disturbance that is the sum of several: offset plus breath plus heart beat, say."""
    S = block_diag(*(e.S for e in exosystems))
    return Exosystem(S, np.hstack([e.H for e in exosystems]))


def with_disturbance(model: LinearModel, channel: ArrayLike, exosystem: Exosystem) -> LinearModel:
    """Add a disturbance: ``x(k+1) = A x + B u + channel d``, ``d = H w``, ``w(k+1) = S w``.

    Args:
        model: the model so far, with ``n`` states.
        channel: how ``d`` enters the states, ``(n, n_d)``; ``model.B`` for a matched disturbance.
            Rows may be fewer than ``n`` where later augmentation has appended states (delay
            registers, other disturbances) that this one does not drive: zeros are added.
        exosystem: what is known about ``d``; its states are appended.
    """
    channel = matrix("channel", channel, columns=exosystem.H.shape[0])
    n, n_w = model.n_states, exosystem.S.shape[0]
    missing = n - channel.shape[0]
    if missing < 0:
        raise ModelError(f"channel has {channel.shape[0]} rows, the model only {n} states")
    A = block_diag(model.A, exosystem.S)
    A[: channel.shape[0], n:] = channel @ exosystem.H
    B = np.vstack([model.B, np.zeros((n_w, model.n_inputs))])
    C = np.hstack([model.C, np.zeros((model.n_outputs, n_w))])
    return LinearModel(A, B, C, model.period)
