"""The force that the tissue's motion causes, as a signal known ahead.

A linear contact adds up: ``F = F_tool + F_motion``, the force that the tool's own motion causes on
tissue at rest and the one that the tissue's motion causes on a tool at rest. The first follows from
the encoders without noise, the second is what is left of the measured force. `MotionEstimator` says
what it is and will be; to the controller it is a change of the setpoint and of the bounds on force.
"""

from __future__ import annotations

import numpy as np

from qpmpc.arrays import Array, all_finite
from qpmpc.config import ModelConfig, ObserverConfig
from qpmpc.rhythm.estimator import Motion, MotionEstimator


class MotionPreview:
    """Splits the measured force of one to three axes and previews what is not the tool's."""

    def __init__(
        self,
        model: ModelConfig,
        observer: ObserverConfig,
        axes: int,
        period: float,
        horizon: int,
    ) -> None:
        """Set up.

        Args:
            model, observer: see there; the disturbance is ``tracked`` or ``beats``.
            axes: number of axes.
            period: control period [s].
            horizon: N, steps that are previewed.
        """
        rhythm, synchronised = observer.rhythm, observer.disturbance == "beats"
        self._stiffness, self._damping, self._period = model.stiffness, model.damping, period
        self.estimator = MotionEstimator(
            axes,
            period,
            Motion(
                observer.force_noise,
                model.stiffness * rhythm.jerk_drift,
                model.stiffness * rhythm.residual_jerk_drift,
                rhythm.memory,
                rhythm.amplitude_spread,
                rhythm.amplitude_memory,
                rhythm.beat_delay if synchronised else rhythm.interval_spread,
            ),
            synchronised=synchronised,
        )
        self._behind = False
        self._spring, self._velocity = np.zeros(axes), np.zeros(axes)
        self.tool = np.zeros(axes)
        """F_tool of this cycle, ``(axes,)`` [N]: zero where the tool began."""
        self.motion = np.zeros((horizon + 1, axes))
        """F_motion at k ... k+N, ``(N + 1, axes)`` [N]."""

    def reset(self) -> None:
        """Start anew, with the tool where it is."""
        self.estimator.reset()
        self._behind = False
        for memory in (self._spring, self._velocity, self.tool, self.motion):
            memory[:] = 0.0

    def advance(self) -> None:
        """Go on to the next cycle; who leaves it out gets it done by the next `update`."""
        if self._behind:
            self.estimator.advance()
            self._behind = False

    def beat(self) -> None:
        """Tell that an R peak has come since the last `update`."""
        self.advance()
        self.estimator.beat()

    def adopt(self, force: Array) -> None:
        """Let the whole force be ``force (axes,)`` [N], and forget how the tissue moved."""
        self.estimator.reset()
        self.estimator.correct(force - self.tool)
        self.motion[:] = force - self.tool

    def update(self, force: Array, velocity: Array) -> None:
        """Take the measurements of this cycle, ``(axes,)`` each [N], [m/s].

        Where the velocity is not finite the last one is taken to go on; where the force is not,
        the motion goes on as expected.
        """
        self.advance()
        self._behind = True
        self._spring += (0.5 * self._period * self._stiffness) * self._velocity
        if all_finite(velocity):
            self._velocity[:] = velocity
        self._spring += (0.5 * self._period * self._stiffness) * self._velocity
        np.multiply(self._damping, self._velocity, out=self.tool)
        self.tool += self._spring
        self.estimator.correct(force - self.tool)
        self.estimator.preview(self.motion)
