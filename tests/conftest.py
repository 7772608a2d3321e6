"""What several folders share; each fixture hands out a function or a small record."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from plant import (
    Cell,
    CellConfig,
    ContactConfig,
    ImperfectionConfig,
    Measurement,
    ProtectionConfig,
    SensorConfig,
    ToolConfig,
)

Array = NDArray[np.float64]
PERIOD = 1e-3
AMPLITUDE = np.array([2e-3, 3e-3, 5e-3])
SETPOINT = np.array([1.0, 2.0, -10.0])


@dataclass(frozen=True, eq=False)
class Path3:
    """A motion of the tissue, ``(n, 3)`` each [m, m/s, m/s^2]."""

    position: Array
    velocity: Array
    acceleration: Array

    @classmethod
    def still(cls, n: int) -> Path3:
        return cls(*np.zeros((3, n, 3)))

    @classmethod
    def beating(cls, n: int, *, scale: float = 1.0, phase: float = 0.4) -> Path3:
        """Third power of a sine at 1.5 Hz: pulses and rests, analytic derivatives."""
        w = 3.0 * np.pi
        t = PERIOD * np.arange(n)[:, None]
        s, c = np.sin(w * t + phase), np.cos(w * t + phase)
        a = scale * AMPLITUDE
        return cls(a * s**3, a * 3 * w * s**2 * c, a * 3 * w**2 * (2 * s * c**2 - s**3))

    def only(self, k: int) -> Path3:
        """The motion of a single sample."""
        here = slice(k, k + 1)
        return Path3(self.position[here], self.velocity[here], self.acceleration[here])


@dataclass(frozen=True, eq=False)
class Trace:
    """What a cell did, one row a cycle."""

    measured: list[Measurement]
    force: Array
    read: Array
    position: Array
    velocity: Array
    tissue: Array
    torque: Array
    saturated: NDArray[np.bool_]
    touching: NDArray[np.bool_]

    def equals(self, other: Trace) -> bool:
        """Bit for bit."""
        names = ("force", "read", "position", "velocity", "tissue", "torque", "saturated")
        return all(
            np.array_equal(getattr(self, n), getattr(other, n), equal_nan=True) for n in names
        )


def _perfect(**changes: Any) -> CellConfig:
    """A cell whose inner loop knows everything; changes go to the record that has the name."""
    config = CellConfig(
        sensor=SensorConfig("ideal"),
        imperfections=ImperfectionConfig(
            inertia_error=0.0,
            friction=0.0,
            friction_compensation=0.0,
            torque_lag=0.0,
            delay=0,
            command_resolution=0.0,
        ),
    )
    return _changed(config, **changes)


def _changed(config: CellConfig, **changes: Any) -> CellConfig:
    parts: dict[str, Any] = {}
    for part, kind in (
        ("contact", ContactConfig),
        ("tool", ToolConfig),
        ("imperfections", ImperfectionConfig),
        ("protection", ProtectionConfig),
        ("sensor", SensorConfig),
    ):
        mine = {k: changes.pop(k) for k in list(changes) if k in kind.__dataclass_fields__}
        parts[part] = replace(getattr(config, part), **mine)
    return replace(config, **parts, **changes)


def _run(
    cell: Cell, command: Callable[[int], Array] | Array | float, cycles: int | None = None
) -> Trace:
    """Drive a cell open loop by ``command``, constant or a function of the cycle."""
    rows = []
    measured = []
    for k in range(cell.cycles if cycles is None else cycles):
        measured.append(cell.measure())
        truth = cell.truth()
        value = command(k) if callable(command) else command
        cell.apply(np.broadcast_to(np.asarray(value, dtype=np.float64), (3,)))
        asked = cell.truth()
        rows.append((truth.force, truth.tissue, asked.torque, asked.saturated, truth.touching))
    force, tissue, torque, saturated, touching = (np.array(v) for v in zip(*rows, strict=True))
    return Trace(
        measured,
        force,
        np.array([m.force for m in measured]),
        np.array([m.position for m in measured]),
        np.array([m.velocity for m in measured]),
        tissue,
        torque,
        saturated,
        touching,
    )


@pytest.fixture(scope="session")
def still() -> Callable[[int], Path3]:
    return Path3.still


@pytest.fixture(scope="session")
def beating() -> Callable[..., Path3]:
    return Path3.beating


@pytest.fixture(scope="session")
def perfect() -> Callable[..., CellConfig]:
    """Configuration of a perfect cell, with changes by the name of a field."""
    return _perfect


@pytest.fixture(scope="session")
def realistic() -> Callable[..., CellConfig]:
    """Configuration of the default cell, with changes by the name of a field."""
    return lambda **changes: _changed(CellConfig(), **changes)


@pytest.fixture(scope="session")
def make_cell() -> Callable[..., Cell]:
    """A cell in contact at the paper's setpoint."""

    def build(config: CellConfig, motion: Path3, **others: Any) -> Cell:
        return Cell(config, motion, **{"force": SETPOINT, "seed": 0} | others)

    return build


@pytest.fixture(scope="session")
def drive() -> Callable[..., Trace]:
    """Drive a cell open loop by a constant command, or a function of the cycle."""
    return _run


@pytest.fixture(scope="session")
def perfect_run() -> Callable[..., Trace]:
    """Drive a perfect cell, with changes by the name of a field."""

    def run(motion: Path3, command: Any, force: Any = SETPOINT, **changes: Any) -> Trace:
        start = np.asarray(force, dtype=np.float64)
        return _run(Cell(_perfect(**changes), motion, force=start, seed=0), command)

    return run
