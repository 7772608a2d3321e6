"""The paper's law: eq. (13), with the state as it is measured and no idea of a disturbance."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from qpmpc.backends import Backend
from qpmpc.config import BoundsConfig, ControllerConfig
from qpmpc.force_control import Axis, ForceController
from qpmpc.joints import JointSpace


def paper_law(
    config: ControllerConfig,
    axes: Sequence[Axis],
    period: float,
    backend: str | type[Backend] = "analytic",  # noqa: ARG001
    *,
    joints: JointSpace | None = None,
    moving: Collection[str] = (),
) -> ForceController:
    """Return `qpmpc.ForceController` reduced to what the paper has.

    Closed form, force and encoder velocity taken as measured, no disturbance, delay or lag in the
    model; weight and reference time are those of ``config.paper_law``. Of the bounds those on
    command and rate are left, by clipping. Arguments as for `qpmpc.ForceController`; the backend
    is not used.

    Raises:
        QpmpcError: an argument is out of range.
    """
    own = config.paper_law
    reduced = replace(
        config,
        decision="increment",
        increment_weight=own.increment_weight,
        reference_time=own.reference_time,
        model=replace(config.model, delay=0, lag=0.0),
        observer=replace(config.observer, disturbance="none"),
        bounds=BoundsConfig(command=config.bounds.command, rate=config.bounds.rate),
    )
    return ForceController(reduced, axes, period, "analytic", joints=joints, moving=moving)
