"""What tests of the plant share."""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Callable

import mujoco
import numpy as np
import pytest

from plant.cell import Cell
from scenarios.physics import physics_loop


@pytest.fixture(scope="session")
def library() -> ctypes.CDLL:
    """The compiled physics loop for six joints."""
    found = physics_loop(6)
    if found.binary is None:
        pytest.skip(found.told)
    return found.binary


def _check_force_on_both_arms(cell: Cell) -> np.ndarray:
    model, force = cell.model, cell.truth().force
    tip, surface = np.zeros((3, model.nv)), np.zeros((3, model.nv))
    data = copy.copy(cell.data)
    mujoco.mj_forward(model, data)
    turn = data.site("heart_surface").xmat.reshape(3, 3)
    np.testing.assert_allclose(-turn @ data.actuator_force[12:], force, rtol=0, atol=1e-9)
    mujoco.mj_jacSite(model, data, tip, None, model.site("tool_tip").id)
    mujoco.mj_jacSite(model, data, surface, None, model.site("heart_surface").id)
    contact = data.qfrc_actuator - data.actuator_force[:12]
    np.testing.assert_allclose(contact, (surface - tip).T @ force, rtol=0, atol=1e-9)
    return turn.T @ force


@pytest.fixture(scope="session")
def check_force_on_both_arms() -> Callable[[Cell], np.ndarray]:
    """Check that what is measured is what the physics applies, to tool and heart alike.

    Returns the force in the axes of the tissue's surface, ``(3,)`` [N].
    """
    return _check_force_on_both_arms
