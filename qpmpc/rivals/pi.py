"""PI control of the force around a velocity loop, with feed-forward of the tissue's velocity.

With e = s - y and the filtered velocity of the tissue, as encoders and force sensor tell it,

    v_e = v - (dy/dt) / K_s                                   low-pass, time constant filter_time
    v*  = (proportional e + integral ∫ e dt) / K_s + feedforward v_e
    u   = K2 v + velocity (v* - v)

K2 v takes the damping of the inner loop out, so that ``velocity`` is the loop's gain. A force loop
around a velocity loop is the textbook's (Siciliano et al., Robotics, 2009, section 9.3); motion fed
forward into it is what Yuen et al. (IEEE Transactions on Robotics 26, 2010) do with the tissue's
motion from ultrasound, for which encoders and force sensor stand in here.
"""

from __future__ import annotations

import math

import numpy as np

from qpmpc.arrays import Array
from qpmpc.config import ControllerConfig
from qpmpc.rivals.law import Mask


class PiLaw:
    """The law of this module, for several axes; the integral stops where the command is clipped."""

    def __init__(self, config: ControllerConfig, n_axes: int, period: float) -> None:
        """Take gains from ``config.pi``, stiffness and K2 from ``config.model``."""
        gains, stiffness = config.pi, config.model.stiffness
        self._proportional = gains.proportional / stiffness
        self._integral = gains.integral / stiffness * period
        self._velocity = gains.velocity
        self._damping = config.model.velocity_damping - gains.velocity
        self._forward = gains.feedforward
        self._slope = 1.0 / (stiffness * period)
        self._share = -math.expm1(-period / gains.filter_time) if gains.filter_time > 0 else 1.0
        self._sum, self._gain = np.zeros(n_axes), np.zeros(n_axes)
        self._last, self._tissue = np.zeros(n_axes), np.zeros(n_axes)
        self._error, self._work = np.zeros(n_axes), np.zeros(n_axes)
        self._wished = np.zeros(n_axes)
        self._seen = np.ones(n_axes, dtype=np.bool_)

    @property
    def error(self) -> Array:
        """Force error of the last decision, ``(n_axes,)`` [N]."""
        return self._error

    def reset(self, force: Array) -> None:
        """See `Law.reset`."""
        self._last[:] = force
        self._sum[:] = 0.0
        self._gain[:] = 0.0
        self._tissue[:] = 0.0
        self._seen[:] = True

    def decide(self, force: Array, velocity: Array, setpoint: Array, known: Mask) -> Array:
        """See `Law.decide`."""
        error, work, wished = self._error, self._work, self._wished
        np.subtract(setpoint, force, out=error)
        np.subtract(force, self._last, out=work)
        self._last[:] = force
        work *= -self._slope
        work += velocity
        work -= self._tissue
        work *= self._share
        # Within a gap the force seems to stand still, and at its end to jump: the estimate waits.
        self._seen &= known
        np.add(self._tissue, work, out=self._tissue, where=self._seen)
        self._seen[:] = known
        np.multiply(error, self._integral, out=self._gain)
        self._sum += self._gain
        np.multiply(error, self._proportional, out=wished)
        wished += self._sum
        np.multiply(self._tissue, self._forward, out=work)
        wished += work
        wished *= self._velocity
        np.multiply(velocity, self._damping, out=work)
        wished += work
        return wished

    def settle(self, command: Array) -> None:
        """See `Law.settle`: what was just integrated is taken back where it would wind up."""
        np.subtract(self._wished, command, out=self._work)
        self._work *= self._gain
        np.subtract(self._sum, self._gain, out=self._sum, where=self._work > 0.0)

    def adopt(self, force: Array) -> None:
        """See `Law.adopt`."""
        self._last[:] = force
