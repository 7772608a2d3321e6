"""Motion that nearly repeats: what it is now, and what it will be over the horizon."""

from __future__ import annotations

import math
from dataclasses import dataclass
from math import exp, sqrt

import numpy as np

from qpmpc.arrays import Array, all_finite
from qpmpc.rhythm.alignment import align
from qpmpc.rhythm.filter import MotionFilter
from qpmpc.rhythm.period import Periodicity
from qpmpc.rhythm.plain import ORDER, PlainFilter, extrapolation
from qpmpc.rhythm.spline import Spline
from qpmpc.rhythm.waveform import Waveform

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(7)
_WEIGHTS /= _WEIGHTS.sum()
"""Gauss-Hermite rule for a mean over a normal distribution."""
_SURE = 1e-6
"""Deviation of the delay below which it counts as known [s]."""
_LEAD = 0.004
"""How far ahead both ways of going on are judged: delay, lag, and what a command takes [s]."""
_JUDGED = 1.0
"""Time over which they are judged [s]."""
_HANDOVER = 0.05
"""Time that going over from one to the other takes [s]."""
_LENGTH, _KNOTS = 1.2, 0.02
"""Of the waveform, and distance of its knots [s], for a beat of `_USUAL` length."""
_USUAL = 0.8
"""Interval before a beat at which the waveform's time is the beat's [s]."""
_INTERVALS = (0.3, 2.0)
"""Between beats; what lies outside says nothing about the next [s]."""
_REFRACTORY = 0.2
"""After an R peak, in which another is none [s]."""
_ABSURD = 1e9
"""Standard deviations beyond which a sample is none [-]."""
_SAMPLE = 0.004
"""Over which samples are averaged for the waveform [s]."""
_LOOK = 0.02
"""Between looks for the period [s]."""
_LONGEST = 1.6
"""Of a beat, as far as it is learned [s]."""
_RHYTHM = 0.5
"""Correlation of the motion with itself a period ago from which it is followed [-]."""
_FITS = 0.4
"""Share of a beat that the waveform must explain for the beat to count as one of its kind [-]."""
_PATIENCE = 3
"""Beats in a row of another kind after which the rhythm is given up."""
_LEARNED = 3
"""Beats after which amplitude and delay of the next are estimated."""
_CALM = 1.25
"""Surprise up to which the waveform is trusted [-]."""
_ALARM = 8.0
"""Power of the surprise beyond with which the rest is freed."""
_FOLLOW = 0.8
"""Share of the last interval in what the next is expected to be [-]."""
_REACH = 0.2
"""Largest delay of a beat that is looked for, as a share of the interval [-]."""
_SPREADS = 4.0
"""The same behind an R peak, in standard deviations of the delay."""
_SHARE = 0.3
"""Share of the last beat in the variance of delays behind what was expected [-]."""
_WIDER, _SCATTER = 4.0, 0.004
"""Times the deviation of past delays, and least deviation [s], that the next is thought to have."""
_BIAS = 0.7
"""Share of a delay behind its R peak that the waveform takes for its own [-]."""
_LEAST = 0.2
"""Amplitude below which a beat counts as this large when it is learned [-]."""
_NOISE = 0.6
"""Of a sample of the waveform, with what makes beats unlike, as a share of its size [-]."""


@dataclass(frozen=True)
class Motion:
    """What is assumed of the motion and of its samples; units of the samples, `u`."""

    noise: float
    """Standard deviation of a sample [u]."""
    drift: float
    """Change of the third derivative per cycle while there is no waveform, std. dev. [u/s^3]."""
    residual_drift: float
    """The same beside a waveform that fits [u/s^3]."""
    memory: float
    """Beats after which one has lost 63 % of its weight."""
    amplitude_spread: float
    """Relative change of a beat's amplitude, standard deviation [-]."""
    amplitude_memory: float
    """Share of an amplitude's change that the next beat keeps [-]."""
    delay_spread: float
    """Of a beat behind its R peak, or behind the expected beat [s], standard deviation."""


@dataclass(frozen=True)
class Wave:
    """The waveform at one instant, the mean over delays that are possible; ``(axes,)`` each."""

    value: Array
    rate: Array
    """Its time derivative."""
    lateness: Array
    """Its derivative by the delay, the slope of the line that fits best over the delays."""
    doubt: Array
    """Variance about that line."""


class MotionEstimator:
    """Estimates and previews ``rest + (1 + a) waveform`` on one to three axes.

    A cycle is `beat` where an R peak has come, then `correct`, `preview`, and `advance` when there
    is time: there beats end, and the waveform is learned.
    """

    def __init__(self, axes: int, period: float, motion: Motion, *, synchronised: bool) -> None:
        """Set up.

        Args:
            axes: number of axes.
            period: of the samples [s].
            motion: see there.
            synchronised: whether beats begin when `beat` says so; else they are found.
        """
        self._axes, self._period, self._motion = axes, period, motion
        self.synchronised = synchronised
        self.filter = MotionFilter(axes, period, motion.noise)
        self._plain = PlainFilter(axes, period, motion.noise, motion.drift)
        self._lead = max(1, round(_LEAD / period))
        self._leading = extrapolation(period * np.arange(self._lead + 1, dtype=np.float64))
        self._expected = np.zeros((self._lead, 2, axes))
        self._missed = np.zeros((2, axes))
        self._trust = np.zeros(axes)
        self._note = 1.0 - exp(-period / _JUDGED)
        self._move = period / _HANDOVER
        self._every = max(1, round(_SAMPLE / period))
        spacing = self._every * period
        self.waveform = Waveform(
            axes,
            Spline(_LENGTH, _KNOTS),
            capacity=int(_LONGEST / spacing),
            noise=_NOISE,
            memory=motion.memory,
        )
        self._look = max(1, round(_LOOK / period))
        self._periodicity = Periodicity(axes, self._look * period)
        self._sum, self._summed = np.zeros(axes), 0
        self._nothing = Wave(*np.zeros((4, axes)))
        self._taylor = np.zeros((0, ORDER))
        self._start: float | None = None
        self._interval = self._next = self._last = math.nan
        self._stretch, self._misses = 1.0, 0
        self._variance = self._motion.delay_spread**2
        self.reset()

    def reset(self) -> None:
        """Forget motion, beats and waveform."""
        self._cycle, self._started, self._peak = 0, False, False
        self._missed[:] = 0.0
        self._trust[:] = 0.0
        self._periodicity.reset()
        self._search()

    @property
    def following(self) -> bool:
        """Whether beats are being told apart."""
        return self._start is not None

    @property
    def interval(self) -> float:
        """Expected from the last beat to the next [s]; NaN before there is any."""
        return self._interval

    def beat(self) -> None:
        """Tell that an R peak has come since the last sample."""
        now = self._cycle * self._period
        if self._start is None or now - self._start >= _REFRACTORY:
            self._peak = True

    def correct(self, sample: Array) -> None:
        """Blend in a sample ``(axes,)``; what is not finite, or absurd, is passed over."""
        if not (all_finite(sample) and np.abs(sample).max() < _ABSURD * self._motion.noise):
            return
        if not self._started:
            self.filter.begin(sample, self._spread())
            self._plain.begin(sample)
            self._expected[:] = sample
            self._started = True
            return
        wave = self._wave(self._cycle * self._period)
        self.filter.correct(sample, wave.value, wave.lateness, wave.doubt)
        self._plain.correct(sample)
        self._judge(sample)
        if not all_finite(self.filter.state):  # it is nonlinear: nothing promises that it is
            self.reset()
            return
        if self._start is not None:
            self._sum += sample
            self._summed += 1
            if self._summed == self._every:
                elapsed = self._cycle * self._period - self._start
                self._sum /= self._every
                self.waveform.note(elapsed - 0.5 * (self._every - 1) * self._period, self._sum)
                self._sum[:] = 0.0
                self._summed = 0

    def preview(self, out: Array) -> Array:
        """Write the motion now and in the cycles to come into ``out (n, axes)``; return it."""
        n = out.shape[0]
        if self._taylor.shape[0] != n:
            self._taylor = extrapolation(self._period * np.arange(n, dtype=np.float64))
        np.dot(self._taylor, self._plain.state.T, out=out)
        if self._trust.any():
            out += self._trust * (self._rhythmic(self._taylor) - out)
        return out

    def _rhythmic(self, taylor: Array) -> Array:
        """Return the motion by the waveform and its rest, at times `extrapolation` was made for."""
        wave = taylor @ self.filter.rest.T
        if self._start is not None and self.waveform.beats:
            elapsed = self._cycle * self._period - self._start
            read = np.einsum("j,ijk->ik", _WEIGHTS, self._read(elapsed + taylor[:, 1]))
            wave += (1.0 + self.filter.change) * read
        return wave

    def _judge(self, sample: Array) -> None:
        """Compare what both ways of going on expected of this sample a little while ago."""
        slot = self._expected[self._cycle % self._lead]
        self._missed += self._note * ((slot - sample) ** 2 - self._missed)
        slot[0] = self._leading[-1] @ self._plain.state.T
        slot[1] = self._rhythmic(self._leading[-1:])[0] if self.waveform.beats else slot[0]
        better = self._missed[1] < self._missed[0]
        self._trust += np.where(better, self._move, -self._move)
        np.minimum(np.maximum(self._trust, 0.0, out=self._trust), 1.0, out=self._trust)

    def advance(self) -> None:
        """Go on to the next cycle; end the beat where it is over."""
        now = self._cycle * self._period
        if self._started:
            if self.synchronised:
                if self._peak:
                    self._turn(now)
            else:
                if self._cycle % self._look == 0:
                    self._listen(now)
                if now >= self._next + self.filter.delay:  # NaN: none is expected
                    self._turn(now)
            self._peak = False
            self.filter.predict(self._drift())
            self._plain.predict()
        self._cycle += 1

    def _drift(self) -> float:
        """Return how freely the rest may move: the worse the waveform fits, the more freely."""
        motion = self._motion
        if not self.waveform.beats:
            return motion.drift
        alarm = max(self.filter.surprise / _CALM, 1.0) ** _ALARM
        return float(min(motion.residual_drift * alarm, motion.drift))

    def _spread(self) -> Array:
        """Return what is unknown of value and derivatives after one sample."""
        rate = (self._motion.drift / self._motion.noise) ** (1.0 / (ORDER - 1))
        return np.asarray(self._motion.noise * np.maximum(rate, 1.0) ** np.arange(ORDER))

    def _read(self, elapsed: Array) -> Array:
        """Return the waveform at times since the beat began, ``(n, nodes, axes)``.

        The second index is over the delays that are thought possible.
        """
        possible = self.filter.delay + self.filter.delay_deviation * _NODES
        places = ((elapsed[:, None] - possible) / self._stretch).reshape(-1)
        numbers, weights, _ = self.waveform.spline.locate(places)
        read = np.einsum("ij,ijk->ik", weights, self.waveform.coefficients[numbers])
        return np.asarray(read.reshape(elapsed.size, _NODES.size, self._axes))

    def _wave(self, now: float) -> Wave:
        """Return what the waveform says for one instant."""
        if self._start is None or not self.waveform.beats:
            return self._nothing
        elapsed = np.array([now - self._start, now - self._start + self._period])
        read = self._read(elapsed)
        value, then = _WEIGHTS @ read[0], _WEIGHTS @ read[1]
        deviation = self.filter.delay_deviation
        late = (_WEIGHTS * _NODES) @ read[0]  # covariance with the delay, over its deviation
        doubt = np.maximum(_WEIGHTS @ (read[0] - value) ** 2 - late**2, 0.0)
        rate = (then - value) / self._period
        return Wave(value, rate, late / deviation if deviation > _SURE else -rate, doubt)

    def _listen(self, now: float) -> None:
        """Note how fast the motion is; begin to follow it where it repeats itself."""
        rate = self._wave(now).rate
        self._periodicity.note(self.filter.rest[:, 1] + (1.0 + self.filter.change) * rate)
        if np.isnan(self._next):
            period, correlation = self._periodicity.find()
            if correlation >= _RHYTHM:
                self._interval = period
                self._next = now - self._periodicity.since_quiet(period) + period

    def _turn(self, now: float) -> None:
        """End the beat that is under way, if one is, and let the next begin.

        Value and slope of the motion go on as they were: what the waveform of the new beat, or the
        lack of one, would change in them is given to the rest.
        """
        wave, size = self._wave(now), 1.0 + self.filter.change
        value, rate = size * wave.value, size * wave.rate
        begin = now if self.synchronised else self._next
        if self._start is not None:
            begin = self._finish(self._start, begin)
        if np.isnan(begin):
            self._search()
        else:
            self._start, self._next = begin, begin + self._interval
            self._stretch = sqrt(self._interval / _USUAL) if self._interval > 0 else 1.0
            if self.waveform.beats >= _LEARNED:
                motion = self._motion
                new = motion.amplitude_spread * sqrt(1.0 - motion.amplitude_memory**2)
                self.filter.expect(motion.amplitude_memory, new, self._scatter())
        self._sum[:] = 0.0
        self._summed = 0
        wave, size = self._wave(now), 1.0 + self.filter.change
        self.filter.rest[:, 0] += value - size * wave.value
        self.filter.rest[:, 1] += rate - size * wave.rate

    def _scatter(self) -> float:
        """Return how far a beat may be from where it is expected, standard deviation [s]."""
        spread = self._motion.delay_spread
        if self.synchronised:
            return spread
        return min(spread, max(_WIDER * sqrt(self._variance), _SCATTER))

    def _finish(self, start: float, begin: float) -> float:
        """Learn the beat that is over; return when the next begins, NaN where none is told."""
        waveform, delay, fits = self.waveform, 0.0, True
        if waveform.beats:
            reach = _REACH * self._interval
            if self.synchronised:
                reach = _SPREADS * self._motion.delay_spread
            found = align(waveform, self._stretch, reach)
            delay, fits = found.delay, found.explained >= _FITS
        seen = delay if fits else self._motion.delay_spread
        self._variance += _SHARE * (seen**2 - self._variance)
        self._misses = 0 if fits else self._misses + 1
        if self._misses > _PATIENCE:
            self._misses = 0
            waveform.forget()
            self.filter.expect(0.0, 0.0, 0.0)
            if not self.synchronised:
                return math.nan
        elif fits or waveform.beats < _LEARNED:
            usual = delay * (1.0 - _BIAS * self.synchronised)
            waveform.learn(self._stretch, usual, np.maximum(1.0 + self.filter.change, _LEAST))
        else:
            waveform.drop()
        if not self.synchronised:
            begin = start + self._interval + (delay if fits else 0.0)
        last = begin - start if self.synchronised else start + delay - self._last
        if fits and _INTERVALS[0] <= last <= _INTERVALS[1]:
            if self.synchronised or np.isnan(self._interval):
                self._interval = last
            else:
                self._interval += _FOLLOW * (last - self._interval)
                begin = start + delay + self._interval
        self._last = start + delay
        return begin

    def _search(self) -> None:
        """Forget beats and waveform, and wait for a rhythm."""
        self.waveform.forget()
        self.filter.expect(0.0, 0.0, 0.0)
        self._start = None
        self._interval = self._next = self._last = math.nan
        self._stretch, self._misses = 1.0, 0
        self._variance = self._motion.delay_spread**2
