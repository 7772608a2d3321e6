"""Which controllers there are: the one registry behind ``controller.kind`` and ``--controller``."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

from qpmpc.backends import Backend
from qpmpc.config import ControllerConfig
from qpmpc.errors import UnknownNameError
from qpmpc.force_control import Axis, ForceController
from qpmpc.joints import JointSpace
from qpmpc.protocol import ForceControl
from qpmpc.rivals.active_observer import ActiveObserverLaw
from qpmpc.rivals.law import Law, LawController
from qpmpc.rivals.learning import LearningLaw
from qpmpc.rivals.paper_law import paper_law
from qpmpc.rivals.pi import PiLaw


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
class Tunable:
    """A key whose value is found by a search, and where it is looked for, in equal ratios."""

    key: str
    """Dotted, below ``controller``."""
    low: float
    high: float


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
    tunables: tuple[Tunable, ...] = ()
    """What ``python -m bench.tune_rivals`` tunes."""
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


def by_law(law: Callable[[ControllerConfig, int, float], Law]) -> Maker:
    """Return what makes a controller that follows a law; the law is made of configuration, number
    of axes and period [s]. No law asks for a backend or for the joints.
    """

    def make(
        config: ControllerConfig,
        axes: Sequence[Axis],
        period: float,
        backend: str | type[Backend] = "",  # noqa: ARG001
        *,
        joints: JointSpace | None = None,  # noqa: ARG001
        moving: Collection[str] = (),
    ) -> LawController:
        return LawController(law(config, len(axes), period), axes, config, moving)

    return make


for _kind in (
    ControllerKind(
        "mpc",
        "predictive, with bounds, a disturbance observer and any backend",
        "this library",
        "controller",
        ForceController,
        (
            Tunable("increment_weight", 1e-4, 1e-1),
            Tunable("reference_time", 2e-3, 1e-1),
            Tunable("observer.tissue_jerk_drift", 1.0, 1e3),
            Tunable("observer.input_drift", 1e-2, 3.0),
        ),
        takes_backend=True,
    ),
    ControllerKind(
        "paper-law",
        "the paper's law: closed form, no disturbance state, no delay in the model",
        "Dominici et al., IROS 2009",
        "controller.paper_law",
        paper_law,
        (
            Tunable("paper_law.increment_weight", 1e-4, 1e-1),
            # longer, and the reference does not reach the setpoint within N = 8 (reading 11)
            Tunable("paper_law.reference_time", 5e-4, 2.67e-3),
        ),
    ),
    ControllerKind(
        "aob",
        "two active observers, one for the force and one for the tissue's motion",
        "the paper's [10]; Cortesao, J. Intelligent and Robotic Systems 48, 2007",
        "controller.aob",
        by_law(ActiveObserverLaw),
        (
            Tunable("aob.closed_loop_time", 2e-3, 5e-2),
            Tunable("aob.disturbance_drift", 1e-2, 3.0),
            Tunable("aob.jerk_drift", 1.0, 1e3),
        ),
    ),
    ControllerKind(
        "pi",
        "PI on the force around a velocity loop, the tissue's velocity fed forward",
        "textbook; feed-forward as in Yuen et al., IEEE Trans. Robotics 26, 2010",
        "controller.pi",
        by_law(PiLaw),
        (
            Tunable("pi.proportional", 10.0, 300.0),
            Tunable("pi.integral", 300.0, 5e4),
            Tunable("pi.velocity", 100.0, 1000.0),
            Tunable("pi.feedforward", 0.3, 1.0),
            Tunable("pi.filter_time", 3e-4, 1e-2),
        ),
    ),
    ControllerKind(
        "pi-ilc",
        "the same, with iterative learning over the known periods of heart and breath",
        "the paper's [8]; learning as in Bristow et al., IEEE Control Systems 26, 2006",
        "controller.pi, controller.ilc",
        by_law(LearningLaw),
        (
            Tunable("ilc.heart_gain", 0.05, 1.0),
            Tunable("ilc.breath_gain", 0.05, 1.0),
            Tunable("ilc.cutoff", 2.0, 60.0),
            Tunable("ilc.forgetting", 1e-3, 0.3),
        ),
    ),
):
    register_controller(_kind)
