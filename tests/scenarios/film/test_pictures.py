"""What is drawn: letters, arrows, plots; and whole pictures where a renderer is."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plant.own_arm import tool_arm
from scenarios.errors import ScenarioError
from scenarios.film import Wish, render
from scenarios.film.canvas import FORCE, INK, SETPOINT, Canvas, Colour, arrow, plain
from scenarios.film.layout import Box, lay_out
from scenarios.film.offscreen import NoRendererError, Offscreen, renderer
from scenarios.film.overlay import Overlay, arrow_scale
from scenarios.film.plan import plan_film
from scenarios.film.plots import ForcePlots, signed
from scenarios.film.record import Record, read_run
from scenarios.film.render import frames
from scenarios.scene.camera import CLOSE, towards
from scenarios.scene.scene import FIELD_OF_VIEW, Scene

pytestmark = pytest.mark.slow

BOX = Box(0, 0, 640, 480)


@pytest.fixture(scope="module")
def record(finished) -> Record:
    return read_run(finished)


def where(picture: np.ndarray, colour: Colour, within: int = 40) -> np.ndarray:
    """Rows and columns of the pixels of a colour, ``(n, 2)``."""
    near = np.abs(picture[..., :3].astype(int) - colour[:3]).max(axis=-1) < within
    if picture.shape[-1] == 4:
        near &= picture[..., 3] > 200
    return np.argwhere(near)


# --- what is drawn with ----------------------------------------------------------------------


@settings(deadline=None)
@given(st.tuples(*[st.floats(-500, 500)] * 4), st.floats(1.0, 20.0))
def test_an_arrow_ends_where_it_should_and_is_no_wider_than_its_head(ends, width):
    start, end = np.array(ends[:2]), np.array(ends[2:])
    corners = arrow(start, end, width)
    np.testing.assert_allclose(corners[3], end, atol=1e-9)
    length = np.linalg.norm(end - start)
    if length > 1e-6:
        along = (corners - start) @ (end - start) / length
        assert along.max() == pytest.approx(length, abs=1e-6)
        assert along.min() == pytest.approx(0.0, abs=1e-6)


@settings(deadline=None)
@given(st.text())
def test_a_text_is_one_line_whatever_it_is(text):
    shown = plain(text)
    assert len(shown) <= 200
    assert shown.isprintable()


def test_a_text_that_is_too_long_is_cut_where_its_room_ends():
    canvas = Canvas(400, 60)
    canvas.text(10, 10, "a name that goes on and on " * 20, 20.0, INK, room=200.0)
    columns = where(np.asarray(canvas.finished()), INK, 120)[:, 1]
    assert columns.size
    assert columns.max() < 215


@pytest.mark.parametrize("name", ["$x^2$", "\\textbf{}", "<b>", "a\nb\tc\x00", "\N{GRINNING FACE}"])
def test_names_are_drawn_as_they_are(name):
    canvas = Canvas(300, 40)
    canvas.text(5, 5, name, 16.0, INK)
    assert np.asarray(canvas.finished())[..., 3].any()


def test_a_force_is_written_with_its_sign():
    assert signed(1.0) == "+1.00 N"
    assert signed(-0.004) == "\N{MINUS SIGN}0.00 N"
    assert signed(-12.345) == "\N{MINUS SIGN}12.35 N" or signed(-12.345) == "\N{MINUS SIGN}12.34 N"


# --- over the views --------------------------------------------------------------------------


def pressing(record: Record, size: float, wish: float = 0.0) -> Record:
    """The run with one force on z throughout."""
    n = len(record.time)
    force, setpoint = np.zeros((n, 3)), np.zeros((n, 3))
    force[:, 2], setpoint[:, 2] = size, wish
    return replace(record, force=force, setpoint=setpoint)


def overlay(record: Record, scale: float) -> np.ndarray:
    place = np.array([0.0, 0.0, 0.42])
    camera = towards(CLOSE, place, 0.2, FIELD_OF_VIEW, BOX.aspect)
    return np.asarray(Overlay(record, camera, BOX, 1.0, scale).close(0.1, place))


def test_the_arrow_grows_with_the_force_and_points_along_it(record):
    reach = {}
    for size in (-4.0, -8.0, 4.0):
        rows = where(overlay(pressing(record, size), 0.005), FORCE)[:, 0] - BOX.height / 2
        assert rows.size
        reach[size] = rows.max() if size < 0 else rows.min()
    assert reach[-4.0] > 30  # pressing down, it points down
    assert reach[-8.0] == pytest.approx(2.0 * reach[-4.0], rel=0.06)
    assert reach[4.0] < -30


def test_the_setpoint_is_a_rim_of_its_own(record):
    picture = overlay(pressing(record, 0.0, -8.0), 0.005)
    assert not where(picture, FORCE).size
    assert where(picture, SETPOINT).size
    both = overlay(pressing(record, -4.0, -8.0), 0.005)
    assert where(both, SETPOINT)[:, 0].max() > where(both, FORCE)[:, 0].max() + 20


def test_after_a_trip_nothing_is_wished_for(record):
    wished = pressing(record, 0.0, -8.0)
    assert where(overlay(wished, 0.005), SETPOINT).size
    assert not where(overlay(replace(wished, trip=("force", 0.05)), 0.005), SETPOINT).size


def test_a_usual_force_fills_the_room_of_an_arrow(record):
    assert arrow_scale(pressing(record, -10.0), 0.05) == pytest.approx(0.005)
    unknown = replace(record, force=np.full_like(record.force, np.nan))
    assert arrow_scale(unknown, 0.05) > 0


# --- plots -----------------------------------------------------------------------------------


def plots(record: Record, time: float) -> np.ndarray:
    box = Box(0, 0, 460, 430)
    return np.asarray(ForcePlots(record, box, 1.0, 0.0, record.end).draw(time))


def test_the_cursor_goes_along_with_time(record):
    dots = []
    for time in (0.05, 0.15, 0.25):
        now = record.cycle(time)
        force = np.zeros((300, 3))
        force[now] = 5.0
        one = replace(record, force=force)
        highest = where(plots(one, time), FORCE)
        highest = highest[highest[:, 0] > 28]  # below the first plot's heading
        dots.append(float(np.median(highest[highest[:, 0] < highest[:, 0].min() + 4][:, 1])))
    left, right = 46.0, 460 - 18.0
    for dot, share in zip(dots, (1 / 6, 3 / 6, 5 / 6), strict=True):
        assert dot == pytest.approx(left + share * (right - left), abs=4.0)


@pytest.mark.parametrize("axes", [(0, 1, 2), (2,), (1, 2)])
def test_each_axis_under_control_has_its_plot(record, axes):
    lines = where(plots(replace(record, axes=axes), 0.2), FORCE)
    rows = np.bincount(np.minimum(lines[:, 0] * len(axes) // 378, len(axes)), minlength=len(axes))
    assert (rows[: len(axes)] > 50).all()


def test_plots_bear_what_a_broken_off_run_lacks(record):
    lacking = replace(
        record, held=np.full_like(record.held, np.nan), setpoint=np.full_like(record.held, np.nan)
    )
    assert where(plots(lacking, 0.2), FORCE).size


@pytest.mark.parametrize("force", [0.0, 1e-9, 1e6])
def test_plots_bear_forces_of_any_size(record, force):
    n = np.full((300, 3), force)
    assert plots(replace(record, force=n, setpoint=n, held=n), 0.1).any()


# --- whole pictures --------------------------------------------------------------------------


def test_without_a_renderer_one_line_says_what_to_install(finished, tmp_path, monkeypatch):
    monkeypatch.setattr("scenarios.film.offscreen.renderer", lambda: None)
    with pytest.raises(NoRendererError, match="apt install") as refused:
        render(finished, Wish(tmp_path / "a.png"), lambda *_: None)
    assert "\n" not in str(refused.value)
    assert not list(tmp_path.iterdir())


def test_no_library_that_draws_is_found_where_none_works(monkeypatch):
    """Each is tried in a process of its own: here they are all told to fail."""
    monkeypatch.setattr("scenarios.film.offscreen._TRIAL", "raise SystemExit(1)")
    assert renderer.__wrapped__() is None
    monkeypatch.setattr(
        "scenarios.film.offscreen._TRIAL", "import sys; assert sys.argv[1] != 'egl'"
    )
    assert renderer.__wrapped__() == "osmesa"


def test_a_film_of_a_run_that_is_none_leaves_nothing(tmp_path):
    with pytest.raises(ScenarioError):
        render(tmp_path / "run", Wish(tmp_path / "a.png"), lambda *_: None)
    assert not list(tmp_path.iterdir())


@pytest.mark.rendering
def test_a_point_is_drawn_where_the_camera_says(record):
    """The tissue's red, as MuJoCo draws it, goes through the picture as its middle does."""
    scene = Scene(tool_arm(record.cell), 640, 480)
    contact = scene.pose(record.angles[0], False)
    middle = contact.surface - [0.0, 0.0, 0.016]  # what is seen of it lies lower than its top
    drawn, expected = [], []
    with Offscreen(scene, 640, 480) as offscreen:
        for shift in ([0.0, 0.0, 0.0], [0.08, 0.0, 0.0], [0.0, 0.0, 0.08], [-0.06, 0.05, -0.04]):
            place = contact.surface + shift
            camera = towards(CLOSE, place, 0.3, FIELD_OF_VIEW, 640 / 480)
            picture = offscreen.picture(camera, 640, 480, 0.3)
            red = np.argwhere(picture[..., 0].astype(int) > 2.2 * picture[..., 1] + 30)
            assert len(red) > 2000
            drawn.append(red.mean(axis=0)[::-1])
            expected.append(camera.project(middle, 640, 480))
    np.testing.assert_allclose(drawn, expected, atol=6.0)
    moved = np.ptp(drawn, axis=0)
    assert (moved > 80).all()
    np.testing.assert_allclose(moved, np.ptp(expected, axis=0), atol=4.0)


@pytest.fixture(scope="module")
def pictures(record) -> list[np.ndarray]:
    """At 0.05 s, at 0.15 s with the tool elsewhere, at 0.25 s with the heart too, and the first."""
    plan = plan_film(Wish(Path("a.mp4"), size="480x320"), 0.0, record.end)
    angles = record.angles.copy()
    angles[100:, 7] -= 0.03
    angles[200:, 1] += 0.03
    moving = replace(record, angles=angles)
    return list(frames(moving, replace(plan, instants=np.array([0.05, 0.15, 0.25, 0.05]))))


@pytest.mark.rendering
def test_pictures_differ_when_the_arms_move_and_only_then(pictures):
    view = lay_out(480, 320).view
    first, second, third, again = (p[:, : view.width] for p in pictures)
    assert np.array_equal(first, again)
    middle = view.width // 2
    for a, b, moved, still in (
        (first, second, np.s_[80:280, middle + 40 :], np.s_[80:200, : middle - 40]),
        (second, third, np.s_[80:200, : middle - 40], np.s_[80:280, middle + 40 :]),
    ):
        changed = np.abs(a.astype(int) - b).max(axis=-1) > 20
        assert changed[moved].sum() > 200
        assert changed[still].sum() < 100  # a shadow may fall there


@pytest.mark.rendering
def test_a_picture_has_arms_tissue_force_and_plots(pictures):
    layout = lay_out(480, 320)
    picture = pictures[0]
    assert picture.shape == (320, 480, 3)
    assert picture.dtype == np.uint8
    view = picture[:, : layout.view.width]
    assert (view.min(axis=-1) > 150).mean() > 0.05  # white shells
    assert where(view, FORCE).size
    close = picture[: layout.close.height, layout.close.left :]
    assert ((close[..., 0] > 90) & (close[..., 1] < 50)).mean() > 0.03  # tissue
    assert where(picture[layout.plots.top :, layout.plots.left :], FORCE).size


@pytest.mark.rendering
def test_every_view_and_shape_of_picture_can_be_drawn(record):
    for camera, size in (("left", "480x640"), ("above", "960x320")):
        wish = Wish(Path("a.png"), size=size, camera=camera)
        (picture,) = frames(record, plan_film(wish, 0.0, record.end))
        assert f"{picture.shape[1]}x{picture.shape[0]}" == size
        assert (picture.min(axis=-1) > 150).mean() > 0.01
