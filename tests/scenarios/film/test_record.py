"""Folders of runs: what is read from a good one, and what is said of a bad one."""

import json
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from scenarios import ScenarioError
from scenarios.film.record import read_run


def test_what_is_read_is_what_was_logged(finished):
    record = read_run(finished)
    table = pq.read_table(finished / "log.parquet")
    assert record.name == "paper"
    assert record.axes == (0, 1, 2)
    assert record.angles.shape == (300, 12)
    assert np.array_equal(record.force[:, 2], table["force_z"])
    assert np.array_equal(record.setpoint[:, 1], table["setpoint_y"])
    assert np.array_equal(record.held[:, 0], table["force_uncompensated_x"])
    assert np.array_equal(record.angles[:, 1], table["heart_joint_angle_2"].to_numpy())
    assert np.array_equal(record.angles[:, 6], table["joint_angle_1"].to_numpy())
    assert (record.start, record.trip) == (0.0, None)
    assert record.end == pytest.approx(0.3)


def test_an_instant_belongs_to_the_cycle_that_began_last(finished):
    record = read_run(finished)
    assert [record.cycle(t) for t in (-1.0, 0.0, 0.0009, 0.001, 0.0019, 0.299, 0.3, 9.0)] == [
        0, 0, 0, 1, 1, 299, 299, 299,
    ]  # fmt: skip


def changed(folder: Path, name: str, values: pa.Array | None) -> None:
    """Replace a column of the log, or take it away."""
    table = pq.read_table(folder / "log.parquet")
    place = table.column_names.index(name)
    field = table.schema.field(name)
    table = table.remove_column(place)
    if values is not None:
        table = table.add_column(
            place, pa.field(name, values.type, metadata=field.metadata), values
        )
    pq.write_table(table, folder / "log.parquet")


def test_a_trip_is_read_with_its_time(folder):
    causes = pa.array(["none"] * 200 + ["force"] * 100).dictionary_encode()
    changed(folder, "trip", causes)
    assert read_run(folder).trip is None  # without a time nothing can be said
    table = pq.read_table(folder / "log.parquet")
    field = table.schema.field("trip").with_metadata({"time": "0.1995"})
    place = table.column_names.index("trip")
    pq.write_table(table.set_column(place, field, table["trip"]), folder / "log.parquet")
    assert read_run(folder).trip == ("force", 0.1995)


def test_a_run_on_one_axis_has_no_setpoint_on_the_others(folder):
    config = (folder / "config.toml").read_text()
    start = config.index("axes = [")
    end = config.index("]", start) + 1
    (folder / "config.toml").write_text(config[:start] + 'axes = ["z"]' + config[end:])
    record = read_run(folder)
    assert record.axes == (2,)
    assert np.isnan(record.setpoint[:, :2]).all()
    assert np.isfinite(record.setpoint[:, 2]).all()


def test_an_interrupted_run_can_be_drawn_as_far_as_it_went(folder):
    table = pq.read_table(folder / "log.parquet").slice(0, 120)
    pq.write_table(table, folder / "log.parquet")
    changed(folder, "force_uncompensated_x", pa.array(np.full(120, np.nan)))
    record = read_run(folder)
    assert record.end == pytest.approx(0.12)
    assert np.isnan(record.held[:, 0]).all()


def test_times_of_a_log_that_do_not_grow_are_refused(folder):
    changed(folder, "time", pa.array(np.zeros(300)))
    with pytest.raises(ScenarioError, match="time: does not grow"):
        read_run(folder)


def no_folder(folder: Path) -> Path:
    return folder / "nowhere"


def a_file(folder: Path) -> Path:
    return folder / "log.parquet"


def nothing(folder: Path) -> Path:
    (folder / "empty").mkdir()
    return folder / "empty"


def several_runs(folder: Path) -> Path:
    return folder.parent


def no_log(folder: Path) -> Path:
    (folder / "log.parquet").unlink()
    return folder


def no_config(folder: Path) -> Path:
    (folder / "config.toml").unlink()
    return folder


def half_a_log(folder: Path) -> Path:
    whole = (folder / "log.parquet").read_bytes()
    (folder / "log.parquet").write_bytes(whole[: len(whole) // 2])
    return folder


def text_for_a_log(folder: Path) -> Path:
    (folder / "log.parquet").write_text(json.dumps({"time": [0.0]}))
    return folder


def empty_log(folder: Path) -> Path:
    table = pq.read_table(folder / "log.parquet").slice(0, 0)
    pq.write_table(table, folder / "log.parquet")
    return folder


def bad_toml(folder: Path) -> Path:
    (folder / "config.toml").write_text("name = [")
    return folder


def another_key(folder: Path) -> Path:
    with (folder / "config.toml").open("a") as file:
        file.write("\n[film]\nsize = 3\n")
    return folder


def no_angles(folder: Path) -> Path:
    changed(folder, "joint_angle_3", None)
    return folder


def no_force(folder: Path) -> Path:
    changed(folder, "force_y", None)
    return folder


def unknown_angles(folder: Path) -> Path:
    changed(folder, "heart_joint_angle_1", pa.array(np.full(300, np.nan, dtype=np.float32)))
    return folder


def a_column_of_words(folder: Path) -> Path:
    changed(folder, "force_y", pa.array(["much"] * 300))
    return folder


BAD = {
    no_folder: "no such folder",
    a_file: "not a folder",
    nothing: "has no log.parquet",
    several_runs: "it holds several runs, give one: run",
    no_log: "has no log.parquet",
    no_config: "has no config.toml",
    half_a_log: "cannot be read",
    text_for_a_log: "cannot be read",
    empty_log: "no cycle",
    bad_toml: "config.toml",
    another_key: "film",
    no_angles: "has no column joint_angle_3: made by an older version",
    no_force: "has no column force_y",
    unknown_angles: "joint angles: not known in every cycle",
    a_column_of_words: "force_y: not a column of numbers",
}


@pytest.mark.parametrize("spoil", BAD, ids=lambda f: f.__name__)
def test_what_is_no_run_is_told_in_one_line(spoil, folder):
    with pytest.raises(ScenarioError) as refused:
        read_run(spoil(folder))
    assert BAD[spoil] in str(refused.value)
    assert "\n" not in str(refused.value)
