"""Recorded cycles as plain arrays: problem, vectors and certified answers, for any program to read.

The file is an ``.npz`` (numpy, no pickle): one array for each field of `Instances` that holds
numbers or names, under the field's name, and for each bound ``bounds/<name>/<field>`` with the
fields of `BoundRows`. `FORMAT` stands in ``format``. Shapes: K instances, horizon N, control
horizon N_u, n states, n_u commands, n_y outputs, n_d = N_u n_u decisions, m rows.

What an instance asks: with the model ``x+ = A x + B u``, ``y = C x``, over the horizon

    minimise    sum_i (y(k+i) - w(k+i))' diag(output_weight) (y(k+i) - w(k+i))
              + sum_j Du(k+j)' diag(increment_weight) Du(k+j)
              + sum over soft rows of linear * violation + quadratic * violation^2
    over        Du(k) ... Du(k+N_u-1),     u(k+j) = u(k+j-1) + Du(k+j), then held
    subject to  every bound of ``bounds``

from ``x(k) = state`` and ``u(k-1) = previous``. The same as a condensed QP, up to a constant:

    minimise    1/2 z' P z + q' z + penalties     subject to   l <= G z <= u,     z = Du stacked

where rows with a finite ``linear`` may give way. (``decision`` "absolute" means z holds commands
instead of increments, and their cost is the commands'.) The whole step, from measurement to
command, is: ``state = predicted + gain (measurement - measured predicted)``, then
``w(k+i) = s(k+i) - alpha^i (s(k) - C state)`` with the preview s, then the QP, then
``u(k) = previous + z[:n_u]``. Cycles follow one another, so that ``predicted`` of one is
``A state + B command`` of the one before, with ``command`` the ``previous`` of the next.
"""

from __future__ import annotations

import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.reference import Reference
from bench.stream import Replay, Stream
from qpmpc.bounds import Bound, CommandBound, OutputBound, RateBound, over_horizon
from qpmpc.reference import ExponentialReference
from scenarios import ScenarioError

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
FORMAT = "pulsempc.instances/1"


@dataclass(frozen=True, eq=False)
class BoundRows:
    """One bound, as a modelling tool would state it, and where its rows are in the QP.

    Bounds ``lower <= v <= upper`` at every step: ``v`` is u(k+j), j = 0 ... N_u-1, of kind
    "command"; Du(k+j) of kind "rate"; ``output x(k+i)``, i = 1 ... N, of kind "output".
    """

    name: str
    kind: str
    output: Array
    """Output matrix, ``(width, n)``; empty, ``(0, n)``, where the kind is not "output"."""
    lower: Array
    """``(steps, width)``, may be infinite; as configured: what moves is in the instances' l, u."""
    upper: Array
    """``(steps, width)``, may be infinite."""
    linear: float
    """Price of one unit of violation; infinite: hard."""
    quadratic: float
    """Price of one squared unit of violation."""
    kept: NDArray[np.bool_]
    """Which of the bound's rows are in the QP, ``(steps, width)``: under a delay the first outputs
    are decided already, and what is infinite on both sides is no row."""


@dataclass(frozen=True, eq=False)
class Instances:
    """K consecutive cycles of one closed loop, for one horizon."""

    scenario: str
    axes: str
    """Controlled axes, "x,y,z"."""
    decision_form: str
    """"increment" or "absolute": what z stacks."""
    period: float
    """[s]."""
    horizon: int
    control_horizon: int
    alpha: float
    """Decay of the reference per cycle."""
    A: Array
    B: Array
    C: Array
    measured: Array
    """Rows that are measured, ``(n_measured, n)``."""
    gain: Array
    """Of the observer, ``(n, n_measured)``."""
    output_weight: Array
    """``(n_y,)``."""
    increment_weight: Array
    """``(n_u,)``."""
    P: Array
    """``(n_d, n_d)``."""
    G: Array
    """``(m, n_d)``."""
    linear: Array
    """Price of each row's violation, ``(m,)``, infinite: hard."""
    quadratic: Array
    """``(m,)``."""
    row_bound: NDArray[np.str_]
    """Name of the bound of each row, ``(m,)``; rows of a bound are in the order of its ``kept``."""
    measurement: Array
    """``(K, n_measured)``."""
    predicted: Array
    """x(k|k-1), ``(K, n)``."""
    state: Array
    """x(k|k), ``(K, n)``."""
    previous: Array
    """u(k-1), ``(K, n_u)`` [m/s^2]."""
    command: Array
    """u(k) as it was applied in the recording, ``(K, n_u)`` [m/s^2]."""
    preview: Array
    """s(k) ... s(k+N), ``(K, N + 1, n_y)`` [N]."""
    reference: Array
    """w(k+1) ... w(k+N), ``(K, N, n_y)`` [N]."""
    q: Array
    """``(K, n_d)``."""
    l: Array  # noqa: E741 - the field's name for it
    """``(K, m)``."""
    u: Array
    """``(K, m)``."""
    decision: Array
    """Certified minimiser z, ``(K, n_d)``; NaN where none was certified."""
    multipliers: Array
    """Of the rows, ``(K, m)``, positive at upper bounds, negative at lower ones; NaN likewise."""
    residual: Array
    """Scaled residual that certifies it, at most 1e-7, ``(K,)``; NaN likewise."""
    bounds: tuple[BoundRows, ...]

    @property
    def cycles(self) -> int:
        """K."""
        return len(self.q)

    @property
    def active(self) -> NDArray[np.bool_]:
        """Which rows act on the certified answer, ``(K, m)``."""
        return active_rows(self.multipliers)

    def save(self, path: Path) -> None:
        """Write the file."""
        arrays: dict[str, Any] = {"format": np.array(FORMAT)}
        for field in fields(self):
            if field.name != "bounds":
                arrays[field.name] = np.asarray(getattr(self, field.name))
        for bound in self.bounds:
            for field in fields(bound):
                key = f"bounds/{bound.name}/{field.name}"
                arrays[key] = np.asarray(getattr(bound, field.name))
        np.savez_compressed(path, **arrays)

    @classmethod
    def load(cls, path: Path) -> Instances:
        """Read the file.

        Raises:
            ScenarioError: it cannot be read, or is none of this format.
        """
        try:
            with path.open("rb") as stream:
                file = np.load(stream, allow_pickle=False)
                arrays = {key: file[key] for key in file.files}
        except OSError as error:
            raise ScenarioError(f"{path}: {error.strerror or error}") from None
        except (ValueError, EOFError, AttributeError, zipfile.BadZipFile, zlib.error):
            # no archive, a single array, objects to unpickle, damaged
            raise ScenarioError(f"{path}: not a file of instances") from None
        if str(arrays.get("format")) != FORMAT:
            raise ScenarioError(f"{path}: not a file of instances of format {FORMAT}")
        try:
            return _from_arrays(arrays)
        except KeyError as error:
            raise ScenarioError(f"{path}: misses {error}") from None


def instances(stream: Stream, horizon: int) -> Instances:
    """Write out what a stream asks for with a given horizon, and the certified answers.

    Raises:
        ScenarioError: joints are bounded, so that the rows are others in every cycle.
    """
    replay = Replay(stream, horizon, "analytic")
    controller = replay.controller
    if controller.bounds_joints:
        raise ScenarioError("instances have constant rows: joints must not be bounded")
    general, problem = controller.general, controller.general.problem
    certify = Reference(controller)
    cycles, qp = stream.cycles, problem.qp
    reference = np.empty((cycles, horizon, problem.model.n_outputs))
    state = np.empty((cycles, problem.model.n_states))
    q, l, u = (np.empty((cycles, size)) for size in (qp.n, qp.m, qp.m))  # noqa: E741
    decision, multipliers = np.full_like(q, np.nan), np.full_like(l, np.nan)
    residual = np.full(cycles, np.nan)
    for k, _ in replay.steps(0, cycles):
        state[k] = general.observer.state
        q[k], l[k], u[k] = problem.q, problem.l, problem.u
        reference[k] = general.reference(replay.previews[k], problem.model.C @ state[k])
        solution = certify()
        if solution is not None:
            decision[k], multipliers[k] = solution.x, solution.y
            residual[k] = solution.residuals.scaled
    config = stream.scenario.controller
    trajectory = general.reference
    assert isinstance(trajectory, ExponentialReference)
    return Instances(
        scenario=stream.scenario.name,
        axes=stream.axes,
        decision_form=problem.decision,
        period=stream.scenario.cell.period,
        horizon=horizon,
        control_horizon=problem.moves,
        alpha=trajectory.alpha,
        A=np.array(problem.model.A),
        B=np.array(problem.model.B),
        C=np.array(problem.model.C),
        measured=general.observer.measured,
        gain=general.observer.gain,
        output_weight=np.full(problem.model.n_outputs, config.force_weight),
        increment_weight=np.full(problem.model.n_inputs, config.increment_weight),
        P=np.array(qp.P),
        G=np.array(problem.A),
        linear=np.array(qp.linear),
        quadratic=np.array(qp.quadratic),
        row_bound=np.repeat(
            np.array(list(problem.rows), dtype=np.str_),
            [rows.stop - rows.start for rows in problem.rows.values()],
        ),
        measurement=replay.measurements,
        predicted=replay.states,
        state=state,
        previous=replay.previous[:-1],
        command=replay.previous[1:],
        preview=np.array(replay.previews),
        reference=reference,
        q=q,
        l=l,
        u=u,
        decision=decision,
        multipliers=multipliers,
        residual=residual,
        bounds=tuple(_bounds(replay)),
    )


def active_rows(multipliers: Array) -> NDArray[np.bool_]:
    """Return which rows act, from certified multipliers ``(..., m)``: beyond rounding not zero."""
    size = np.abs(multipliers)
    largest = size.max(axis=-1, initial=0.0, keepdims=True)
    return np.asarray((size > _ROUNDING * largest) & (size > 0), dtype=np.bool_)


_ROUNDING = 1e-7
"""Share of the largest multiplier of a QP below which another is none."""


def _bounds(replay: Replay) -> Iterator[BoundRows]:
    problem = replay.controller.general.problem
    for bound in problem.bounds:
        kept = problem.kept(bound.name)
        lower, upper = over_horizon(bound.name, bound.lower, bound.upper, *kept.shape)
        output, linear, quadratic = np.zeros((0, problem.model.n_states)), np.inf, 0.0
        if isinstance(bound, OutputBound):
            output, linear, quadratic = np.array(bound.output), bound.linear, bound.quadratic
        kind = _KINDS[type(bound)]
        yield BoundRows(bound.name, kind, output, lower, upper, linear, quadratic, kept)


_KINDS: dict[type[Bound], str] = {
    CommandBound: "command",
    RateBound: "rate",
    OutputBound: "output",
}


def _from_arrays(arrays: dict[str, Any]) -> Instances:
    def plain(array: Any) -> Any:
        return array.item() if array.ndim == 0 else array

    names = dict.fromkeys(key.split("/")[1] for key in arrays if key.startswith("bounds/"))
    bounds = tuple(
        BoundRows(**{f.name: plain(arrays[f"bounds/{name}/{f.name}"]) for f in fields(BoundRows)})
        for name in names
    )
    own = {f.name: plain(arrays[f.name]) for f in fields(Instances) if f.name != "bounds"}
    return Instances(**own, bounds=bounds)
