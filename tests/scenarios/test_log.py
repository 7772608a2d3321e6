"""The log: one row a cycle, units in the columns' metadata, text for the status."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from plant.interface import Cause, JointSpace, Measurement, Trip, Truth
from qpmpc.config import BoundsConfig, ControllerConfig, JointsConfig, TangentialConfig
from qpmpc.fallback import Source
from qpmpc.force_control import ForceController
from qpmpc.status import Status
from scenarios import Log

BOUNDED = ControllerConfig(bounds=BoundsConfig(velocity=(-0.4, 0.4), rate=(-5.0, 5.0)))


def filled(cycles: int, rows: int, axes=("x", "z")) -> Log:
    """A log with known, distinct numbers and steps of a real controller."""
    controller = ForceController(BOUNDED, axes, 1e-3)
    log = Log(cycles, axes, tuple(controller.general.problem.rows))
    preview = np.tile([1.0, -10.0], (9, 1))
    for k in range(rows):
        step = controller.step(np.array([1.1, -9.0]), np.zeros(2), preview)
        if k % 2:
            step = replace(step, status=Status.CLIPPED, source=Source.PLAN)
        step = replace(step, times=replace(step.times, build=1e-3 * k))
        measurement = Measurement(
            k * 1e-3, np.full(3, k + 0.1), np.full(3, k + 0.2), np.full(3, k + 0.3)
        )
        truth = Truth(
            np.full(3, k + 0.4), np.full(3, k + 0.5), np.full(6, k + 0.6), k % 3 == 0,
            touching=k > 1, joint_velocity=k + 0.1 * np.arange(6),
            joint_angle=k + 0.01 * np.arange(12),
        )  # fmt: skip
        log.record(
            measurement,
            truth,
            step,
            setpoint=preview[0],
            saturated=k % 4 == 0,
            cycle_time=1e-6 * (k + 1),
        )
    return log


@pytest.fixture(scope="module")
def log() -> Log:
    return filled(8, 5)


@pytest.fixture(scope="module")
def table(log, tmp_path_factory) -> pa.Table:
    path = tmp_path_factory.mktemp("log") / "log.parquet"
    log.write(path)
    return pq.read_table(path)


def test_the_file_gives_the_columns_back(log, table):
    assert table.num_rows == log.cycles == 5
    axes = {"setpoint", "force_predicted", "command"}
    for name in (
        "setpoint", "force", "force_measured", "force_predicted", "tissue", "tool",
        "tool_velocity", "command",
    ):  # fmt: skip
        tags = log.axes if name in axes else "xyz"
        read = np.column_stack([table[f"{name}_{tag}"].to_numpy() for tag in tags])
        assert np.array_equal(read, getattr(log, name)[:5]), name
    for name in ("torque", "joint_velocity"):
        read = np.column_stack([table[f"{name}_{j}"].to_numpy() for j in range(1, 7)])
        assert np.array_equal(read, getattr(log, name)[:5])
    for start, name in ((0, "heart_joint_angle"), (6, "joint_angle")):
        read = np.column_stack([table[f"{name}_{j}"].to_numpy() for j in range(1, 7)])
        assert np.array_equal(read, log.joint_angle[:5, start : start + 6])
    for name in (
        "time", "torque_saturated", "command_saturated", "touching", "residual", "iterations",
        "build_time", "solve_time", "cycle_time",
    ):  # fmt: skip
        assert np.array_equal(table[name].to_numpy(), getattr(log, name)[:5]), name
    for i, name in enumerate(log.bounds):
        assert np.array_equal(table[f"slack_{name}"].to_numpy(), log.slack[:5, i])


def test_what_is_recorded_lands_in_its_own_column(table):
    row = {name: table[name][3].as_py() for name in table.column_names}
    assert row["force_measured_x"] == 3.1
    assert row["tool_y"] == 3.2
    assert row["tool_velocity_z"] == 3.3
    assert row["force_x"] == 3.4
    assert row["tissue_y"] == 3.5
    assert row["torque_6"] == 3.6
    assert row["joint_velocity_1"] == 3.0
    assert row["joint_velocity_6"] == 3.5
    assert row["heart_joint_angle_2"] == pytest.approx(3.01, abs=1e-6)
    assert row["joint_angle_1"] == pytest.approx(3.06, abs=1e-6)
    assert row["build_time"] == 3e-3
    assert table["touching"].to_pylist() == [False, False, True, True, True]
    assert (row["setpoint_x"], row["setpoint_z"]) == (1.0, -10.0)
    assert table["torque_saturated"].to_pylist() == [True, False, False, True, False]
    assert table["command_saturated"].to_pylist() == [True, False, False, False, True]
    assert row["cycle_time"] == 4e-6
    assert row["command_x"] != row["command_z"]


UNITS = {
    "time": "s", "setpoint_x": "N", "force_y": "N", "force_measured_z": "N",
    "force_uncompensated_x": "N", "force_predicted_z": "N", "tissue_x": "m", "tool_z": "m",
    "tool_velocity_x": "m/s", "command_z": "m/s^2", "torque_1": "N m", "torque_saturated": "1",
    "slack_command": "m/s^2", "slack_rate": "m/s^2", "slack_velocity": "m/s", "status": "1",
    "solve_time": "s", "cycle_time": "s", "build_time": "s", "source": "1", "touching": "1",
    "joint_velocity_1": "rad/s", "joint_velocity_6": "rad/s", "force_peak": "N", "trip": "1",
    "joint_angle_1": "rad", "heart_joint_angle_6": "rad",
}  # fmt: skip


@pytest.mark.parametrize(("column", "unit"), UNITS.items())
def test_a_column_has_its_unit(column, unit, table):
    assert table.schema.field(column).metadata[b"unit"].decode() == unit


def test_no_column_is_without_a_unit(table):
    assert all((field.metadata or {}).get(b"unit") for field in table.schema)


def test_the_status_reads_as_text(table, log):
    assert table["status"].to_pylist() == ["solved", "clipped", "solved", "clipped", "solved"]
    assert log.status_counts() == {"solved": 3, "clipped": 2}


def test_the_source_reads_as_text_and_those_that_did_not_occur_are_counted_too(table, log):
    assert table["source"].to_pylist() == ["solution", "plan", "solution", "plan", "solution"]
    assert log.source_counts() == {"solution": 3, "plan": 2, "analytic": 0, "hold": 0}


def test_what_each_bound_has_to_give_has_a_column_and_a_unit():
    """All bounds there are; the figure is the worst of the bound's rows."""
    config = ControllerConfig(
        bounds=BoundsConfig(
            force=(-1.0, 3.0), velocity=(-0.4, 0.4), rate=(-5.0, 5.0),
            tangential=TangentialConfig(limit=0.5), joints=JointsConfig(0.5, 0.5),
        )
    )  # fmt: skip
    joints = JointSpace(
        np.ones((6, 3)), np.zeros(6), np.ones((6, 3)), np.ones((6, 3)), np.ones((6, 3)),
        np.zeros(6), np.ones(6), np.ones(6),
    )  # fmt: skip
    controller = ForceController(config, ("x", "y", "z"), 1e-3, joints=joints)
    rows = controller.general.problem.rows
    log = Log(1, ("x", "y", "z"), tuple(rows))
    step = controller.step(np.array([1.1, 2.0, -9.0]), np.zeros(3), np.tile([1.0, 2, -10], (9, 1)))
    nothing = Truth(np.zeros(3), np.zeros(3), np.zeros(6), False)
    log.record(
        Measurement(0.0, *np.zeros((3, 3))), nothing, step,
        setpoint=np.zeros(3), saturated=False, cycle_time=0.0,
    )  # fmt: skip
    table = log.table()
    units = {"force": "N", "velocity": "m/s", "tangential": "N", "joint_speed": "rad/s",
             "joint_torque": "N m", "command": "m/s^2", "rate": "m/s^2"}  # fmt: skip
    assert set(rows) == set(units)
    for name, unit in units.items():
        column = f"slack_{name}"
        assert table.schema.field(column).metadata[b"unit"].decode() == unit
        assert table[column][0].as_py() == step.violation[rows[name]].max()
    assert table["slack_force"][0].as_py() > 5.0


def test_a_log_without_rows_can_be_written(tmp_path):
    log = filled(4, 0)
    log.write(tmp_path / "empty.parquet")
    assert pq.read_table(tmp_path / "empty.parquet").num_rows == 0
    assert log.status_counts() == {}
    assert set(log.source_counts().values()) == {0}


def test_what_was_not_run_is_no_number(table):
    assert np.isnan(table["force_uncompensated_x"].to_numpy()).all()


def test_a_full_log_takes_no_further_row():
    log = filled(2, 2)
    with pytest.raises(IndexError):
        log.record(
            Measurement(0.0, *np.zeros((3, 3))),
            Truth(np.zeros(3), np.zeros(3), np.zeros(6), False),
            ForceController(BOUNDED, ("x", "z"), 1e-3).step(
                np.zeros(2), np.zeros(2), np.zeros((9, 2))
            ),
            setpoint=np.zeros(2),
            saturated=False,
            cycle_time=0.0,
        )
    assert log.cycles == 2


def test_a_trip_has_its_cause_in_every_row_from_its_cycle_on_and_its_time():
    log = filled(6, 2)
    trip = Trip(Cause.TIP_SPEED, 0.002125, 0.51, 0.5)
    step = ForceController(BOUNDED, ("x", "z"), 1e-3).step(
        np.zeros(2), np.zeros(2), np.zeros((9, 2))
    )
    for k in range(2, 5):
        log.record(
            Measurement(k * 1e-3, *np.zeros((3, 3))),
            Truth(np.zeros(3), np.zeros(3), np.zeros(6), False, force_peak=float(k), trip=trip),
            step,
            setpoint=np.zeros(2),
            saturated=False,
            cycle_time=0.0,
        )
    table = log.table()
    assert table["trip"].to_pylist() == ["none", "none", *["tip_speed"] * 3]
    assert float(table.schema.field("trip").metadata[b"time"]) == 0.002125
    assert table["force_peak"].to_pylist()[2:] == [2.0, 3.0, 4.0]
    assert log.counted == 3  # the cycle in which it tripped began under control
    assert filled(4, 3).counted == 3
    assert b"time" not in filled(4, 3).table().schema.field("trip").metadata
