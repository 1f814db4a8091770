"""The factor of the light painted on colors: of every particle in the file, and out again."""

import h5py
import numpy as np
import pytest

from tests.preprocess.test_prune import duck_obj
from tests.preprocess.test_scene_builder import CUBE, rows
from tests.support.small_scenes import ROOM, scene
from vgmpi.gaussians.baked_shading import MIN_SHADE, apply_baked_shading
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb, rgb_from_dc
from vgmpi.io import file_layout, initial_state
from vgmpi.io.run_reader import RunError, inspect, particle_set_id, read_gaussians
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.preprocess.sampling import interior_fill
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.solver.initial_particles import prepare, write_initial_particles

RED, BLUE, GREEN = (0.9, 0.1, 0.2), (0.1, 0.3, 0.8), (0.2, 0.7, 0.3)
WATER = """
[material.water]
kind = "fluid"
[[object]]
name = "drop"
material = "water"
shape = { sphere = { center = [0.3, 0.3, 0.1], radius = 0.04 } }
[[inlet]]
name = "tap"
material = "water"
disc = { center = [0.3, 0.3, 0.3], radius = 0.03 }
direction = [0, 0, -1]
speed = 1
"""
TOY = f"""
[[object]]
name = "toy"
material = "clay"
shape = {{ union = [
    {{ box = [[0.05, 0.05, 0.05], [0.1, 0.15, 0.15]], color = {list(RED)} }},
    {{ box = [[0.1, 0.05, 0.05], [0.15, 0.15, 0.15]], color = {list(BLUE)} }},
] }}
"""
MESH = f"""
[[object]]
name = "cube"
material = "clay"
mesh = "cube.obj"
width = 0.1
position = [0.28, 0.12, 0.05]
color = {list(GREEN)}
"""
DECOR = f"""
[[object]]
name = "post"
role = "scenery"
shape = {{ cylinder = {{ endpoints = [[0, 0, 0], [0, 0, 0.3]], radius = 0.02 }} }}
position = [0.1, 0.3, 0]
color = {list(BLUE)}
[[object]]
name = "stone"
role = "scenery"
mesh = "cube.obj"
width = 0.1
position = [0.2, 0.3, 0.05]
color = {list(RED)}
"""
OFF = "[appearance]\nbaked_shading = 0\n"
FAINT = "[appearance]\nbaked_shading = 1e-9\n"  # less than a number of the file tells from none
RIDING = 'prune = "auto"\npassive_gaussians = true\n'


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "cube.obj").write_text(CUBE)
    (tmp_path / "duck.obj").write_text(duck_obj(24))
    return tmp_path


def plain(part, at=slice(None)):
    """Colors without the light."""
    return rgb_from_dc(part.sh[at, 0].astype(float)) / part.shade[at, None]


def kept(folder, text):
    """gaussians.h5 of a scene."""
    loaded = scene(folder, ROOM + text)
    write_initial_particles(
        loaded, prepare(loaded, SerialCommunicator(), folder), SerialCommunicator(), folder
    )
    return read_gaussians(folder / file_layout.GAUSSIANS)


def test_colors_without_the_light_are_those_of_the_scene(folder):
    """Of a shape with two colors, of what lies on a mesh and inside it; what flows has none."""
    made = build_scene(scene(folder, ROOM + WATER + TOY + MESH))
    assert made.shade.dtype == np.float32 and made.shade.shape == (len(made.x),)
    toy, cube = rows(made, "toy"), rows(made, "cube")
    want = np.where(made.x[toy, :1] < 0.1, RED, BLUE)
    np.testing.assert_allclose(plain(made, toy), want, atol=1e-6)
    np.testing.assert_allclose(plain(made, cube), np.tile(GREEN, (len(made.x[cube]), 1)), atol=1e-6)
    for at in (toy, cube):
        assert 0.7 <= made.shade[at].min() < 0.8 and 0.95 < made.shade[at].max() <= 1
    for name in ("drop", "tap"):
        assert (made.shade[rows(made, name)] == 1).all()


def test_the_colors_of_points_come_back(folder):
    """Of a mesh with many colors, as it is where no light is painted."""
    text = ROOM + MESH.replace("cube.obj", "duck.obj")
    lit, unlit = build_scene(scene(folder, text)), build_scene(scene(folder, text + OFF))
    assert np.array_equal(lit.x, unlit.x) and np.ptp(unlit.sh[:, 0, 1]) > 0.5
    np.testing.assert_allclose(plain(lit), rgb_from_dc(unlit.sh[:, 0].astype(float)), atol=1e-6)


@pytest.mark.parametrize(
    "text",
    [OFF + TOY + MESH + DECOR, FAINT + TOY + MESH + DECOR, WATER],
    ids=["off", "faint", "fluids"],
)
def test_what_has_no_light_has_no_dataset(folder, text):
    found = kept(folder, text)
    assert found.shade is None
    if found.scenery is not None:
        assert found.scenery.shade is None
    with h5py.File(folder / file_layout.GAUSSIANS) as f:
        names: list[str] = []
        f.visit(names.append)
    assert "x0" in names and not [name for name in names if "shade" in name]


def test_a_mesh_that_flows_has_no_light(folder):
    made = build_scene(scene(folder, ROOM + MESH.replace("clay", "water") + WATER))
    assert made.shade is None


def test_scenery_and_riders_carry_it(folder):
    """In the file, where only they have it too: bodies of water, or those beside them."""
    found = kept(folder, WATER + DECOR)
    assert found.shade is None
    want = np.where(found.scenery.object[:, None] == 1, BLUE, RED)
    np.testing.assert_allclose(plain(found.scenery), want, atol=1e-6)
    assert np.ptp(found.scenery.shade) > 0.2
    found = kept(folder, MESH + RIDING + TOY + WATER)
    assert len(found.passive.x0) > 1000 and np.ptp(found.passive.shade) > 0.2
    np.testing.assert_allclose(plain(found.passive), found.passive.x0 * 0 + GREEN, atol=1e-6)
    mine = found.object == 0
    np.testing.assert_allclose(plain(found, mine), found.x0[mine] * 0 + GREEN, atol=1e-6)
    assert "passive/shade" in inspect(folder / file_layout.GAUSSIANS)


@pytest.mark.parametrize("how", ["auto", "versagauss"])
def test_a_pruned_body_keeps_the_right_rows(folder, how):
    """Each of one color, which comes back: what is left stands for others, of other lights."""
    keys = 'prune = "auto"\n' if how == "auto" else 'prune = "versagauss"\nprune_scale = 0.4\n'
    whole = build_scene(scene(folder, ROOM + MESH))
    made = build_scene(scene(folder, ROOM + MESH + keys + TOY))
    cube = rows(made, "cube")
    assert cube.stop - cube.start < 0.7 * len(whole.x)
    assert np.ptp(made.shade[cube]) > 0.1
    np.testing.assert_allclose(plain(made, cube), made.x[cube] * 0 + GREEN, atol=1e-6)
    toy = rows(made, "toy")
    want = np.where(made.x[toy, :1] < 0.1, RED, BLUE)
    np.testing.assert_allclose(plain(made, toy), want, atol=1e-6)


def test_it_follows_what_is_left_out_at_the_start(folder):
    share = (
        'volume_fraction_profile = { axis = "y", positions = [0.08, 0.0801], values = [0, 1] }\n'
    )
    whole, made = (build_scene(scene(folder, ROOM + TOY + keys)) for keys in ("", share))
    left = whole.x[:, 1] > 0.08
    assert 0 < len(made.x) == left.sum() < len(whole.x)
    assert np.array_equal(made.shade, whole.shade[left])


def test_clouds_carry_it():
    random = np.random.default_rng(3)
    n = 40
    rgb, light = random.random((n, 3)), random.uniform(0.7, 1, n)
    own = np.tile([1.0, 0, 0, 0], (n, 1)), np.full((n, 3), 0.01), np.ones(n)
    cloud = GaussianCloud(
        random.random((n, 3)), *own, dc_from_rgb(rgb * light[:, None])[:, None], light
    )
    at = random.permutation(n)[:7]
    turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    for some in (cloud.select(at), cloud.transformed(turned).select(at)):
        np.testing.assert_allclose(plain(some), rgb[at], atol=1e-6)
    filled = interior_fill.filling(cloud.x[at] + 1e-6, cloud, 0.1, 1.0)
    np.testing.assert_allclose(plain(filled), rgb[at], atol=1e-6)
    bare = GaussianCloud(cloud.x, *own, cloud.sh)
    both = interior_fill.joined(bare, cloud)
    assert (both.shade[:n] == 1).all() and np.array_equal(both.shade[n:], cloud.shade)
    assert interior_fill.joined(bare, bare).shade is None and bare.select(at).shade is None
    with pytest.raises(ValueError, match=r"Cloud.shade has shape \(39,\), expected \(40,\)"):
        GaussianCloud(cloud.x, *own, cloud.sh, light[1:])


def test_what_gets_no_light_can_be_divided():
    """The light of what faces away is nothing where all of it is painted."""
    away = -np.array([[0.36, -0.48, 0.80]])
    rgb, factor = apply_baked_shading(np.ones((1, 3)), away, 1.0)
    assert np.abs(rgb).max() < 1e-12 and factor == np.float32(MIN_SHADE)
    rgb, factor = apply_baked_shading(np.ones((1, 3)), away, 0.0)
    assert (rgb == 1).all() and factor is None


def test_damaged_light_is_made_anew(folder):
    """Particles are used again where the file is whole; whose they are does not hang on the
    light."""
    loaded = scene(folder, ROOM + TOY)
    whole = kept(folder, TOY)
    path = folder / file_layout.GAUSSIANS
    assert prepare(loaded, SerialCommunicator(), folder).rows is None
    with h5py.File(path, "r+") as f:
        f["shade"][7] = 0.5
    with pytest.raises(RunError, match="shade is not what was written"):
        read_gaussians(path)
    known = prepare(loaded, SerialCommunicator(), folder)
    assert np.array_equal(known.rows["shade"], whole.shade)
    write_initial_particles(loaded, known, SerialCommunicator(), folder)
    assert np.array_equal(read_gaussians(path).shade, whole.shade)
    before = particle_set_id(path)
    arrays = {d.name: getattr(whole, d.name) for d in file_layout.GAUSSIAN if d.name != "shade"}
    arrays = {name: array for name, array in arrays.items() if array is not None}
    initial_state.write(
        path, SerialCommunicator(), arrays, whole.objects, None, whole.scene, whole.digest
    )
    assert particle_set_id(path) == before and read_gaussians(path).shade is None


@pytest.mark.parametrize("group", ["scenery", "passive"])
@pytest.mark.parametrize("value", [0.0, -0.5, 1.5, np.nan])
def test_light_of_groups_that_cannot_be_is_refused(folder, group, value):
    whole = kept(folder, MESH + RIDING + DECOR)
    parts = {name: dict(vars(getattr(whole, name))) for name in ("scenery", "passive")}
    parts[group]["shade"] = np.where(np.arange(len(parts[group]["shade"])) == 5, value, 1.0)
    arrays = {d.name: getattr(whole, d.name) for d in file_layout.GAUSSIAN}
    arrays = {name: array for name, array in arrays.items() if array is not None}
    path = folder / file_layout.GAUSSIANS
    initial_state.write(path, SerialCommunicator(), arrays, whole.objects, parts["scenery"],
    whole.scene, "",
               parts["passive"])  # fmt: skip
    said = "what is no number" if np.isnan(value) else "what is not above 0 and at most 1"
    with pytest.raises(RunError, match=f"{group}/shade holds {said}"):
        read_gaussians(path)
