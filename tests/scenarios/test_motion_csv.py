"""Recorded motion from CSV: what is read, how it is resampled, and every file that is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.errors import ScenarioError
from scenarios.motion import (
    DataFileError,
    DataTooShortError,
    Motion,
    MotionConfig,
    load_motion,
)

PERIOD = 0.001


def play(path: Path, duration: float, period: float = PERIOD, **keys: object) -> Motion:
    return load_motion(MotionConfig(file=str(path), **keys), duration, period, seed=0)


def wave(t: np.ndarray) -> np.ndarray:
    """A smooth motion (n, 3) [m], not at rest at its start."""
    return 1e-3 * np.column_stack(
        (np.sin(7.0 * t), 2.0 * np.cos(5.0 * t), 4.0 * np.sin(4.0 * t + 1.0))
    )


def table(t: np.ndarray, position: np.ndarray) -> str:
    rows = [",".join(map(repr, row)) for row in np.column_stack((t, position)).tolist()]
    return "\n".join(["t,x,y,z", *rows]) + "\n"


def write(path: Path, t: np.ndarray, position: np.ndarray) -> Path:
    path.write_text(table(t, position))
    return path


@pytest.mark.parametrize("rate", [100.0, 250.0, 1000.0, 2000.0])
def test_any_rate_is_resampled(tmp_path: Path, rate: float) -> None:
    t = np.arange(0.0, 4.0 + 0.5 / rate, 1.0 / rate)
    motion = play(write(tmp_path / "m.csv", t, wave(t)), 4.0)
    shift = motion.position - wave(motion.time)
    np.testing.assert_allclose(shift, shift[0] + np.zeros_like(shift), atol=2e-8)
    assert motion.time.size == 4000
    assert motion.beats.size == 0
    inner = slice(100, -100)
    h = 1e-5
    slope = (wave(motion.time + h) - wave(motion.time - h)) / (2 * h)
    np.testing.assert_allclose(motion.velocity[inner], slope[inner], atol=1e-5)


def test_uneven_sampling_and_any_first_time(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    t = np.concatenate(([0.0], np.cumsum(rng.uniform(0.002, 0.02, size=400))))
    motion = play(write(tmp_path / "m.csv", t + 1.7e9, wave(t)), 3.0)
    assert motion.time[0] == 0.0
    shift = motion.position - wave(motion.time)
    np.testing.assert_allclose(shift, shift[0] + np.zeros_like(shift), atol=1e-6)


def test_derivatives_agree_with_differences(tmp_path: Path) -> None:
    t = np.arange(0.0, 3.0, 0.02)
    motion = play(write(tmp_path / "m.csv", t, wave(t)), 2.5)
    velocity = (motion.position[2:] - motion.position[:-2]) / (2 * PERIOD)
    acceleration = (motion.velocity[2:] - motion.velocity[:-2]) / (2 * PERIOD)
    np.testing.assert_allclose(motion.velocity[1:-1], velocity, atol=1e-6)
    np.testing.assert_allclose(motion.acceleration[1:-1], acceleration, atol=1e-3)


def test_the_mean_is_removed_and_the_amplitude_kept(tmp_path: Path) -> None:
    t = np.arange(0.0, 10.001, 0.001)
    there = play(write(tmp_path / "m.csv", t, wave(t)), 10.0)
    far = play(write(tmp_path / "far.csv", t, wave(t) + np.array([0.5, -0.2, 3.0])), 10.0)
    np.testing.assert_allclose(far.position, there.position, atol=1e-12)
    np.testing.assert_allclose(there.position.mean(axis=0), 0.0, atol=1e-6)
    np.testing.assert_allclose(np.ptp(there.position, axis=0), np.ptp(wave(t), axis=0), rtol=1e-4)


def test_the_mean_is_that_of_the_recording_not_of_the_run(tmp_path: Path) -> None:
    t = np.arange(0.0, 5.0, 0.004)
    path = write(tmp_path / "m.csv", t, wave(t))
    np.testing.assert_array_equal(play(path, 1.3).position, play(path, 4.0).position[:1300])


def test_axes_that_do_not_move_are_at_rest(tmp_path: Path) -> None:
    t = np.arange(0.0, 2.0, 0.01)
    path = write(tmp_path / "m.csv", t, wave(t))
    motion, full = play(path, 1.5, axes=("y",)), play(path, 1.5)
    assert not motion.position[:, [0, 2]].any()
    assert not motion.velocity[:, [0, 2]].any()
    assert not motion.acceleration[:, [0, 2]].any()
    np.testing.assert_array_equal(motion.acceleration[:, 1], full.acceleration[:, 1])


@pytest.mark.parametrize(
    "change",
    [
        lambda s: "\ufeff" + s,
        lambda s: s.replace("\n", "\r\n"),
        lambda s: s.replace("\n", "\r"),
        lambda s: s + "\n  \n",
        lambda s: s.rstrip("\n"),
        lambda s: "# a pig, 2009\n" + s.replace("\n", '\n# remark, with "comma\n', 1),
        lambda s: s.replace("t,x,y,z", " t, x ,y,z"),
        lambda s: s.replace("t,x,y,z", '"t","x","y","z"'),
        lambda s: s.replace("\n", ",7,free text\n").replace("z,7,free text", "z,ecg,remark"),
    ],
    ids=["bom", "crlf", "cr", "blank", "no-newline", "comments", "spaces", "quotes", "extra"],
)
def test_harmless_variants_read_the_same(tmp_path: Path, change: object) -> None:
    t = np.arange(0.0, 1.0, 0.01)
    text = table(t, wave(t))
    plain, variant = tmp_path / "plain.csv", tmp_path / "variant.csv"
    plain.write_text(text)
    variant.write_bytes(change(text).encode())  # type: ignore[operator]
    np.testing.assert_array_equal(play(variant, 0.9).position, play(plain, 0.9).position)


def test_columns_may_come_in_any_order(tmp_path: Path) -> None:
    t = np.arange(0.0, 1.0, 0.01)
    plain = write(tmp_path / "plain.csv", t, wave(t))
    other = tmp_path / "other.csv"
    rows = [line.split(",") for line in plain.read_text().split()]
    other.write_text("\n".join(f"{z},{t},{x},{y}" for t, x, y, z in rows))
    np.testing.assert_array_equal(play(other, 0.9).position, play(plain, 0.9).position)


HEAD = "t,x,y,z\n"
ROWS = "0,0,0,0\n0.01,1e-3,0,0\n0.02,0,0,0\n0.03,0,0,0\n"
BAD = {
    "empty": ("", None, "expected a header t,x,y,z"),
    "comments only": ("# nothing\n\n", None, "expected a header t,x,y,z"),
    "header only": (HEAD, None, "0 rows of numbers; at least 4"),
    "three rows": (HEAD + ROWS.rsplit("\n", 2)[0], None, "3 rows of numbers; at least 4"),
    "no header": (ROWS, 1, "no column 't'.*expected t,x,y,z"),
    "missing column": (HEAD.replace("z", "w") + ROWS, 1, "no column 'z'.*expected t,x,y,z"),
    "doubled column": (HEAD.replace("z", "z,z") + ROWS, 1, "more than one column 'z'"),
    "semicolons": ((HEAD + ROWS).replace(",", ";"), 1, "no column 't'"),
    "word": (HEAD + ROWS + "0.04,abc,0,0\n", 6, "column 'x' is 'abc'; expected a finite number"),
    "two lines in a cell": (HEAD + ROWS + '0.04,"a\nb",0,0\n', 7, "column 'x' is"),
    "underscore": (HEAD + ROWS + "0.04,1_0,0,0\n", 6, "column 'x' is '1_0'"),
    "empty cell": (HEAD + ROWS + "0.04,0,,0\n", 6, "column 'y' is ''; expected a finite number"),
    "nan": (HEAD + ROWS + "0.04,0,0,nan\n", 6, "column 'z' is 'nan'; expected a finite number"),
    "infinite": (HEAD + ROWS + "# c\n0.04,-inf,0,0\n", 7, "column 'x' is '-inf'"),
    "overflow": (HEAD + ROWS + "0.04,1e999,0,0\n", 6, "column 'x' is '1e999'"),
    "nan time": (HEAD + ROWS + "nan,0,0,0\n", 6, "column 't' is 'nan'"),
    "short row": (HEAD + ROWS + "0.04,0,0\n", 6, "3 cells, the header has 4"),
    "decimal comma": (HEAD + ROWS + "0.04,0,001,0,0\n", 6, "5 cells.*decimals need a point"),
    "doubled time": (HEAD + ROWS + "0.03,0,0,0\n", 6, "t = 0.03 after 0.03; t must increase"),
    "backward time": (HEAD + ROWS + "0.01,0,0,0\n", 6, "t = 0.01 after 0.03; t must increase"),
    "open quote": (HEAD + ROWS + '0.04,"0,0,0\n', 6, "not CSV"),
    "gap": (HEAD + ROWS + "0.33,0,0,0\n", 6, r"gap of 0\.3 s before t = 0\.33 s; .* 0\.1 s"),
    "millimetres": (HEAD + ROWS + "0.04,0,8,0\n", None, "column 'y' spans 8 m.*in metres"),
}


@pytest.mark.parametrize(("text", "line", "words"), BAD.values(), ids=BAD.keys())
def test_bad_files_name_file_line_and_remedy(
    tmp_path: Path, text: str, line: int | None, words: str
) -> None:
    path = tmp_path / "m.csv"
    path.write_text(text)
    with pytest.raises(DataFileError, match=words) as caught:
        play(path, 0.02)
    error = caught.value
    assert isinstance(error, ScenarioError)
    assert error.path == path
    assert error.line == line
    place = f"{path}: " if line is None else f"{path}: line {line}: "
    assert str(error).startswith(place)
    assert "\n" not in str(error)


@pytest.mark.parametrize(
    "content", [b"\x89PNG\r\n\x1a\n\x00\x00", b"\xff\xfet\x00,\x00x\x00", b"t,x,y,z\n\xe9,0,0,0\n"]
)
def test_binary_files(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "m.csv"
    path.write_bytes(content)
    with pytest.raises(DataFileError, match="not text in UTF-8; name a CSV file"):
        play(path, 1.0)


def test_missing_file_and_directory(tmp_path: Path) -> None:
    with pytest.raises(DataFileError, match="no such file"):
        play(tmp_path / "none.csv", 1.0)
    with pytest.raises(DataFileError, match="is a directory"):
        play(tmp_path, 1.0)
    (tmp_path / "plain").write_text("")
    with pytest.raises(DataFileError, match="cannot be read: Not a directory"):
        play(tmp_path / "plain" / "m.csv", 1.0)


def test_a_recording_shorter_than_the_run(tmp_path: Path) -> None:
    t = np.arange(0.0, 2.0, 0.004)
    path = write(tmp_path / "m.csv", t, wave(t))
    with pytest.raises(DataTooShortError, match=r"lasts 1\.996 s, the run 2 s.* 1\.99") as caught:
        play(path, 2.0)
    assert caught.value.requested == 2.0
    assert caught.value.available == pytest.approx(1.997)
    assert play(path, 1.997).time.size == 1997


def test_slow_recordings_have_no_gaps(tmp_path: Path) -> None:
    t = np.arange(0.0, 20.0, 0.5)
    assert play(write(tmp_path / "m.csv", t, 1e-3 * wave(t)), 19.0).time.size == 19000


def test_100_000_rows_are_read(tmp_path: Path) -> None:
    t = np.arange(100_000) * 1e-3
    position = wave(t)
    motion = play(write(tmp_path / "m.csv", t, position), 99.0)
    expected = position[:99_000] - position.mean(axis=0)
    np.testing.assert_allclose(motion.position, expected, atol=1e-6)


metres = st.floats(-0.09, 0.09)


@settings(max_examples=60, deadline=None)
@given(
    first=st.floats(-1e3, 1e3),
    steps=st.lists(st.integers(1, 90), min_size=3, max_size=40),
    data=st.data(),
)
def test_a_written_recording_is_played_through_its_samples(
    tmp_path_factory: pytest.TempPathFactory, first: float, steps: list[int], data: st.DataObject
) -> None:
    k = np.concatenate(([0], np.cumsum(steps)))
    rows = data.draw(st.lists(st.tuples(metres, metres, metres), min_size=k.size, max_size=k.size))
    position = np.array(rows)
    path = write(tmp_path_factory.mktemp("csv") / "m.csv", first + PERIOD * k, position)
    motion = play(path, PERIOD * (k[-1] + 1) - 1e-9)
    # the last control instant may lie past the last sample by rounding: compare those before it
    inside = k < motion.time.size
    offset = motion.position[0] - position[0]
    np.testing.assert_allclose(motion.position[k[inside]] - offset, position[inside], atol=1e-6)
