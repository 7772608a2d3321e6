"""Which controllers there are: the one registry behind ``controller.kind`` and ``--controller``."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

from qpmpc.backends import Backend
from qpmpc.config import ControllerConfig
from qpmpc.errors import UnknownNameError
from qpmpc.force_control import Axis, ForceController
from qpmpc.joints import JointSpace
from qpmpc.protocol import ForceControl


class Maker(Protocol):
    """Makes a controller; the arguments are those of `qpmpc.ForceController`."""

    def __call__(
        self,
        config: ControllerConfig,
        axes: Sequence[Axis],
        period: float,
        backend: str | type[Backend] = ...,
        *,
        joints: JointSpace | None = ...,
        moving: Collection[str] = ...,
    ) -> ForceControl:
        """Make it, for the start of a run."""
        ...


@dataclass(frozen=True)
class ControllerKind:
    """A controller that can be asked for by its name."""

    name: str
    summary: str
    """What it is, in a line."""
    source: str
    """Where it comes from."""
    table: str
    """Which keys are its own."""
    make: Maker
    takes_backend: bool = False
    """Whether it solves its QP with the backend that is asked for."""


_table: dict[str, ControllerKind] = {}


def register_controller(kind: ControllerKind) -> ControllerKind:
    """Enter a controller under its name; a later one replaces it."""
    _table[kind.name] = kind
    return kind


def controllers() -> tuple[ControllerKind, ...]:
    """Return all that are registered, in the order of their registration."""
    return tuple(_table.values())


def controller_kind(name: str) -> ControllerKind:
    """Return the controller of a name.

    Raises:
        UnknownNameError: there is none.
    """
    if name not in _table:
        raise UnknownNameError("controller", name, _table)
    return _table[name]


register_controller(
    ControllerKind(
        "mpc",
        "predictive, with bounds, a disturbance observer and any backend",
        "this library",
        "controller",
        ForceController,
        takes_backend=True,
    )
)
