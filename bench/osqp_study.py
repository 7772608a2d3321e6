"""How OSQP is best asked: ``python -m bench.osqp_study``, discussed in ``docs/osqp.md``.

Cycles are recorded from closed loops on the cell. Each way to ask OSQP then solves the same ones,
in their order, several times over; a cycle's time is the least of the passes.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from bench.instances import Instances, instances
from bench.osqp_forms import Form, condensed, program, staged
from bench.stream import record
from plant.errors import PlantError
from qpmpc import Solver
from qpmpc.backends import Backend, backend_class
from qpmpc.backends.osqp import OsqpBackend
from qpmpc.errors import QpmpcError
from scenarios import ScenarioError, load_scenario
from scenarios.metrics import versions

Array = NDArray[np.float64]
Part = Literal["ways", "horizons"]
Start = Literal["last answer", "shifted", "cold"]
_MOST, _LONGEST = 4000, 0.05
"""OSQP's limits here, of iterations and time [s]; a cycle that reaches one counts as stopped."""
_CASES = {
    "cap": ("constrained", 11.0, ("axes=['z']",)),
    "tight": (
        "paper-1d",
        4.0,
        ("controller.bounds.command=[-3,3]", "controller.bounds.force.z=[-10.5,-9.5]"),
    ),
}
"""Scenario, duration [s] and settings of each case."""
_FEWER = 10
"""What part of the cycles is enough where the horizon is varied."""
_LONG = "tight"
"""The case of which the horizon is varied."""


@dataclass(frozen=True)
class Row:
    """One way to ask OSQP, in one case."""

    part: Part
    case: str
    horizon: int
    variant: str
    p50: float
    """Of the time of update and solve [us]."""
    p99: float
    p999: float
    iterations: float
    """In the median; of backends with the equations of the polish."""
    stopped: float
    """Share of the cycles that reached a limit, or were called infeasible."""
    error: float
    """Of the first Delta u, at the worst [m/s^2]."""


@dataclass(frozen=True, eq=False)
class Case:
    """Cycles that follow one another."""

    name: str
    data: Instances
    cycles: slice

    def row(self, part: Part, variant: str, run: Run, passes: int) -> Row:
        """Run the cycles ``passes`` times over."""
        every = [run() for _ in range(passes)]
        times = 1e6 * np.min([times for times, _, _, _ in every], axis=0)
        _, iterations, stopped, first = every[-1]
        right = self.data.decision[self.cycles, : first.shape[1]]
        p50, p99, p999 = np.percentile(times, [50, 99, 99.9]).tolist()
        return Row(
            part, self.name, self.data.horizon, variant, p50, p99, p999,
            float(np.median(iterations)), float(np.mean(stopped)),
            float(np.nanmax(np.abs(first - right))),
        )  # fmt: skip


Run = Callable[[], tuple[Array, Array, Array, Array]]
"""Solves all cycles: times [s], iterations, whether stopped, and first increments of each."""


def busiest(data: Instances, cycles: int) -> slice:
    """Return where that many consecutive cycles hold the most with an active row."""
    active = np.concatenate([[0], np.cumsum(data.active.any(axis=1))])
    cycles = min(cycles, data.cycles)
    start = int(np.argmax(active[cycles:] - active[:-cycles]))
    return slice(start, start + cycles)


def raw(
    form: Form, *, start: Start = "last answer", through_python: bool = False, **more: Any
) -> Run:
    """Let OSQP alone solve.

    Args:
        form: the cycles. start: from where each solve begins.
        through_python: whether to go through osqp's Python class instead of the object in C.
        more: settings other than those that all variants begin from.
    """
    import osqp  # noqa: PLC0415 - as in its backend

    settings = {
        "eps_abs": 1e-6, "eps_rel": 1e-6, "check_termination": 5, "adaptive_rho_interval": 25,
        "rho": 1.0, "scaling": 0, "max_iter": _MOST, "time_limit": _LONGEST,
    } | more  # fmt: skip

    def run() -> tuple[Array, Array, Array, Array]:
        asked = osqp.OSQP()
        asked.setup(form.P, form.q[0], form.A, form.l[0], form.u[0], verbose=False, **settings)
        solver: Any = asked._solver
        x, y = np.zeros(form.q.shape[1]), np.zeros(form.l.shape[1])
        times, iterations, stopped, first = [], [], [], []
        for k, (q, l, u) in enumerate(zip(form.q, form.l, form.u, strict=True)):  # noqa: E741
            begin = perf_counter()
            if through_python:
                asked.update(q=q, l=l, u=u)
                found = asked.solve(raise_error=False).x
            else:
                solver.update_data_vec(q, l, u)
                if start != "last answer":
                    solver.warm_start(x, y)
                solver.solve()
                found = solver.solution.x
            times.append(perf_counter() - begin)
            iterations.append(solver.info.iter)
            stopped.append(solver.info.status_val != osqp.SolverStatus.OSQP_SOLVED)
            first.append(form.first(k, found))
            if start == "shifted":
                x, y = form.shift(found, solver.solution.y)
        return np.array(times), np.array(iterations), np.array(stopped), np.array(first)

    return run


def through(case: Case, backend: type[Backend]) -> Run:
    """Let a backend solve, with all that the library does around it but its check."""
    data, cycles = case.data, case.cycles
    qp = program(data)
    names = data.row_bound
    groups = [slice(*np.flatnonzero(names == n)[[0, -1]] + [0, 1]) for n in dict.fromkeys(names)]

    def run() -> tuple[Array, Array, Array, Array]:
        solver = Solver(qp, backend, groups)
        times, iterations, first = [], [], []
        for k in range(cycles.start, cycles.stop):
            solution = solver.solve(data.q[k], data.l[k], data.u[k])
            times.append(solution.update_time + solution.solve_time)
            iterations.append(solution.iterations)
            first.append(solution.x[: data.B.shape[1]].copy())
        return np.array(times), np.array(iterations), np.zeros(len(times)), np.array(first)

    return run


def short(case: Case) -> Iterator[tuple[str, Run]]:
    """The variants that are compared on the scenario's own horizon."""
    data, cycles = case.data, case.cycles
    white = condensed(data, cycles)
    commands = condensed(data, cycles, "commands")
    plain = condensed(data, cycles, "increments", "as they are")
    yield (
        "osqp's defaults, through its Python class",
        raw(plain, through_python=True, eps_abs=1e-3, eps_rel=1e-3, check_termination=25,
            adaptive_rho_interval=50, rho=0.1, scaling=10),
    )  # fmt: skip
    yield "variables: increments", raw(condensed(data, cycles, "increments"))
    yield "variables: commands", raw(commands)
    yield (
        "variables: whitened (**base** of what follows)",
        raw(white),
    )
    yield "through osqp's Python class", raw(white, through_python=True)
    yield "rows as they are", raw(condensed(data, cycles, rows="as they are"))
    yield "rows each divided by its norm", raw(condensed(data, cycles, rows="each"))
    yield "OSQP's scaling too", raw(white, scaling=10)
    for rho in (0.1, 1.0, 10.0, 100.0):
        yield f"rho fixed at {rho:g}", raw(white, adaptive_rho=False, rho=rho)
    for interval in (10, 100):
        yield f"rho adapted every {interval}", raw(white, adaptive_rho_interval=interval)
    for interval in (1, 25):
        yield f"checked every {interval}", raw(white, check_termination=interval)
    for eps in (1e-3, 1e-4, 1e-9):
        yield f"eps {eps:g}", raw(white, eps_abs=eps, eps_rel=eps)
    for alpha in (1.0, 1.8):
        yield f"alpha {alpha:g}", raw(white, alpha=alpha)
    yield "start: cold", raw(white, start="cold")
    yield "start: shifted", raw(white, start="shifted")
    for unit in (0.25, 0.5, 1.0):
        yield f"slack in units of price^-{unit:g}", raw(condensed(data, cycles, unit=unit))
    yield "soft rows taken as hard (another QP)", raw(condensed(data, cycles, slack=False))
    yield "osqp's own polishing", raw(white, polishing=True)
    if case.name == _LONG:  # bounds do not move there
        yield "states as variables", raw(staged(data, cycles))
    for first in (5, 25, 100):
        for rho in (1.0, 10.0):
            name = f"our polish after {first} iterations, rho {rho:g}"
            if (first, rho) == (OsqpBackend.rounds[0], OsqpBackend.step_size):
                name += " (**backend `osqp`**)"
            yield name, through(case, _polished(first, rho))
    yield "backend `daqp`", through(case, backend_class("daqp"))


def _polished(first: int, rho: float) -> type[OsqpBackend]:
    class Polished(OsqpBackend):
        rounds = (first, *OsqpBackend.rounds[1:])
        step_size = rho

    return Polished


def long(case: Case) -> Iterator[tuple[str, Run]]:
    """The variants whose horizon is varied."""
    yield "condensed, whitened", raw(condensed(case.data, case.cycles))
    yield "condensed, commands", raw(condensed(case.data, case.cycles, "commands"))
    stages = staged(case.data, case.cycles)
    yield "states as variables", raw(stages)
    yield "states as variables, OSQP's scaling too", raw(stages, scaling=10)
    yield "backend `osqp`", through(case, backend_class("osqp"))
    yield "backend `daqp`", through(case, backend_class("daqp"))


def study(
    cycles: int, passes: int, horizons: Sequence[int], tell: Callable[[str], None]
) -> list[Row]:
    """Record, and measure every variant."""
    rows: list[Row] = []

    def measure(case: Case, part: Part, variants: Iterator[tuple[str, Run]]) -> None:
        share = case.data.active[case.cycles].any(axis=1).mean()
        tell(f"{case.name}, N = {case.data.horizon}: a row is active in {share:.0%} of the cycles")
        for name, run in variants:
            rows.append(case.row(part, name, run, passes))
            tell(f"  {name}: {rows[-1].p50:.0f} / {rows[-1].p99:.0f} us")

    for name, (scenario, duration, settings) in _CASES.items():
        asked = load_scenario(scenario, top={"duration": duration}, settings=settings)
        tell(f"recording {scenario}")
        stream = record(asked, report=lambda *_: None, stop=lambda: False)
        assert stream is not None
        data = instances(stream, asked.controller.horizon)
        case = Case(name, data, busiest(data, cycles))
        measure(case, "ways", short(case))
        for horizon in horizons if name == _LONG else ():
            data = instances(stream, horizon)
            case = Case(name, data, busiest(data, max(cycles // _FEWER, 1)))
            measure(case, "horizons", long(case))
    return rows


def table(rows: Sequence[Row], part: Part) -> str:
    """Write one part of the rows as Markdown, a line a variant, cases or horizons side by side."""
    mine = [row for row in rows if row.part == part]
    groups = list(dict.fromkeys((row.case, row.horizon) for row in mine))
    cells = {(row.variant, row.case, row.horizon): row for row in mine}
    heads = [f"{case}, N = {horizon}" for case, horizon in groups]
    lines = ["| | " + " | ".join(heads) + " |", "|---" * (1 + len(heads)) + "|"]
    for variant in dict.fromkeys(row.variant for row in mine):
        found = [cells.get((variant, *group)) for group in groups]
        lines.append(f"| {variant} | " + " | ".join(map(_cell, found)) + " |")
    return "\n".join(lines)


def _cell(row: Row | None) -> str:
    if row is None:
        return ""
    stopped = f", {row.stopped:.0%} unsolved" if row.stopped else ""
    return (
        f"{row.p50:.0f} / {row.p99:.0f} / {row.p999:.0f}; {row.iterations:.0f}; "
        f"{row.error:.0e}{stopped}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study and print it; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m bench.osqp_study", description=_WHAT)
    parser.add_argument("--cycles", type=_positive, default=500, help="of each case")
    parser.add_argument("--passes", type=_positive, default=3, help="over the same cycles")
    parser.add_argument("--horizons", type=_horizons, default=(8, 16, 32, 64, 128))
    parser.add_argument("--json", action="store_true", help="print rows as JSON, not as tables")
    asked = parser.parse_args(arguments)
    try:
        rows = study(
            asked.cycles, asked.passes, asked.horizons, lambda text: print(text, file=sys.stderr)
        )
    except (QpmpcError, PlantError, ScenarioError) as error:
        print(f"osqp_study: {error}", file=sys.stderr)
        return 2
    if asked.json:
        print(json.dumps({"rows": [asdict(row) for row in rows], "versions": versions()}, indent=1))
    else:
        print(f"{_LEGEND}\n\n{table(rows, 'ways')}\n\n{table(rows, 'horizons')}")
    return 0


_WHAT = "Compare ways to ask OSQP on cycles recorded from closed loops on the cell."
_LEGEND = (
    "Each cell: median / p99 / p99.9 of update and solve [us]; iterations, median; "
    "largest error of the first increment [m/s^2]."
)


def _positive(text: str) -> int:
    number = int(text) if text.isdecimal() else 0
    if number < 1:
        raise argparse.ArgumentTypeError(f"must be a positive whole number, got {text!r}")
    return number


def _horizons(text: str) -> tuple[int, ...]:
    return tuple(_positive(part) for part in text.split(","))


if __name__ == "__main__":
    sys.exit(main())
