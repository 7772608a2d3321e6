"""Which form a receding-horizon problem takes: condensed, or stage by stage."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, get_args

from numpy.typing import ArrayLike

from qpmpc.backends import Backend, Limits
from qpmpc.bounds import Bound, MappedBound
from qpmpc.construction import Decision
from qpmpc.controller import Compiled
from qpmpc.errors import BackendSetupError, UnknownNameError
from qpmpc.models import LinearModel
from qpmpc.native.compiled import unfit
from qpmpc.native.errors import CompilerUnavailableError
from qpmpc.native.toolchain import compiler
from qpmpc.problem import Problem
from qpmpc.scaling import Scaling
from qpmpc.structured.problem import StructuredProblem

Form = Literal["auto", "condensed", "structured"]

LONG, LONG_COMPILED = 32, 256
"""Horizon from which the structured form is faster: beside an interpreted step of the condensed
one, measured by ``python -m bench.horizons``, and beside a compiled step, which only the condensed
form has: by the growth of its cost, where a model lets one be had for so many steps."""


def obstacle(kind: type[Backend], bounds: Sequence[Bound], limits: Limits) -> str | None:
    """Return why the structured form cannot stand in for a backend, None if it can."""
    if not kind.structured:
        return f"backend '{kind.name}' solves the condensed form only"
    mapped = [bound.name for bound in bounds if isinstance(bound, MappedBound)]
    if mapped:
        return f"bound '{mapped[0]}' has a map that changes"
    if limits.time is not None:
        return "the structured form has no limit of time"
    return None


def pose(
    model: LinearModel,
    horizon: int,
    *,
    backend: type[Backend],
    form: Form = "auto",
    compiled: Compiled = "auto",
    limits: Limits,
    output_weight: ArrayLike,
    increment_weight: ArrayLike,
    bounds: Sequence[Bound] = (),
    control_horizon: int | None = None,
    decision: Decision = "increment",
) -> tuple[Problem, str]:
    """Return the problem in one of its forms, and in a few words why in this one.

    ``auto`` takes the structured form where it can be had, there is a compiler, and the horizon is
    long: at least `LONG_COMPILED` where the condensed form has a compiled step, `LONG` where it
    has not. A compiled step that must be leaves the condensed form only.

    Args:
        backend, limits: what will solve it.
        form: see there.
        compiled: whether the step is to be compiled, see `qpmpc.controller.Controller`.
        model, horizon, output_weight, increment_weight, bounds, control_horizon, decision: as for
            `Problem`.

    Raises:
        UnknownNameError: there is no such form. BackendSetupError: ``structured`` cannot be had.
        ModelError, ShapeError, BoundsError: see `Problem`.
    """
    if form not in get_args(Form):
        raise UnknownNameError("form", form, get_args(Form))
    against = obstacle(backend, bounds, limits)
    if form == "structured" and against is not None:
        raise BackendSetupError(backend.name, f"form 'structured' cannot be had: {against}")
    arguments: dict[str, Any] = {
        "output_weight": output_weight, "increment_weight": increment_weight, "bounds": bounds,
        "control_horizon": control_horizon, "decision": decision,
    }  # fmt: skip

    def condensed() -> Problem:
        return Problem(model, horizon, **arguments, construction=backend.construction)

    if form == "auto" and against is None:
        against = _short(horizon, compiled)
    if form == "condensed":
        return condensed(), "asked for"
    if against is not None:
        return condensed(), against
    why = "asked for" if form == "structured" else f"the horizon is {LONG} steps or more"
    if form == "auto" and compiled == "auto" and horizon < LONG_COMPILED:
        problem = condensed()
        # Not inherited, as in `Controller`: a subclass has no compiled step.
        without = unfit(vars(backend).get("compiled"), problem, Scaling(problem.qp))
        if without is None:
            return problem, f"it has a compiled step, and less than {LONG_COMPILED} steps"
        why = f"{why}, and there is no compiled step: {without}"
    staged = StructuredProblem(model, horizon, **arguments)
    if staged.compiled or form == "structured":
        return staged, why
    return condensed(), "the structured form could not be compiled"


def _short(horizon: int, compiled: Compiled) -> str | None:
    """Return why the structured form is not considered, None if it is."""
    if compiled == "on":
        return "only the condensed form has a compiled step"
    if horizon < LONG:
        return f"the horizon is below {LONG} steps"
    return None if _compiles() else "there is no compiler"


def _compiles() -> bool:
    try:
        compiler()
    except CompilerUnavailableError:
        return False
    return True
