"""A plant and a law around it: transfer at the plant's input, closed loop, rejection, noise."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from qpmpc.arrays import Array
from qpmpc.margins.plant import TruePlant
from qpmpc.margins.system import Complex, System


@dataclass(frozen=True, eq=False)
class Loop:
    """One axis under control, linear."""

    plant: TruePlant
    law: System
    """Inputs setpoint, force and, where it is measured, velocity; output command."""

    @cached_property
    def sampled(self) -> System:
        """The plant from instant to instant."""
        return self.plant.sampled(self.law.period)

    @property
    def rows(self) -> int:
        """How many of the plant's outputs the law measures: the force, and maybe the velocity."""
        return int(self.law.B.shape[1]) - 1

    def transfer(self, omega: Array) -> Complex:
        """Return the loop transfer, broken at the plant's input, ``(n_w,)``; -1 is critical."""
        forward = self.sampled.part(slice(0, self.rows), slice(2, 3)).response(omega)
        back = self.law.part(slice(0, 1), slice(1, None)).response(omega)
        return np.asarray(-(back @ forward)[:, 0, 0])

    @cached_property
    def closed(self) -> System:
        """The closed loop.

        Inputs: velocity of the tissue v_e [m/s], disturbing acceleration d [m/s^2], setpoint [N],
        noise of the force sensor [N], and of the velocity [m/s] where it is measured. Outputs:
        force [N], velocity of the tool [m/s], command [m/s^2].
        """
        return closed_loop(self.sampled, self.law)

    @property
    def stable(self) -> bool:
        """Whether the closed loop is."""
        return self.closed.radius < 1.0

    def rejection(self, omega: Array) -> Array:
        """Return how much is left of the force that the tissue's motion causes, ``(n_w,)``.

        ``|F / (K_s x_e)|``: 1 is what a tool that is held still feels.
        """
        closed = self.closed.part(slice(0, 1), slice(0, 1)).response(omega)[:, 0, 0]
        z = np.exp(1j * omega * self.law.period)
        per_position = closed * (z - 1) / self.law.period  # v_e is held: what x_e moves in a period
        return np.asarray(np.abs(per_position) / self.plant.stiffness)

    def noise(self, force: float, velocity: float) -> tuple[float, float]:
        """Return what white noise of the sensors does: RMS of the true force, of Delta u.

        Args:
            force, velocity: standard deviations [N, m/s].
        """
        given = np.zeros(self.closed.B.shape[1])
        given[3:] = (force, velocity)[: self.rows]
        closed = self.closed
        increment = _increments(closed)
        return (
            float(closed.part(slice(0, 1), slice(None)).deviation(given)[0]),
            float(increment.deviation(given)[0]),
        )


def closed_loop(P: System, K: System) -> System:
    """Return a sampled plant under a law; inputs and outputs as those of `Loop.closed`."""
    m = K.B.shape[1] - 1
    c = K.A.shape[0]
    Bu, Cm, Dm, Dy = P.B[:, 2:], P.C[:m], P.D[:m, :2], K.D[:, 1:]
    A = np.block([[P.A + Bu @ Dy @ Cm, Bu @ K.C], [K.B[:, 1:] @ Cm, K.A]])
    B = np.block([
        [P.B[:, :2] + Bu @ Dy @ Dm, Bu @ K.D[:, :1], Bu @ Dy],
        [K.B[:, 1:] @ Dm, K.B[:, :1], K.B[:, 1:]],
    ])  # fmt: skip
    C = np.block([[P.C, np.zeros((2, c))], [Dy @ Cm, K.C]])
    D = np.block([
        [P.D[:, :2], np.zeros((2, 1 + m))],
        [Dy @ Dm, K.D[:, :1], Dy],
    ])  # fmt: skip
    return System(A, B, C, D, P.period)


def _increments(closed: System) -> System:
    """From the closed loop's inputs to the change of the command per cycle."""
    C, D = closed.C[2:3], closed.D[2:3]
    A = np.block([[closed.A, np.zeros((len(closed.A), 1))], [C, np.zeros((1, 1))]])
    B = np.vstack([closed.B, D])
    return System(A, B, np.hstack([C, -np.ones((1, 1))]), D, closed.period)
