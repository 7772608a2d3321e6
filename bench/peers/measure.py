"""Peers and our own rows on the same instances: set up, pass by pass in turn, judged."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.instances import Instances
from bench.peers.catalogue import Peer
from bench.peers.environment import environment, foreign_variables
from bench.peers.failure import PeerFailure
from bench.peers.session import Session

Tell = Callable[[str], None]
AGREES = 1e-4
"""Error of the first increment, as a share of the command's bound, up to which it is the same."""
_ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Effort:
    """How long a measurement may take."""

    passes: int = 5
    """Times that every instance is solved."""
    install: float = 900.0
    """Seconds for one requirement of an environment."""
    run: float = 300.0
    """Seconds for set-up (with compilers), and for each pass."""


@dataclass(eq=False)
class Row:
    """One way of using one package, and what came of it."""

    peer: Peer
    variant: str
    told: dict[str, Any] = field(default_factory=dict)
    """What the harness said: what it solves, versions, Python."""
    reason: str | None = None
    """Why there are no figures."""
    times: NDArray[np.int64] | None = None
    """``(passes, K)`` [ns]."""
    increments: NDArray[np.float64] | None = None
    """``(passes, K, n_u)``."""


def measure(
    peers: Sequence[Peer], task: Path, folder: Path, effort: Effort, tell: Tell
) -> list[Row]:
    """Let every variant of every peer solve the task, the passes of all in turn.

    Speeds of a shared machine change from minute to minute: taken in turn, all meet the same ones.
    A peer that fails gets a row with the reason, and the others go on.

    Args:
        peers: in the order of the rows.
        task: see `write_task`.
        folder: of environments and generated code.
        effort: see there.
        tell: told in a line what is being done.
    """
    rows = [Row(peer, variant) for peer in peers for variant in peer.variants]
    with ExitStack() as stack:
        sessions: list[tuple[Row, Session]] = []
        for peer in peers:
            own = [row for row in rows if row.peer is peer]
            tell(f"{peer.name}: environment")
            try:
                python, variables = interpreter(peer, folder, effort)
            except PeerFailure as failure:
                for row in own:
                    row.reason = str(failure)
                continue
            for row in own:
                tell(f"{peer.name}, {row.variant}: set-up")
                work = folder / "work" / f"{peer.name}-{_plain(row.variant)}"
                session = stack.enter_context(
                    Session(
                        python,
                        peer.adapter,
                        task,
                        work,
                        row.variant,
                        environment=variables,
                        limit=effort.run,
                    )
                )
                _unless_failed(row, partial(_set_up, row, session))
                sessions.append((row, session))
        for i in range(effort.passes):
            for row, session in sessions:
                tell(f"pass {i + 1} of {effort.passes}: {row.peer.name}, {row.variant}")
                _unless_failed(row, session.make_pass)
        for row, session in sessions:
            _unless_failed(row, partial(_collect, row, session))
    return rows


def _unless_failed(row: Row, act: Callable[[], object]) -> None:
    """Do the next thing with a peer that has not failed, and note the reason where it does."""
    if row.reason is None:
        try:
            act()
        except PeerFailure as failure:
            row.reason = str(failure)


def _set_up(row: Row, session: Session) -> None:
    row.told = session.ready()


def _collect(row: Row, session: Session) -> None:
    row.times, row.increments = session.finish()


def interpreter(peer: Peer, folder: Path, effort: Effort) -> tuple[list[str], dict[str, str]]:
    """Return the command that starts the peer's Python, and its variables.

    A peer's own is isolated (``-I``): neither the working directory nor PYTHONPATH are searched,
    and what it imports as ``qpmpc`` is what its environment holds.

    Raises:
        PeerFailure: its environment cannot be made.
    """
    variables = foreign_variables()
    if peer.requirements is None:
        return [sys.executable, "-P"], variables | {"PYTHONPATH": str(_ROOT)}
    python = environment(folder / peer.name, peer.requirements, limit=effort.install)
    return [str(python), "-I"], variables


def judge(row: Row, instances: Instances) -> dict[str, Any]:
    """Return the row of the JSON: figures of time, and how far increments are from the certified.

    ``us``: median and tails over all passes and instances; ``floor_us``: over the smallest time of
    each instance, which is the algorithm's, without the machine's stalls. ``error`` is the largest
    difference from the certified first increment in any pass, as a share of the command's bound.
    """
    result: dict[str, Any] = {
        "peer": row.peer.name,
        "variant": row.variant,
        "ours": row.peer.requirements is None,
        "solves": row.told.get("solves"),
        "versions": row.told.get("versions", {}),
        "python": row.told.get("python"),
        "reason": row.reason,
    }
    if row.times is None or row.increments is None:
        return result | {"us": None, "floor_us": None, "error": None, "answered": None,
                         "agreed": None}  # fmt: skip
    n_u = instances.B.shape[1]
    known = ~np.isnan(instances.decision).any(axis=1)
    apart = np.abs(row.increments - instances.decision[:, :n_u]).max(axis=(0, 2))
    share = apart[known] / bound_size(instances)
    answered = ~np.isnan(share)
    floor = row.times.min(axis=0)
    return result | {
        "us": _figures(row.times.ravel()),
        "floor_us": _figures(floor),
        "answered": float(answered.mean()),
        "agreed": float((share[answered] <= AGREES).sum() / share.size),
        "error": {
            "p50": float(np.median(share[answered])),
            "p999": float(np.quantile(share[answered], 0.999)),
            "max": float(share[answered].max()),
        }
        if answered.any()
        else None,
    }


def bound_size(instances: Instances) -> float:
    """Return the command's bound [m/s^2], by which errors are measured; its size if unbounded."""
    for bound in instances.bounds:
        if bound.kind == "command":
            sides = np.abs(np.concatenate([bound.lower.ravel(), bound.upper.ravel()]))
            if np.isfinite(sides).any():
                return float(sides[np.isfinite(sides)].max())
    return float(np.abs(instances.command).max())


def _figures(nanoseconds: NDArray[np.int64]) -> dict[str, float]:
    us = nanoseconds * 1e-3
    quantiles = (("p50", 0.5), ("p99", 0.99), ("p999", 0.999))
    return {name: float(np.quantile(us, q)) for name, q in quantiles} | {"max": float(us.max())}


def _plain(name: str) -> str:
    return "".join(letter if letter.isalnum() else "_" for letter in name)
