"""Bounds that move and maps that change, against problems made anew and plants rolled out."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from qpmpc import (
    BoundsError,
    CommandBound,
    Controller,
    ExponentialReference,
    KalmanObserver,
    LinearModel,
    MappedBound,
    ModelError,
    OutputBound,
    Problem,
    RateBound,
    ShapeError,
    Solver,
    Status,
    UnknownNameError,
    stack,
    with_delay,
)

N, N_U, INPUTS, STATES = 6, 4, 2, 4
SENSE = np.array([[0.3, -1.0, 2.0, 0.0], [1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 1.0, -1.0]])
decisions = pytest.mark.parametrize("decision", ["increment", "absolute"])
moves = pytest.mark.parametrize("N_u", [1, N_U, N])
directs = pytest.mark.parametrize("direct", [False, True], ids=["outputs", "direct"])
INF = np.inf


class Case:
    """A problem with random parameters, and the plant's own view of any decision."""

    def __init__(self, rng: np.random.Generator, model: LinearModel, **arguments: Any) -> None:
        settings = {"output_weight": [1.5, 0.3], "increment_weight": [0.02, 0.1]} | arguments
        self.problem, self.model = Problem(model, N, **settings), model
        self.state = rng.standard_normal(model.n_states)
        self.previous = rng.standard_normal(INPUTS)
        self.reference = rng.standard_normal((N, 2))

    def update(self) -> None:
        self.problem.update(self.state, self.previous, self.reference)

    def commands(self, z: np.ndarray) -> np.ndarray:
        """u(k) ... u(k+N_u-1), ``(N_u, n_inputs)``."""
        steps = z.reshape(-1, INPUTS)
        if self.problem.decision == "increment":
            steps = self.previous + np.cumsum(steps, axis=0)
        return steps

    def states(self, z: np.ndarray) -> np.ndarray:
        """x(k) ... x(k+N), ``(N + 1, n)``."""
        u, x = self.commands(z), [self.state]
        for i in range(N):
            x.append(self.model.A @ x[-1] + self.model.B @ u[min(i, len(u) - 1)])
        return np.array(x)


@pytest.fixture
def model(rng: np.random.Generator, random_model: Callable[..., LinearModel]) -> LinearModel:
    return random_model(rng, STATES, INPUTS, 2, 1.02)


@pytest.fixture
def case(rng: np.random.Generator, model: LinearModel) -> Callable[..., Case]:
    return lambda plant=model, **arguments: Case(rng, plant, **arguments)


def bound(kind: str, lower: Any, upper: Any, *, moving: bool = True) -> Any:
    made = {
        "command": lambda: CommandBound(lower, upper, moving=moving),
        "rate": lambda: RateBound(lower, upper, moving=moving),
        "speed": lambda: OutputBound("speed", SENSE, lower, upper, 10.0, 0.5, moving=moving),
    }
    return made[kind]()


def width(kind: str) -> int:
    return len(SENSE) if kind == "speed" else INPUTS


kinds = pytest.mark.parametrize("kind", ["command", "rate", "speed"])


# ---- bounds that move


@kinds
@decisions
@pytest.mark.parametrize("shape", ["one", "axis", "step"])
def test_moved_bound_is_the_bound_made_so(
    rng: np.random.Generator, case: Any, kind: str, decision: str, shape: str
) -> None:
    settings = {"decision": decision, "control_horizon": N_U}
    others = [bound(k, -7.0, 8.0) for k in ("command", "rate", "speed") if k != kind]
    mine = case(bounds=[*others, bound(kind, -1.0, 1.0)], **settings)
    steps = N if kind == "speed" else N_U
    size = {"one": (), "axis": (width(kind),), "step": (steps, width(kind))}[shape]
    P, A = mine.problem.qp.P.copy(), mine.problem.A.copy()
    for _ in range(3):
        low, high = -3.0 * rng.random(size), 3.0 * rng.random(size)
        mine.problem.move(kind, low, high)
        mine.update()
        fresh = Problem(
            mine.model, N, output_weight=[1.5, 0.3], increment_weight=[0.02, 0.1],
            bounds=[*others, bound(kind, low, high)], **settings,
        )  # fmt: skip
        fresh.update(mine.state, mine.previous, mine.reference)
        for name in ("q", "l", "u", "A"):
            np.testing.assert_array_equal(getattr(mine.problem, name), getattr(fresh, name))
        for ours, theirs in zip(
            mine.problem.limits(mine.previous), fresh.limits(mine.previous), strict=True
        ):
            np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(mine.problem.qp.P, P)
    np.testing.assert_array_equal(mine.problem.A, A)
    assert not mine.problem.rows_changed


@kinds
def test_bound_moves_from_the_next_update_on(case: Any, kind: str) -> None:
    c = case(bounds=[bound(kind, -1.0, 1.0)])
    c.update()
    before = c.problem.u.copy()
    c.problem.move(kind, -1.0, 3.0)
    np.testing.assert_array_equal(c.problem.u, before)
    c.update()
    np.testing.assert_allclose(c.problem.u, before + 2.0, rtol=1e-12)


@kinds
def test_moving_bound_has_its_rows_while_it_bounds_nothing(case: Any, kind: str) -> None:
    c = case(bounds=[bound(kind, -INF, INF)])
    full = case(bounds=[bound(kind, -1.0, 1.0)])
    np.testing.assert_array_equal(c.problem.A, full.problem.A)
    rows = c.problem.rows[kind]
    for low, high in ((-1.0, 2.0), (-INF, 2.0), (-INF, INF), (-1.0, INF), (0.5, 0.5)):
        c.problem.move(kind, low, high)
        c.update()
        full.problem.move(kind, 0.0, 0.0)
        full.problem.update(c.state, c.previous, c.reference)
        offset = -full.problem.u[rows]
        np.testing.assert_allclose(c.problem.l[rows], low - offset, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(c.problem.u[rows], high - offset, rtol=1e-12, atol=1e-12)


def test_single_axes_and_steps_move_in_and_out_of_infinity(case: Any) -> None:
    c = case(bounds=[bound("speed", -INF, INF)])
    upper = np.full((N, 3), INF)
    upper[3, 1] = 2.0
    c.problem.move("speed", -INF, upper)
    c.update()
    finite = np.isfinite(c.problem.u).reshape(N, 3)
    assert finite.sum() == 1
    assert finite[3, 1]
    c.problem.move("speed", [-INF, -1.0, -INF], INF)
    c.update()
    assert not np.isfinite(c.problem.u).any()
    np.testing.assert_array_equal(
        np.isfinite(c.problem.l).reshape(N, 3), np.tile([False, True, False], (N, 1))
    )


@kinds
def test_rows_that_were_left_out_cannot_be_bounded(case: Any, kind: str) -> None:
    c = case(bounds=[bound(kind, -INF, [1.0] + [INF] * (width(kind) - 1), moving=False)])
    c.update()
    before = c.problem.u.copy(), c.problem.limits(c.previous)[1].copy()
    with pytest.raises(BoundsError, match="moving=True") as error:
        c.problem.move(kind, -INF, [1.0, 2.0] + [INF] * (width(kind) - 2))
    assert error.value.bound == kind
    c.update()  # nothing has happened
    np.testing.assert_array_equal(c.problem.u, before[0])
    np.testing.assert_array_equal(c.problem.limits(c.previous)[1], before[1])
    c.problem.move(kind, -INF, [5.0] + [INF] * (width(kind) - 1))  # those that are there may
    c.update()
    np.testing.assert_allclose(c.problem.u, before[0] + 4.0, rtol=1e-9)


@pytest.mark.parametrize("cycles", [1, 3])
def test_rows_that_nothing_can_change_may_be_named_when_a_bound_moves(
    case: Any, model: LinearModel, cycles: int
) -> None:
    wide = np.hstack([SENSE, np.zeros((3, INPUTS * cycles))])
    c = case(
        with_delay(model, cycles), bounds=[OutputBound("speed", wide, -1, 1, 1.0, moving=True)]
    )
    assert c.problem.qp.m == 3 * (N - cycles)
    upper = np.arange(3.0 * N).reshape(N, 3) + 2
    c.update()
    before = c.problem.u.copy()
    c.problem.move("speed", -1.0, upper)
    c.update()
    np.testing.assert_allclose(c.problem.u - before, upper[cycles:].ravel() - 1.0, rtol=1e-9)


@kinds
@pytest.mark.parametrize(
    ("lower", "upper", "text"),
    [
        (1.0, 0.0, "lower 1 exceeds upper 0"),
        (np.nan, 1.0, "lower holds NaN"),
        (0.0, np.ones(7), r"got \(7,\)"),
        ("none", 1.0, "not numeric"),
    ],
)
def test_a_refused_move_changes_nothing(
    case: Any, kind: str, lower: Any, upper: Any, text: str
) -> None:
    c = case(bounds=[bound(kind, -1.0, 1.0)])
    c.update()
    before = c.problem.l.copy(), c.problem.u.copy()
    with pytest.raises(BoundsError, match=f"^bound '{kind}': .*{text}"):
        c.problem.move(kind, lower, upper)
    c.update()
    np.testing.assert_array_equal(c.problem.l, before[0])
    np.testing.assert_array_equal(c.problem.u, before[1])


def test_unknown_bound(case: Any) -> None:
    problem = case(bounds=[bound("speed", -1.0, 1.0)]).problem
    with pytest.raises(UnknownNameError, match="unknown bound 'sped', did you mean 'speed'"):
        problem.move("sped", -1.0, 1.0)
    with pytest.raises(UnknownNameError, match="unknown bound"):
        problem.map("sped", np.eye(3), np.zeros(3))


def test_limits_follow_bounds_that_move(case: Any) -> None:
    problem = case(bounds=[bound("command", -5.0, 5.0), bound("rate", -INF, INF)]).problem
    previous = np.array([1.0, -4.0])

    def limits() -> list[list[float]]:
        return [side.tolist() for side in problem.limits(previous)]

    assert limits() == [[-5.0, -5.0], [5.0, 5.0]]
    problem.move("rate", [-2.0, -3.0], 1.0)
    assert limits() == [[-1.0, -5.0], [2.0, -3.0]]
    first = np.full((N, 2), 9.0)
    first[0] = [1.5, 0.0]
    problem.move("command", -3.0, first)  # only the first step counts
    assert limits() == [[-1.0, -3.0], [1.5, -3.0]]
    problem.move("command", -INF, INF)
    assert limits() == [[-1.0, -7.0], [2.0, -3.0]]
    problem.move("rate", -INF, INF)
    assert limits() == [[-INF, -INF], [INF, INF]]


def test_answers_follow_a_bound_that_moves() -> None:
    cart = LinearModel([[1, 0.1], [0, 1]], [[0], [0.1]], [[1, 0]], 0.1)
    speed = OutputBound("speed", np.array([[0, 1.0]]), -INF, INF, 1e5, moving=True)
    problem = Problem(cart, 10, output_weight=1.0, increment_weight=1e-3, bounds=[speed])
    solver = Solver(problem.qp, "daqp", problem.rows.values())
    for cap in (INF, 0.2, 0.05, INF, 0.1):
        problem.move("speed", -cap, cap)
        problem.update(np.zeros(2), np.zeros(1), np.ones((10, 1)))
        solution = solver.solve(problem.q, problem.l, problem.u)
        assert solution.status is Status.SOLVED
        fastest = 0.1 * np.cumsum(np.cumsum(solution.x)).max()
        assert (fastest > 0.5) if cap == INF else fastest == pytest.approx(cap, abs=1e-6)


# ---- mapped bounds


def mapped(direct: bool, mapping: np.ndarray, **others: Any) -> MappedBound:
    settings: dict[str, Any] = {"lower": -1.0, "upper": 1.0, "linear": 10.0} | others
    return MappedBound("joints", SENSE, mapping, direct=direct, **settings)


def shape(direct: bool, rows: int = 5) -> tuple[int, int]:
    return rows, len(SENSE) + (INPUTS if direct else 0)


def expected(
    c: Case, z: np.ndarray, direct: bool, mapping: np.ndarray, offset: np.ndarray
) -> np.ndarray:
    """The mapped quantity along the plant's own trajectory, ``(steps, n_m)``."""
    x = c.states(z)
    if not direct:
        return x[1:] @ SENSE.T @ mapping.T + offset
    u = c.commands(z)
    return np.hstack([u, x[: len(u)] @ SENSE.T]) @ mapping.T + offset


@decisions
@moves
@directs
@pytest.mark.parametrize("delay", [0, 2])
def test_rows_are_the_map_of_the_rolled_out_plant(
    *,
    rng: np.random.Generator,
    model: LinearModel,
    decision: str,
    N_u: int,
    direct: bool,
    delay: int,
) -> None:
    plant = with_delay(model, delay)
    sense = np.hstack([SENSE, np.zeros((3, INPUTS * delay))])
    bounds = [
        CommandBound(-3, 3),
        MappedBound(
            "joints", sense, rng.standard_normal(shape(direct)), -1, 1, 10.0, direct=direct
        ),
        OutputBound("speed", sense, -2, 2, 5.0),
    ]
    c = Case(rng, plant, decision=decision, control_horizon=N_u, bounds=bounds)
    p, rows = c.problem, c.problem.rows["joints"]
    steps = N_u if direct else N
    # Rows that no decision moves are left out: outputs that the delay has decided already.
    left_out = 0 if direct else min(delay, N) * 5
    assert rows.stop - rows.start == steps * 5 - left_out
    for _ in range(3):
        mapping, offset = rng.standard_normal(shape(direct)), rng.standard_normal(5)
        p.map("joints", mapping, offset)
        c.update()
        z = rng.standard_normal(N_u * INPUTS)
        x, u = c.states(z), c.commands(z)
        outputs = x @ sense.T
        wanted = (
            np.hstack([u, outputs[:N_u]]) @ mapping.T + offset
            if direct
            else outputs[1:] @ mapping.T + offset
        )
        found = p.A[rows] @ z + 1.0 - p.u[rows]
        np.testing.assert_allclose(found, wanted.ravel()[left_out:], rtol=1e-9, atol=1e-10)
        found = p.A[rows] @ z - 1.0 - p.l[rows]
        np.testing.assert_allclose(found, wanted.ravel()[left_out:], rtol=1e-9, atol=1e-10)


@directs
def test_rows_before_the_first_map_have_no_offset(
    rng: np.random.Generator, case: Any, direct: bool
) -> None:
    mapping = rng.standard_normal(shape(direct))
    c = case(bounds=[mapped(direct, mapping)])
    c.update()
    z = rng.standard_normal(N * INPUTS)
    wanted = expected(c, z, direct, mapping, np.zeros(5)).ravel()
    found = c.problem.A @ z + 1.0 - c.problem.u
    np.testing.assert_allclose(found, wanted, rtol=1e-9, atol=1e-10)


@decisions
@directs
def test_problem_mapped_is_the_problem_made_so(
    rng: np.random.Generator, case: Any, decision: str, direct: bool
) -> None:
    """Same rows, same vectors, same answer; the scale of the rows may be another."""
    first, second = rng.standard_normal((2, *shape(direct)))
    settings = {"decision": decision, "control_horizon": N_U}
    bounds = [CommandBound(-3, 3)]
    ours = case(bounds=[*bounds, mapped(direct, first, linear=0.2)], **settings)
    p = ours.problem
    solver = Solver(p.qp, "piqp", p.rows.values(), pattern=p.pattern)
    p.map("joints", second, np.zeros(5))
    assert p.rows_changed
    solver.replace_rows(p.A)
    theirs = Problem(
        ours.model, N, output_weight=[1.5, 0.3], increment_weight=[0.02, 0.1],
        bounds=[*bounds, mapped(direct, second, linear=0.2)], **settings,
    )  # fmt: skip
    np.testing.assert_allclose(p.A, theirs.A, rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(p.pattern, theirs.pattern)
    ours.update()
    theirs.update(ours.state, ours.previous, ours.reference)
    np.testing.assert_allclose(p.l, theirs.l, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(p.u, theirs.u, rtol=1e-10, atol=1e-12)
    answer = solver.solve(p.q, p.l, p.u)
    fresh = Solver(theirs.qp, "piqp", theirs.rows.values()).solve(theirs.q, theirs.l, theirs.u)
    assert answer.status is fresh.status is Status.SOLVED
    assert fresh.slack.max() > 1e-3
    np.testing.assert_allclose(answer.x, fresh.x, atol=1e-7)


@directs
def test_pattern_covers_what_maps_may_bring(
    rng: np.random.Generator, model: LinearModel, direct: bool
) -> None:
    """Two plants side by side: a map that couples them may come at any time."""
    plant = stack([model, model])
    sense = np.kron(np.eye(2), SENSE[:1])
    size = (2, 2 + 2 * INPUTS) if direct else (2, 2)
    apart = np.zeros(size)
    apart[0, 0] = apart[1, -1] = 1.0
    bounds = [MappedBound("joints", sense, apart, -1, 1, 10.0, direct=direct)]
    p = Problem(plant, N, output_weight=1.0, increment_weight=0.1, bounds=bounds)
    for _ in range(5):
        p.map("joints", rng.standard_normal(size), np.zeros(2))
        assert not ((p.A != 0) & ~p.pattern).any()
        if not direct:
            np.testing.assert_array_equal(p.A != 0, p.pattern)
    assert Solver(p.qp, pattern=p.pattern).parts == 1


def test_pattern_of_other_bounds_is_where_their_rows_are(case: Any) -> None:
    p = case(bounds=[bound("command", -1, 1), bound("rate", -1, 1), bound("speed", -1, 1)]).problem
    np.testing.assert_array_equal(p.pattern, p.A != 0)
    assert case().problem.pattern.shape == (0, N * INPUTS)


def test_rows_changed_is_said_once_and_for_maps_alone(rng: np.random.Generator, case: Any) -> None:
    c = case(bounds=[bound("speed", -1, 1), mapped(False, rng.standard_normal((5, 3)))])
    assert not c.problem.rows_changed
    c.problem.move("speed", -2, 2)
    assert not c.problem.rows_changed
    c.problem.map("joints", rng.standard_normal((5, 3)), np.zeros(5))
    assert c.problem.rows_changed
    others = c.problem.A[c.problem.rows["speed"]].copy()
    c.problem.map("joints", rng.standard_normal((5, 3)), np.zeros(5))
    np.testing.assert_array_equal(c.problem.A[c.problem.rows["speed"]], others)


def test_mapped_bound_may_move_too(rng: np.random.Generator, case: Any) -> None:
    c = case(bounds=[mapped(False, rng.standard_normal((5, 3)), lower=-INF, upper=INF)])
    c.update()
    assert np.isinf(c.problem.u).all()
    assert c.problem.u.size == 5 * N
    c.problem.move("joints", -1.0, np.arange(5.0))
    c.update()
    np.testing.assert_allclose(
        (c.problem.u - c.problem.l).reshape(N, 5), np.tile(np.arange(5) + 1.0, (N, 1)), rtol=1e-10
    )


@pytest.mark.parametrize(
    ("mapping", "offset", "error", "text"),
    [
        (np.ones((4, 3)), np.zeros(5), ShapeError, "mapping of 'joints'"),
        (np.ones((5, 2)), np.zeros(5), ShapeError, "mapping of 'joints'"),
        (np.ones(5), np.zeros(5), ShapeError, "mapping of 'joints'"),
        (np.full((5, 3), np.nan), np.zeros(5), ModelError, "mapping of 'joints'.*NaN"),
        (np.full((5, 3), INF), np.zeros(5), ModelError, "mapping of 'joints'"),
        pytest.param(
            np.full((5, 3), 9.0), np.zeros(4), ShapeError, "offset of 'joints'"
        ),
        pytest.param(
            np.full((5, 3), 9.0), np.full(5, np.nan), ModelError, "offset of 'joints'.*NaN"
        ),
    ],
)  # fmt: skip
def test_a_refused_map_changes_nothing(
    *, rng: np.random.Generator, case: Any, mapping: Any, offset: Any, error: Any, text: str
) -> None:
    c = case(bounds=[mapped(False, rng.standard_normal((5, 3)))])
    c.update()
    before = c.problem.A.copy(), c.problem.l.copy(), c.problem.u.copy()
    with pytest.raises(error, match=text):
        c.problem.map("joints", mapping, offset)
    assert not c.problem.rows_changed
    c.update()
    for ours, was in zip((c.problem.A, c.problem.l, c.problem.u), before, strict=True):
        np.testing.assert_array_equal(ours, was)


def test_only_mapped_bounds_have_a_map(case: Any) -> None:
    problem = case(bounds=[bound("speed", -1, 1), bound("command", -1, 1)]).problem
    for name in ("speed", "command"):
        with pytest.raises(BoundsError, match="is not a MappedBound"):
            problem.map(name, np.eye(3), np.zeros(3))


@pytest.mark.parametrize(
    ("changes", "error", "text"),
    [
        ({"mapping": np.ones((5, 4))}, ShapeError, "mapping of 'joints'"),
        ({"mapping": np.full((5, 3), np.nan)}, ModelError, "mapping of 'joints'"),
        ({"output": np.ones((3, 9))}, ShapeError, "output"),
        ({"lower": np.zeros(4)}, BoundsError, r"got \(4,\)"),
        ({"lower": 2.0}, BoundsError, "lower 2 exceeds upper 1"),
        ({"linear": 0.0}, ModelError, "'joints'"),
        ({"quadratic": -1.0}, ModelError, "'joints'"),
    ],
)
def test_mapped_bound_out_of_range(
    case: Any, changes: dict[str, Any], error: type[Exception], text: str
) -> None:
    arguments: dict[str, Any] = {
        "name": "joints", "output": SENSE, "mapping": np.ones((5, 3)),
        "lower": -1.0, "upper": 1.0, "linear": 10.0,
    }  # fmt: skip
    with pytest.raises(error, match=text):
        case(bounds=[MappedBound(**(arguments | changes))])


def test_a_row_of_the_map_that_is_zero_at_first_may_come(
    rng: np.random.Generator, case: Any
) -> None:
    """A Jacobian's row may vanish in the pose that the run begins in."""
    first = rng.standard_normal((5, 3))
    first[2] = 0.0
    c = case(bounds=[mapped(False, first)])
    assert c.problem.A.shape[0] == 5 * N


# ---- end to end


def cart_controller(backend: str = "daqp", decision: str = "increment") -> Controller:
    """A cart whose motor turns with the speed times a gain that changes."""
    T = 0.01
    model = LinearModel([[1, T], [0, 1]], [[0], [T]], [[1, 0]], T)
    motor = MappedBound("motor", np.array([[0.0, 1.0]]), np.ones((1, 1)), -1, 1, 100.0)
    force = MappedBound(
        "force", np.array([[0.0, 1.0]]), np.array([[1.0, 0.1]]), -5, 5, 100.0, direct=True
    )
    problem = Problem(
        model, 20, output_weight=1.0, increment_weight=1e-4, bounds=[motor, force],
        decision=decision,
    )  # fmt: skip
    observer = KalmanObserver(model, np.eye(2), 1e-4 * np.eye(2), 1e-6 * np.eye(2))
    return Controller(problem, observer, ExponentialReference(20, 1, T, 0.0), backend)


@pytest.mark.parametrize("backend", ["daqp", "osqp", "piqp", "clarabel"])
@decisions
def test_controller_heeds_maps_as_they_change(backend: str, decision: str) -> None:
    controller = cart_controller(backend, decision)
    model, x = controller.problem.model, np.zeros(2)
    goal, k, speeds, forces = np.full((21, 1), 10.0), 0, [], []
    for k in range(200):
        gain = 1.0 + (k >= 100)  # the motor turns twice as fast from here on
        drag = 1.0 if k < 50 else -2.0
        controller.problem.map("motor", np.full((1, 1), gain), np.full(1, 0.1))
        controller.problem.map("force", np.array([[2.0, 0.1]]), np.full(1, drag))
        step = controller.step(x, goal)
        assert step.status is Status.SOLVED
        assert not controller.problem.rows_changed
        forces.append(2.0 * step.command[0] + 0.1 * x[1] + drag)
        x = model.A @ x + model.B @ step.command
        speeds.append(x[1])
    assert np.max(forces[:50]) == pytest.approx(5.0, abs=1e-6)
    assert np.max(np.abs(forces[:100])) <= 5.0 + 1e-6
    assert speeds[99] == pytest.approx(0.9, abs=1e-6)
    assert speeds[-1] == pytest.approx(0.45, abs=1e-6)
