"""The file of instances says what it says it says: checked against its own description."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from bench.instances import FORMAT, BoundRows, Instances, active_rows, instances
from bench.stream import record
from qpmpc import QuadraticProgram, solve
from scenarios import ScenarioError, load_scenario


def made(*settings, horizon=8, duration=0.12):
    scenario = load_scenario("latency", top={"duration": duration}, settings=settings)
    stream = record(scenario, report=lambda *_: None, stop=lambda: False)
    return instances(stream, horizon)


@pytest.fixture(scope="module", params=["as shipped", "other", "absolute"])
def file(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("instances") / "i.npz"
    case = {
        "as shipped": ((), 8),
        "other": (("controller.control_horizon=5", "controller.bounds.rate=[-0.4, 0.4]",
                   'axes=["y", "z"]', "controller.increment_weight=0.01"), 12),
        "absolute": (('controller.decision="absolute"', "controller.bounds.rate=[-0.4, 0.4]"), 6),
    }[request.param]  # fmt: skip
    whole = made(*case[0], horizon=case[1])
    whole.save(path)
    return whole, Instances.load(path)


def test_what_is_read_is_what_was_written(file):
    written, read = file
    for field in fields(Instances):
        mine, theirs = getattr(written, field.name), getattr(read, field.name)
        if field.name == "bounds":
            assert [b.name for b in mine] == [b.name for b in theirs]
            for one, other in zip(mine, theirs, strict=True):
                for part in fields(BoundRows):
                    np.testing.assert_array_equal(
                        getattr(one, part.name), getattr(other, part.name)
                    )
        else:
            np.testing.assert_array_equal(mine, theirs)
            assert np.shape(mine) == np.shape(theirs)


def test_cycles_follow_one_another_as_described(file):
    i = file[1]
    np.testing.assert_allclose(
        i.state,
        i.predicted + (i.measurement - i.predicted @ i.measured.T) @ i.gain.T,
        atol=1e-9,
    )
    following = i.state[:-1] @ i.A.T + i.command[:-1] @ i.B.T
    np.testing.assert_allclose(i.predicted[1:], following, atol=1e-9)
    np.testing.assert_array_equal(i.previous[1:], i.command[:-1])
    error = i.preview[:, 0] - i.state @ i.C.T
    decay = i.alpha ** np.arange(1, i.horizon + 1)
    w = i.preview[:, 1:] - decay[None, :, None] * error[:, None, :]
    np.testing.assert_allclose(i.reference, w, atol=1e-12)


def rolled_out(i, k, z):
    """Commands, increments and states of the horizon, straight from the recursion."""
    steps = z.reshape(i.control_horizon, -1)
    increments = i.decision_form == "increment"
    commands = i.previous[k] + np.cumsum(steps, axis=0) if increments else steps
    increments = np.diff(np.vstack([i.previous[k], commands]), axis=0)
    x, states = i.state[k], []
    for j in range(i.horizon):
        x = i.A @ x + i.B @ commands[min(j, i.control_horizon - 1)]
        states.append(x)
    return commands, increments, np.array(states)


def test_the_condensed_qp_is_the_problem_that_is_described(file):
    i = file[1]
    rng = np.random.default_rng(7)
    for k in (0, 40, 119):
        offset = None
        for z in rng.normal(0.0, 0.5, (4, i.q.shape[1])):
            commands, increments, states = rolled_out(i, k, z)
            outputs = states @ i.C.T
            steps = increments if i.decision_form == "increment" else commands
            cost = float(
                (i.output_weight * (outputs - i.reference[k]) ** 2).sum()
                + (i.increment_weight * steps**2).sum()
            )
            condensed = float(0.5 * z @ i.P @ z + i.q[k] @ z)
            if offset is None:
                offset = cost - condensed
            assert condensed + offset == pytest.approx(cost, rel=1e-9, abs=1e-9)
            row = 0
            for bound in i.bounds:
                values = {"command": commands, "rate": increments}.get(bound.kind)
                if values is None:
                    values = states @ bound.output.T
                mine = np.flatnonzero(i.row_bound == bound.name)
                assert list(mine) == list(range(row, row + int(bound.kept.sum())))
                row += mine.size
                for side, limits in ((bound.lower, i.l), (bound.upper, i.u)):
                    room = (values - side)[bound.kept]
                    finite = np.isfinite(room)
                    assert (np.isfinite(limits[k, mine]) == finite).all()
                    np.testing.assert_allclose(
                        (i.G[mine] @ z - limits[k, mine])[finite], room[finite], atol=1e-9
                    )
                assert (i.linear[mine] == bound.linear).all()
                assert (i.quadratic[mine] == bound.quadratic).all()
            assert row == len(i.G)


def test_answers_are_those_of_an_independent_solver(file):
    i = file[1]
    assert np.isfinite(i.residual).all()
    assert i.residual.max() <= 1e-7
    hard = np.flatnonzero(i.active.any(axis=1))
    for k in (*hard[:6], 0, 60):
        qp = QuadraticProgram(i.P, i.q[k], i.G, i.l[k], i.u[k], i.linear, i.quadratic)
        found = solve(qp, "clarabel")
        np.testing.assert_allclose(found.x, i.decision[k], atol=1e-5)
        rows = i.G @ found.x
        at = (np.abs(rows - i.l[k]) < 1e-6) | (np.abs(rows - i.u[k]) < 1e-6)
        beyond = (rows > i.u[k]) | (rows < i.l[k])
        assert not (i.active[k] & ~(at | beyond)).any()


def test_rows_act_where_their_multiplier_is_more_than_rounding():
    y = np.array([[0.0, 0.0], [1e3, 1e-9], [-2.0, 1.0], [np.nan, np.nan]])
    assert active_rows(y).tolist() == [[False, False], [True, False], [True, True], [False, False]]


def test_rows_that_change_are_refused():
    with pytest.raises(ScenarioError, match="joints"):
        made("controller.bounds.joints.speed=0.5", duration=0.02)


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    path = tmp_path_factory.mktemp("small") / "i.npz"
    made(duration=0.01, horizon=3).save(path)
    return path


def change(path, **arrays):
    with np.load(path) as file:
        kept = {key: file[key] for key in file.files}
    for key, value in arrays.items():
        if value is None:
            del kept[key]
        else:
            kept[key] = value
    np.savez(path, **kept)


DAMAGES = {
    "missing": lambda path: path.unlink(),
    "a folder": lambda path: (path.unlink(), path.mkdir()),
    "empty": lambda path: path.write_bytes(b""),
    "text": lambda path: path.write_text("q, l, u\n1, 2, 3\n"),
    "cut short": lambda path: path.write_bytes(path.read_bytes()[:4000]),
    "one array": lambda path: np.save(path.open("wb"), np.zeros(3)),
    "another format": lambda path: change(path, format=np.array("pulsempc.instances/0")),
    "no format": lambda path: change(path, format=None),
    "no q": lambda path: change(path, q=None),
    "no bound's output": lambda path: change(path, **{"bounds/force/output": None}),
    "pickled": lambda path: change(path, q=np.array([{"a": 1}], dtype=object)),
}


@pytest.mark.parametrize("damage", DAMAGES.values(), ids=DAMAGES)
def test_a_file_that_is_none_is_told_in_one_line(damage, small, tmp_path):
    path = tmp_path / "i.npz"
    path.write_bytes(small.read_bytes())
    assert Instances.load(path).cycles == 10
    damage(path)
    with pytest.raises(ScenarioError) as told:
        Instances.load(path)
    assert str(path) in str(told.value)
    assert "\n" not in str(told.value)


def test_the_format_is_in_the_file(small):
    with np.load(small, allow_pickle=False) as file:
        assert str(file["format"]) == FORMAT
        assert file["bounds/velocity/output"].shape == (3, file["A"].shape[0])
