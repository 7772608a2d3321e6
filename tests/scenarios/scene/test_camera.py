"""Cameras: what has to be in the picture is, and points lie where MuJoCo draws them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.scene.arrows import force_arrow
from scenarios.scene.camera import VIEWS, View, around, directions, towards

views = st.builds(View, st.floats(-180, 180), st.floats(-80, 80))
numbers = st.floats(-1.0, 1.0)


@settings(deadline=None)
@given(views)
def test_directions_are_a_right_handed_frame(view):
    right, up, forward = directions(view)
    frame = np.stack([right, up, -forward])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame) == pytest.approx(1.0)
    assert up[2] > 0


@settings(deadline=None)
@given(views, st.integers(0, 10_000), st.integers(400, 3000), st.floats(10.0, 70.0))
def test_all_points_are_in_the_picture_and_the_camera_is_as_near_as_can_be(
    view, seed, width, opening
):
    points = np.random.default_rng(seed).normal(0.0, 0.4, (20, 3))
    camera = around(view, points, opening, width / 1000, margin=0.1)
    assert ((points - camera.position) @ camera.forward > 0).all()
    places = 2.0 * camera.project(points, width, 1000) / [width, 1000] - 1.0
    assert np.abs(places).max() == pytest.approx(0.9, abs=1e-6)


@settings(deadline=None)
@given(views, numbers, numbers, numbers)
def test_what_a_camera_is_aimed_at_is_in_the_middle_and_a_height_fills_it(view, x, y, z):
    point = np.array([x, y, z])
    camera = towards(view, point, 0.5, 30.0, 1.5)
    np.testing.assert_allclose(camera.project(point, 600, 400), [300.0, 200.0], atol=1e-6)
    above = point + 0.25 * directions(view)[1]
    np.testing.assert_allclose(camera.project(above, 600, 400), [300.0, 0.0], atol=1e-6)


def test_views_look_at_the_cell_from_different_sides():
    forward = np.array([directions(view)[2] for view in VIEWS.values()])
    angles = forward @ forward.T - 2.0 * np.eye(len(forward))
    assert angles.max() < np.cos(np.deg2rad(5.0))


@settings(deadline=None)
@given(st.floats(0.1, 100.0), st.floats(1e-4, 0.1), st.floats(1.1, 10.0))
def test_an_arrow_is_as_long_as_its_force_is_large(size, scale, factor):
    at, along = np.array([0.1, 0.2, 0.3]), np.array([0.6, 0.0, -0.8])
    one, more = force_arrow(at, size * along, scale), force_arrow(at, factor * size * along, scale)
    assert one is not None
    assert more is not None
    np.testing.assert_array_equal(one.start, at)
    np.testing.assert_allclose(one.end - one.start, scale * size * along, rtol=1e-9, atol=1e-12)
    length = [float(np.linalg.norm(a.end - a.start)) for a in (one, more)]
    assert length[1] / length[0] == pytest.approx(factor, rel=1e-6)


@pytest.mark.parametrize("force", [np.zeros(3), np.full(3, 0.01), np.full(3, np.nan)])
def test_next_to_no_force_has_no_arrow(force):
    assert force_arrow(np.zeros(3), force, 0.01) is None
