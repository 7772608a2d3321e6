"""Linear discrete systems with feed-through: responses, poles, noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_discrete_lyapunov

from qpmpc.arrays import Array

Complex = np.typing.NDArray[np.complex128]


@dataclass(frozen=True, eq=False)
class System:
    """``x(k+1) = A x(k) + B u(k)``, ``y(k) = C x(k) + D u(k)``."""

    A: Array
    B: Array
    C: Array
    D: Array
    period: float
    """Sampling period [s]."""

    @property
    def poles(self) -> Complex:
        """Eigenvalues of A, ``(n,)``."""
        return np.linalg.eigvals(self.A).astype(np.complex128)

    @property
    def radius(self) -> float:
        """Largest magnitude of a pole; the system is stable below 1."""
        return float(np.abs(self.poles).max(initial=0.0))

    def response(self, omega: Array) -> Complex:
        """Return the frequency response at ``omega (n_w,)`` [rad/s], ``(n_w, n_y, n_u)``."""
        z = np.exp(1j * omega * self.period)
        if not self.A.size:
            return np.broadcast_to(self.D, (omega.size, *self.D.shape)).astype(np.complex128)
        resolvent = z[:, None, None] * np.eye(self.A.shape[0]) - self.A
        states = np.linalg.solve(resolvent, np.broadcast_to(self.B, (z.size, *self.B.shape)))
        return np.asarray(self.C @ states + self.D)

    def deviation(self, noise: Array) -> Array:
        """Return the standard deviation of each output under white noise at the inputs.

        Args:
            noise: standard deviation of each input, ``(n_u,)``.
        """
        V = np.diag(noise**2)
        P = solve_discrete_lyapunov(self.A, self.B @ V @ self.B.T)
        return np.asarray(np.sqrt(np.diag(self.C @ P @ self.C.T + self.D @ V @ self.D.T)))

    def simulate(self, inputs: Array) -> Array:
        """Return the outputs ``(n_k, n_y)`` from rest under ``inputs (n_k, n_u)``."""
        x, outputs = np.zeros(self.A.shape[0]), np.empty((len(inputs), self.C.shape[0]))
        for k, u in enumerate(inputs):
            outputs[k] = self.C @ x + self.D @ u
            x = self.A @ x + self.B @ u
        return outputs

    def part(self, outputs: slice | list[int], inputs: slice | list[int]) -> System:
        """Return the system from some of its inputs to some of its outputs."""
        D = self.D[outputs][:, inputs]
        return System(self.A, self.B[:, inputs], self.C[outputs], D, self.period)
