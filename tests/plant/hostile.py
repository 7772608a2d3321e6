"""Controllers that mean harm, cells of every kind, and what must hold whatever they send."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np

from plant import Cell, CellConfig, ContactConfig, ImperfectionConfig, Trip, force_cap
from plant.cell import heart_programme
from plant.config import ArmConfig
from plant.own_arm import tool_arm

Array = np.ndarray[Any, np.dtype[np.float64]]
Controller = Callable[[int, Any], Array | None]
"""From the cycle and the measurement to a command, or None: nothing came."""

MOST = 200.0
"""Largest command that is not refused [m/s^2]."""


def direction(rng: np.random.Generator) -> Array:
    """A unit vector, downwards or along an axis more often than by chance."""
    pick = rng.integers(4)
    if pick == 0:
        return np.array([0.0, 0.0, -1.0])
    if pick == 1:
        return np.eye(3)[rng.integers(3)] * rng.choice([-1.0, 1.0])
    d = rng.standard_normal(3)
    if pick == 2:
        d[2] = -abs(d[2])
    return np.asarray(d / np.linalg.norm(d))


def size(rng: np.random.Generator) -> float:
    """From a gentle command to the largest, and the largest itself."""
    return MOST if rng.random() < 0.2 else float(np.exp(rng.uniform(0.0, np.log(MOST))))


# --- the controllers -----------------------------------------------------------------------------


def constant(rng: np.random.Generator) -> Controller:
    u = size(rng) * direction(rng)
    return lambda k, m: u


def rubbish(rng: np.random.Generator) -> Controller:
    """NaN, infinities and absurd numbers, on one axis or all, from some cycle on."""
    value = rng.choice([np.nan, np.inf, -np.inf, 1e300, -1e300, 1e5, 200.0001])
    u, start = constant(rng)(0, None).copy(), int(rng.integers(40))
    wrong = u.copy()
    wrong[rng.integers(3) if rng.random() < 0.5 else slice(None)] = value
    return lambda k, m: wrong if k >= start else u


def bang_bang(rng: np.random.Generator) -> Controller:
    u, half = size(rng) * direction(rng), int(rng.integers(1, 60))
    return lambda k, m: u if k // half % 2 == 0 else -u


def noise(rng: np.random.Generator) -> Controller:
    scale = size(rng)
    return lambda k, m: np.clip(scale * rng.standard_normal(3), -MOST, MOST)


def nothing(rng: np.random.Generator) -> Controller:
    return lambda k, m: None


def late(rng: np.random.Generator) -> Controller:
    """Another controller whose commands come in some cycles only."""
    other, share = any_controller(rng, but=late), rng.random()
    return lambda k, m: other(k, m) if rng.random() < share else None


def ramp(rng: np.random.Generator) -> Controller:
    d, slope = direction(rng), float(np.exp(rng.uniform(np.log(0.02), np.log(5.0))))
    return lambda k, m: min(slope * k, MOST) * d


def wave(rng: np.random.Generator) -> Controller:
    u, w = size(rng) * direction(rng), 2e-3 * np.pi * rng.uniform(1.0, 200.0)
    return lambda k, m: u * np.sin(w * k)


def cruise(rng: np.random.Generator) -> Controller:
    """Just below the speed limit to wherever it leads."""
    d, speed = direction(rng), rng.uniform(0.3, 0.498)
    return lambda k, m: np.clip(20.0 * speed * d + 60.0 * (speed * d - m.velocity), -MOST, MOST)


def ram(rng: np.random.Generator) -> Controller:
    """Just below the speed limit onto the tissue, and full thrust before the force trips."""
    d = direction(rng)
    d[2] = -abs(d[2]) - 0.3
    d /= np.linalg.norm(d)
    speed, force = rng.uniform(0.35, 0.498), rng.uniform(10.0, 29.5)

    def command(k: int, m: Any) -> Array:
        if np.linalg.norm(m.force) > force:
            return MOST * d
        return np.clip(20.0 * speed * d + 100.0 * (speed * d - m.velocity), -MOST, MOST)

    return command


def resonate(rng: np.random.Generator) -> Controller:
    """Pushes along with the velocity: as much energy as the motors give."""
    gain, start = np.exp(rng.uniform(np.log(20.0), np.log(2000.0))), direction(rng)
    return lambda k, m: start if k < 3 else np.clip(gain * m.velocity, -MOST, MOST)


def changing(rng: np.random.Generator) -> Controller:
    """A few of the others, one after the other."""
    others = [any_controller(rng, but=changing) for _ in range(4)]
    each = int(rng.integers(1, 80))
    return lambda k, m: others[k // each % 4](k, m)


CONTROLLERS = (
    constant, rubbish, bang_bang, noise, nothing, late, ramp, wave, cruise, ram, resonate, changing,
)  # fmt: skip


def any_controller(rng: np.random.Generator, but: Any) -> Controller:
    simple = [c for c in CONTROLLERS if c is not but and c not in (late, changing)]
    return simple[rng.integers(len(simple))](rng)


# --- the cells -----------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Motion:
    position: Array
    velocity: Array
    acceleration: Array


def beating(rng: np.random.Generator, n: int) -> Motion:
    """Cubed sines at a random rate, up to half as large again as the paper's heart."""
    w = 2.0 * np.pi * rng.uniform(0.8, 2.5)
    a = rng.uniform(0.0, 1.5) * np.array([2e-3, 3e-3, 5e-3])
    t = 1e-3 * np.arange(n)[:, None]
    s, c = np.sin(w * t + (phase := rng.uniform(0, 6.28))), np.cos(w * t + phase)
    return Motion(a * s**3, a * 3 * w * s**2 * c, a * 3 * w**2 * (2 * s * c**2 - s**3))


def some_config(rng: np.random.Generator) -> CellConfig:
    unilateral = rng.random() < 0.6
    friction = float(rng.choice([0.0, 0.5, 1.0]))
    return CellConfig(
        contact=ContactConfig(
            stiffness=float(np.exp(rng.uniform(np.log(200.0), np.log(3000.0)))),
            damping=float(rng.choice([0.0, rng.uniform(0.0, 20.0)])),
            unilateral=bool(unilateral),
            gap=float(rng.uniform(1e-4, 0.03)) if unilateral and rng.random() < 0.6 else 0.0,
        ),
        imperfections=ImperfectionConfig(
            inertia_error=float(rng.uniform(-0.3, 0.4)),
            friction=friction,
            friction_compensation=float(rng.uniform(0.0, 1.0)) if friction else 0.0,
            torque_lag=float(rng.choice([0.0, 0.001, 0.003])),
            delay=int(rng.integers(4)),
        ),
    )


def flawed_config(rng: np.random.Generator) -> CellConfig:
    """Some cell, and every imperfection that there is, each in half of them."""
    config = some_config(rng)

    def now_and_then(low: float, high: float, otherwise: float = 0.0) -> float:
        return float(rng.uniform(low, high)) if rng.random() < 0.5 else otherwise

    flaws = replace(
        config.imperfections,
        inertia_error=tuple(rng.uniform(-0.3, 0.4, 7).tolist()),
        stribeck=now_and_then(0.0, 0.5),
        torque_limit=now_and_then(0.5, 1.0, 1.0),
        joint_frequency=now_and_then(12.0, 60.0),
        joint_damping=float(rng.uniform(0.02, 0.1)),
        encoder_resolution=now_and_then(1e-7, 1e-5),
        velocity_filter=now_and_then(0.0, 0.002),
        delay_jitter=now_and_then(0.0, 0.3),
        tip_mass=now_and_then(0.0, 0.05),
    )
    return replace(config, imperfections=flaws)


@dataclass
class Worst:
    """What came nearest to breaking a promise, over many sequences."""

    sequences: int = 0
    tripped: Counter[str] = field(default_factory=Counter)
    force: float = 0.0
    share_of_cap: float = 0.0
    room_in_range: float = np.inf
    """[rad]"""


class Ring:
    """One cell in which controllers are let loose, one after the other."""

    def __init__(
        self,
        rng: np.random.Generator,
        cycles: int,
        library: Any,
        arm: ArmConfig | None,
        config: Callable[[np.random.Generator], CellConfig] = some_config,
    ) -> None:
        self.config = replace(config(rng), arm=arm)
        self.tool = tool_arm(self.config)
        self.motion = beating(rng, cycles)
        self.rng = rng
        self.force = np.array([1.0, 2.0, -10.0]) * rng.uniform(0.0, 1.5)
        self.cell = Cell(
            self.config,
            self.motion,  # type: ignore[arg-type]
            force=self.force,
            seed=0,
            heart=heart_programme(self.config, self.motion),  # type: ignore[arg-type]
            library=library,
            tool=self.tool,
        )
        contact = self.config.contact
        load = np.zeros(3) if contact.gap else self.force / contact.stiffness
        self.start = self.motion.position[0] + load + [0.0, 0.0, contact.gap]
        self.cap = force_cap(
            self.config, 1.1 * float(np.linalg.norm(self.motion.velocity, axis=1).max()), self.tool
        )

    def fight(self, controller: Controller, worst: Worst) -> Trip | None:
        """Let one controller do its worst; return what the protection made of it.

        Raises:
            AssertionError: a promise is broken.
        """
        cell = self.cell
        cell.move_tool(self.start)
        previous, seen, trip = False, 0, None
        for k in range(cell.cycles):
            measurement, truth = cell.measure(), cell.truth()
            q = cell.data.qpos[6 : 6 + cell.joints]
            room = min(float((q - self.tool.lower).min()), float((self.tool.upper - q).min()))
            assert room > 0.0, f"joint out of range at {k}: {np.rad2deg(q)}"
            assert truth.force_peak <= self.cap, f"{truth.force_peak} N at {k}, cap {self.cap}"
            worst.force = max(worst.force, truth.force_peak)
            worst.share_of_cap = max(worst.share_of_cap, truth.force_peak / self.cap)
            worst.room_in_range = min(worst.room_in_range, room)
            if trip is None:
                beyond = bool(exceeded(cell, self, truth.force))
                trip = truth.trip
                if trip is None:
                    assert not beyond, f"no trip at {k}: {exceeded(cell, self, truth.force)}"
                else:
                    # In the period that ends here; at its beginning all was within limits.
                    assert (k - 1) * 1e-3 - 1e-12 <= trip.time <= k * 1e-3 + 1e-12
                    assert not previous
                previous = beyond
            elif cell.data.eq_active[0]:
                seen += 1
                if seen > 20:
                    break
            cell.apply(controller(k, measurement))
        worst.sequences += 1
        name = str(trip.cause) if trip else "none"
        worst.tripped[name] += 1
        return trip


def exceeded(cell: Cell, ring: Ring, force: Array) -> list[str]:
    """Limits that the state of this instant exceeds, by quantities of MuJoCo's own."""
    own, found = ring.config.protection, []
    data, model, joints = cell.data, cell.model, slice(6, 6 + cell.joints)
    q, speeds = data.qpos[joints], data.qvel[joints]
    twist = np.zeros(6)
    site = model.site("tool_tip").id
    mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, site, twist, 0)
    if (np.abs(speeds) > 1.001 * own.joint_speed * ring.tool.speed).any():
        found.append("joint_speed")
    if np.linalg.norm(twist[3:]) > own.tip_speed + 0.03:  # the guard's is the mean over a step
        found.append("tip_speed")
    if np.linalg.norm(force) > own.force * (1 + 1e-9):
        found.append("force")
    margin = own.joint_margin
    if (q > ring.tool.upper - margin).any() or (q < ring.tool.lower + margin).any():
        found.append("joint_range")
    return found


def rings(
    seed: int | list[int],
    count: int,
    cycles: int,
    library: Any,
    arm: ArmConfig | None = None,
    *,
    config: Callable[[np.random.Generator], CellConfig] = some_config,
) -> Iterator[Ring]:
    for stream in np.random.SeedSequence(seed).spawn(count):
        yield Ring(np.random.default_rng(stream), cycles, library, arm, config)
