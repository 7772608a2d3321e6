"""Files: whole or not at all, with the frames and the time that were asked for."""

import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from scenarios.errors import ScenarioError
from scenarios.film.encode import FilmPackageError, durations, film_file

WIDTH, HEIGHT, FRAMES = 128, 96, 8


def frame(i: int) -> np.ndarray:
    """A bright bar on dark ground that wanders to the right."""
    picture = np.full((HEIGHT, WIDTH, 3), (20, 30, 40), dtype=np.uint8)
    picture[:, 16 * i : 16 * i + 16] = (230, 220, 90)
    return picture


def write(out: Path, frames: int = FRAMES, fps: float = 25.0) -> None:
    with film_file(out, fps, WIDTH, HEIGHT) as writer:
        for i in range(frames):
            writer.add(frame(i))


def bar(picture: np.ndarray) -> float:
    """Where the bar is."""
    bright = np.flatnonzero(picture[HEIGHT // 2, :, 0] > 128)
    return float(bright.mean())


def test_an_mp4_has_its_frames_in_order(tmp_path):
    av = pytest.importorskip("av")
    write(tmp_path / "a.mp4")
    with av.open(str(tmp_path / "a.mp4")) as film:
        stream = film.streams.video[0]
        frames = [picture.to_ndarray(format="rgb24") for picture in film.decode(video=0)]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert stream.average_rate == 25
        assert float(stream.duration * stream.time_base) == pytest.approx(FRAMES / 25)
    assert len(frames) == FRAMES
    assert frames[0].shape == (HEIGHT, WIDTH, 3)
    for i, picture in enumerate(frames):
        assert bar(picture) == pytest.approx(16 * i + 7.5, abs=1.0)
        assert np.abs(picture.astype(int) - frame(i)).mean() < 8


def test_a_gif_has_its_frames_in_order_and_goes_round(tmp_path):
    write(tmp_path / "a.gif", fps=30.0)
    with Image.open(tmp_path / "a.gif") as film:
        assert (film.n_frames, film.size, film.info["loop"]) == (FRAMES, (WIDTH, HEIGHT), 0)
        shown = []
        for i in range(FRAMES):
            film.seek(i)
            shown.append(film.info["duration"])
            assert bar(np.asarray(film.convert("RGB"))) == pytest.approx(16 * i + 7.5, abs=1.0)
    assert sum(shown) == pytest.approx(1000 * FRAMES / 30.0, abs=10)


def test_a_png_is_the_picture_itself(tmp_path):
    write(tmp_path / "a.png", frames=1)
    with Image.open(tmp_path / "a.png") as still:
        assert np.array_equal(np.asarray(still), frame(0))


@settings(deadline=None)
@given(st.integers(1, 400), st.floats(0.1, 50.0))
def test_a_gif_keeps_time_in_the_long_run(frames, fps):
    shown = durations(frames, fps)
    assert len(shown) == frames
    assert all(step >= 20 and step % 10 == 0 for step in shown)
    assert sum(shown) == pytest.approx(1000.0 * frames / fps, abs=5.0 + 1e-6)


@pytest.mark.parametrize("name", ["a.mp4", "a.gif", "a.png"])
def test_what_is_broken_off_leaves_nothing(name, tmp_path):
    pytest.importorskip("av")

    def break_off() -> None:
        with film_file(tmp_path / name, 25.0, WIDTH, HEIGHT) as writer:
            writer.add(frame(0))
            assert not (tmp_path / name).exists()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        break_off()
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_there_is_left_alone(tmp_path):
    (tmp_path / "a.gif").write_text("mine")
    with pytest.raises(ScenarioError, match="exists; give another --out"):
        write(tmp_path / "a.gif")
    assert [p.name for p in tmp_path.iterdir()] == ["a.gif"]
    assert (tmp_path / "a.gif").read_text() == "mine"


@pytest.mark.parametrize("place", ["nowhere/a.png", "file/a.png"])
def test_a_folder_that_is_not_there_is_told(place, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ScenarioError, match="no such folder"):
        write(tmp_path / place)


def test_a_name_that_is_no_name_is_told(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be written"):
        write(tmp_path / ("a" * 300 + ".png"))
    assert not list(tmp_path.iterdir())


def test_without_the_package_an_mp4_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(FilmPackageError, match=r"pip install 'pulsempc\[film\]'"):
        write(tmp_path / "a.mp4")
    assert not list(tmp_path.iterdir())
    write(tmp_path / "a.gif")


def test_a_file_is_for_all_whom_the_mask_lets(tmp_path):
    write(tmp_path / "a.png", frames=1)
    (tmp_path / "b").touch()
    assert (tmp_path / "a.png").stat().st_mode == (tmp_path / "b").stat().st_mode
