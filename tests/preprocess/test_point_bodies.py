"""Bodies whose particles a program gives as arrays."""

import copy

import numpy as np
import pytest

import vgmpi
from vgmpi.preprocess.scene_builder import build_scene

EDGE = 0.01  # [m] of the lattice, half a cell
LATTICE = EDGE * (
    np.stack(np.meshgrid(*3 * [np.arange(8)], indexing="ij"), -1).reshape(-1, 3) + 0.5
)
SCENE = {
    "accuracy": {"precision": "double"},
    "domain": {"size": [0.32, 0.32, 0.32], "cell": "2 cm", "gravity": [0, 0, 0]},
    "time": {"end": "5 ms", "frames": 2},
    "material": {"rubber": {"kind": "elastic", "youngs_modulus": "0.1 MPa", "density": 1000}},
    "object": [
        {
            "name": "block",
            "material": "rubber",
            "origin": [0.1, 0.12, 0.14],
            "points": {"positions": LATTICE},
        }
    ],
}


def scene(points=(), **keys):
    """Return the scene with other keys of its points and of its object."""
    table = copy.deepcopy(SCENE)
    table["object"][0]["points"] |= dict(points)
    table["object"][0] |= keys
    return table


def build(*args, **keys):
    return build_scene(vgmpi.load(scene(*args, **keys)))


def test_points_in_a_lattice_are_the_box_of_that_lattice(tmp_path):
    """The same particles as those of a shape, so the same run, also with another body at it."""
    ball = {
        "name": "ball",
        "material": "rubber",
        "velocity": [0, 0, 2],
        "shape": {"sphere": {"center": [0.14, 0.16, 0.1], "radius": 0.03}},
    }
    table, shape = scene(), scene()
    del shape["object"][0]["points"]
    shape["object"][0]["shape"] = {"box": [[0, 0, 0], [0.08, 0.08, 0.08]]}
    for one in (table, shape):
        one["object"].append(ball)
    given, same = (build_scene(vgmpi.load(one)) for one in (table, shape))
    for found, want in ((given.x, same.x), (given.vol0, same.vol0), (given.cov0, same.cov0)):
        order = (np.lexsort(given.x[:512].round(9).T), np.lexsort(same.x[:512].round(9).T))
        np.testing.assert_allclose(found[order[0]], want[order[1]], 1e-12, 1e-15)
    run = vgmpi.run(vgmpi.load(table), tmp_path / "out")
    assert run.code == 0
    moved = run.array("velocity")[run.ids("block"), 2]
    assert moved.max() > 0.05  # the ball has hit it
    objects = vgmpi.read(tmp_path / "out").objects
    assert objects[0]["row_count"] == 512 and objects[0]["name"] == "block"


def test_volumes():
    """Given, of a spacing, or a share of the lattice's cell; all of them scale with the body."""
    random = np.random.default_rng(0)
    volumes = random.uniform(0.5, 1, 512) * EDGE**3
    built = build({"volumes": volumes})
    assert (built.vol0 == volumes).all()
    assert build({"spacing": "8 mm"}).vol0 == pytest.approx(0.008**3, rel=1e-12)
    assert build().vol0 == pytest.approx(EDGE**3, rel=1e-12)
    half = build({"volumes": volumes}, scale=0.5)
    assert half.vol0 == pytest.approx(volumes / 8, rel=1e-12)
    assert half.x.max(0) == pytest.approx([0.1375, 0.1575, 0.1775])
    twice = np.concatenate([LATTICE, LATTICE + 0.002])  # two particles in a cell of the lattice
    assert build({"positions": twice}).vol0 == pytest.approx(EDGE**3 / 2, rel=1e-12)


def test_colors_and_the_size_of_the_gaussians():
    colors = np.random.default_rng(0).uniform(size=(512, 3))
    built = build({"colors": colors, "spacing": 0.01})
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * built.sh[:, 0], colors, 1e-5, 1e-6)
    radius = np.sqrt(built.cov0[:, 0])
    assert 4 / 3 * np.pi * radius**3 == pytest.approx(built.vol0, rel=1e-5)
    plain = build(color="#ff0000")
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * plain.sh[0, 0], [1, 0, 0], 0, 1e-6)


def test_velocities_turn_with_the_body_and_go_where_their_particle_goes():
    """They are added to the body's own; parts that are cut out and regions keep them in order."""
    v = np.random.default_rng(0).normal(size=(512, 3))
    turned = {"rotation": {"axis": "z", "angle": "90 deg"}, "origin": [0.2, 0.12, 0.14]}
    built = build({"velocities": v}, velocity=[0, 0, 2], scale=0.5, **turned)
    want = np.stack([-v[:, 1], v[:, 0], v[:, 2] + 2], axis=1)
    np.testing.assert_allclose(built.v0, want, 1e-12, 1e-12)
    table = scene({"velocities": 10 * LATTICE})
    table["material"]["gum"] = {"kind": "elastic", "youngs_modulus": 1e5, "density": 2000}
    table["object"][0]["region"] = [{"material": "gum", "box": [[0, 0, 0], [0.14, 0.16, 1]]}]
    made = build_scene(vgmpi.load(table))
    assert made.objects[0]["regions"][0]["row_count"] == 128 and (made.x[0] != made.x[1]).any()
    np.testing.assert_allclose(made.v0, 10 * (made.x - [0.1, 0.12, 0.14]), 1e-9, 1e-12)
    table = scene({"velocities": 10 * LATTICE}, material="water", subtract=["ball"])
    table["material"]["water"] = {"kind": "fluid", "tait_coefficient": 2e4}
    ball = {"sphere": {"center": [0.14, 0.16, 0.18], "radius": 0.025}}
    table["object"].append({"name": "ball", "material": "rubber", "shape": ball})
    made = build_scene(vgmpi.load(table))
    own = made.object == 0
    assert 400 < own.sum() < 500
    np.testing.assert_allclose(made.v0[own], 10 * (made.x[own] - [0.1, 0.12, 0.14]), 1e-9, 1e-12)


def test_points_with_velocities_move_by_them(tmp_path):
    """Two halves that part: momentum is that of the given velocities."""
    v = np.where(LATTICE[:, :1] < 4 * EDGE, [-0.5, 0, 0.1], [0.7, 0, 0.1])
    table = scene({"velocities": v})
    table["time"]["end"] = "0.2 ms"  # waves go 2 mm
    run = vgmpi.run(vgmpi.load(table), tmp_path / "out")
    assert run.code == 0
    found = run.array("velocity")
    np.testing.assert_allclose(found.mean(0), v.mean(0), 0, 1e-9)
    assert (
        found[LATTICE[:, 0] < EDGE, 0].mean() < -0.4 < 0.6 < found[LATTICE[:, 0] > 0.07, 0].mean()
    )


@pytest.mark.parametrize(
    "points, keys, line",
    [
        ({"positions": LATTICE[:, :2]}, {}, "object.block.points.positions: must be a row of 3"
         " numbers per point; its shape is (512, 2)"),
        ({"positions": []}, {}, "object.block.points.positions: must be a row of 3 numbers per"),
        ({"positions": [[0, 0, "a"]]}, {}, "object.block.points.positions: must be a row of 3"),
        ({"positions": [[0, 0, np.nan]]}, {}, "object.block.points.positions: must be finite; point"
         " 0 has [0.0, 0.0, nan]"),
        ({"volumes": np.full(3, 1e-6)}, {}, "object.block.points.volumes: has 3 rows, positions has"
         " 512"),
        ({"volumes": np.full(512, -1e-6)}, {}, "object.block.points.volumes: must be > 0 m3;"),
        ({"volumes": np.full(512, 1e-6), "spacing": 1}, {}, "object.block.points.spacing: volumes"
         " and spacing given at once: give one"),
        ({"colors": np.full((512, 3), 2.0)}, {}, "object.block.points.colors: must be from 0 to"),
        ({"velocities": np.zeros((2, 3))}, {}, "object.block.points.velocities: has 2 rows,"),
        ({"velocities": np.zeros(512)}, {}, "object.block.points.velocities: must be a row of 3"),
        ({"velocities": LATTICE}, {"motion": {"velocity": [1, 0, 0]}}, "object.block.points: has"
         " velocities, which are not for a body with motion or release_time"),
        ({"file": "a.ply"}, {}, "object.block.points.positions: file and positions given at once"),
        ({"radius": 1}, {}, "object.block.points.radius: unknown key"),
        ({"spacing": 0.03}, {}, "object.block.points: a particle as large as a cube of 0.03 m is"
         " larger than a cell of 0.02 m"),
        ({}, {"rigid": True}, "object.block.rigid: is not for objects made of points"),
        ({}, {"mesh": "a.obj"}, "object.block.points: mesh and points given at once"),
        ({}, {"origin": [0.3, 0, 0]}, "object.block"),
    ],
)  # fmt: skip
def test_what_is_wrong_with_points_is_one_line(points, keys, line):
    with pytest.raises(vgmpi.SceneError) as caught:
        build(points, **keys)
    messages = str(caught.value).splitlines()
    assert any(message.startswith(line) for message in messages), messages
    assert all(len(message) < 400 for message in messages)


def test_scenery_of_points_is_refused():
    table = scene(role="scenery")
    del table["object"][0]["material"]
    with pytest.raises(vgmpi.SceneError, match="object.block.points: is only for bodies"):
        vgmpi.load(table)


def test_files_hold_a_summary_of_the_arrays():
    """A resumed run is compared with it."""
    one = vgmpi.load(scene()).to_json()["object"][0]["points"]
    assert one["positions"]["shape"] == [512, 3] and set(one) == {"positions"}
    other = vgmpi.load(scene({"positions": LATTICE + 1e-9})).to_json()["object"][0]["points"]
    assert one["positions"]["crc"] != other["positions"]["crc"]
