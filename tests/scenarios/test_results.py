"""The folder of a run: all or nothing, and enough to repeat the run bit for bit."""

from __future__ import annotations

import json
import os
import shutil
import stat

import numpy as np
import pyarrow.parquet as pq
import pytest

from scenarios import ScenarioError, load_scenario, run_experiment, summarise
from scenarios.load import shipped
from scenarios.results import result_folder, to_json, write_run

TIMES = ("build_time", "solve_time", "cycle_time", "plant_time")
DURATION = 0.15


def repeatable(summary) -> dict:
    return {key: value for key, value in summary.items() if key != "timing"}


def simulate(name, folder, **named):
    """Run a scenario, write its folder, return its summary."""
    experiment = run_experiment(
        load_scenario(str(name), **named), report=lambda *_: None, stop=lambda: False
    )
    summary = summarise(experiment)
    with result_folder(folder) as partial:
        write_run(experiment, summary, partial)
    return summary


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    t = np.arange(0.0, 0.4, 0.005)
    path = tmp_path_factory.mktemp("recording") / "heart.csv"
    xyz = [a * np.sin(9.0 * t + a) for a in (0.001, 0.002, 0.003)]
    rows = [",".join(f"{v:.9g}" for v in row) for row in zip(t, *xyz, strict=True)]
    path.write_text("t,x,y,z\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def beats(tmp_path_factory):
    path = tmp_path_factory.mktemp("beats") / "rr.csv"
    times = 0.3 + np.cumsum([0.8, 0.7, 0.85] * 10)
    path.write_text("t\n" + "\n".join(f"{t:.4f}" for t in times) + "\n")
    return path


@pytest.fixture(scope="module", params=["generated", "recorded", "beats"])
def twins(request, tmp_path_factory, recording, beats):
    """A run, and the run of its own config.toml, from a folder that was moved."""
    folder = tmp_path_factory.mktemp(request.param)
    source = {"recorded": {"motion": recording}, "beats": {"beats": beats}}.get(request.param, {})
    top = {"duration": DURATION, "seed": 3}
    settings = ["cell.contact.stiffness=1500.0", "setpoint.steps=[{time=0.05, z=-9.0}]"]
    first = simulate("paper", folder / "first", top=top, settings=settings, **source)
    moved = (folder / "first").rename(folder / "moved")
    return first, moved, simulate(moved / "config.toml", folder / "again"), folder / "again"


def test_the_folders_config_repeats_the_run_bit_for_bit(twins):
    first, moved, again, other = twins
    assert repeatable(first) == repeatable(again)
    assert to_json(repeatable(first)) == to_json(repeatable(again))
    assert json.loads((moved / "summary.json").read_text()) == first
    logs = [pq.read_table(folder / "log.parquet").drop(TIMES) for folder in (moved, other)]
    assert logs[0].equals(logs[1])
    assert logs[0].num_rows == round(1000 * DURATION)
    assert (moved / "config.toml").read_bytes() == (other / "config.toml").read_bytes()


def test_the_log_has_both_runs(twins):
    table = pq.read_table(twins[1] / "log.parquet")
    for axis in "xyz":
        for name in ("force", "force_uncompensated", "force_measured"):
            assert np.isfinite(table[f"{name}_{axis}"].to_numpy()).all()


def test_the_folder_needs_no_file_from_elsewhere(twins):
    config = (twins[1] / "config.toml").read_text()
    named = [line for line in config.splitlines() if line.startswith(("file =", "beats ="))]
    assert all("/" not in line for line in named)
    for line in named:
        assert (twins[1] / line.split('"')[1]).is_file()


def test_a_recorded_setpoint_goes_with_the_folder(tmp_path):
    wish = tmp_path / "wish.csv"
    wish.write_text("t,x,y,z\n0,1,2,-10\n0.02,1,2,-10\n0.04,0,2,-11\n")
    first = simulate("paper", tmp_path / "a", top={"duration": 0.04}, setpoint=wish)
    wish.unlink()
    again = simulate(tmp_path / "a" / "config.toml", tmp_path / "b")
    assert repeatable(first) == repeatable(again)
    asked = pq.read_table(tmp_path / "b" / "log.parquet")["setpoint_z"].to_numpy()
    assert asked[[0, 20, 30]] == pytest.approx([-10.0, -10.0, -10.5])


def test_an_arm_of_ones_own_goes_with_the_folder(tmp_path):
    """With what its file includes."""
    source = tmp_path / "mine"
    shutil.copytree(shipped()["other-arm"].parent, source)
    whole = (source / "arms" / "panda.xml").read_text()
    start, end = whole.index("<worldbody>") + len("<worldbody>"), whole.index("</worldbody>")
    (source / "arms" / "parts.xml").write_text(f"<mujocoinclude>{whole[start:end]}</mujocoinclude>")
    split = f"{whole[:start]}<include file='parts.xml'/>{whole[end:]}"
    (source / "arms" / "panda.xml").write_text(split)
    first = simulate(source / "other-arm.toml", tmp_path / "a", top={"duration": 0.04})
    shutil.rmtree(source)
    again = simulate(tmp_path / "a" / "config.toml", tmp_path / "b")
    assert repeatable(first) == repeatable(again)


def test_a_recorded_setpoint_is_held_to_the_bounds_on_force(tmp_path):
    wish = tmp_path / "wish.csv"
    wish.write_text("t,x,y,z\n0,1,2,-10\n0.02,1,2,-30\n")
    with pytest.raises(ScenarioError, match=r"wish\.csv: z is -21 N at 0.011 s, outside"):
        simulate("paper", tmp_path / "a", top={"duration": 0.02}, setpoint=wish)


def test_another_seed_is_another_run(tmp_path):
    runs = [
        simulate("paper", tmp_path / str(seed), top={"duration": 0.03, "seed": seed})
        for seed in (1, 2)
    ]
    assert runs[0]["axes"] != runs[1]["axes"]


# --- all or nothing ------------------------------------------------------------------------------


def test_what_is_written_appears_at_the_end(tmp_path):
    folder = tmp_path / "a" / "b" / "run"
    with result_folder(folder) as partial:
        (partial / "x").write_text("1")
        assert not folder.exists()
        assert partial.parent == folder.parent  # a move, not a copy
    assert [p.name for p in folder.iterdir()] == ["x"]
    assert [p.name for p in folder.parent.iterdir()] == ["run"]


def test_it_can_be_read_by_who_may_read_other_folders(tmp_path):
    (tmp_path / "usual").mkdir()
    with result_folder(tmp_path / "run"):
        pass
    modes = [stat.S_IMODE((tmp_path / name).stat().st_mode) for name in ("usual", "run")]
    assert modes[0] == modes[1]


@pytest.mark.parametrize("error", [RuntimeError("drawing failed"), KeyboardInterrupt()])
@pytest.mark.parametrize("place", ["run", "new/deeper/run"])
def test_a_failure_on_the_way_leaves_nothing(error, place, tmp_path):
    folder = tmp_path / place
    with pytest.raises(type(error)), result_folder(folder) as partial:  # noqa: PT012
        (partial / "summary.json").write_text("{}")
        raise error
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_is_one_line_and_leaves_nothing(tmp_path):
    with (
        pytest.raises(ScenarioError, match="No space left") as caught,
        result_folder(tmp_path / "r"),
    ):
        raise OSError(28, "No space left on device")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_holds_something_is_refused(tmp_path):
    (tmp_path / "mine.txt").write_text("precious")
    with pytest.raises(ScenarioError, match="not empty"), result_folder(tmp_path):
        pytest.fail("nothing may be done before that")
    assert [p.name for p in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(ScenarioError, match="no folder"), result_folder(tmp_path / "mine.txt"):
        pytest.fail("nothing may be done before that")
    assert (tmp_path / "mine.txt").read_text() == "precious"


def test_an_empty_folder_is_taken(tmp_path):
    (tmp_path / "run").mkdir()
    with result_folder(tmp_path / "run") as partial:
        (partial / "x").write_text("1")
    assert [p.name for p in (tmp_path / "run").iterdir()] == ["x"]


def test_a_place_below_a_file_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ScenarioError) as caught, result_folder(tmp_path / "file" / "run"):
        pytest.fail("nothing may be done before that")
    assert "\n" not in str(caught.value)


def test_a_parent_that_cannot_be_written_is_refused(tmp_path, monkeypatch):
    """Root may write anywhere, so the system call itself is made to refuse."""

    def refuse(path, *_args, **_named):
        raise PermissionError(13, os.strerror(13), str(path))

    monkeypatch.setattr(os, "mkdir", refuse)
    with pytest.raises(ScenarioError, match="Permission denied"), result_folder(tmp_path / "run"):
        pytest.fail("nothing may be done before that")
    assert list(tmp_path.iterdir()) == []
