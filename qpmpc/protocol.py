"""What a run needs of a force controller, whatever is inside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from qpmpc.arrays import Array
from qpmpc.backends import Fact
from qpmpc.controller import Compilation
from qpmpc.joints import JointSpace
from qpmpc.step import Step


@dataclass(frozen=True)
class About:
    """What a controller tells of itself at the end of a run."""

    compilation: Compilation
    """Whether its step was compiled."""
    form: Mapping[str, str] = field(default_factory=dict)
    """Which form its problem has, and why: ``name`` and ``reason``; empty without a problem."""
    facts: Sequence[Mapping[str, Fact]] = ()
    """What its backend tells of itself, one entry for each problem that it solves a cycle."""


class ForceControl(Protocol):
    """A controller of the contact force on one to three axes.

    A cycle is ``step``, then the command is applied, then ``prepare``. `qpmpc.ForceController` is
    one, `qpmpc.rivals.law.LawController` another.
    """

    @property
    def axes(self) -> tuple[str, ...]:
        """Which of x, y, z, in the order of all vectors."""
        ...

    @property
    def bounds_joints(self) -> bool:
        """Whether `view` has to be told the joints before each step."""
        ...

    @property
    def rows(self) -> Mapping[str, slice]:
        """Where each bound's rows are in `Step.violation`; empty without a QP."""
        ...

    def reset(self, force: Array) -> None:
        """Start at rest with the given contact force ``(n_axes,)`` [N]."""
        ...

    def step(
        self, force: Array, velocity: Array, preview: Array, *, deadline: float | None = None
    ) -> Step:
        """Decide the acceleration command of this cycle.

        Args:
            force: measured contact force, ``(n_axes,)`` [N]; NaN where nothing was measured.
            velocity: the tool's velocity from its encoders, ``(n_axes,)`` [m/s].
            preview: setpoint s(k) ... s(k+N), ``(N + 1, n_axes)`` [N].
            deadline: what is left until the answer has to be there [s]; the controller's own
                counts if not given.
        """
        ...

    def prepare(self) -> None:
        """Do what needs no measurement, after the command has been applied."""
        ...

    def beat(self) -> None:
        """Tell that an R peak has come since the last step."""
        ...

    def adopt(self, *, command: Array | None = None, force: Array | None = None) -> None:
        """Go on from what is so in place of what was decided or expected.

        Args:
            command: applied in place of that of the last step, ``(n_axes,)`` [m/s^2]; between
                `step` and `prepare`.
            force: contact force that counts from now on, ``(n_axes,)`` [N]: after `step`, that of
                this cycle; after `prepare`, that of the next.
        """
        ...

    def move(self, name: str, lower: Array, upper: Array) -> None:
        """Change a bound from the next step on, as far as the controller knows it."""
        ...

    def view(self, joints: JointSpace) -> None:
        """Take the joints as they are now; before each step, where `bounds_joints`."""
        ...

    def about(self) -> About:
        """Return what there is to tell at the end of a run."""
        ...
