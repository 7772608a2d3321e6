"""Which peers there are, and what each needs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_HERE = Path(__file__).parent


@dataclass(frozen=True)
class Peer:
    """A package to measure: an adapter, and the requirements of an environment of its own."""

    name: str
    adapter: Path
    """Script with the contract of ``adapters/_harness.py``."""
    requirements: Path | None
    """File of pinned requirements, installed line by line; None: runs in our own environment."""
    variants: tuple[str, ...]
    """Ways of using it that get a row each, as the adapter calls them."""


def peer(name: str, adapter: str, *variants: str) -> Peer:
    """Return a peer whose adapter and requirements are in their folders."""
    return Peer(
        name,
        _HERE / "adapters" / f"{adapter}.py",
        _HERE / "requirements" / f"{name}.txt",
        variants,
    )


OURS = Peer(
    "pulsempc", _HERE / "adapters" / "ours.py", None, ("analytic", "daqp", "daqp, compiled")
)
PEERS = (
    peer("qpmpc", "caron_qpmpc", "slack inputs, DAQP", "hard, DAQP"),
    peer("affine-mpc", "affine_condensed", "slack inputs", "hard"),
    peer("acados", "acados_ocp", "full condensing, HPIPM", "full condensing, qpOASES", "HPIPM"),
    peer("tinympc", "tiny_mpc", "ADMM"),
    peer("cvxpygen", "cvxpygen_c", "OSQP", "QOCO"),
    peer("cvxpy", "cvxpy_qp", "OSQP", "Clarabel"),
    peer("do-mpc", "do_mpc_ipopt", "IPOPT"),
    peer("lmpc", "lmpc_daqp", "DAQP"),
)
