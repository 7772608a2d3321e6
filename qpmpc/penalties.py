"""Exact penalties in an order: what gives way first when not all soft bounds can hold."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from qpmpc.arrays import Array, Indices, vector
from qpmpc.bounds import MappedBound, OutputBound
from qpmpc.construction import NUMPY, Construction, Decision
from qpmpc.models import LinearModel
from qpmpc.rows import Rows, Setting

_MARGIN = 4.0
"""Factor between a penalty and what giving way could bring by the estimate below."""
_HARDLY = 1e-2
"""Directions in which rows move less than this, beside the others, are no way to gain anything."""

SoftBound = OutputBound | MappedBound


def ordered(
    bounds: Sequence[SoftBound],
    model: LinearModel,
    horizon: int,
    *,
    output_weight: ArrayLike,
    largest_error: ArrayLike,
    control_horizon: int | None = None,
    decision: Decision = "increment",
    construction: Construction = NUMPY,
) -> list[SoftBound]:
    """Return the bounds with penalties such that each holds before all that stand after it.

    A row that gives way by one unit lets the outputs, and the rows of weaker bounds, move by
    ``M = A_weaker pinv(A_row)``. What that can bring is at most the sum of the weaker penalties and
    of the slope of the output's cost, times ``|M|``; the penalty is four times that. It is an
    estimate, not a proof: it knows nothing of the cost of the decision, nor of other rows that are
    at their bounds, and the cost of the outputs is quadratic, so that no finite penalty is exact
    for every error. A bound can give way early where only a decision near the limit of the command
    would hold it.

    Args:
        bounds: strongest first; their ``linear`` is replaced.
        model, horizon, output_weight, control_horizon, decision, construction: as for `Problem`.
        largest_error: error of the outputs up to which the order is promised, scalar or
            ``(n_outputs,)``.
    """
    common = Setting.of(model, horizon, control_horizon, decision, construction)
    delta = vector("output_weight", output_weight, model.n_outputs)
    error = vector("largest_error", largest_error, model.n_outputs)
    slope = np.tile(2.0 * delta * error, horizon)
    weaker: list[tuple[Array, Array]] = [(common.predict(model.C).Theta, slope)]
    result: list[SoftBound] = []
    for bound in reversed(bounds):
        kept = replace(bound, moving=True) if isinstance(bound, OutputBound) else bound
        rows = Rows(kept, common).decision
        penalty = _MARGIN * _relief(rows, weaker)
        result.append(replace(bound, linear=penalty))
        weaker.append((rows, np.full(len(rows), penalty)))
    return result[::-1]


def _relief(rows: Array, weaker: Sequence[tuple[Array, Array]]) -> float:
    """Return the most that one unit of one row can bring to all that is weaker."""
    if not rows.size:
        return 1.0
    own, others = np.asarray(rows != 0), [np.asarray(other != 0) for other, _ in weaker]
    # Axes that nothing couples are looked at one by one: the work grows with the third power.
    groups = [
        (columns, own[:, columns].any(axis=1)) for columns in _uncoupled(np.vstack([own, *others]))
    ]
    factors = [
        np.linalg.svd(rows[np.ix_(mine, columns)], full_matrices=False) for columns, mine in groups
    ]
    least = _HARDLY * max(float(s.max(initial=0.0)) for _, s, _ in factors)
    most = 0.0
    for (columns, _), (U, s, Vt) in zip(groups, factors, strict=True):
        used = s > least
        inverse = (Vt[used].T / s[used]) @ U[:, used].T
        gain = np.zeros(len(U))
        for (other, price), there in zip(weaker, others, strict=True):
            touched = there[:, columns].any(axis=1)
            gain += price[touched] @ np.abs(other[np.ix_(touched, columns)] @ inverse)
        most = max(most, float(gain.max(initial=0.0)))
    return most or 1.0  # nothing to gain: any price will do


def _uncoupled(pattern: NDArray[np.bool_]) -> list[Indices]:
    """Return the columns in groups that no row of ``pattern`` has in common."""
    rows, columns = pattern.shape
    entries = coo_matrix(pattern)
    graph = coo_matrix((entries.data, (entries.row + columns, entries.col)), (rows + columns,) * 2)
    count, label = connected_components(graph, directed=False)
    groups = [np.flatnonzero(label[:columns] == i) for i in range(count)]
    return [group for group in groups if group.size]
