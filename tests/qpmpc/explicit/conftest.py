"""Small problems whose vectors follow from a few parameters, and optima found without the law."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pytest

from qpmpc import BoundsConfig, ControllerConfig, ForceController, Limits, QuadraticProgram
from qpmpc.arrays import Array
from qpmpc.backends.daqp import DaqpBackend
from qpmpc.expectation import expected
from qpmpc.explicit.enumeration import Enumeration, enumerate_regions
from qpmpc.explicit.regions import Family, Sides
from qpmpc.multipliers import MultiplierSearch
from qpmpc.parametric import Parametric


@pytest.fixture(autouse=True)
def own_cache(tmp_path_factory: Any, monkeypatch: Any) -> Any:
    """One for all tests here, so that the walk is compiled once."""
    path = tmp_path_factory.getbasetemp() / "explicit-cache"
    monkeypatch.setenv("PULSEMPC_CACHE", str(path))
    return path


@dataclass(frozen=True, eq=False)
class Case:
    """A scaled QP and what its vectors follow from."""

    qp: QuadraticProgram
    parameters: Parametric
    family: Family
    find: Callable[[Array, Array, Array], Sides | None]

    def enumerate(self, most: int = 5000, programs: int = 10**6) -> Enumeration:
        return enumerate_regions(
            self.family, self.parameters, self.find, most=most, programs=programs
        )

    @cached_property
    def all_of_them(self) -> Enumeration:
        return self.enumerate()

    def points(self, count: int, seed: int = 0, size: float = 1.0) -> Array:
        rng = np.random.default_rng(seed)
        return rng.uniform(-size, size, (count, self.parameters.size))


def case(qp: QuadraticProgram, parameters: Parametric) -> Case:
    family, daqp = Family(qp), DaqpBackend(qp, Limits())
    search = MultiplierSearch(np.array(qp.linear), np.array(qp.quadratic), 1e-9, 1e-9)
    search.replace_gram(family.gram)

    def find(q: Array, l: Array, u: Array) -> Sides | None:  # noqa: E741
        answer = daqp.solve(q, l, u)
        if answer.status != "solved":
            return None
        search.bound(l, u)
        sides = search.sides(answer.y, family.rows @ q - family.gram @ answer.y)
        sides[(np.abs(sides) == 1) & (np.abs(answer.y) <= 1e-9 * (1 + np.abs(q).max()))] = 0
        return sides

    return Case(qp, parameters, family, find)


def axis_controller(horizon: int, axes: str = "z", backend: str = "daqp", **bounds: Any) -> Any:
    given = {"command": (-20.0, 20.0), "velocity": (-0.1, 0.1), "force": (-14.0, 2.0)} | bounds
    config = ControllerConfig(horizon=horizon, bounds=BoundsConfig(**given))
    return ForceController(config, tuple(axes), 1e-3, backend)


@pytest.fixture
def controller() -> Callable[..., Any]:
    return axis_controller


@pytest.fixture(scope="session")
def contact() -> Callable[[int], Case]:
    """One axis of the force controller, scaled as a backend sees it."""
    known: dict[int, Case] = {}

    def get(horizon: int) -> Case:
        if horizon not in known:
            made = axis_controller(horizon)
            general = made.general
            parameters = expected(general.problem, made.ranges, general.reference)
            assert parameters is not None
            scaling = general.solver.scaling
            known[horizon] = case(scaling.qp, scaling.parameters(parameters))
        return known[horizon]

    return get


@pytest.fixture(scope="session")
def mixed() -> Case:
    """Hard rows and soft ones, some of which have a quadratic penalty, over three parameters."""
    rng = np.random.default_rng(3)
    n, m, d = 3, 6, 3
    root = rng.standard_normal((n, n))
    linear = np.array([np.inf, np.inf, 0.4, 0.4, 1.5, 0.2])
    quadratic = np.array([0.0, 0.0, 0.0, 0.7, 0.3, 0.0])
    l, u = np.full(m, -0.6), np.full(m, 0.5)  # noqa: E741
    l[1], u[3] = -np.inf, np.inf
    qp = QuadraticProgram(
        root @ root.T + np.eye(n), np.zeros(n), rng.standard_normal((m, n)), l, u, linear, quadratic
    )
    offset = 0.3 * rng.standard_normal((m, d))
    offset[:2] = 0.0  # hard rows can always be met
    return case(qp, Parametric(4 * rng.standard_normal((n, d)), np.zeros(n), offset, l, u))
