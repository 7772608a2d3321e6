"""What a peer is given: recorded instances, written so that a modelling tool can state them.

The file holds no answers: what a peer returns is judged by who kept them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.instances import BoundRows, Instances
from qpmpc import LinearModel
from qpmpc.prediction import prediction
from scenarios import ScenarioError

Array = NDArray[np.float64]


def write_task(instances: Instances, path: Path) -> None:
    """Write the task of ``instances`` to an ``.npz``; `Task` in ``adapters/_harness.py`` reads it.

    Beside model, weights, states, last commands and references: ``E``, the outputs that are
    bounded softly, with ``linear``, ``quadratic`` and ``kept`` (which rows a decision can move);
    bounds of every cycle, ``command``, ``rate``, ``output``, each ``(K, 2, N, width)``; ``moved``,
    where they are others than in the cycle before; and the condensed QP, ``P``, ``G``,
    ``row_linear``, ``row_quadratic``, ``rows (K, 2, m)``, with the maps that give its vectors from
    ``p = (x, u(k-1))``: ``q = error_to_q (w - free_map p)``, ``l, u = rows - row_map p``. For who
    does the whole step there are observer, measurements and previews of the setpoint, too.

    Raises:
        ScenarioError: the instances are of a form that peers do not know.
    """
    if instances.decision_form != "increment":
        raise ScenarioError("peers decide increments: record with controller.decision='increment'")
    if instances.control_horizon != instances.horizon:
        raise ScenarioError("peers move at every step: record without a control horizon")
    N, n_u, cycles = instances.horizon, instances.B.shape[1], instances.cycles
    model = prediction_maps(instances)
    parameters = np.hstack([instances.state, instances.previous])
    offsets = parameters @ model["row_map"].T
    rows = np.stack([instances.l + offsets, instances.u + offsets], axis=1)
    by_bound = {
        bound.name: _over_cycles(bound, rows[..., instances.row_bound == bound.name])
        for bound in instances.bounds
    }
    command, rate = np.full((2, cycles, 2, N, n_u), np.inf)
    command[:, 0], rate[:, 0] = -np.inf, -np.inf
    for bound in instances.bounds:
        if bound.kind != "output":
            _tighten(command if bound.kind == "command" else rate, by_bound[bound.name])
    soft = [bound for bound in instances.bounds if bound.kind == "output"]
    width = [len(bound.output) for bound in soft]
    moved = np.ones(cycles, dtype=np.bool_)
    # Offsets are added back to what they were taken off: equal up to rounding is equal.
    moved[1:] = ~np.isclose(rows[1:], rows[:-1], rtol=1e-9, atol=1e-9).all(axis=(1, 2))
    arrays: dict[str, Any] = dict(
        N=N,
        period=instances.period,
        A=instances.A,
        B=instances.B,
        C=instances.C,
        E=np.vstack([np.zeros((0, len(instances.A))), *(bound.output for bound in soft)]),
        output_weight=instances.output_weight,
        increment_weight=instances.increment_weight,
        linear=np.repeat([bound.linear for bound in soft], width),
        quadratic=np.repeat([bound.quadratic for bound in soft], width),
        kept=np.hstack([np.zeros((N, 0), dtype=np.bool_), *(bound.kept for bound in soft)]),
        state=instances.state,
        previous=instances.previous,
        reference=instances.reference,
        measured=instances.measured,
        gain=instances.gain,
        alpha=instances.alpha,
        measurement=instances.measurement,
        preview=instances.preview,
        predicted=instances.predicted,
        command=command,
        rate=rate,
        output=np.concatenate(
            [np.zeros((cycles, 2, N, 0)), *(by_bound[bound.name] for bound in soft)], axis=-1
        ),
        moved=moved,
        P=instances.P,
        G=instances.G,
        row_linear=instances.linear,
        row_quadratic=instances.quadratic,
        rows=rows,
        **model,
    )
    np.savez(path, **arrays)


def prediction_maps(instances: Instances) -> dict[str, Array]:
    """Return ``free_map``, ``error_to_q`` and ``row_map``, see `write_task`."""
    model, N = (instances.A, instances.B, instances.C), instances.horizon
    n, n_u = instances.B.shape
    free = _prediction(*model[:2], instances.C, N)
    weights = np.tile(instances.output_weight, N)
    parts: list[Array] = [np.zeros((0, n + n_u))]
    for bound in instances.bounds:
        if bound.kind == "output":
            whole = np.hstack(_prediction(*model[:2], bound.output, N)[:2])
        else:
            last = np.eye(n_u) if bound.kind == "command" else np.zeros((n_u, n_u))
            whole = np.tile(np.hstack([np.zeros((n_u, n)), last]), (N, 1))
        parts.append(whole[bound.kept.ravel()])
    return {
        "free_map": np.hstack(free[:2]),
        "error_to_q": -2.0 * (weights[:, None] * free[2]).T,
        "row_map": np.vstack(parts),
    }


def _prediction(A: Array, B: Array, C: Array, N: int) -> tuple[Array, Array, Array]:
    p = prediction(LinearModel(A, B, C, 1.0), N, N, C)
    return p.Psi, p.Upsilon, p.Theta


def _over_cycles(bound: BoundRows, rows: Array) -> Array:
    """Spread the rows of a bound ``(K, 2, size)`` over its steps; what is no row is infinite."""
    steps, width = bound.kept.shape
    result = np.full((len(rows), 2, steps * width), np.inf)
    result[:, 0] = -np.inf
    result[:, :, bound.kept.ravel()] = rows
    return result.reshape(len(rows), 2, steps, width)


def _tighten(both: Array, other: Array) -> None:
    np.maximum(both[:, 0], other[:, 0], out=both[:, 0])
    np.minimum(both[:, 1], other[:, 1], out=both[:, 1])
