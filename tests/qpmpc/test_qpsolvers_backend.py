# ruff: noqa: E741 - l is the name of the lower bounds throughout the library
"""What is particular to solvers behind qpsolvers; test_backends.py has what all promise."""

import importlib.metadata
import pkgutil
import re
import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    BackendSetupError,
    BackendUnavailableError,
    Limits,
    QuadraticProgram,
    Solver,
    Status,
    UnknownNameError,
    available,
)
from qpmpc.backends import backend_class
from qpmpc.backends import qpsolvers as family
from qpmpc.backends._qpsolvers_table import VARIANTS

qpsolvers = pytest.importorskip("qpsolvers")

INF = np.inf
SLOW = ("jaxopt_osqp", "qpax")
"""Compiled anew for each problem, for seconds."""
LISTED = {info.name: info for info in available() if info.name.startswith("qpsolvers")}
INSTALLED = [
    name
    for name, info in LISTED.items()
    if info.version is not None and name.partition(":")[2] not in SLOW
]
variants = pytest.mark.parametrize("name", INSTALLED)


@pytest.fixture(autouse=True)
def silence(capfd: pytest.CaptureFixture[str]) -> Iterator[None]:
    """Nothing is printed and nothing warned, whatever a solver meets."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield
    assert capfd.readouterr() == ("", "")


def definite(name: str) -> bool:
    return VARIANTS[name.partition(":")[2]].definite


def box(n: int = 2, linear: Any = INF) -> QuadraticProgram:
    return QuadraticProgram(np.eye(n), np.zeros(n), np.eye(n), -np.ones(n), np.ones(n), linear)


# ---- names


def test_table_is_what_qpsolvers_has() -> None:
    there = {module.name.rstrip("_") for module in pkgutil.iter_modules(qpsolvers.solvers.__path__)}
    extras = importlib.metadata.metadata("qpsolvers").get_all("Provides-Extra") or []
    for variant, it in VARIANTS.items():
        assert variant in there
        assert it.extra or variant in extras
        assert it.extra in ("", *extras)
    left_out = there - set(VARIANTS)
    assert left_out <= {
        "copt", "gurobi", "mosek", "hpipm", "nppro", "pdhcg", "qpoases", "qpswift",
    }  # fmt: skip


def test_listed_installed_or_not() -> None:
    assert list(LISTED) == sorted(f"qpsolvers:{variant}" for variant in VARIANTS)
    for name, info in LISTED.items():
        variant = name.partition(":")[2]
        try:
            installed = importlib.metadata.version(VARIANTS[variant].package)
        except importlib.metadata.PackageNotFoundError:
            installed = None
        assert info.version == installed
        assert not info.warm_starts
        assert info.replaces_rows
    assert LISTED["qpsolvers:highs"].install == "pip install qpsolvers[highs]"
    assert LISTED["qpsolvers:highs"].limits == {"iterations", "time"}
    assert LISTED["qpsolvers:jaxopt_osqp"].install == "pip install qpsolvers[jaxopt]"
    assert LISTED["qpsolvers:quadprog"].limits == set()


def missing(monkeypatch: pytest.MonkeyPatch, *packages: str) -> None:
    found = family.version
    monkeypatch.setattr(
        family, "version", lambda package: None if package in packages else found(package)
    )


def test_says_what_installs_a_variant(monkeypatch: pytest.MonkeyPatch) -> None:
    missing(monkeypatch, "highspy")
    with pytest.raises(BackendUnavailableError, match=re.escape("pip install qpsolvers[highs]")):
        backend_class("qpsolvers:highs")
    missing(monkeypatch, "qpsolvers")
    with pytest.raises(BackendUnavailableError, match=re.escape("pip install qpsolvers[daqp]")):
        backend_class("qpsolvers:daqp")
    assert all(info.version is None for info in available() if info.name in LISTED)


def test_unknown_variant() -> None:
    with pytest.raises(UnknownNameError, match="did you mean 'qpsolvers:highs'") as caught:
        backend_class("qpsolvers:higs")
    assert set(caught.value.valid) == set(LISTED)


def test_plain_name_is_the_best_that_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("quadprog", "daqp", "piqp", "clarabel"):
        if f"qpsolvers:{name}" not in INSTALLED:
            continue
        assert backend_class("qpsolvers") is backend_class(f"qpsolvers:{name}")
        missing(monkeypatch, VARIANTS[name].package)
    monkeypatch.undo()
    missing(monkeypatch, *(it.package for it in VARIANTS.values()))
    with pytest.raises(BackendUnavailableError, match="quadprog"):
        backend_class("qpsolvers")


def test_qpsolvers_may_fail_to_import_what_is_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(qpsolvers, "available_solvers", [])
    with pytest.raises(BackendSetupError, match="cannot import it"):
        Solver(box(), INSTALLED[0])


# ---- answers


@variants
def test_multipliers_have_the_sign_of_their_bound(name: str) -> None:
    qp = box(5, [INF, INF, INF, 2.0, 2.0])
    l, u = np.array([-1, -1, 0.5, -1, -1]), np.array([1, 1, 0.5, 1, 1])
    solution = Solver(qp, name).solve(np.array([-3.0, 4.0, 0.0, -6.0, 6.0]), l, u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [1.0, -1.0, 0.5, 4.0, -4.0], atol=1e-7)
    np.testing.assert_allclose(solution.y, [2.0, -3.0, -0.5, 2.0, -2.0], atol=1e-7)
    np.testing.assert_allclose(solution.slack, [0, 0, 0, 3.0, 3.0], atol=1e-7)


@variants
def test_layouts_of_the_bounds(name: str, rng: np.random.Generator) -> None:
    root = rng.standard_normal((4, 4))
    qp = QuadraticProgram(
        root @ root.T + np.eye(4), np.zeros(4), rng.standard_normal((6, 4)),
        np.full(6, -0.5), np.full(6, 0.5), [INF, INF, INF, 5.0, 5.0, INF],
    )  # fmt: skip
    solver, daqp = Solver(qp, name), Solver(qp, "daqp")
    for free_l, free_u, equal in (
        ([], [], []),
        ([0, 3], [1, 4], []),
        ([], [], [0, 4]),
        (range(6), range(6), []),
        ([1, 2, 3, 4, 5], [1, 2, 3, 4, 5], [0]),
        ([], [], []),
    ):
        l, u, q = np.array(qp.l), np.array(qp.u), 5 * rng.standard_normal(4)
        l[list(free_l)], u[list(free_u)] = -INF, INF
        l[list(equal)] = u[list(equal)] = 0.1
        found, expected = solver.solve(q, l, u), daqp.solve(q, l, u)
        assert found.status is Status.SOLVED
        np.testing.assert_allclose(found.x, expected.x, atol=1e-7)
        np.testing.assert_allclose(found.y, expected.y, atol=1e-6)


@variants
def test_replaced_rows_give_the_answer_of_a_fresh_solver(
    name: str, rng: np.random.Generator
) -> None:
    qp = replace(box(3, [INF, 2.0, INF]), A=rng.standard_normal((3, 3)))
    solver = Solver(qp, name)
    for _ in range(3):
        A, q = rng.standard_normal((3, 3)), 4 * rng.standard_normal(3)
        solver.replace_rows(A)
        found, fresh = (
            solver.solve(q, qp.l, qp.u),
            Solver(replace(qp, A=A), name).solve(q, qp.l, qp.u),
        )
        assert found.status is fresh.status is Status.SOLVED
        np.testing.assert_allclose(found.x, fresh.x, atol=1e-7)


def test_replaced_rows_reach_the_solver(monkeypatch: pytest.MonkeyPatch) -> None:
    """A polish of what the old rows gave would hide that they did not."""
    problems, solve = [], qpsolvers.solve_problem

    def spy(problem: Any, *rest: Any, **options: Any) -> Any:
        problems.append(problem)
        return solve(problem, *rest, **options)

    qp = box(3, [INF, 2.0, INF])
    l, u = np.array([-1, -1, 0.3]), np.array([1, 1, 0.3])
    solver = Solver(qp, INSTALLED[0])
    monkeypatch.setattr(qpsolvers, "solve_problem", spy)
    solver.solve(np.ones(3), l, u)
    solver.replace_rows(2 * qp.A)
    solver.solve(np.ones(3), l, u)
    before, after = (p.unpack_as_dense() for p in problems[-2:])
    hard = np.abs(before[2][:, :3]).max(axis=1) > 0
    assert hard.sum() == 4
    np.testing.assert_allclose(after[2][hard, :3], 2 * before[2][hard, :3])
    np.testing.assert_allclose(after[4], 2 * before[4])


@variants
def test_semidefinite_hessian(name: str) -> None:
    qp = QuadraticProgram(np.diag([1.0, 0.0]), np.zeros(2), np.eye(2), -1.0, 1.0)
    if definite(name):
        with pytest.raises(BackendSetupError, match="wants a positive definite P"):
            Solver(qp, name)
        return
    solution = Solver(qp, name).solve(np.array([-0.5, -1.0]), qp.l, qp.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [0.5, 1.0], atol=1e-7)


@variants
def test_soft_rows_need_no_curvature_of_their_own(name: str) -> None:
    """Slack without a quadratic penalty is singular in the Hessian with slack."""
    qp = box(3, [4.0, 0.7, 30.0])
    far = np.array([100.0, -100.0, 1.0])
    solution = Solver(qp, name).solve(far, qp.l, qp.u)
    assert solution.status is Status.SOLVED
    np.testing.assert_allclose(solution.x, [-96.0, 99.3, -1.0], rtol=1e-7)


@variants
def test_no_row_bounds_anything(name: str) -> None:
    qp, free = box(), np.full(2, INF)
    solver = Solver(qp, name)
    for l, u in ((-free, free), (np.zeros(2), np.zeros(2)), (-free, free)):
        solution = solver.solve(np.array([3.0, -4.0]), l, u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, np.clip([-3.0, 4.0], l, u), atol=1e-7)


# ---- without an answer


@variants
def test_infeasible_and_unbounded(name: str) -> None:
    rows = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    P = np.eye(2) if definite(name) else np.diag([1.0, 0.0])
    qp = QuadraticProgram(P, np.zeros(2), rows, -np.ones(3), np.ones(3))
    solver, q = Solver(qp, name), np.array([0.5, 1.0])
    for _ in range(2):
        apart = np.array([0.5, -1, -1]), np.array([1, -0.5, 1])
        assert solver.solve(q, *apart).status is Status.INFEASIBLE
        if not definite(name):
            free = np.array([-1.0, -1.0, -INF]), qp.u
            assert solver.solve(q, *free).status is Status.UNBOUNDED
        solution = solver.solve(q, qp.l, qp.u)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, [-0.5, -1.0], atol=1e-7)


@variants
def test_limits(name: str, contact_problem: Any, instance: Any, optimum: Any) -> None:
    rng = np.random.default_rng(7)
    problem = contact_problem(rng, 1, 8)
    draws = [instance(rng, problem).vectors() for _ in range(20)]
    vectors = [v for v in draws if optimum(problem.qp, *v).slack.max() > 1e-2][:4]
    assert vectors
    groups = list(problem.rows.values())
    short, ample = {"iterations": 1, "time": 1e-9}, {"iterations": 1000, "time": 5.0}
    for kind in ("iterations", "time"):
        if kind not in backend_class(name).limits:
            with pytest.raises(BackendSetupError, match=f"no limit of {kind}"):
                Solver(problem.qp, name, groups, limits=Limits(**{kind: ample[kind]}))
            continue
        solver = Solver(problem.qp, name, groups, limits=Limits(**{kind: short[kind]}))
        stopped = {str(solver.solve(*v).status) for v in vectors}
        # Who is done before the first look at the clock has kept the limit of time.
        assert "iteration_limit" in stopped <= {"iteration_limit", *(["solved"] * (kind == "time"))}
        if name == "qpsolvers:osqp" and kind == "iterations":
            continue  # needs more
        solver = Solver(problem.qp, name, groups, limits=Limits(**{kind: ample[kind]}))
        assert {str(solver.solve(*v).status) for v in vectors} == {"solved"}


# ---- what qpsolvers may do


def lie(monkeypatch: pytest.MonkeyPatch, **said: Any) -> None:
    def solve(problem: Any, *_: Any, **__: Any) -> Any:
        answer = qpsolvers.Solution(problem)
        for name, value in said.items():
            setattr(answer, name, value)
        return answer

    monkeypatch.setattr(qpsolvers, "solve_problem", solve)


def test_error_of_a_solver_is_a_failed_solve(monkeypatch: pytest.MonkeyPatch) -> None:
    qp, q = box(), np.array([3.0, 0.5])
    solver = Solver(qp, INSTALLED[0])

    def broken(*_: Any, **__: Any) -> Any:
        raise ArithmeticError("singular")

    with monkeypatch.context() as patch:
        patch.setattr(qpsolvers, "solve_problem", broken)
        assert solver.solve(q, qp.l, qp.u).status is Status.FAILED
    assert solver.solve(q, qp.l, qp.u).status is Status.SOLVED


def test_infeasible_is_not_believed_without_proof(monkeypatch: pytest.MonkeyPatch) -> None:
    qp = QuadraticProgram(np.eye(2), np.zeros(2), [[1.0, 0], [1.0, 0]], [-1, -1.0], [1, 1.0])
    solver, q = Solver(qp, INSTALLED[0]), np.array([3.0, 0.5])
    lie(monkeypatch, found=False, extras={"status": "primal infeasible"})
    assert solver.solve(q, qp.l, qp.u).status is Status.FAILED
    apart = np.array([0.5, -1.0]), np.array([1.0, -0.5])
    assert solver.solve(q, *apart).status is Status.INFEASIBLE


def test_wrong_answer_called_optimal_is_not_solved_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    qp, q = box(), np.array([3.0, 0.5])
    solver = Solver(qp, INSTALLED[0])
    lie(monkeypatch, found=True, x=np.full(2, np.nan), z=np.zeros(4))
    assert solver.solve(q, qp.l, qp.u).status is Status.FAILED
    lie(monkeypatch, found=True, x=np.array([5.0, 5.0]), z=np.zeros(4))
    solution = solver.solve(q, qp.l, qp.u)
    assert solution.status is Status.SOLVED  # by the polish
    np.testing.assert_allclose(solution.x, [-1.0, -0.5], atol=1e-9)


def test_setting_that_the_installed_version_lacks_is_left_out(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    name = INSTALLED[0]
    variant = name.partition(":")[2]
    it = replace(VARIANTS[variant], options={"no_such_setting": 1.0}, iterations="no_such_limit")
    monkeypatch.setitem(VARIANTS, variant, it)
    call, kinds = family._Call.__call__, family._accepted

    def strict(self: Any, *problem: Any) -> Any:
        if {"no_such_setting", "no_such_limit"} & set(self.options):
            raise TypeError("unexpected keyword argument")
        return call(self, *problem)

    monkeypatch.setattr(family._Call, "__call__", strict)
    kinds.cache_clear()
    try:
        qp = box()
        solution = Solver(qp, name).solve(np.array([3.0, 0.5]), qp.l, qp.u)
        assert solution.status is Status.SOLVED
        with pytest.raises(BackendSetupError, match="does not take its limits"):
            backend_class(name)(qp, Limits(iterations=3))
    finally:
        kinds.cache_clear()


@variants
def test_build_is_told_apart(name: str) -> None:
    qp = box(4)
    solver = Solver(qp, name)
    for _ in range(3):
        solution = solver.solve(np.arange(4.0), qp.l, qp.u)
        assert 0.0 < solution.build_time < 1.0
        assert 0.0 < solution.solve_time < 1.0
