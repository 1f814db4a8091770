"""From a scene to particles: order, numbers, placement, volumes, looks, colliders, determinism."""

import json
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.support.small_scenes import ROOM, scene
from vgmpi.gaussians.cloud import GaussianCloud, unpack_symmetric
from vgmpi.gaussians.formats import ply, registry
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb, rotate
from vgmpi.preprocess.meshes.surface_mesh import quaternion_to_normal
from vgmpi.preprocess.object_builder import apply_baked_shading
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.loader import load
from vgmpi.scene.scene_feature import features

GUITAR = Path(__file__).resolve().parents[3] / "shared" / "data" / "guitar.compressed.ply"
SPOT = GUITAR.parent / "spot.obj"

SCENE = """
[domain]
size = [0.64, 0.32, 0.32]
cell = "2 cm"
[time]
end = "1 s"
[material.water]
kind = "fluid"
[material.rubber]
kind = "elastic"
density = 400
youngs_modulus = "0.1 MPa"
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.64, 0.32, 0.1]] }
color = "#336699"
opacity_scale = 0.02
velocity = [1, 0, 0]
[[object]]
name = "post"
role = "scenery"
shape = { cylinder = { endpoints = [[0, 0, 0], [0, 0, 0.3]], radius = 0.02 } }
position = [0.5, 0.16, 0]
collider = true
[[object]]
name = "egg"
material = "rubber"
gaussians = "egg.ply"
height = "10 cm"
position = [0.2, 0.16, 0.15]
rotation = { axis = "z", angle = "90 deg" }
angular_velocity = [0, 0, 3]
[[object]]
name = "cube"
material = "rubber"
mesh = "cube.obj"
width = "6 cm"
position = [0.4, 0.16, 0.15]
color = "#ff0000"
"""


def egg(terms=4, count=8000):
    """A hollow ellipsoid, three units high, long along x, with a view-dependent color."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, k * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    unit = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    sh = np.zeros((count, terms, 3), dtype=np.float32)
    sh[:, 0] = dc_from_rgb(np.array([0.9, 0.6, 0.2]))
    sh[:, 1:] = 0.1 * np.arange(1, terms)[None, :, None]
    return GaussianCloud(
        unit * (1.2, 1.0, 1.5) + (7, 8, 9),
        quaternion_to_normal(unit),
        np.tile([0.04, 0.04, 0.004], (count, 1)),
        np.full(count, 0.9),
        sh,
    )


CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + (
    "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scene")
    ply.write(folder / "egg.ply", egg())
    (folder / "cube.obj").write_text(CUBE)
    (folder / "scene.toml").write_text(SCENE)
    return folder / "scene.toml"


@pytest.fixture(scope="module")
def made(path):
    return build_scene(load(path))


def rows(made, name):
    item = next(o for o in made.objects if o["name"] == name)
    return slice(item["first_row"], item["first_row"] + item["row_count"])


def test_a_rigid_capture_keeps_its_gaussians(path):
    """Pruning is for particles, which it has not: it is the same body with and without."""
    rigid = SCENE.replace("angular_velocity = [0, 0, 3]", "rigid = true")
    pruned = rigid.replace("rigid = true", 'rigid = true\nprune = "auto"\npassive_gaussians = true')
    plain, other = (build_scene(load(path, text=text)) for text in (rigid, pruned))
    for name in ("x", "object", "cov0", "opacity", "sh"):
        assert np.array_equal(getattr(plain.scenery, name), getattr(other.scenery, name)), name
    egg_rows = plain.scenery.object == [o["name"] for o in plain.objects].index("egg")
    assert egg_rows.sum() == 8000 and other.passive is None
    one, two = (next(c for c in made.colliders if c.name == "egg") for made in (plain, other))
    assert one.body.mass == two.body.mass > 0 and np.array_equal(plain.x, other.x)


def test_arrays_types_and_order(made):
    n = len(made.x)
    shapes = {"x": (n, 3), "v0": (n, 3), "vol0": (n,), "object": (n,), "cov0": (n, 6)}
    shapes |= {"opacity": (n,), "sh": (n, 4, 3)}
    kinds = {"x": "f8", "v0": "f8", "vol0": "f8", "object": "i4"}
    for name, shape in shapes.items():
        value = getattr(made, name)
        assert value.shape == shape and value.dtype == np.dtype(kinds.get(name, "f4")), name
        assert np.isfinite(value).all()
    assert np.all(np.diff(made.object) >= 0) and set(made.object) == {0, 2, 3}
    first = 0
    for number, item in enumerate(made.objects):
        assert item["row_count"] == np.count_nonzero(made.object == number)
        if item["role"] == "body":
            assert item["first_row"] == first
        first += item["row_count"]
    assert first == n


def test_descriptions_are_json(made):
    items = json.loads(json.dumps(made.objects))
    pool, post, egg_, cube = items
    assert (pool["family"], pool["phase"], pool["density"]) == ("fluid", "fluid", 1000.0)
    assert (egg_["family"], egg_["phase"], egg_["kind"]) == ("solid", "egg", "elastic")
    assert (post["material"], post["phase"], post["row_count"]) == (None, None, 0) and post[
        "collider"
    ]
    assert pool["opacity_scale"] == 0.02 and pool["alpha_min"] == 1e-4
    assert cube["color"] == [1.0, 0.0, 0.0]


def test_shapes_fill_their_volume_from_half_a_spacing_on(made):
    pool = rows(made, "pool")
    assert made.vol0[pool].sum() == pytest.approx(0.64 * 0.32 * 0.1, rel=1e-12)
    assert np.allclose(made.x[pool].min(axis=0), 0.005, atol=1e-15)
    assert np.allclose(made.x[pool].max(axis=0), [0.635, 0.315, 0.095], atol=1e-12)
    assert np.array_equal(made.v0[pool], np.tile([1.0, 0, 0], (len(made.x[pool]), 1)))


def test_a_capture_is_scaled_turned_placed_and_filled(made):
    item, at = made.objects[2], rows(made, "egg")
    x = made.x[at]
    assert np.allclose(np.ptp(x, axis=0), [0.2 / 3, 0.24 / 3, 0.1], rtol=2e-3)
    assert np.allclose((x[:, :2].min(axis=0) + x[:, :2].max(axis=0)) / 2, [0.2, 0.16], atol=1e-4)
    assert x[:, 2].min() == pytest.approx(0.15, abs=1e-12)
    source = egg()
    matrix = np.array(item["transform"])
    back = source.x.astype(np.float32) @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.allclose(x[: len(source)], back, atol=1e-6)  # the file's Gaussians come first
    assert len(x) > len(source)
    true = 4 / 3 * np.pi * 1.2 * 1.0 * 1.5 / 30**3
    assert made.vol0[at].sum() == pytest.approx(true, rel=0.1)  # seven voxels across


def test_covariances_and_colors_turn_along(made):
    source, at = egg(), rows(made, "egg")
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    cov = unpack_symmetric(made.cov0[at][: len(source)].astype(float))
    expected = turn @ unpack_symmetric(source.cov()) @ turn.T / 30**2
    assert np.allclose(cov, expected, atol=1e-3 * expected.max())
    assert np.allclose(made.sh[at][: len(source)], rotate(source.sh, turn), atol=1e-4)
    assert np.all(made.sh[rows(made, "pool")][:, 1:] == 0)  # padded


def test_spin_turns_about_the_centre_of_mass(made):
    at = rows(made, "egg")
    x, v, m = made.x[at], made.v0[at], made.vol0[at]
    middle = (x * m[:, None]).sum(axis=0) / m.sum()
    assert np.abs((v * m[:, None]).sum(axis=0)).max() < 1e-12 * (m[:, None] * np.abs(v)).sum()
    assert np.allclose(v, np.cross([0, 0, 3.0], x - middle), atol=1e-12)


def test_a_mesh_becomes_a_body(made):
    at = rows(made, "cube")
    x = made.x[at]
    assert np.allclose(x.min(axis=0), [0.37, 0.13, 0.15], atol=1e-3)
    assert np.allclose(x.max(axis=0), [0.43, 0.19, 0.21], atol=1e-3)
    assert made.vol0[at].sum() == pytest.approx(0.06**3, rel=0.02)


def test_light_is_painted_on_solids_only(made):
    plain = (made.sh[rows(made, "pool")][:, 0] == made.sh[0, 0]).all()
    red = made.sh[rows(made, "cube")][:, 0]
    assert plain and np.ptp(red[:, 0]) > 0.1
    (up, down), _ = apply_baked_shading(np.ones((2, 3)), np.array([[0, 0, 1.0], [0, 0, -1.0]]), 0.3)
    assert up[0] > 0.9 > 0.8 > down[0] >= 0.7


def test_scenery_has_no_particles_but_collides(made):
    assert set(made.scenery.object) == {1} and len(made.scenery.x) > 100
    [post] = made.colliders
    points = np.array([[0.5, 0.16, 0.1], [0.5, 0.2, 0.1], [0.56, 0.16, 0.1]])
    assert np.allclose(post.distance(points), [-0.02, 0.02, 0.04], atol=1e-12)
    assert np.allclose(post.normal(points[1:]), [[0, 1, 0], [1, 0, 0]], atol=1e-6)


def same(a, b):
    if is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    return np.array_equal(a, b) if isinstance(a, np.ndarray) else True


def test_twice_the_same_bits(path, made):
    assert same(made, build_scene(load(path)))


def test_the_seed_moves_only_what_is_random(path, made):
    other = build_scene(load(path, ["seed=2"]))
    assert np.array_equal(other.x[rows(other, "egg")], made.x[rows(made, "egg")])
    assert not np.array_equal(other.x[rows(other, "cube")][:9], made.x[rows(made, "cube")][:9])


def test_hollow_on_request(path, made):
    hollow = build_scene(load(path, ["object.egg.fill=false"]))
    assert len(hollow.x) < len(made.x)
    assert len(hollow.x[rows(hollow, "egg")]) == len(egg())


def test_scenery_from_a_mesh_and_a_cloud(path):
    text = SCENE.replace('material = "rubber"', 'role = "scenery"\ncollider = true')
    text = text.replace("angular_velocity = [0, 0, 3]", "")
    other = path.with_name("scenery.toml")
    other.write_text(text)
    made = build_scene(load(other))
    assert set(made.object) == {0} and set(made.scenery.object) == {1, 2, 3}
    assert len(made.colliders) == 3
    _, egg_, cube = made.colliders
    inside = np.array([[0.2, 0.16, 0.2]]), np.array([[0.4, 0.16, 0.18]])
    assert egg_.distance(inside[0])[0] < -0.02 and cube.distance(inside[1])[0] < -0.02
    above = np.array([[0.4, 0.16, 0.25]])
    assert cube.distance(above)[0] == pytest.approx(0.04, abs=0.01)
    assert cube.normal(above)[0, 2] > 0.99


def test_bodies_in_one_place_are_told(path, caplog):
    build_scene(load(path, ["object.cube.position=[0.2, 0.16, 0.16]"]))
    assert "'egg' and 'cube' overlap by" in caplog.text
    caplog.clear()
    build_scene(load(path))
    assert "overlap by" not in caplog.text


@pytest.mark.parametrize("transfer", ["apic", "apic-corrected", "aflip", "flip", "pic"])
def test_a_share_per_step_is_told_where_it_counts(tmp_path, transfer):
    lump = '[[object]]\nname = "lump"\nmaterial = "clay"\n'
    lump += "shape = { sphere = { center = [0.1, 0.1, 0.1], radius = 0.05 } }"
    shares = f'flip_ratio = 0.95\ntransfer = "{transfer}"\nprecision'
    found = scene(tmp_path, ROOM.replace("precision", shares) + lump)
    notes = [line for feature in features() for line in feature.note_lines(found)]
    told = [line for line in notes if "accuracy.flip_ratio = 0.95 is retained" in line]
    assert len(told) == (transfer in ("aflip", "flip"))


def test_all_objects_are_tried_before_giving_up(path):
    wrong = ["object.cube.position=[0.4, 0.16, 0.3]", "object.egg.position=[0, 0.16, 0.15]"]
    with pytest.raises(SceneError) as caught:
        build_scene(load(path, wrong))
    assert [line.split(": ")[1] for line in caught.value.lines] == [
        "object.egg.position",
        "object.cube.position",
    ]
    assert "x = -0.0333" in caught.value.lines[0]


def test_a_selection_of_nothing(path):
    text = SCENE.replace('height = "10 cm"', 'height = "10 cm"\nselect = { min_opacity = 0.99 }')
    other = path.with_name("nothing.toml")
    other.write_text(text)
    with pytest.raises(SceneError, match="egg.select: selects no Gaussian of the file"):
        build_scene(load(other))


@pytest.mark.parametrize("suffix", [".splat", ".spz"])
def test_other_kinds_of_gaussian_files(path, made, suffix):
    """The same body, to the rounding of the format (sizes in a .spz: 3 %)."""
    registry.write(path.with_name(f"egg{suffix}"), egg())
    other = build_scene(load(path, [f"object.egg.gaussians=egg{suffix}"]))
    a, b = rows(made, "egg"), rows(other, "egg")
    assert b.stop - b.start == pytest.approx(a.stop - a.start, rel=0.01)
    assert other.vol0[b].sum() == pytest.approx(made.vol0[a].sum(), rel=0.01)
    np.testing.assert_allclose(other.x[b].mean(axis=0), made.x[a].mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(other.cov0[b][:8000], made.cov0[a][:8000], rtol=0.07, atol=1e-7)


@pytest.mark.data
@pytest.mark.skipif(not GUITAR.exists() or not SPOT.exists(), reason="no shared data")
def test_real_files(path):
    """A real capture and a textured mesh: sizes, sensible volumes, seconds not minutes."""
    sets = [f"object.egg.gaussians={GUITAR}", "object.egg.up=-y", "object.egg.height=15 cm"]
    sets += [f"object.cube.mesh={SPOT}", "object.cube.up=y", "object.cube.width=6 cm"]
    made = build_scene(load(path, [*sets, "object.egg.particles_per_cell=64"]))
    guitar, spot = rows(made, "egg"), rows(made, "cube")
    assert made.objects[2]["row_count"] >= 90_854
    assert np.ptp(made.x[guitar][:, 2]) == pytest.approx(0.15, rel=1e-3)
    box = np.prod(np.ptp(made.x[guitar], axis=0))
    assert 0.02 * box < made.vol0[guitar].sum() < 0.6 * box
    assert made.vol0[spot].sum() == pytest.approx(1.1895e-3 * (0.06 / 0.1109) ** 3, rel=0.04)


def test_overlaps_are_those_of_every_pair(tmp_path, caplog):
    """Each pair in the order of the scene, with the volume that both fill."""
    random = np.random.default_rng(4)
    low = np.round(random.uniform(0, 0.2, (25, 3)), 2)
    high = low + np.round(random.uniform(0.03, 0.12, (25, 3)), 2)
    boxes = "".join(
        f'[[object]]\nname = "b{k}"\nmaterial = "clay"\nshape = {{ box = [{a}, {b}] }}\n'
        for k, (a, b) in enumerate(zip(low.tolist(), high.tolist()))
    )
    build_scene(scene(tmp_path, ROOM + boxes))
    expected = []
    edge = high - low
    for a in range(25):
        for b in range(a + 1, 25):
            both = np.clip(np.minimum(high[a], high[b]) - np.maximum(low[a], low[b]), 0, None)
            if both.prod() > 0.021 * min(edge[a].prod(), edge[b].prod()):
                expected.append(f"'b{a}' and 'b{b}' overlap by {1e3 * both.prod():.3g} l")
    assert len(expected) > 30
    said = [r.getMessage().split(":")[0] for r in caplog.records if "overlap" in r.getMessage()]
    assert said == expected
