"""Iterative learning over known periods, on top of PI control of the force.

What heart and breath do comes again after a period P. The command that is added to that of `PiLaw`
is remembered, and bettered by the error that was left (Bristow, Tharayil, Alleyne: A Survey of
Iterative Learning Control, IEEE Control Systems Magazine 26, 2006, with what they call the
frequency-domain design); for a motion that never stops this is repetitive control:

    w(k) = Q w(k - P) + gain Q T⁺ e(k - P)          u = u_PI + w

T is what w does to the force in the closed PI loop, by the model with its delay and lag, and T⁺ its
inverse where T is not small. Q is a low-pass filter without phase, which can be had because the
past is looked at from a period later. There is one such memory for the heart, one for the breath.
The errors shrink while |Q (1 - gain T⁺ T)| < 1, as far as the motion does repeat.
"""

from __future__ import annotations

import numpy as np

from qpmpc.arrays import Array
from qpmpc.augment import with_delay
from qpmpc.config import ControllerConfig
from qpmpc.contact import contact_model
from qpmpc.errors import ModelError
from qpmpc.rivals.law import Mask
from qpmpc.rivals.pi import PiLaw

_LENGTH = 4096
"""Samples of the responses that are inverted."""
_REACH = 200
"""Samples to either side that a filter looks at, at most half a period."""
_GROWN = 1e6
"""Times the force of one impulse: what grows so large does not settle."""
_SMALL = 1e-3
"""Share of the largest power of T below which it is not inverted."""


class LearningLaw:
    """The law of this module, for several axes."""

    def __init__(self, config: ControllerConfig, n_axes: int, period: float) -> None:
        """Design the filters from ``config.ilc``, ``config.pi`` and ``config.model``.

        Raises:
            ModelError: the PI loop is not stable on the model, or a period is too short.
        """
        own = config.ilc
        self._pi = PiLaw(config, n_axes, period)
        response = closed_loop_response(config, period)
        self._memories = [
            Memory(
                response,
                n_axes,
                cycles=repeats / period,
                gain=gain,
                cutoff=own.cutoff * period,
                forgetting=own.forgetting,
            )
            for repeats, gain in (
                (own.heart_period, own.heart_gain),
                (own.breath_period, own.breath_gain),
            )
        ]
        self._learned, self._wished = np.zeros(n_axes), np.zeros(n_axes)

    def reset(self, force: Array) -> None:
        """See `Law.reset`; what was learned is forgotten."""
        self._pi.reset(force)
        for memory in self._memories:
            memory.forget()
        self._learned[:] = 0.0

    def decide(self, force: Array, velocity: Array, setpoint: Array, known: Mask) -> Array:
        """See `Law.decide`."""
        wished = self._pi.decide(force, velocity, setpoint, known)
        self._learned[:] = 0.0
        for memory in self._memories:
            self._learned += memory.recall(self._pi.error, known)
        return np.add(wished, self._learned, out=self._wished)

    def settle(self, command: Array) -> None:
        """See `Law.settle`."""
        self._pi.settle(np.subtract(command, self._learned, out=self._wished))

    def adopt(self, force: Array) -> None:
        """See `Law.adopt`."""
        self._pi.adopt(force)


class Memory:
    """What was added to the command, and the error that was left, over a period and a little more.

    Each is written twice, a length apart, so that the window that a filter looks at is always in
    one piece.
    """

    def __init__(
        self,
        response: Array,
        n_axes: int,
        *,
        cycles: float,
        gain: float,
        cutoff: float,
        forgetting: float,
    ) -> None:
        """Make the filters.

        Args:
            response: of the force to an impulse of what is added, ``(n,)`` [N s^2/m].
            n_axes: number of axes.
            cycles: the period, which need not be a whole number of them.
            gain: share of what would have prevented the error.
            cutoff: of the filter Q [1/cycle].
            forgetting: share that is forgotten each period.

        Raises:
            ModelError: the period is shorter than 4 cycles.
        """
        if not cycles >= 4:
            raise ModelError(f"a period to learn over must be 4 cycles or more, got {cycles:g}")
        whole = round(cycles)
        reach = min(_REACH, whole // 2)
        frequency = np.fft.rfftfreq(_LENGTH)
        lowpass = (1 - forgetting) * np.exp2(-0.5 * (frequency / cutoff) ** 2)
        lowpass = lowpass * np.exp(-2j * np.pi * frequency * (cycles - whole))
        spectrum = np.fft.rfft(response, _LENGTH)
        power = np.abs(spectrum) ** 2
        inverse = spectrum.conj() / (power + _SMALL * power.max())
        self._remember = _taps(lowpass, reach)
        self._better = gain * _taps(lowpass * inverse, reach)
        self._length, self._width = whole + reach + 1, 2 * reach + 1
        self._added = np.zeros((n_axes, 2 * self._length))
        self._error = np.zeros((n_axes, 2 * self._length))
        self._k = 0
        # The window ends `reach` after the sample of a period ago.
        self._back = whole + reach
        self._out, self._work = np.zeros(n_axes), np.zeros(n_axes)

    def forget(self) -> None:
        """Begin anew."""
        self._added[:] = 0.0
        self._error[:] = 0.0
        self._k = 0

    def recall(self, error: Array, known: Mask) -> Array:
        """Return what to add now, ``(n_axes,)``, and note the error of now where it is known."""
        length = self._length
        here = self._k % length
        start = (self._k - self._back) % length
        window = slice(start, start + self._width)
        out = np.dot(self._added[:, window], self._remember, out=self._out)
        out += np.dot(self._error[:, window], self._better, out=self._work)
        for place in (here, here + length):
            self._added[:, place] = out
            np.multiply(error, known, out=self._error[:, place])
        self._k += 1
        return out


def closed_loop_response(config: ControllerConfig, period: float) -> Array:
    """Return the force after an impulse added to the command of `PiLaw`, ``(4096,)`` [N s^2/m].

    On the contact model, with its delay and lag. The error after it is the negative.

    Raises:
        ModelError: it does not settle: the loop is not stable on the model.
    """
    contact = contact_model(
        config.model.stiffness, config.model.velocity_damping, period, lag=config.model.lag
    )
    model = with_delay(contact.model, config.model.delay)
    velocity = np.append(contact.velocity, np.zeros((1, config.model.delay)), axis=1)
    law, known = PiLaw(config, 1, period), np.ones(1, dtype=np.bool_)
    state, force, nothing = np.zeros(model.n_states), np.zeros(_LENGTH), np.zeros(1)
    for k in range(_LENGTH):
        force[k] = model.C[0] @ state
        command = law.decide(force[k : k + 1], velocity @ state, nothing, known)
        law.settle(command)
        state = model.A @ state + model.B @ (command + (k == 0))
        if abs(force[k]) > _GROWN * model.period**2 * config.model.stiffness:
            break
    else:
        if np.abs(force[-_LENGTH // 8 :]).max() < 0.05 * np.abs(force).max():
            return force
    raise ModelError("controller.pi: this loop does not settle on controller.model")


def _taps(spectrum: Array, reach: int) -> Array:
    """Return the filter of a spectrum for a window in the order of time, ``(2 reach + 1,)``."""
    pulse = np.fft.irfft(spectrum, _LENGTH)
    taps = np.concatenate([pulse[-reach:], pulse[: reach + 1]])
    return np.ascontiguousarray(taps[::-1])
