"""The setpoint over a run and its preview."""

from __future__ import annotations

import numpy as np
import pytest

from scenarios import Setpoint, SetpointConfig, SetpointStep
from scenarios.errors import DataFileError, DataTooShortError

PERIOD = 1e-3
STEPS = (SetpointStep(0.003, z=-8.0), SetpointStep(0.0055, x=0.5, z=-6.0))


def test_without_steps_it_is_constant():
    setpoint = Setpoint(SetpointConfig(), ("x", "y", "z"), 5, 8, PERIOD)
    assert np.array_equal(setpoint.force, np.tile([1.0, 2.0, -10.0], (13, 1)))


def test_a_step_begins_at_its_time_and_leaves_the_other_axes():
    config = SetpointConfig(x=1.0, y=2.0, z=-10.0, steps=STEPS)
    force = Setpoint(config, ("x", "y", "z"), 10, 4, PERIOD).force
    assert force[:, 1].tolist() == [2.0] * 14
    assert force[:, 2].tolist() == [-10.0] * 3 + [-8.0] * 3 + [-6.0] * 8
    assert force[:, 0].tolist() == [1.0] * 6 + [0.5] * 8


def test_columns_are_the_axes_in_their_order():
    force = Setpoint(SetpointConfig(steps=STEPS), ("z", "x"), 10, 1, PERIOD).force
    assert force[0].tolist() == [-10.0, 1.0]
    assert force[-1].tolist() == [-6.0, 0.5]


@pytest.mark.parametrize("horizon", [1, 8])
def test_the_preview_looks_the_horizon_ahead_even_at_the_end(horizon):
    cycles = 10
    setpoint = Setpoint(SetpointConfig(steps=STEPS), ("x", "z"), cycles, horizon, PERIOD)
    for k in range(cycles):
        preview = setpoint.preview(k)
        assert preview.shape == (horizon + 1, 2)
        assert np.array_equal(preview, setpoint.force[k : k + horizon + 1])
    known_ahead = setpoint.preview(3 - horizon if horizon < 3 else 0)
    assert -8.0 in known_ahead[:, 1]


def test_a_step_beyond_the_run_is_previewed_only():
    late = SetpointConfig(steps=(SetpointStep(0.012, z=-5.0),))
    setpoint = Setpoint(late, ("z",), 10, 4, PERIOD)
    assert (setpoint.force[:10] == -10.0).all()
    assert setpoint.preview(9)[-1, 0] == -5.0
    beyond = SetpointConfig(steps=(SetpointStep(5.0, z=-5.0),))
    assert (Setpoint(beyond, ("z",), 10, 4, PERIOD).force == -10.0).all()


def test_a_ramp_moves_straight_from_what_was_to_what_is_wished():
    steps = (SetpointStep(0.002, z=-6.0, ramp=0.004), SetpointStep(0.008, z=-7.0, x=3.0))
    force = Setpoint(SetpointConfig(steps=steps), ("x", "z"), 8, 4, PERIOD).force
    assert force[:, 1].tolist() == [-10, -10, -10, -9, -8, -7, -6, -6, -7, -7, -7, -7]
    assert force[:, 0].tolist() == [1.0] * 8 + [3.0] * 4


def test_a_ramp_may_end_after_the_run_and_be_cut_by_the_next_step():
    steps = (SetpointStep(0.002, z=0.0, ramp=0.010), SetpointStep(0.004, z=-1.0, ramp=0.002))
    force = Setpoint(SetpointConfig(steps=steps), ("z",), 6, 1, PERIOD).force[:, 0]
    assert force.tolist() == [-10, -10, -10, -9, -8, -4.5, -1]
    long = (SetpointStep(0.002, z=0.0, ramp=1.0),)
    assert Setpoint(SetpointConfig(steps=long), ("z",), 6, 1, PERIOD).force[-1, 0] == -9.96


def test_without_preview_nothing_is_known_ahead():
    config = SetpointConfig(steps=STEPS, preview=False)
    setpoint = Setpoint(config, ("x", "z"), 10, 4, PERIOD)
    for k in range(10):
        assert np.array_equal(setpoint.preview(k), np.tile(setpoint.force[k], (5, 1)))


# --- recorded ------------------------------------------------------------------------------------


def write(path, text):
    path.write_text(text)
    return SetpointConfig(file=str(path))


def test_a_recorded_wish_is_straight_between_its_rows_and_held_after_them(tmp_path):
    config = write(tmp_path / "wish.csv", "# N\nt,z,x\n5,-10,0\n5.004,-8,0\n5.008,-8,4\n")
    setpoint = Setpoint(config, ("x", "z"), 9, 3, PERIOD)
    assert setpoint.force[:, 1] == pytest.approx([-10, -9.5, -9, -8.5, *[-8.0] * 8])
    assert setpoint.force[:, 0] == pytest.approx([0.0] * 5 + [1, 2, 3, 4, 4, 4, 4])
    assert setpoint.start == pytest.approx([0.0, 2.0, -10.0])  # y is held where it starts


@pytest.mark.parametrize(
    ("text", "error", "told"),
    [
        ("t,x\n0,1\n1,1\n", DataFileError, "no column 'z'"),
        ("t,z\n0,1\n", DataFileError, "at least 2"),
        ("t,z\n0,-1\n1,nan\n", DataFileError, "line 3.*'z' is 'nan'"),
        ("t,z\n0,-1\n0,-2\n", DataFileError, "must increase"),
        ("t,z\n0,-1\n1,-9999\n", DataFileError, "line 3.*-9999 N.*in newtons"),
        ("t,z\n0,-1\n0.004,-2\n", DataTooShortError, "at most 0.005 s"),
        ("", DataFileError, "no data"),
        ("t;z\n0;1\n", DataFileError, "no column 't'"),
    ],
)
def test_bad_files_say_where_and_what_is_wrong(text, error, told, tmp_path):
    with pytest.raises(error, match=told) as caught:
        Setpoint(write(tmp_path / "wish.csv", text), ("z",), 10, 3, PERIOD)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named():
    with pytest.raises(DataFileError, match=r"nowhere\.csv: no such file"):
        Setpoint(SetpointConfig(file="nowhere.csv"), ("z",), 10, 3, PERIOD)
