"""The polygon that stands for a circle, and the force controller that stays inside it."""

from typing import Any

import numpy as np
import pytest

from qpmpc import (
    BoundsConfig,
    BoundsError,
    ControllerConfig,
    ForceController,
    PerAxis,
    ShapeError,
    SolverConfig,
    Status,
    TangentialConfig,
    force_cone,
)

PERIOD = 1e-3
X, Y, Z = np.eye(3)
TANGENTIAL = np.array([X, Y])
facets_ = pytest.mark.parametrize("facets", [3, 4, 8, 17, 64])
frictions = pytest.mark.parametrize(("limit", "friction"), [(2.0, 0.0), (0.0, 0.4), (1.5, 0.3)])


def cone(facets: int, limit: float = 2.0, friction: float = 0.0, **others: Any) -> Any:
    """Of the states (F_x, F_y, F_z), pressing along -z."""
    return force_cone(
        "cone", TANGENTIAL, -Z[None], limit=limit, friction=friction, facets=facets, **others
    )


def allows(bound: Any, force: np.ndarray) -> bool:
    value = bound.output @ force
    return bool((value <= bound.upper + 1e-12).all() and (value >= bound.lower).all())


# ---- the polygon


@facets_
@frictions
def test_what_the_facets_allow_the_norm_allows(
    rng: np.random.Generator, facets: int, limit: float, friction: float
) -> None:
    bound, allowed = cone(facets, limit, friction), 0
    for force in rng.uniform(-6, 6, (2000, 3)):
        if allows(bound, force):
            allowed += 1
            assert np.hypot(*force[:2]) <= limit - friction * force[2] + 1e-12
    assert allowed > 10


@facets_
@frictions
def test_no_more_is_forbidden_than_the_corners_of_the_circle(
    rng: np.random.Generator, facets: int, limit: float, friction: float
) -> None:
    bound = cone(facets, limit, friction)
    for angle, pressure in zip(rng.uniform(0, 7, 200), rng.uniform(0.1, 10, 200), strict=True):
        radius = (limit + friction * pressure) * np.cos(np.pi / facets) * (1 - 1e-9)
        assert allows(bound, np.array([radius * np.cos(angle), radius * np.sin(angle), -pressure]))


@facets_
@frictions
def test_vertices_lie_on_the_circle(facets: int, limit: float, friction: float) -> None:
    """The largest polygon there is: at its corners the norm is what is allowed, to the last bit."""
    bound, pressure = cone(facets, limit, friction), 3.0
    radius = limit + friction * pressure
    for i in range(facets):
        angle = 2 * np.pi * (i + 0.5) / facets
        corner = radius * np.array([np.cos(angle), np.sin(angle)])
        assert allows(bound, np.append(0.9999 * corner, -pressure))
        assert not allows(bound, np.append(1.0001 * corner, -pressure))
        at = bound.output @ np.append(corner, -pressure) - bound.upper
        assert np.sum(np.abs(at) < 1e-9) == 2  # where two facets meet


def test_without_pressure_coulomb_allows_nothing_and_pulling_less() -> None:
    bound = cone(8, 0.0, 0.5)
    assert allows(bound, np.zeros(3))
    assert not allows(bound, np.array([1e-6, 0.0, 0.0]))
    assert not allows(bound, np.array([0.0, 0.0, 1e-6]))
    assert allows(bound, np.array([0.0, 0.4, -1.0]))


def test_any_rows_of_the_state_will_do(rng: np.random.Generator) -> None:
    tangential, normal = rng.standard_normal((2, 7)), rng.standard_normal((1, 7))
    bound = force_cone("cone", tangential, normal, limit=2.0, friction=0.3, facets=64)
    for state in rng.standard_normal((200, 7)):
        norm, room = np.hypot(*(tangential @ state)), 2.0 + 0.3 * float((normal @ state)[0])
        if abs(norm - room) > 0.01:
            assert allows(bound, state) == (norm < room)


def test_record() -> None:
    bound = cone(5, linear=7.0)
    assert bound.name == "cone"
    assert bound.output.shape == (5, 3)
    assert np.all(np.asarray(bound.lower) == -np.inf)
    assert bound.linear == 7.0
    assert np.isinf(cone(5).linear)


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"facets": 2}, BoundsError, "at least 3 facets"),
        ({"limit": -1.0}, BoundsError, "must not be negative"),
        ({"limit": np.nan}, BoundsError, "must not be negative"),
        ({"friction": -0.1}, BoundsError, "must not be negative"),
        ({"tangential": np.eye(3)}, ShapeError, "tangential"),
        ({"normal": np.ones((1, 2))}, ShapeError, "normal"),
        ({"normal": np.ones(3)}, ShapeError, "normal"),
    ],
)
def test_out_of_range(changes: dict[str, Any], error: type[Exception], text: str) -> None:
    arguments: dict[str, Any] = {
        "tangential": TANGENTIAL, "normal": -Z[None], "limit": 1.0, "friction": 0.1, "facets": 8,
    }  # fmt: skip
    with pytest.raises(error, match=text):
        force_cone("cone", **(arguments | changes))


# ---- in the force controller


def controller(limit: float = 2.0, friction: float = 0.0, **others: Any) -> ForceController:
    cone = TangentialConfig(limit, friction, others.pop("facets", 8))
    config = ControllerConfig(
        bounds=BoundsConfig(tangential=cone, **others), solver=SolverConfig(smallest_part=8)
    )
    return ForceController(config, ("x", "y", "z"), PERIOD)


@pytest.mark.parametrize(
    ("limit", "friction", "parts"), [(np.inf, 0.0, 3), (2.0, 0.0, 2), (2.0, 0.3, 1), (0.0, 0.3, 1)]
)
def test_axes_are_solved_together_where_the_cone_couples_them(
    limit: float, friction: float, parts: int
) -> None:
    general = controller(limit, friction).general
    assert general.solver.parts == parts
    assert ("tangential" in general.problem.rows) == np.isfinite(limit)


@pytest.mark.parametrize("facets", [4, 8, 16])
def test_norm_is_held_in_closed_loop(on_own_model: Any, facets: int) -> None:
    wish = [3.0, 2.0, -5.0]
    free = on_own_model(controller(np.inf), [0.0, 0.0, -5.0], wish, 200)
    held = on_own_model(controller(2.0, facets=facets), [0.0, 0.0, -5.0], wish, 200)
    assert np.hypot(*free.force[-1, :2]) == pytest.approx(np.hypot(3, 2), abs=1e-3)
    norm = np.hypot(held.force[:, 0], held.force[:, 1])
    assert norm.max() <= 2.0 + 1e-4
    assert norm[-1] >= 2.0 * np.cos(np.pi / facets) - 1e-3
    assert held.force[-1, 2] == pytest.approx(-5.0, abs=1e-3)
    assert all(step.status is Status.SOLVED for step in held.steps)


def test_force_beneath_the_cone_is_left_alone(on_own_model: Any) -> None:
    free = on_own_model(controller(np.inf), [0.0, 0.0, -5.0], [0.8, 0.6, -5.0], 60)
    held = on_own_model(controller(2.0), [0.0, 0.0, -5.0], [0.8, 0.6, -5.0], 60)
    np.testing.assert_allclose(held.commands, free.commands, atol=1e-5)


def test_more_pressure_allows_more(on_own_model: Any) -> None:
    """Coulomb's law: no slip, while the normal force is free to help."""
    ends = {}
    for pressure in (5.0, 10.0):
        bounds = PerAxis(z=(-pressure - 0.01, -pressure + 0.01))
        trace = on_own_model(
            controller(0.0, 0.3, force=bounds, order=ORDER),
            [0.0, 0.0, -pressure],
            [9.0, 0.0, -pressure],
            200,
        )
        room = 0.3 * -trace.force[:, 2]
        assert (np.hypot(*trace.force[:, :2].T) <= room + 1e-3).all()
        assert max(step.slack["tangential"].max() for step in trace.steps) < 1e-2
        ends[pressure] = trace.force[-1, 0]
    assert ends[5.0] == pytest.approx(0.3 * 5.0 * np.cos(np.pi / 8), abs=0.01)
    assert ends[10.0] == pytest.approx(2 * ends[5.0], abs=0.01)


ORDER = ("joint_torque", "joint_speed", "velocity", "force", "tangential")


def test_needs_all_three_axes() -> None:
    config = ControllerConfig(bounds=BoundsConfig(tangential=TangentialConfig(2.0)))
    for axes in (("x", "y"), ("z",), ("z", "y", "x")):
        with pytest.raises(BoundsError, match=r"'tangential'.*x, y and z"):
            ForceController(config, axes, PERIOD)  # type: ignore[arg-type]
