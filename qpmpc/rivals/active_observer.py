"""Two active observers: one for the force under control, one for the motion of the tissue.

The active observer (AOB) of Cortesao (On Kalman Active Observers, Journal of Intelligent and
Robotic Systems 48, 2007) is a Kalman filter for the closed loop that is wished for, with one state
more: p, an equivalent disturbance at the input, which the filter takes for a random walk.

    [x; p](k+1) = [Φ Γ; 0 1] [x; p](k) + [Γ; 0] u(k) + noise,     y = C x + noise
    u = L (x_ref - x) - p                                         so that x follows Φ - Γ L

L places the poles. As in the paper's ref. [10] a second one stands beside it for the motion. What
it measures is where the tissue is: the tool's way, summed from its encoders, minus y / K_s. Its
active state is the tissue's acceleration, with a second-order random walk (AOB-2). From it,

    a_e + K2 v_e     at the time when a command of now will act

is added to the command, which cancels the motion (``docs/mathematics.md``, section 1). The force
observer is told the command without that share; p is what the two leave over.
"""

from __future__ import annotations

import numpy as np

from qpmpc.arrays import Array
from qpmpc.augment import constant, with_delay, with_disturbance
from qpmpc.config import ControllerConfig
from qpmpc.contact import contact_model
from qpmpc.errors import ModelError
from qpmpc.models import LinearModel, zero_order_hold
from qpmpc.observer import kalman_gain
from qpmpc.rivals.law import Mask

_UNMODELLED_FORCE = 1e-6
"""Change of the force per cycle that no model explains [N]: keeps the Riccati equation regular."""


class AxisObserver:
    """A steady-state Kalman filter of one measurement, the same for several axes."""

    def __init__(self, A: Array, B: Array, C: Array, noise: Array, deviation: float) -> None:
        """Compute the gain.

        Args:
            A, B, C: of the model with its active state, ``(n, n)``, ``(n, 1)``, ``(1, n)``.
            noise: change of each state per cycle, standard deviation, ``(n,)``.
            deviation: standard deviation of what is measured.

        Raises:
            ObserverError: there is no such observer.
        """
        self._A, self._B, self._C = np.array(A), np.array(B), np.array(C)
        self._gain = kalman_gain(A, C, np.diag(np.square(noise)), np.array([[deviation**2]]))

    def start(self, n_axes: int) -> None:
        """Make room for the states of so many axes, all zero."""
        self.state = np.zeros((self._A.shape[0], n_axes))
        self._next, self._work = np.zeros_like(self.state), np.zeros_like(self.state)
        self._innovation = np.zeros((1, n_axes))

    def correct(self, measurement: Array, known: Mask) -> None:
        """Blend in ``(n_axes,)`` where known; elsewhere the prediction stands."""
        innovation = np.dot(self._C, self.state, out=self._innovation)
        np.subtract(measurement, innovation, out=innovation)
        innovation *= known
        self.state += np.dot(self._gain, innovation, out=self._work)

    def predict(self, command: Array) -> None:
        """Advance by one cycle under ``(n_axes,)``."""
        np.dot(self._A, self.state, out=self._next)
        self._next += np.multiply(self._B, command, out=self._work)
        self.state[:] = self._next


class ActiveObserverLaw:
    """The law of this module, for several axes."""

    def __init__(self, config: ControllerConfig, n_axes: int, period: float) -> None:
        """Design both observers and the feedback from ``config.aob``, ``model`` and ``observer``.

        Raises:
            ModelError, ObserverError: they cannot be had.
        """
        own, model = config.aob, config.model
        self._stiffness, self._period = model.stiffness, period
        contact = contact_model(model.stiffness, model.velocity_damping, period, lag=model.lag)
        plant = with_delay(contact.model, model.delay)
        active = with_disturbance(plant, plant.B, constant())
        noise = np.zeros(active.n_states)
        noise[0], noise[-1] = _UNMODELLED_FORCE, own.disturbance_drift
        deviation = config.observer.force_noise
        self._force = AxisObserver(active.A, active.B, active.C, noise, deviation)
        poles = np.zeros(plant.n_states)
        poles[:2] = np.exp(-period / own.closed_loop_time)
        if model.lag > 0:  # what decays by itself costs nothing if it is left to it
            poles[2] = np.exp(-period / model.lag)
        feedback = place(plant, poles)
        self._feedback = np.append(feedback, 1.0)[None]
        self._gain = float(feedback[0, 0])
        A, _ = zero_order_hold(np.diag(np.ones(3), 1), np.zeros((4, 1)), period)
        self._motion = AxisObserver(
            A,
            np.zeros((4, 1)),
            np.eye(1, 4),
            np.array([0.0, 0.0, 0.0, own.jerk_drift]),
            deviation / model.stiffness,
        )
        # A command acts after the delay, the lag, and half of the period over which it is held.
        later = model.delay * period + model.lag + period / 2
        self._compensation = compensation(model.velocity_damping, later)
        self._way, self._velocity, self._work = np.zeros((3, n_axes))
        self._motion_share, self._wished = np.zeros((1, n_axes)), np.zeros((1, n_axes))
        self._adopted = False
        for observer in (self._force, self._motion):
            observer.start(n_axes)

    @property
    def disturbance(self) -> Array:
        """Active state of the force observer, ``(n_axes,)`` [m/s^2]."""
        found: Array = self._force.state[-1]
        return found

    def reset(self, force: Array) -> None:
        """See `Law.reset`."""
        for observer in (self._force, self._motion):
            observer.state[:] = 0.0
        self._force.state[0] = force
        np.divide(force, self._stiffness, out=self._way)  # so that the tissue begins at 0
        self._velocity[:] = 0.0
        self._adopted = False

    def decide(self, force: Array, velocity: Array, setpoint: Array, known: Mask) -> Array:
        """See `Law.decide`."""
        work = np.add(velocity, self._velocity, out=self._work)
        work *= self._period / 2
        self._way += work
        self._velocity[:] = velocity
        if self._adopted:  # the tissue has not moved because another force counts
            np.divide(force, self._stiffness, out=self._way)
            self._way += self._motion.state[0]
            self._adopted = False
        np.divide(force, -self._stiffness, out=work)
        work += self._way
        self._motion.correct(work, known)
        self._force.correct(force, known)
        np.dot(self._compensation, self._motion.state, out=self._motion_share)
        wished = np.dot(self._feedback, self._force.state, out=self._wished)
        np.subtract(self._motion_share, wished, out=wished)
        command: Array = wished[0]
        command += np.multiply(setpoint, self._gain, out=work)
        return command

    def settle(self, command: Array) -> None:
        """See `Law.settle`: both observers advance."""
        np.subtract(command, self._motion_share[0], out=self._work)
        self._force.predict(self._work)
        self._work[:] = 0.0
        self._motion.predict(self._work)

    def adopt(self, force: Array) -> None:
        """See `Law.adopt`."""
        self._force.state[0] = force
        self._adopted = True


def compensation(damping: float, later: float) -> Array:
    """Return the row that makes a_e + K2 v_e, ``later`` [s] ahead, of position to jerk, ``(1, 4)``.

    Args:
        damping: K2 [1/s].
        later: how far ahead [s]; the jerk is taken to go on.
    """
    return np.array(
        [[0.0, damping, 1.0 + damping * later, later + damping * later**2 / 2]], dtype=np.float64
    )


def place(model: LinearModel, poles: Array) -> Array:
    """Return L, ``(1, n)``, so that A - B L has the poles: Ackermann's formula, one input.

    Raises:
        ModelError: the input does not reach every state.
    """
    n = model.n_states
    scale = np.maximum(np.abs(_reach(model.A, model.B)).max(axis=1), 1e-300)
    A, B = model.A * scale / scale[:, None], model.B / scale[:, None]
    reach = _reach(A, B)
    if np.linalg.matrix_rank(reach) < n:
        raise ModelError("the command does not reach every state of the model")
    polynomial = np.eye(n)
    for pole in poles:
        polynomial = polynomial @ (A - pole * np.eye(n))
    last = np.linalg.solve(reach.T, np.eye(n)[-1])
    return np.asarray((last @ polynomial / scale)[None])


def _reach(A: Array, B: Array) -> Array:
    columns = [B]
    for _ in range(A.shape[0] - 1):
        columns.append(A @ columns[-1])
    return np.hstack(columns)
