"""The drawn cell stands where the simulated one does, and its tissue gives way to the tip."""

import mujoco
import numpy as np
import pytest

from plant import Cell, CellConfig
from plant.arm_model import effector_solids, link_solids
from plant.chain import Solid
from plant.own_arm import tool_arm
from plant.viper import HEART, TOOL, VIPER_S650
from scenarios import load_scenario
from scenarios.scene.scene import Scene
from scenarios.scene.shells import arm_shells, instrument, pad_holder
from scenarios.scene.skin import skin
from scenarios.scene.tissue import RADIUS, Tissue

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(tool_arm(CellConfig()), 640, 480)


def middle_of_the_tissue(scene: Scene) -> np.ndarray:
    """Where the first vertex of the tissue, its middle, is in the world."""
    model, data = scene.model, scene.data
    geom = next(i for i in range(model.ngeom) if model.geom_dataid[i] == scene.tissue_id)
    vertex = model.mesh_vert[model.mesh_vertadr[scene.tissue_id]]
    return data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ vertex


def test_the_scene_stands_where_the_simulation_does(scene, beating):
    cell = Cell(CellConfig(), beating(40), force=np.array([1.0, 2.0, -10.0]), seed=0)
    first = cell.truth().tissue
    for k in range(40):
        measurement, truth = cell.measure(), cell.truth()
        contact = scene.pose(truth.joint_angle, truth.touching)
        np.testing.assert_allclose(contact.surface, truth.tissue, atol=1e-12)
        np.testing.assert_allclose(contact.tip, measurement.position, atol=1e-12)
        cell.apply(np.array([2.0, -3.0, 5.0]) * np.cos(0.1 * k))
    # and the tissue has moved by then, so that this says something
    assert np.linalg.norm(truth.tissue - first) > 1e-3


def test_the_tissue_goes_with_the_tip_that_touches_and_not_with_one_that_does_not(scene, beating):
    cell = Cell(CellConfig(), beating(3), force=np.array([1.0, 2.0, -10.0]), seed=0)
    cell.measure()
    angles = cell.truth().joint_angle
    touching = scene.pose(angles, True)
    assert np.linalg.norm(touching.tip - touching.surface) > 3e-3
    # MuJoCo keeps vertices as floats of four bytes
    np.testing.assert_allclose(middle_of_the_tissue(scene), touching.tip, atol=1e-7)
    scene.pose(angles, False)
    np.testing.assert_allclose(middle_of_the_tissue(scene), touching.surface, atol=1e-7)


def test_what_is_drawn_has_no_mass_and_touches_nothing(scene):
    simulated = Cell(CellConfig(), Still(), force=np.zeros(3), seed=0).model
    np.testing.assert_array_equal(scene.model.body_mass, simulated.body_mass)
    np.testing.assert_array_equal(scene.model.body_inertia, simulated.body_inertia)
    assert not scene.model.geom_contype.any()
    assert not scene.model.geom_conaffinity.any()


class Still:
    position = velocity = acceleration = np.zeros((1, 3))


def test_each_body_of_the_arms_is_dressed(scene):
    for arm in ("heart", "tool"):
        for part in ("base", *(f"link{i}" for i in range(1, 7))):
            assert scene.model.body(f"{arm}_{part}").geomnum[0] > 0


def test_an_arm_of_ones_own_keeps_its_solids_and_stands_where_it_is_simulated():
    config = load_scenario("other-arm").cell
    tool = tool_arm(config)
    scene = Scene(tool, 640, 480)
    cell = Cell(config, Still(), force=np.array([1.0, 2.0, -10.0]), seed=0, tool=tool)
    measurement, truth = cell.measure(), cell.truth()
    assert truth.joint_angle.shape == (6 + 7,)
    contact = scene.pose(truth.joint_angle, True)
    np.testing.assert_allclose(contact.tip, measurement.position, atol=1e-12)
    np.testing.assert_allclose(contact.surface, truth.tissue, atol=1e-12)
    meshes = int(mujoco.mjtGeom.mjGEOM_MESH)
    kinds = {
        arm: {int(scene.model.geom(int(g)).type[0]) for g in geoms_of(scene, arm)}
        for arm in ("heart_link", "tool_link")
    }
    assert kinds["heart_link"] == {meshes}
    assert meshes not in kinds["tool_link"]


def geoms_of(scene: Scene, part: str) -> list[int]:
    """Geoms of the bodies with a name that begins so."""
    names = [scene.model.body(i).name for i in range(scene.model.nbody)]
    return [g for g, b in enumerate(scene.model.geom_bodyid) if names[b].startswith(part)]


@pytest.mark.parametrize("part", range(7))
def test_a_shell_covers_the_solid_that_is_weighed(part):
    """The figures of the two agree within 5 cm: a shell left behind would show at once."""
    name = "base" if part == 0 else f"link{part}"
    drawn = np.concatenate([p.mesh.vertices for p in arm_shells(VIPER_S650)[name]])
    low, high = np.array([extent(solid) for solid in link_solids(VIPER_S650)[part]]).swapaxes(0, 1)
    assert np.abs(drawn.min(axis=0) - low.min(axis=0)).max() < 0.05
    assert np.abs(drawn.max(axis=0) - high.max(axis=0)).max() < 0.05


def extent(solid: Solid) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest coordinates of a solid, ``(3,)`` each."""
    ends = np.array([solid.start, solid.end])
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = 1.0 if solid.shape == "capsule" else np.sqrt(1.0 - along**2)
    return ends.min(axis=0) - across * solid.radius, ends.max(axis=0) + across * solid.radius


@pytest.mark.parametrize(("parts", "effector"), [(instrument(TOOL.effector), TOOL.effector)])
def test_the_instrument_ends_where_it_touches(parts, effector):
    deepest = max(part.mesh.vertices[:, 2].max() for part in parts)
    assert deepest == pytest.approx(float(effector.reach.si), abs=1e-9)
    assert deepest == pytest.approx(max(s.end[2] + s.radius for s in effector_solids(effector)))


def test_the_cup_ends_below_the_surface_of_the_tissue():
    highest = max((-part.mesh.vertices[:, 0]).max() for part in pad_holder(HEART.effector))
    assert 0.5 * float(HEART.effector.rise.si) < highest < float(HEART.effector.rise.si)


def test_a_displacement_is_whole_at_the_tip_fades_and_is_nothing_at_the_rim():
    tissue = Tissue(0.02)
    push = np.array([0.001, -0.002, -0.004])
    moved = tissue.pressed(push).vertices - tissue.mesh.vertices
    np.testing.assert_allclose(moved[0], push, atol=1e-15)
    distance = np.linalg.norm(tissue.mesh.vertices[:, :2], axis=1)
    size = np.linalg.norm(moved, axis=1)
    order = np.argsort(distance)
    assert (np.diff(size[order]) < 1e-12).all()
    assert size[distance > 0.999 * RADIUS].max() < 1e-5
    twice = tissue.pressed(2.0 * push).vertices - tissue.mesh.vertices
    np.testing.assert_allclose(twice, 2.0 * moved, atol=1e-15)


def test_a_dent_is_lit_as_one():
    tissue = Tissue(0.02)
    flat, dent = tissue.mesh, tissue.pressed(np.array([0.0, 0.0, -0.005]))
    beside = int(np.argmin(np.abs(np.linalg.norm(flat.vertices[:, :2], axis=1) - 0.006)))
    outwards = flat.vertices[beside, :2] / np.linalg.norm(flat.vertices[beside, :2])
    assert dent.normals[beside, :2] @ outwards < -0.2 < flat.normals[beside, :2] @ outwards
    assert dent.normals[0, 2] > 0.9


def test_the_skin_is_always_the_same_and_mostly_red():
    picture = skin(128)
    assert np.array_equal(picture, skin(128))
    red, green, blue = picture.reshape(-1, 3).mean(axis=0)
    assert red > 2.0 * green
    assert red > 2.0 * blue
