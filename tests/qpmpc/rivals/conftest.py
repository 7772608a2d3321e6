"""The linear loop that the rivals are tested on: contact, delay and lag, nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import NDArray

from qpmpc.augment import with_delay
from qpmpc.config import ControllerConfig
from qpmpc.contact import contact_model
from qpmpc.kinds import controller_kind
from qpmpc.protocol import ForceControl
from qpmpc.step import Step

Array = NDArray[np.float64]
PERIOD = 1e-3


@dataclass(frozen=True, eq=False)
class Loop:
    """What a loop did, one row a cycle."""

    force: Array
    command: Array
    velocity: Array
    steps: list[Step]


def _loop(
    controller: ForceControl,
    config: ControllerConfig,
    cycles: int,
    *,
    setpoint: Callable[[int], Array | float] = lambda k: 0.0,
    tissue: Callable[[int], Array | float] = lambda k: 0.0,
    load: Callable[[int], Array | float] = lambda k: 0.0,
    measured: Callable[[int, Array, Array], tuple[Array, Array]] = lambda k, f, v: (f, v),
    start: float = 0.0,
    stiffness: float | None = None,
    sent: Callable[[Array], Array] = lambda u: u,
) -> Loop:
    """Run a controller on its own model, or with another stiffness.

    Args:
        controller, config: see there.
        cycles: how many.
        setpoint: [N] of each cycle.
        tissue: velocity of the tissue [m/s] over each cycle.
        load: acceleration that disturbs the tool [m/s^2].
        measured: what the sensors make of force and velocity.
        start: contact force at the start [N].
        stiffness: of the plant [N/m]; the model's if not given.
        sent: what becomes of a command on its way.
    """
    n = len(controller.axes)
    model = config.model
    contact = contact_model(
        stiffness or model.stiffness, model.velocity_damping, PERIOD, lag=model.lag
    )
    plant = with_delay(contact.model, model.delay)
    pad = np.zeros((model.delay, 1))
    way, push = np.vstack([contact.tissue, pad]), np.vstack([contact.load, pad])
    state = np.zeros((plant.n_states, n))
    state[0] = start
    controller.reset(np.full(n, start))
    force, command, velocity = np.zeros((3, cycles, n))
    steps = []
    for k in range(cycles):
        force[k], velocity[k] = state[0], state[1]
        seen = measured(k, force[k].copy(), velocity[k].copy())
        preview = np.broadcast_to(setpoint(k), (9, n)).astype(np.float64)
        step = controller.step(*seen, preview)
        steps.append(step)
        command[k] = step.command
        state = plant.A @ state + plant.B * sent(step.command) + way * tissue(k) + push * load(k)
        controller.prepare()
    return Loop(force, command, velocity, steps)


@pytest.fixture(scope="session")
def loop() -> Callable[..., Loop]:
    """Run a controller on the linear contact model."""
    return _loop


@pytest.fixture(scope="session")
def make() -> Callable[..., ForceControl]:
    """Make a controller of a kind for some axes, at 1 kHz."""

    def build(
        kind: str, config: ControllerConfig, axes: str = "z", moving: tuple[str, ...] = ()
    ) -> ForceControl:
        return controller_kind(kind).make(config, tuple(axes), PERIOD, moving=moving)

    return build
