"""Which form a problem gets, and why."""

from dataclasses import replace

import numpy as np
import pytest

from qpmpc import (
    BackendSetupError,
    BoundsConfig,
    ControllerConfig,
    ForceController,
    Limits,
    ObserverConfig,
    SolverConfig,
    Status,
    TangentialConfig,
    UnknownNameError,
    available,
)
from qpmpc.backends import backend_class
from qpmpc.forms import LONG, LONG_COMPILED, pose
from qpmpc.native.errors import CompilerUnavailableError
from qpmpc.native.toolchain import compiler
from qpmpc.structured.compiled import _library
from qpmpc.structured.problem import StructuredProblem
from qpmpc.structured.solver import StructuredSolver

BOUNDED = ControllerConfig(
    bounds=BoundsConfig(velocity=(-0.05, 0.05), force=(-9.0, 0.0), rate=(-15.0, 15.0))
)


def controller(horizon, backend="daqp", axes=("z",), config=BOUNDED, **solver) -> ForceController:
    asked = replace(config, horizon=horizon, solver=SolverConfig(**solver))
    return ForceController(asked, axes, 1e-3, backend)


class Interpreted(backend_class("daqp")):
    """DAQP, but not the class that states a compiled form."""


def form(made: ForceController) -> str:
    problem = made.general.problem
    assert isinstance(problem, StructuredProblem) == (problem.form == "structured")
    assert isinstance(made.general.solver, StructuredSolver) == (problem.form == "structured")
    return problem.form


def can_compile() -> bool:
    try:
        compiler()
    except CompilerUnavailableError:
        return False
    return True


def test_the_key_says_which():
    for name in ("condensed", "structured"):
        made = controller(4, form=name)
        assert form(made) == name
        assert made.form_reason == "asked for"
    with pytest.raises(UnknownNameError, match=r"'dense'.*structured"):
        controller(4, form="dense")


@pytest.mark.skipif(not can_compile(), reason="no compiler")
def test_auto_goes_by_the_horizon():
    for horizon, name in ((LONG - 1, "condensed"), (LONG, "structured")):
        made = controller(horizon, compiled="off")
        assert form(made) == name
        assert str(LONG) in made.form_reason


@pytest.mark.skipif(not can_compile(), reason="no compiler")
def test_a_compiled_step_keeps_the_condensed_form_longer():
    made = controller(LONG)
    assert form(made) == "condensed"
    assert str(LONG_COMPILED) in made.form_reason
    assert form(controller(LONG_COMPILED)) == "structured"
    assert form(controller(LONG, Interpreted)) == "structured"
    required, why = pose(
        made.general.problem.model, LONG_COMPILED, backend=backend_class("daqp"), limits=Limits(),
        output_weight=1.0, increment_weight=1.0, compiled="on",
    )  # fmt: skip
    assert required.form == "condensed"
    assert why == "only the condensed form has a compiled step"


@pytest.mark.skipif(not can_compile(), reason="no compiler")
def test_auto_does_not_wait_for_a_compiled_step_that_there_is_not():
    """The Hessian of the contact model cannot be whitened any more long before `LONG_COMPILED`."""
    made = controller(LONG_COMPILED - 32)
    assert form(made) == "structured"
    assert "no compiled step: the Hessian is too badly conditioned" in made.form_reason


def test_auto_stays_condensed_where_there_is_no_compiler(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler")
    made = controller(LONG_COMPILED)
    assert form(made) == "condensed"
    assert made.form_reason == "there is no compiler"


@pytest.mark.skipif(not can_compile(), reason="no compiler")
def test_auto_stays_condensed_where_nothing_can_be_compiled(monkeypatch, tmp_path):
    monkeypatch.setattr("qpmpc.structured.compiled._library", _library.__wrapped__)
    cache = tmp_path / "cache"
    cache.write_text("no folder")
    monkeypatch.setenv("PULSEMPC_CACHE", str(cache))
    made = controller(LONG, compiled="off")
    assert form(made) == "condensed"
    assert "could not be compiled" in made.form_reason
    assert form(controller(4, form="structured")) == "structured"


def test_what_has_no_structured_form_stays_condensed_and_says_why():
    long = LONG_COMPILED
    timed = controller(long, time_limit=1.0)
    assert form(timed) == "condensed"
    assert "limit of time" in timed.form_reason
    with pytest.raises(BackendSetupError, match=r"cannot be had: .*limit of time"):
        controller(4, time_limit=1.0, form="structured")
    for info in available():
        if info.version and not backend_class(info.name).structured and ":" not in info.name:
            with pytest.raises(BackendSetupError, match="solves the condensed form only") as caught:
                controller(4, info.name, form="structured")
            assert "\n" not in str(caught.value)
    assert form(controller(long, "analytic")) == "condensed"


@pytest.mark.parametrize("decision", ["increment", "absolute"])
@pytest.mark.parametrize("moves", [None, 3])
def test_a_loop_goes_the_same_way_in_either_form(decision, moves, on_own_model):
    bounds = replace(BOUNDED.bounds, tangential=TangentialConfig(limit=1.0, friction=0.1))
    config = replace(BOUNDED, bounds=bounds, decision=decision, control_horizon=moves)
    traces = []
    for name in ("condensed", "structured"):
        made = controller(8, axes=("x", "y", "z"), config=config, form=name)
        traces.append(on_own_model(made, [0.2, 0.0, -2.0], [1.5, 1.0, -12.0], 60))
    ours, theirs = traces
    assert {step.status for step in theirs.steps} == {Status.SOLVED}
    assert any(step.violation.any() for step in theirs.steps)
    np.testing.assert_allclose(ours.commands, theirs.commands, atol=1e-5)
    np.testing.assert_allclose(
        [step.predicted for step in ours.steps],
        [step.predicted for step in theirs.steps],
        atol=1e-5,
    )


def test_without_an_answer_the_fallback_goes_on():
    impatient = replace(BOUNDED, observer=ObserverConfig(patience=0.0))
    made = controller(8, config=impatient, form="structured", max_iterations=1)
    preview = np.full((9, 1), -12.0)
    steps = [made.step(np.array([-2.0 - 0.1 * k]), np.zeros(1), preview) for k in range(12)]
    assert any(step.status is Status.ITERATION_LIMIT for step in steps)
    assert all(np.isfinite(step.command).all() for step in steps)
    assert any(step.source != "solution" for step in steps)
    assert made.step(np.array([np.nan]), np.zeros(1), preview).status is Status.FAILED
