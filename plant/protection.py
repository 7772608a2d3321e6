"""The guard of the cell: watches at every physics step, and takes the tool away for good.

It stands apart from the controller and from the inner loop, as the watchdog of a drive does: it
reads joints, tip and contact force themselves, and from a trip on commands the motors itself. What
it watches, and what happens at a trip, is told in ``docs/plant.md``.

`Guard.watch` and `Guard.retract` run at every physics step. They are the reference for the same two
functions in ``stepping.c``, which do the same operations in the same order on the same memory.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from plant.arm_model import build_arm_model
from plant.chain import Arm
from plant.config import CellConfig, ImperfectionConfig
from plant.contact import Contact
from plant.errors import PlantError
from plant.interface import Cause, Trip
from plant.memory import HEART_JOINTS, Memory
from plant.own_arm import tool_arm
from plant.playback import Programme
from plant.tissue import worst_force
from plant.viper import FloatArray

OFF, WATCHING, RETRACTING, BRAKED = range(4)
"""What the guard is doing, ``memory["mode"]``."""
_CAUSES = tuple(Cause)
_NUMBER = {cause: number for number, cause in enumerate(_CAUSES, start=1)}
"""Of each cause in ``memory["cause"]``; 0 is none."""
_BANDWIDTH = 100.0
"""Of the joints' position loop on the way back, where the motors' lag allows it [rad/s]."""
_LAG_SHARE = 0.2
"""Largest product of that bandwidth and the lag [-]."""
_LEASH = 0.002
"""How far the goal may be ahead of its joint [rad]: what is caught up after an impact then adds
little to the speed of the way back."""
_STUCK = 0.05
"""Share of the speed of the way back below which there is no way further [-]."""
_REST = 0.02
"""Joint speed at which the brakes can close [rad/s]."""
_SAFETY = 0.5
"""Share of the deceleration that a joint has at home on which its stopping distance counts [-]."""
_STRAIGHTENING = 20.0
"""Rate at which the tip comes back to the normal through where it tripped, as friction leads it
aside [1/s]."""
_WEIGHTS = np.array([[1.0], [1.0], [1.0], [0.1], [0.1], [0.1]])
"""Of the tip's velocity, and of the instrument's turning on the way back [-, m/rad]."""
_DAMPING = 0.01**2 * np.eye(6)
"""Square of the gain below which the way back takes a direction for impossible [m^2/rad^2]."""
_FLAT = 2.0 * math.sqrt(2.0)
"""Frobenius norm of the difference of two rotations half a turn apart [-]."""


class Guard:
    """Protection of one cell, from `begin` on."""

    def __init__(
        self,
        config: CellConfig,
        block: Memory,
        engine: tuple[Any, Any],
        contact: Contact,
        arms: tuple[Programme, Arm],
        *,
        repeats: bool = False,
    ) -> None:
        """Derive limits and gains.

        Args:
            config: of the whole cell.
            block: what it shares with the physics loop.
            engine: model and data of MuJoCo.
            contact: released at a trip.
            arms: Robot_Heart's programme, and Robot_Tool.
            repeats: whether the programme begins anew at its end.
        """
        heart, tool = arms
        own, lag = config.protection, config.imperfections.torque_lag
        self._config, self._block = own, block
        model, data = self._model, self._data = engine
        self._contact = contact
        self._period, self._substeps = config.period, config.substeps
        step = config.period / config.substeps
        block["lower"] = tool.lower + own.joint_margin
        block["upper"] = tool.upper - own.joint_margin
        block["goal_lower"], block["goal_upper"] = block["lower"], block["upper"]
        block["joint_speed"] = own.joint_speed * tool.speed
        block["tip_speed"], block["force"] = own.tip_speed, own.force
        block["tracking_velocity"] = own.tracking_velocity
        block["tracking_orientation"] = _FLAT * math.sin(0.5 * own.tracking_orientation)
        block["tracking_heart"] = own.tracking_heart
        inertia, reserve, _, _ = _strength(tool)
        block["stopping"] = np.diag(inertia) / (2.0 * _SAFETY * reserve)
        block["reaction"] = step + 2.0 * _lag(config.imperfections)
        damping = config.tool.velocity_damping
        block["decay"] = math.exp(-damping * step)
        block["gain"] = -math.expm1(-damping * step) / damping if damping > 0 else step
        bandwidth = min(_BANDWIDTH, _LAG_SHARE / lag) if lag > 0 else _BANDWIDTH
        block["inertia"] = inertia.ravel()
        block["stiff"], block["damp"] = bandwidth**2, 2.0 * bandwidth
        block["torque_limit"], block["leash"] = tool.torque_limit, _LEASH
        # Views: looking them up costs as much as a small matrix product.
        self._mode, self._asked = block["mode"], block["asked"]
        self._angles = heart.angles
        self._turns = _turns(heart, config.substeps, repeats=repeats)
        self._repeats = repeats
        self._heart, self._heart_step = block["heart"], block["heart_step"]
        self._own = own_joints = slice(HEART_JOINTS, HEART_JOINTS + tool.joints)
        self._q, self._speeds = data.qpos[own_joints], data.qvel[own_joints]
        self._motor, self._motor_speeds = data.qpos[-tool.joints :], data.qvel[-tool.joints :]
        self._tip, self._frame = data.site("tool_tip").xpos, data.site("tool_tip").xmat
        self._surface = data.site("heart_surface")
        self._site = model.site("tool_tip").id
        self._jacobian = np.zeros((6, model.nv))
        self.trip: Trip | None = None
        """What it tripped on, and when."""
        self._cycle = self._missed = 0

    def begin(self) -> None:
        """Start anew where the arms are, at rest and within all limits."""
        block = self._block
        block["tip_before"], block["frame_held"] = self._tip, self._frame
        block["asked"] = block["expected"] = 0.0
        block["cause"] = 0
        self._mode[()] = WATCHING if self._config.enabled else OFF
        self._cycle = self._missed = 0
        self._arrived = False
        self.trip = None

    def stand_down(self) -> None:
        """Watch no more until the next `begin`: the brakes hold the tool."""
        self._mode[()] = OFF

    @property
    def tripped(self) -> bool:
        """Whether the tool is the guard's."""
        return bool(self._block["cause"])

    def heard(self, valid: bool) -> None:
        """Count the heartbeat: whether a usable command came in this period."""
        self._missed = 0 if valid else self._missed + 1
        if self._missed > self._config.heartbeat and self._mode == WATCHING:
            self._block["step"] = 0
            self._trip(Cause.HEARTBEAT, -1, float(self._missed), float(self._config.heartbeat))
            self._contact.follow(0)
            self.retract()

    def follow(self, heart: Programme) -> None:
        """Compare Robot_Heart with another programme from the next period on."""
        self._angles = heart.angles
        self._turns = _turns(heart, self._substeps, repeats=self._repeats)

    def expect(self, cycle: int, asked: FloatArray) -> None:
        """Take in what the coming period is for, or go on with the way back.

        Args:
            cycle: number of the period.
            asked: command that acts now, 0 on axes that hold their position, ``(3,)`` [m/s^2].
        """
        self._cycle = cycle
        if self._mode == WATCHING:
            self._asked[:] = asked
            row = cycle % len(self._angles)
            self._heart[:], self._heart_step[:] = self._angles[row], self._turns[row]
        elif self._mode == RETRACTING:
            self._aim()

    def notice(self) -> None:
        """After a period: make the record of a trip that happened in it."""
        if self.trip is None and self._block["cause"]:
            block = self._block
            cause, joint = _CAUSES[int(block["cause"]) - 1], int(block["joint"])
            value, limit = float(block["value"]), float(block["limit"])
            if cause is Cause.TRACKING_ORIENTATION:
                value = 2.0 * math.asin(min(value / _FLAT, 1.0))
                limit = self._config.tracking_orientation
            periods = self._cycle + int(block["step"]) / self._substeps
            self.trip = Trip(
                cause, periods * self._period, value, limit, joint + 1 if joint >= 0 else None
            )

    def watch(self, step: int) -> None:
        """Compare the state after physics step ``step`` of the period, from 1, with the limits."""
        self._block["step"] = step
        for within, cause, joint, value, limit in self._compared():
            if not within:
                self._trip(cause, joint, value, limit)
                return

    def _compared(self) -> Iterator[tuple[bool, Cause, int, float, float]]:
        """Go through the limits: whether it is kept, its cause and joint, what was found, and it.

        NaN keeps no limit.
        """
        m = self._block
        square = error = turned = 0.0
        decay, gain, timestep = float(m["decay"]), float(m["gain"]), float(m["timestep"])
        before, expected = m["tip_before"], m["expected"]
        for i, (x, u) in enumerate(zip(self._tip.tolist(), self._asked.tolist(), strict=True)):
            v = (x - float(before[i])) / timestep
            before[i] = x
            wanted = decay * float(expected[i]) + gain * u
            expected[i] = wanted
            square += v * v
            error += (v - wanted) * (v - wanted)
        self._heart += self._heart_step
        for now, held in zip(self._frame.tolist(), m["frame_held"].tolist(), strict=True):
            turned += (now - held) * (now - held)

        q, speeds = self._q.tolist(), self._speeds.tolist()
        lower, upper, stopping = m["lower"].tolist(), m["upper"].tolist(), m["stopping"].tolist()
        reaction = float(m["reaction"])
        for i, speed in enumerate(speeds):
            travel = stopping[i] * speed * speed + reaction * abs(speed)
            high = q[i] + travel if speed > 0.0 else q[i]
            low = q[i] - travel if speed < 0.0 else q[i]
            yield high <= upper[i], Cause.JOINT_RANGE, i, high, upper[i]
            yield low >= lower[i], Cause.JOINT_RANGE, i, low, lower[i]
        for i, (speed, most) in enumerate(zip(speeds, m["joint_speed"].tolist(), strict=True)):
            yield abs(speed) <= most, Cause.JOINT_SPEED, i, abs(speed), most
        for cause, size in (
            (Cause.TIP_SPEED, math.sqrt(square)),
            (Cause.TRACKING_VELOCITY, math.sqrt(error)),
            (Cause.TRACKING_ORIENTATION, math.sqrt(turned)),
        ):
            limit = float(m[cause.value])
            yield size <= limit, cause, -1, size, limit
        limit = float(m["tracking_heart"])
        heart = zip(self._data.qpos[:HEART_JOINTS].tolist(), self._heart.tolist(), strict=True)
        for i, (x, wanted) in enumerate(heart):
            yield abs(x - wanted) <= limit, Cause.TRACKING_HEART, i, abs(x - wanted), limit
        force, limit = self._contact.size(), float(m["force"])
        yield force <= limit, Cause.FORCE, -1, force, limit

    def retract(self) -> None:
        """Command the motors for the next physics step: goals on a leash, damped, weight borne.

        Where a motor has not enough torque, all get the same share of what they should have: the
        arm then brakes later but on the same way, without a jerk aside.
        """
        m = self._block
        timestep, leash = float(m["timestep"]), float(m["leash"])
        stiff, damp, share = float(m["stiff"]), float(m["damp"]), 1.0
        ends = zip(m["goal_lower"].tolist(), m["goal_upper"].tolist(), strict=True)
        goals, paces = m["goal"].tolist(), m["goal_speed"].tolist()
        states = zip(self._motor.tolist(), self._motor_speeds.tolist(), ends, strict=True)
        wanted = []
        for i, (q, speed, (low, high)) in enumerate(states):
            goal = goals[i] + paces[i] * timestep
            goal = max(min(max(min(goal, q + leash), q - leash), high), low)
            m["goal"][i] = goal
            wanted.append(stiff * (goal - q) + damp * (paces[i] - speed))
        torques = []
        bias, limits = self._data.qfrc_bias[self._own].tolist(), m["torque_limit"].tolist()
        for row, borne, limit in zip(
            m["inertia"].reshape(len(bias), -1).tolist(), bias, limits, strict=True
        ):
            torque = 0.0
            for factor, want in zip(row, wanted, strict=True):
                torque += factor * want
            torques.append(torque)
            room = max(limit - (borne if torque > 0.0 else -borne), 0.0)
            if share * abs(torque) > room:
                share = room / abs(torque)
        for i, (borne, torque) in enumerate(zip(bias, torques, strict=True)):
            self._data.ctrl[HEART_JOINTS + i] = borne + share * torque

    def _trip(self, cause: Cause, joint: int, value: float, limit: float) -> None:
        m = self._block
        self._mode[()] = RETRACTING
        m["cause"], m["joint"], m["value"], m["limit"] = _NUMBER[cause], joint, value, limit
        m["unilateral"] = m["renewed"] = 1
        m["normal"], m["tip_tripped"] = self._surface.xmat[2::3], self._tip
        m["depth"] = float(self._contact.depth)
        m["goal"], m["goal_speed"] = self._motor, 0.0

    def _aim(self) -> None:
        """Once a period: how fast each joint's goal moves, and whether the brakes can close."""
        m = self._block
        pace, normal, way = m["goal_speed"], m["normal"], self._tip - m["tip_tripped"]
        done = float(normal @ way)
        if not self._arrived:
            speed = self._config.retraction_speed
            aside = _STRAIGHTENING * (way - done * normal)
            aside *= speed / max(speed, float(np.linalg.norm(aside)))
            pace[:] = self._lead(np.concatenate([speed * normal - aside, np.zeros(3)]))
            rises = float(normal @ (self._jacobian[:3, self._own] @ pace))
            travel = max(0.0, self._config.retraction + float(m["depth"]))
            self._arrived = done >= travel or rises < _STUCK * speed
        if self._arrived:
            pace[:] = 0.0
            if np.abs(self._motor_speeds).max() < _REST:
                self._mode[()] = BRAKED
                close_brakes(self._model, self._data, self._q.size)

    def _lead(self, twist: FloatArray) -> FloatArray:
        """Joint speeds ``(n,)`` [rad/s] that lead the tip by ``twist (6,)`` [m/s, rad/s].

        By damped least squares: where the arm is stretched it goes another way round, turns the
        instrument or is slow, but its tip is never led back into the tissue. A joint at the end of
        its range stays where it is.
        """
        m, J = self._block, self._jacobian
        mujoco.mj_jacSite(self._model, self._data, J[:3], J[3:], self._site)
        high, low = m["goal"] >= m["goal_upper"], m["goal"] <= m["goal_lower"]
        A = J[:, self._own] * _WEIGHTS
        while True:
            speeds = A.T @ np.linalg.solve(A @ A.T + _DAMPING, twist)
            blocked = (high & (speeds > 0.0)) | (low & (speeds < 0.0))
            if not blocked.any():
                return np.asarray(
                    speeds / max(1.0, float((np.abs(speeds) / m["joint_speed"]).max()))
                )
            A[:, blocked] = 0.0


def _turns(heart: Programme, substeps: int, *, repeats: bool) -> FloatArray:
    """Change of the programme's angles in a physics step, ``(n, 6)`` [rad]."""
    after = heart.angles[:1] if repeats else heart.angles[-1:]
    turns: FloatArray = np.diff(heart.angles, axis=0, append=after) / substeps
    return turns


def close_brakes(model: Any, data: Any, joints: int) -> None:
    """Lock the motors of the tool's joints, of which there are so many, where they are."""
    model.eq_data[:joints, 0] = data.qpos[-joints:]
    data.eq_active[:joints] = True


def force_cap(config: CellConfig, tissue_speed: float, tool: Arm | None = None) -> float:
    """Largest contact force that can occur whatever is commanded, where the arm stands at home [N].

    The guard trips at the latest at ``protection.force``, with the tip no faster than its limit and
    whatever the motors added in the physics step before. Their torque turns round with its lag, the
    tip stops, and meanwhile the tissue comes towards it:

        v = v_limit + a h + (a + b) lag       v' = -b + (a + b) exp(-t / lag), integrated
        way = v h + v^2 / (2 b) + v_tissue v / b
        cap = F_limit + K way + D (v + v_tissue)       for a spring or a Kelvin-Voigt element;
                                                       for all laws, see `plant.tissue.worst_force`

    a is the largest acceleration of the tip, b its smallest deceleration, in any direction.
    Infinite without protection.

    Args:
        config: of the cell.
        tissue_speed: largest speed of the tissue [m/s].
        tool: the arm of `plant.own_arm.tool_arm`, where it is at hand.
    """
    own, contact = config.protection, config.contact
    if not own.enabled:
        return math.inf
    _, _, hardest, braking = _strength(tool or tool_arm(config))
    step, lag = config.period / config.substeps, _lag(config.imperfections)
    speed = own.tip_speed + hardest * step + (hardest + braking) * lag
    way = speed * step + speed**2 / (2.0 * braking) + tissue_speed * speed / braking
    return worst_force(contact, own.force, way, speed + tissue_speed)


def _lag(flaws: ImperfectionConfig) -> float:
    """Time that the torque at the links needs to turn round [s].

    A spring between motor and link unwinds no faster than its mode swings.
    """
    swing = 1.0 / (2.0 * math.pi * flaws.joint_frequency) if flaws.joint_frequency > 0 else 0.0
    return flaws.torque_lag + swing


@lru_cache(maxsize=4)
def _strength(tool: Arm) -> tuple[FloatArray, FloatArray, float, float]:
    """What the tool's motors can do at home.

    Returns the joint-space inertia ``(n, n)`` [kg m^2], the torque that gravity leaves to each
    joint ``(n,)`` [N m], the largest acceleration of the tip, and the smallest deceleration of a
    tip that moves without turning and is braked as `Guard.retract` brakes [m/s^2].

    Raises:
        PlantError: they do not bear the arm's weight.
    """
    arm, q = build_arm_model(tool), tool.home
    model, data = arm.model, arm.model.createData()
    inertia = np.triu(pin.crba(model, data, q))
    inertia = inertia + np.triu(inertia, 1).T
    limit = tool.torque_limit
    weight = np.abs(pin.computeGeneralizedGravity(model, data, q))
    reserve = limit - weight
    worst = int(reserve.argmin())
    if not reserve[worst] > 0.0:
        raise PlantError(
            f"torque_limit: joint {worst + 1} can give {limit[worst]:.3g} N m, which does not bear "
            f"the arm's weight at home: {weight[worst]:.3g} N m"
        )
    J = pin.computeFrameJacobian(model, data, q, arm.tip, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
    extremes = limit * np.array(list(product([-1.0, 1.0], repeat=tool.joints)))
    hardest = np.linalg.norm(extremes @ np.linalg.inv(inertia) @ J[:3].T, axis=1).max()
    # Torque that each motor needs for 1 m/s^2, in the direction that is the worst for it.
    ways = np.eye(6)[:, :3]
    speeds = np.linalg.solve(J, ways) if tool.joints == 6 else np.linalg.pinv(J) @ ways
    torques = np.linalg.norm(inertia @ speeds, axis=1)
    return inertia, reserve, float(hardest), float((reserve / torques).min())
