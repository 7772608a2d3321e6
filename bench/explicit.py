"""How large the explicit law becomes: ``python -m bench.explicit``, the table of docs/explicit.md."""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from qpmpc import BoundsConfig, ControllerConfig, ForceController, ObserverConfig
from qpmpc.config import FREE, Band, Disturbance

_PERIOD = 1e-3
_BANDS: dict[str, dict[str, Band]] = {
    "command": {"velocity": FREE, "force": FREE},
    "command, velocity": {"velocity": (-0.1, 0.1), "force": FREE},
    "command, velocity, force": {"velocity": (-0.1, 0.1), "force": (-14.0, 2.0)},
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
        bounds=BoundsConfig(command=(-20.0, 20.0), **_BANDS[bounds]),
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
    state: np.ndarray, setpoint: np.ndarray, commands: tuple[np.ndarray, np.ndarray]
) -> Iterator[tuple[np.ndarray, ...]]:
    """Yield states, last commands and setpoints that wander, slowly against the cycle."""
    sides = np.vstack([state, np.column_stack(commands), setpoint])
    centre, half = sides.mean(axis=1), np.ptp(sides, axis=1) / 2
    rng, v = np.random.default_rng(1), np.zeros(len(sides))
    n = len(state)
    for _ in range(_CYCLES):
        v = np.clip(0.995 * v + 0.08 * rng.standard_normal(v.size), -1.0, 1.0)
        values = centre + half * v
        yield values[:n], values[n : n + 1], values[n + 1 :]


def table(sizes: Sequence[Size]) -> str:
    """Return the table in Markdown."""
    lines = [
        "| N | bounds | disturbance | rows | regions | complete | covered | memory | most "
        "multiplications | set up | same region | left to DAQP | longest search |",
        "|" + "---|" * 13,
    ]
    for s in sizes:
        lines.append(
            f"| {s.horizon} | {s.bounds} | {s.disturbance} | {s.rows} | {s.regions} | "
            f"{'yes' if s.complete else 'no'} | {s.covered:.1%} | {s.memory / 1e3:.0f} kB | "
            f"{s.operations} | {s.seconds:.1f} s | {s.at_once:.1%} | {s.left:.2%} | {s.longest} |"
        )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table for the horizons that are asked for."""
    parser = argparse.ArgumentParser(prog="python -m bench.explicit", description=__doc__)
    parser.add_argument("--horizons", default="1,2,3,4,5,6,8,10,16,32", metavar="N,N,...")
    asked = parser.parse_args(arguments)
    try:
        horizons = [int(word) for word in asked.horizons.split(",")]
    except ValueError:
        parser.error(f"--horizons: whole numbers separated by commas, got '{asked.horizons}'")
    sizes = [measure(n, "command, velocity, force", "fused") for n in horizons]
    sizes += [measure(8, bounds, "fused") for bounds in list(_BANDS)[:2]]
    sizes += [measure(8, "command, velocity, force", kind) for kind in ("none", "constant")]
    sys.stdout.write(table(sizes) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
