"""Which pictures are drawn, and what is refused."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.errors import ScenarioError
from scenarios.film.layout import lay_out
from scenarios.film.plan import Wish, plan_film


def plan(name: str = "film.mp4", **wish):
    """Plan a film of a run of 15 s."""
    return plan_film(Wish(Path(name), **wish), 0.0, 15.0)


def test_a_film_of_a_whole_run_lasts_as_long_as_the_run():
    made = plan()
    assert (made.width, made.height, made.fps) == (1280, 720, 25.0)
    assert len(made.instants) == 375
    np.testing.assert_allclose(np.diff(made.instants), 0.04)
    assert made.instants[0] == 0.0
    assert made.instants[-1] < 15.0


@settings(deadline=None)
@given(st.floats(0.0, 5.0), st.floats(0.1, 9.0), st.floats(1.0, 60.0), st.floats(0.1, 20.0))
def test_frames_cover_what_was_asked_for_at_the_speed_that_was_asked_for(start, span, fps, speed):
    made = plan(start=start, end=start + span, fps=fps, speed=speed)
    step = speed / fps
    assert len(made.instants) == max(1, np.ceil(span / step - 1e-6))
    np.testing.assert_allclose(made.instants, start + step * np.arange(len(made.instants)))
    assert made.instants[-1] < start + span + 1e-9


def test_a_still_is_one_picture_of_the_middle_or_of_the_instant_that_was_named():
    assert plan("a.png").instants.tolist() == [7.5]
    assert plan("a.PNG", start=2.25).instants.tolist() == [2.25]


BAD = {
    "no suffix": ({"name": "film"}, "one of .mp4, .gif, .png"),
    "another suffix": ({"name": "film.avi"}, "one of .mp4, .gif, .png"),
    "beyond the end": ({"start": 15.5}, "--from: 15.5 s is outside"),
    "before the start": ({"start": -1.0}, "--from: -1 s is outside"),
    "to beyond the end": ({"end": 16.0}, "--to: 16 s is outside"),
    "to before from": ({"start": 5.0, "end": 4.0}, "--to: 4 s is not after"),
    "to is from": ({"start": 5.0, "end": 5.0}, "--to: 5 s is not after"),
    "no number": ({"start": float("nan")}, "--from"),
    "endless": ({"end": float("inf")}, "--to"),
    "a size of one number": ({"size": "1280"}, "WIDTHxHEIGHT"),
    "a size of words": ({"size": "bigxsmall"}, "WIDTHxHEIGHT"),
    "a size of three": ({"size": "1x2x3"}, "WIDTHxHEIGHT"),
    "other digits": ({"size": "\N{SUPERSCRIPT TWO}00x300"}, "WIDTHxHEIGHT"),
    "a negative size": ({"size": "-1280x720"}, "WIDTHxHEIGHT"),
    "nothing": ({"size": "0x0"}, "smaller than 480x320"),
    "too small": ({"size": "479x320"}, "smaller than 480x320"),
    "too large": ({"size": "100000x100000"}, "larger than 3840x2160"),
    "absurd": ({"size": f"{'9' * 5000}x720"}, "larger than 3840x2160"),
    "odd": ({"size": "1281x720"}, "even"),
    "still picture a second": ({"fps": 0.0}, "--fps: 0 is not between"),
    "backwards": ({"fps": -25.0}, "--fps: -25"),
    "too fast": ({"fps": 1000.0}, "--fps: 1000"),
    "fps is no number": ({"fps": float("nan")}, "--fps"),
    "too fast for a gif": ({"name": "a.gif", "fps": 60.0}, "between 0.1 and 50"),
    "no speed": ({"speed": 0.0}, "--speed: 0"),
    "speed backwards": ({"speed": -1.0}, "--speed: -1"),
    "too long": ({"speed": 0.001}, "375000 frames"),
    "too long for a gif": ({"name": "a.gif", "speed": 0.1}, "3750 frames"),
    "another camera": ({"camera": "overvew"}, "did you mean 'overview'"),
    "a still in slow motion": ({"name": "a.png", "speed": 0.5}, "--speed: a .png is one picture"),
    "a still with an end": ({"name": "a.png", "end": 3.0}, "--to: a .png is one picture"),
    "a still a second": ({"name": "a.png", "fps": 10.0}, "--fps: a .png is one picture"),
    "a still beyond the end": ({"name": "a.png", "start": 15.1}, "--from: 15.1 s is outside"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_what_cannot_be_drawn_is_refused_in_one_line(name):
    wish, said = BAD[name]
    with pytest.raises(ScenarioError) as refused:
        plan(**wish)
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 6000


@settings(deadline=None)
@given(st.integers(480, 3840), st.integers(320, 2160))
def test_the_parts_of_a_picture_cover_it_and_do_not_overlap(width, height):
    layout = lay_out(width, height)
    boxes = (layout.view, layout.close, layout.plots)
    assert sum(b.width * b.height for b in boxes) == width * height
    for box in boxes:
        assert box.left >= 0
        assert box.top >= 0
        assert box.left + box.width <= width
        assert box.top + box.height <= height
        assert min(box.width, box.height) > 100
    painted = np.zeros((height // 8, width // 8), dtype=int)
    for b in boxes:
        painted[b.top // 8 : (b.top + b.height) // 8, b.left // 8 : (b.left + b.width) // 8] += 1
    assert painted.max() == 1
