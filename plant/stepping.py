"""One control period of the physics: in Python, or compiled from ``stepping.c``, to the same bits.

``plant`` has no compiler of its own: whoever can turn C text into a library hands it in, see
`plant.cell.Cell`. Without one the loop in Python does the same at some three times the cost.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol

import mujoco

from plant.contact import Contact
from plant.errors import PlantError
from plant.memory import Memory, struct_text
from plant.protection import RETRACTING, WATCHING, Guard

FLAGS = ("-std=gnu11", "-O2", "-ffp-contract=off")
"""With which `source_text` has to be compiled: nothing fused or reordered, so that it computes what
Python computes."""


Act = Callable[[], None]


class Stepper(Protocol):
    """Brings the physics to the next control instant."""

    def advance(self) -> None:
        """Go on by one period."""
        ...


class PythonStepper:
    """The loop over the physics steps of a period: the reference."""

    def __init__(
        self,
        block: Memory,
        model: Any,
        data: Any,
        contact: Contact,
        guard: Guard,
        *,
        before: Sequence[Act] = (),
        between: Sequence[Act] = (),
    ) -> None:
        """Prepare.

        Args:
            block, model, data, contact, guard: of the cell.
            before: what is done before each physics step.
            between: what is done when a step has brought new angles and speeds, before anything
                is derived from them.
        """
        self._model, self._data, self._contact, self._guard = model, data, contact, guard
        self._before, self._between = before, between
        self._substeps = int(block["substeps"])
        self._mode, self._peak, self._renewed = block["mode"], block["peak"], block["renewed"]

    def advance(self) -> None:
        """Go on by one period."""
        contact, guard, mode = self._contact, self._guard, self._mode
        for step in range(1, self._substeps + 1):
            for act in self._before:
                act()
            mujoco.mj_step2(self._model, self._data)
            for act in self._between:
                act()
            # Positions and velocities of the new instant: what mj_step leaves is a step old.
            mujoco.mj_step1(self._model, self._data)
            if self._renewed:
                contact.follow(1)
            force = contact.size()
            if not force <= self._peak:
                self._peak[()] = force
            if mode == WATCHING:
                guard.watch(step)
                if mode == RETRACTING:
                    contact.follow(0)
            if mode == RETRACTING:
                guard.retract()


class CompiledStepper:
    """The same loop from a library of `source_text`."""

    def __init__(self, library: ctypes.CDLL, block: Memory, model: Any, data: Any) -> None:
        """Find the functions and where everything lies.

        Raises:
            PlantError: the library is not one of `source_text`, or MuJoCo's cannot be found.
        """
        try:
            self._advance = library.advance
        except AttributeError:
            raise PlantError("the library for the physics loop has no function 'advance'") from None
        self._advance.argtypes, self._advance.restype = [ctypes.c_void_p] * 5, None
        engine = _engine()
        steps = (ctypes.cast(f, ctypes.c_void_p) for f in (engine.mj_step1, engine.mj_step2))
        self._alive = block, model, data  # what the addresses stand for
        self._arguments = (block.ctypes.data, *steps, model._address, data._address)

    def advance(self) -> None:
        """Go on by one period."""
        self._advance(*self._arguments)


@cache
def source_text(joints: int) -> str:
    """Return the C text of the loop for a tool with this many joints, one translation unit."""
    body = files("plant").joinpath("stepping.c").read_text(encoding="utf-8")
    return f"#include <math.h>\n#include <stdint.h>\n\n{struct_text(joints)}\n{body}"


@cache
def _engine() -> ctypes.CDLL:
    """Return the library of MuJoCo that Python's bindings use."""
    for path in sorted(Path(mujoco.__file__).parent.glob("libmujoco*")):
        return ctypes.CDLL(str(path))
    raise PlantError("MuJoCo's own library is not beside its Python package")
