"""How large the explicit law becomes, ``python -m bench.explicit``: a table of docs/explicit.md."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from qpmpc import BoundsConfig, ControllerConfig, ForceController, ObserverConfig
from qpmpc.arrays import Array
from qpmpc.config import Disturbance

_PERIOD = 1e-3
_COMMAND, _VELOCITY, _FORCE = (-20.0, 20.0), (-0.1, 0.1), (-14.0, 2.0)
_BOUNDS = {
    "command": BoundsConfig(command=_COMMAND),
    "command, velocity": BoundsConfig(command=_COMMAND, velocity=_VELOCITY),
    "command, velocity, force": BoundsConfig(command=_COMMAND, velocity=_VELOCITY, force=_FORCE),
}
_CYCLES = 2000


@dataclass(frozen=True)
class Size:
    """One problem and the law that was made of it."""

    horizon: int
    bounds: str
    disturbance: Disturbance
    rows: int
    regions: int
    complete: bool
    covered: float
    memory: int
    operations: int
    seconds: float
    """To set it up: enumerated, or read from the cache."""
    at_once: float
    """Share of cycles whose region is the one of the cycle before, in the motion of `_walk`."""
    left: float
    """Share of cycles left to DAQP there."""
    longest: int
    """Regions tried at most in one search there."""


def measure(horizon: int, bounds: str, disturbance: Disturbance) -> Size:
    """Make the law of one axis and let it meet states that wander through what is expected."""
    config = ControllerConfig(
        horizon=horizon,
        bounds=_BOUNDS[bounds],
        observer=ObserverConfig(disturbance=disturbance),
    )
    begin = perf_counter()
    controller = ForceController(config, ("z",), _PERIOD, "explicit")
    seconds = perf_counter() - begin
    general = controller.general
    problem, solver = general.problem, general.solver
    (facts,) = solver.facts()
    ranges = controller.ranges
    for state, previous, setpoint in _walk(ranges.state, ranges.setpoint, problem.commands):
        reference = general.reference(np.tile(setpoint, (horizon + 1, 1)), state[:1])
        problem.update(state, previous, reference)
        solver.solve(problem.q, problem.l, problem.u)
        solver.prepare()
    (after,) = solver.facts()
    return Size(
        horizon,
        bounds,
        disturbance,
        problem.qp.m,
        int(facts["regions"]),
        bool(facts["complete"]),
        float(facts["covered"]),
        int(facts["memory_bytes"]),
        int(facts["most_operations"]),
        seconds,
        float(after["found_at_once"]) / _CYCLES,
        float(after["left_to_daqp"]) / _CYCLES,
        int(after["longest_search"]),
    )


def _walk(
    state: Array, setpoint: Array, commands: tuple[Array, Array]
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield states, last commands and setpoints that wander, slowly against the cycle."""
    sides = np.vstack([state, np.column_stack(commands), setpoint])
    centre, half = sides.mean(axis=1), np.ptp(sides, axis=1) / 2
    rng, v = np.random.default_rng(1), np.zeros(len(sides))
    n = len(state)
    for _ in range(_CYCLES):
        v = np.clip(0.995 * v + 0.08 * rng.standard_normal(v.size), -1.0, 1.0)
        values = centre + half * v
        yield values[:n], values[n : n + 1], values[n + 1 :]


_HEAD = (
    "| N | bounds | disturbance | rows | regions | complete | covered | memory | most "
    "multiplications | set up | same region | left to DAQP | longest search |\n"
    f"|{'---|' * 13}\n"
)


def _line(s: Size) -> str:
    return (
        f"| {s.horizon} | {s.bounds} | {s.disturbance} | {s.rows} | {s.regions} | "
        f"{'yes' if s.complete else 'no'} | {s.covered:.1%} | {s.memory / 1e3:.0f} kB | "
        f"{s.operations} | {s.seconds:.1f} s | {s.at_once:.1%} | {s.left:.2%} | {s.longest} |\n"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table for the horizons that are asked for."""
    parser = argparse.ArgumentParser(prog="python -m bench.explicit", description=__doc__)
    parser.add_argument("--horizons", default="1,2,3,4,5,6,8,10,16,32", metavar="N,N,...")
    asked = parser.parse_args(arguments)
    try:
        horizons = [int(word) for word in asked.horizons.split(",")]
    except ValueError:
        parser.error(f"--horizons: whole numbers separated by commas, got '{asked.horizons}'")
    every = list(_BOUNDS)[-1]
    asked_for: list[tuple[int, str, Disturbance]] = [(n, every, "fused") for n in horizons]
    asked_for += [(8, bounds, "fused") for bounds in list(_BOUNDS)[:-1]]
    asked_for += [(8, every, "constant"), (8, every, "none")]
    sys.stdout.write(_HEAD)
    for problem in asked_for:
        sys.stdout.write(_line(measure(*problem)))
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
