"""Meshes: closed, outwards, of the size that was asked for."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scenarios.scene.meshes import Mesh, blend, drum, lathe, rectangle, slab, stadium
from scenarios.scene.shells import facing, shift, side_view


def volume(mesh: Mesh) -> float:
    """Signed: positive where faces turn outwards (divergence theorem)."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def edges_are_shared(mesh: Mesh) -> bool:
    """Whether every edge is walked once in each direction: the surface is closed."""
    f = mesh.faces
    walked = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    there = {tuple(edge) for edge in walked.tolist()}
    return len(there) == len(walked) and all((b, a) in there for a, b in there)


SHAPES = {
    "drum": (drum(0.05, 0.01, 0.11, 0.004), np.pi * 0.05**2 * 0.1),
    "tapering drum": (drum(0.05, 0.0, 0.1, 0.001, 0.03), np.pi * 0.1 * (0.0049) / 3.0),
    "lathe": (lathe([(0.02, 0.0), (0.02, 0.0), (0.02, 0.3), (0.02, 0.3)]), np.pi * 4e-4 * 0.3),
    "slab": (slab(rectangle((-0.1, 0.2), (0.0, 0.1), 0.01), -0.02, 0.03, 0.002), 0.3 * 0.1 * 0.05),
    "stadium": (
        slab(stadium((0.0, 0.0), 0.05, (0.2, 0.0), 0.05), 0.0, 0.1, 0.001),
        0.1 * (np.pi * 0.05**2 + 0.2 * 0.1),
    ),
    "blend": (
        blend([(rectangle((-0.1, 0.1), (-0.1, 0.1), 0.02), 0.0),
               (rectangle((-0.1, 0.1), (-0.1, 0.1), 0.02), 0.1),
               (rectangle((-0.1, 0.1), (-0.1, 0.1), 0.02), 0.2)], 0.001),
        0.2 * 0.04,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_closed_and_has_its_volume(name):
    mesh, expected = SHAPES[name]
    assert edges_are_shared(mesh)
    assert volume(mesh) == pytest.approx(expected, rel=0.03)


@pytest.mark.parametrize("name", SHAPES)
def test_normals_are_of_unit_length_and_point_outwards(name):
    mesh, _ = SHAPES[name]
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-12)
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    area = np.cross(b - a, c - a)
    at_corner = np.einsum("ij,ikj->ik", area, mesh.normals[mesh.faces])
    assert (at_corner >= -1e-9 * np.abs(area).max()).all()


@settings(deadline=None)
@given(
    st.floats(-0.3, 0.3), st.floats(0.02, 0.3), st.floats(0.005, 0.05), st.floats(0.005, 0.05),
    st.floats(0.0, 0.004),
)  # fmt: skip
def test_an_outline_keeps_within_its_circles_and_inside_by_the_inset(x, dx, r0, r1, inset):
    outline = stadium((x, 0.0), r0, (x + dx, 0.0), r1)
    assert outline(0.0)[:, 0].min() >= min(x - r0, x + dx - r1) - 1e-12
    assert outline(0.0)[:, 0].max() <= max(x + r0, x + dx + r1) + 1e-12
    moved = np.linalg.norm(outline(0.0) - outline(inset), axis=1)
    np.testing.assert_allclose(moved, inset, atol=1e-12)


@pytest.mark.parametrize(
    "pose",
    [side_view(0.3), shift(1.0, 2.0, 3.0),
     *(facing(s * axis, (0.1, 0.2, 0.3)) for axis in np.eye(3) for s in (-1.0, 1.0))],
)  # fmt: skip
def test_a_pose_turns_nothing_inside_out(pose):
    mesh, expected = SHAPES["slab"]
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-15)
    moved = mesh.placed(pose)
    assert volume(moved) == pytest.approx(expected, rel=0.03)
    back = (moved.vertices - pose[:3, 3]) @ pose[:3, :3]
    np.testing.assert_allclose(back, mesh.vertices, atol=1e-12)


def test_facing_takes_the_height_along_its_direction():
    mesh = drum(0.01, 0.0, 0.2, 0.001).placed(facing((-1.0, 0.0, 0.0), (0.5, 0.0, 0.0)))
    assert mesh.vertices[:, 0].min() == pytest.approx(0.3)
    assert mesh.vertices[:, 0].max() == pytest.approx(0.5)
