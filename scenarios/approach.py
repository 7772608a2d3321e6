"""A tool that is off the tissue: seen in the measured force, led back at a bounded speed.

A force controller has no use for a tool in the air: its model is a spring that is not there, and
what it asks for is as much speed as it may have. So `Approach` stands beside it, the same for every
controller and backend. From the moment at which the measured force may be none, it bounds the
command so that the tool comes no faster than the speed of the approach; when the force has been
none for long enough, the contact counts as lost, and the approach commands the velocity itself, by
a PI law on the unit mass that the inner loop makes of the tool. When the force is back the
controller goes on from the force and the command that there are.

Meanwhile the controller runs on and is shown tissue at rest right under the tool: the force that
the model's spring would have taken on since the cycle before. So its model holds, with whatever is
in it for delays and disturbances; what it knows of the tool is what the encoders tell, and its
estimate of the tissue's motion comes to rest.
"""

import math
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from plant.interface import Measurement
from plant.tissue import worst_force
from qpmpc.config import ModelConfig
from qpmpc.protocol import ForceControl
from scenarios.config import ApproachConfig, Scenario
from scenarios.consistency import band
from scenarios.schedule import Schedule

Array = NDArray[np.float64]
_FASTEST = 100.0
"""Bandwidth of the velocity loop where nothing delays it [rad/s]."""
_PHASE = 0.45
"""Phase that delay and lag may cost it at its bandwidth [rad]. It leaves 49 degrees of margin, and
44 where the tool is 1.35 times as quick as its model."""
_AIM = 0.9
"""Share of the speed of the approach that is aimed at: friction and a wrong model add to it [-]."""
_INTEGRAL = 0.5
"""Root of the integral gain relative to the bandwidth [-]."""


class ContactState(IntEnum):
    """What the measured force tells of the contact."""

    PRESSING = 0
    """The tool presses on the tissue."""
    DOUBTFUL = 1
    """The force has been below the threshold, but not for long enough."""
    LOST = 2
    """The tool is off the tissue."""


@dataclass(frozen=True)
class ContactEvent:
    """One time off the tissue, as it was seen in the measured force."""

    lost: int
    """Cycle in which the force fell below the threshold; 0 for a start in the air."""
    found: int | None
    """Cycle in which it had come back; None where it had not by the end of the run."""
    meant: bool
    """Whether the setpoint did not ask for pressure when the contact was lost."""


class ContactWatch:
    """Tells from measured forces whether the tool presses, with hysteresis and patience."""

    def __init__(
        self, threshold: float, found_at: float, *, lost_after: int, found_after: int
    ) -> None:
        """Start without knowing.

        Args:
            threshold: pressing force below which there may be no contact [N].
            found_at: above which there is contact again [N].
            lost_after, found_after: cycles in a row that decide, at least 1.
        """
        self.threshold, self.found_at = threshold, found_at
        self._lost_after, self._found_after = max(1, lost_after), max(1, found_after)
        self._below = self._above = 0
        self._known = False
        self.state = ContactState.PRESSING
        self.events: list[ContactEvent] = []

    def look(self, k: int, pressure: float, wish: float) -> ContactState:
        """Take the pressing force of cycle ``k`` [N], NaN where there is none, and the wish [N]."""
        if pressure > self.found_at and self.state is ContactState.PRESSING:
            self._below, self._known = 0, True
            return self.state
        if pressure < self.threshold:
            self._below, self._above = self._below + 1, 0
        elif pressure > self.found_at:
            self._below, self._above = 0, self._above + 1
        elif not math.isnan(pressure):  # between: neither in the air nor found again
            self._above = 0
            if self.state is not ContactState.LOST:
                self._below = 0
        if self.state is ContactState.LOST:
            if self._above >= self._found_after:
                last = self.events[-1]
                self.events[-1] = ContactEvent(last.lost, k, last.meant)
                self.state = ContactState.PRESSING
        elif self._below >= (self._lost_after if self._known else 1):
            first = k + 1 - self._below if self._known else 0
            self.events.append(ContactEvent(first, None, -wish <= self.found_at))
            self.state = ContactState.LOST
        elif self._below:
            self.state = ContactState.DOUBTFUL
        else:
            self.state = ContactState.PRESSING
        self._known |= not math.isnan(pressure)
        return self.state


class Approach:
    """The velocity law that stands in for the controller off the tissue."""

    def __init__(
        self, config: ApproachConfig, model: ModelConfig, period: float, z: int, n_axes: int
    ) -> None:
        """Prepare.

        Args:
            config: see there.
            model: what is known of the inner loop, its delay and lag.
            period: of control [s].
            z: which of the controlled axes is the normal; pressing is its negative direction.
            n_axes: how many there are.
        """
        self._period, self._z, self._speed = period, z, _AIM * config.speed
        self._damping = model.velocity_damping
        late = (1.5 + model.delay) * period + model.lag
        self._gain = min(_FASTEST, _PHASE / late)
        self._change = config.acceleration * period
        self._wanted, self._sum = np.zeros(n_axes), np.zeros(n_axes)

    def begin(self, velocity: Array) -> None:
        """Start from a tool that moves at ``velocity (n_axes,)`` [m/s]."""
        self._wanted[:] = velocity
        self._sum[:] = 0.0

    def command(
        self, velocity: Array, low: Array, high: Array, *, approach: bool, speed: float
    ) -> Array:
        """Return the acceleration command ``(n_axes,)`` [m/s^2].

        Args:
            velocity: measured, ``(n_axes,)`` [m/s].
            low, high: what may be commanded, ``(n_axes,)`` each [m/s^2].
            approach: whether to go on to the tissue; to stop where the tool is if not.
            speed: largest to approach at, beside the configured one [m/s].
        """
        target = np.zeros_like(velocity)
        if approach:
            target[self._z] = -min(self._speed, _AIM * speed)
        # Speed that it must not have fades as fast as the loop can follow: were it taken away at
        # once, the integral would gather the error of the braking, and let the tool swing past.
        allowed = np.minimum(np.maximum(self._wanted, -self._speed), self._speed)
        change = np.minimum(np.maximum(target - allowed, -self._change), self._change)
        change -= self._gain * self._period * (self._wanted - allowed)
        self._wanted += change
        error = self._wanted - velocity
        step = (_INTEGRAL * self._gain) ** 2 * self._period * error
        wanted = change / self._period + self._damping * self._wanted + self._gain * error
        wanted += self._sum + step
        command = np.minimum(np.maximum(wanted, low), high)
        # What is beyond the bounds is not gathered.
        self._sum += np.where((wanted - command) * step > 0.0, 0.0, step)
        return np.asarray(command)

    def slowest(self, velocity: float, speed: float) -> float:
        """Return the command on the normal below which the tool would come too fast [m/s^2]."""
        return self._damping * velocity + self._gain * (-min(self._speed, _AIM * speed) - velocity)


class Recovery:
    """Watch and approach of one run, around the step of its controller."""

    def __init__(self, scenario: Scenario, schedule: Schedule) -> None:
        """Prepare for a scenario and the bounds of its run."""
        config, period, axes = scenario.approach, scenario.cell.period, scenario.axes
        self.watch = ContactWatch(
            scenario.contact_lost_below,
            scenario.contact_found_above,
            lost_after=round(config.lost_after / period),
            found_after=round(config.found_after / period),
        )
        self._index = ["xyz".index(axis) for axis in axes]
        self._z = axes.index("z") if "z" in axes else None
        self._law: Approach | None = None
        if config.enabled and self._z is not None:
            self._law = Approach(config, scenario.controller.model, period, self._z, len(axes))
        self._schedule, self._margin = schedule, scenario.controller.bounds.velocity_margin
        self._low, self._high = schedule.first_command
        self._rate = np.array([band(scenario.controller.bounds.rate, axis) for axis in axes]).T
        self._stiffness = scenario.controller.model.stiffness
        self._last: Measurement | None = None
        self._nothing = np.zeros(len(axes))
        self._wish, self._state = 0.0, ContactState.PRESSING

    def measured(
        self,
        k: int,
        measurement: Measurement,
        force: Array,
        wish: Array,
        controller: ForceControl,
    ) -> Array:
        """Look at a measurement; return the force to show the controller, ``(n_axes,)`` [N].

        Args:
            k: cycle.
            measurement: of this cycle.
            force: of it, on the controlled axes, ``(n_axes,)`` [N].
            wish: setpoint of this cycle, ``(n_axes,)`` [N].
            controller: told where another force counts from now on.
        """
        before, last, self._last = self._state, self._last, measurement
        self._wish = -np.inf if self._z is None else float(wish[self._z])
        self._state = self.watch.look(k, -float(measurement.force[2]), self._wish)
        if self._law is None:
            return force
        if self._state is ContactState.LOST:
            way = (measurement.position - (last or measurement).position)[self._index]
            if before is not ContactState.LOST:
                controller.adopt(force=self._stiffness * way)
                self._law.begin(measurement.velocity[self._index])
            return np.asarray(self._stiffness * way)
        if before is ContactState.LOST:
            controller.adopt(force=force)
        return force

    def command(self, k: int, decided: Array, previous: Array, controller: ForceControl) -> Array:
        """Return the command to apply in cycle ``k``, ``(n_axes,)`` [m/s^2].

        Args:
            k: cycle.
            decided: by the controller.
            previous: applied in the cycle before.
            controller: told if another command is applied.
        """
        law, z = self._law, self._z
        if self._state is ContactState.PRESSING or law is None or z is None or self._last is None:
            return decided
        velocity = self._last.velocity[self._index]
        speed = -self._margin - float(self._schedule.preview("velocity", k)[0][0, z])
        presses = -self._wish > self.watch.found_at
        low = np.maximum(self._low, previous + self._rate[0])
        high = np.minimum(self._high, previous + self._rate[1])
        if self._state is ContactState.LOST:
            wanted = law.command(velocity, low, high, approach=presses, speed=speed)
        elif presses:
            wanted = decided.copy()
            wanted[z] = max(wanted[z], law.slowest(float(velocity[z]), speed))
            wanted[z] = min(max(wanted[z], low[z]), high[z])
        else:
            return decided
        lost = self._state is ContactState.LOST
        controller.adopt(command=wanted, force=self._nothing if lost else None)
        return wanted


def recovery(scenario: Scenario, schedule: Schedule) -> Recovery | None:
    """Return what a run needs whose contact can be lost, None where it cannot."""
    return Recovery(scenario, schedule) if scenario.cell.contact.unilateral else None


def touch_down_cap(scenario: Scenario, tissue_speed: float) -> float:
    """Return the largest force that finding the tissue again may cause by itself [N].

    Tool and tissue meet at no more than the speed of the approach and that of the tissue, w. Until
    the force has risen to what counts as found, has been there for ``found_after``, and the first
    command of the controller has its effect, they come closer at w; then the tool is braked by what
    the bound on the command allows, b:

        way = w t + w^2 / (2 b)      t = found_after + (delay + 1) Ts + 2 lag

    and the force is the largest that the contact law has for it. Where that is less than the
    setpoint, the setpoint is what is gone for.

    Args:
        scenario: see there.
        tissue_speed: largest speed of the tissue [m/s].
    """
    config, flaws, period = scenario.approach, scenario.cell.imperfections, scenario.cell.period
    speed = config.speed + tissue_speed
    wait = config.found_after + (flaws.delay + 1) * period + 2.0 * flaws.torque_lag
    braking = band(scenario.controller.bounds.command, "z")[1]
    seen = scenario.contact_found_above
    way = speed * wait + speed**2 / (2.0 * braking)
    return worst_force(scenario.cell.contact, seen, way, speed)
