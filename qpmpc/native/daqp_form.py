"""DAQP's core in a compiled step: the library that `daqp` brings, called without Python."""

from __future__ import annotations

import ctypes
import importlib.metadata
import importlib.util
from collections.abc import Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from qpmpc.native.errors import CompiledStepError
from qpmpc.native.forms import Functions, c_text
from qpmpc.native.pack import Field, blocks, columns, integers, plain
from qpmpc.native.toolchain import Library

if TYPE_CHECKING:
    from qpmpc.native.groups import Group
    from qpmpc.scaling import Scaling

_NAMES = (
    "daqp_ldp",
    "daqp_refine_active",
    "allocate_daqp_settings",
    "allocate_daqp_workspace",
    "allocate_daqp_ldp",
    "daqp_allocate_soft_weights",
    "free_daqp_ldp",
    "free_daqp_workspace",
    "daqp_refresh_soft_weights",
)
"""In the order of the enumeration in ``daqp_abi.h``."""
_WHITE = 1e-9
"""How far a whitened Hessian may be from the identity."""
_ZERO = 1e-11
"""Squared norm below which DAQP takes a row for zero and looks away."""
_SOFT, _IGNORED = 8, 4
"""DAQP's marks of rows."""


class DaqpForm:
    """DAQP on whitened variables, a `CompiledForm`."""

    heeds_rows = True

    def __init__(
        self,
        *,
        primal_tol: float,
        rounding: float,
        inside: float,
        far: float,
        iterations: int,
        each: int,
        flat: float,
        least: float,
    ) -> None:
        """Take the figures that the interpreted backend uses; see `qpmpc.backends.daqp`."""
        self._primal_tol, self._rounding, self._far = primal_tol, rounding, far
        self._inside = inside
        self._iterations, self._each = iterations, each
        self._flat, self._least = flat, least

    @property
    def preamble(self) -> str:
        """See `CompiledForm`."""
        figures = (
            f"#define PRIMAL_TOL {self._primal_tol!r}\n"
            f"#define ROUNDING {self._rounding!r}\n"
            f"#define INSIDE {self._inside!r}\n"
            f"#define DAQP_FAR {self._far!r}\n"
        )
        return figures + c_text("daqp_abi.h") + c_text("daqp_probe.c")

    @property
    def text(self) -> str:
        """See `CompiledForm`."""
        return c_text("daqp.c")

    def obstacle(self, scaling: Scaling) -> str | None:
        """Without whitened variables there is no least-distance problem."""
        P = scaling.qp.P
        if np.abs(P - np.eye(P.shape[0])).max() > _WHITE:
            return "the Hessian is too badly conditioned to whiten the variables"
        return None

    def functions(self) -> Functions:
        """Find DAQP's functions in its Python package, the library that the backend uses too.

        Raises:
            CompiledStepError: it is not there, or hides them.
        """
        return _functions()

    def iterations(self, limit: int | None, size: int) -> int:
        """Return the limit of iterations of one solve."""
        return limit or max(self._iterations, self._each * size)

    def sizes(self, group: Group) -> Mapping[str, int]:
        """Return how many rows are soft, and whether their curvature has to be corrected."""
        qp, rows = group.whole.scaling.qp, group.rows
        soft = np.isfinite(qp.linear[rows])
        excess = self._curve(group) - qp.quadratic[rows]
        return {"NS": int(soft.sum()), "CORRECTS": int((excess[soft] > 0).any())}

    def constants(self, group: Group) -> Sequence[Field]:
        """Return normalised rows, penalties as DAQP wants them, and the way back."""
        whole, rows = group.whole, group.rows
        qp, M = whole.scaling.qp, group.scaled_rows
        squares = np.einsum("ij,ij->i", M, M)
        seen = squares >= _ZERO
        normal = np.where(seen, 1.0 / np.sqrt(np.where(seen, squares, 1.0)), 1.0)
        M = M * normal[:, None]
        soft = np.isfinite(qp.linear[rows])
        linear = np.where(soft, qp.linear[rows], 0.0)
        curve = self._curve(group)
        quadratic = np.where(soft, qp.quadratic[rows], 0.0)
        return [
            columns("normal_columns", M),
            plain("normal_rows", M),
            plain("normal", normal),
            blocks("bound_scale", normal * whole.scaling.E[rows]),
            plain("give", np.where(soft, 0.5 / curve, 0.0)),
            plain("weight", linear),
            plain("excess", np.where(soft, 2.0 * (curve - quadratic), 0.0)),
            columns("whitening", group.back),
            integers("sense", _SOFT * soft.astype(np.intc) + _IGNORED * (~seen).astype(np.intc)),
        ]

    def verify(self, library: Library, functions: Functions) -> None:
        """Let DAQP lay out a problem and compare with what the C text takes for granted.

        Raises:
            CompiledStepError: this DAQP is another.
        """
        probe = library.handle.probe
        probe.restype, probe.argtypes = ctypes.c_int, [ctypes.c_void_p]
        calls = (ctypes.c_void_p * len(functions.addresses))(*functions.addresses)
        found = probe(ctypes.cast(calls, ctypes.c_void_p))
        if found:
            raise CompiledStepError(
                f"{functions.depends[0]} lays out its memory in another way than is known "
                f"(place {found})"
            )

    def _curve(self, group: Group) -> np.ndarray:
        """Return the quadratic penalties that DAQP is told, which want some curvature."""
        qp, rows = group.whole.scaling.qp, group.rows
        linear = np.where(np.isfinite(qp.linear[rows]), qp.linear[rows], 0.0)
        least = np.maximum(self._flat * linear, self._least)
        return np.asarray(np.maximum(qp.quadratic[rows], least))


@cache
def _functions() -> Functions:
    found = importlib.util.find_spec("daqp")
    if found is None or not found.origin:
        raise CompiledStepError("the package daqp is not installed")
    version = f"daqp {importlib.metadata.version('daqp')}"
    try:
        library = ctypes.CDLL(found.origin)
        addresses = [
            ctypes.cast(getattr(library, name), ctypes.c_void_p).value or 0 for name in _NAMES
        ]
    except (OSError, AttributeError) as error:
        raise CompiledStepError(f"{version} does not show its functions ({error})") from error
    return Functions(tuple(addresses), (version,))
