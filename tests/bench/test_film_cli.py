"""``pulsempc render`` and ``pulsempc view`` as a user calls them."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import time
from itertools import pairwise

import numpy as np
import pytest
from PIL import Image

from scenarios.film.offscreen import NoRendererError, renderer

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def run_folder(call, tmp_path_factory):
    folder = tmp_path_factory.mktemp("film")
    done = call("run", "paper", "--duration", "0.3", "--out", "mine", folder=folder)
    assert done.returncode == 0, done.stderr
    return folder / "mine"


@pytest.fixture
def needs_a_renderer():
    if renderer() is None:
        pytest.skip(str(NoRendererError()))


@pytest.mark.rendering
def test_a_still_of_a_run(needs_a_renderer, run_folder, call, tmp_path):
    done = call(
        "render", str(run_folder), "--out", "still.png", "--from", "0.2", "--size", "641x360",
        folder=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout == "film: still.png\n"
    assert [path.name for path in tmp_path.iterdir()] == ["still.png"]
    with Image.open(tmp_path / "still.png") as still:
        assert still.size == (641, 360)
        assert len(np.unique(np.asarray(still).reshape(-1, 3), axis=0)) > 1000


@pytest.mark.rendering
def test_a_film_has_the_frames_and_the_size_that_were_asked_for(
    needs_a_renderer, run_folder, call, tmp_path
):
    av = pytest.importorskip("av")
    done = call(
        "render", str(run_folder), "--out", "film.mp4", "--from", "0.1", "--to", "0.2",
        "--speed", "0.5", "--fps", "20", "--size", "640x360", folder=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert "film: 100 %" in done.stderr
    with av.open(str(tmp_path / "film.mp4")) as film:
        frames = [frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)]
    assert len(frames) == 4
    assert frames[0].shape == (360, 640, 3)
    assert any((a != b).any() for a, b in pairwise(frames))


@pytest.mark.rendering
def test_ctrl_c_leaves_nothing_of_a_film(needs_a_renderer, run_folder, start, tmp_path):
    process = start(
        "render", str(run_folder), "--out", "film.gif", "--speed", "0.01", "--fps", "10",
        "--size", "480x320", folder=tmp_path,
    )  # fmt: skip
    for line in process.stderr:
        if "film: 0 %" in line:
            break
    assert list(tmp_path.iterdir())  # something is being written, under another name
    assert not (tmp_path / "film.gif").exists()
    time.sleep(1.0)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted; nothing was written" in said
    assert "Traceback" not in said
    assert not list(tmp_path.iterdir())


def test_a_wish_for_a_library_that_is_not_there_breaks_nothing(call, tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    done = call("scenarios", folder=tmp_path)
    assert done.returncode == 0, done.stderr


BAD = {
    "no run": (("render", "nowhere", "--out", "a.png"), "nowhere: no such folder"),
    "no file": (("render", "RUN"), "--out"),
    "no suffix": (("render", "RUN", "--out", "film"), "one of .mp4, .gif, .png"),
    "beyond the end": (("render", "RUN", "--out", "a.png", "--from", "0.4"), "outside the run"),
    "a word for a number": (("render", "RUN", "--out", "a.gif", "--fps", "many"), "fps"),
    "too large": (("render", "RUN", "--out", "a.png", "--size", "9999x9999"), "larger than"),
    "no folder": (("render", "RUN", "--out", "nowhere/a.png"), "nowhere: no such folder"),
    "a camera that is not": (("render", "RUN", "--out", "a.png", "--camera", "x"), "no view 'x'"),
    "a scenario that is not": (("view", "paprika"), "did you mean 'paper'"),
    "a speed that is none": (("view", "paper", "--speed", "0"), "--speed: 0"),
    "a key that is not": (("view", "paper", "--set", "cell.colour=1"), "colour"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input_is_told_in_one_line(name, run_folder, refuse):
    arguments, said = BAD[name]
    assert said in refuse(*(str(run_folder) if a == "RUN" else a for a in arguments))


def test_a_file_that_exists_is_kept(run_folder, leave, tmp_path, said_once):
    (tmp_path / "a.png").write_text("mine")
    code, _, said = leave("render", str(run_folder), "--out", "a.png")
    assert code == 2
    assert "exists" in said_once(said)
    assert (tmp_path / "a.png").read_text() == "mine"


def test_without_a_display_the_viewer_says_so(environment, tmp_path, said_once):
    bare = {k: v for k, v in environment.items() if k not in {"DISPLAY", "WAYLAND_DISPLAY"}}
    done = subprocess.run(
        [sys.executable, "-m", "bench", "view", "paper"],
        cwd=tmp_path, env=bare, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "no window can be opened" in said_once(done.stderr)


@pytest.mark.skipif(shutil.which("xvfb-run") is None, reason="needs xvfb-run (Debian: xvfb)")
def test_the_viewer_opens_a_window_and_ctrl_c_closes_it(environment, tmp_path):
    """A watcher of the experiment says when its loop goes; then Ctrl-C, as a user would."""
    script = tmp_path / "watch.py"
    script.write_text(
        "import os, signal, sys, threading, time\n"
        "import scenarios.viewer as viewer\n"
        "from bench.cli import main\n"
        "inner = viewer._draw_force\n"
        "def draw(*arguments):\n"
        "    inner(*arguments)\n"
        "    draw.times += 1\n"
        "    if draw.times == 3:\n"
        "        print('drawn', arguments[0].ngeom, flush=True)\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "draw.times = 0\n"
        "viewer._draw_force = draw\n"
        "main(['view', 'paper', '--duration', '60'])\n"
    )
    done = subprocess.run(
        ["xvfb-run", "-a", "-s", "-screen 0 640x480x24", sys.executable, str(script)],
        cwd=tmp_path, env=environment | {"LIBGL_ALWAYS_SOFTWARE": "1"}, capture_output=True,
        text=True, timeout=150, check=False, start_new_session=True,
    )  # fmt: skip
    assert done.returncode == 130, done.stderr
    assert done.stdout == "drawn 1\n"
    assert "Traceback" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["watch.py"]
