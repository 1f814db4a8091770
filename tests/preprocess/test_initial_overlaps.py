"""What flows and begins inside a collider, a rigid body or a solid is told, with a remedy that cuts
these out: no particle is left inside, whatever they are made of.

Volumes are those of the shapes, to the sampling of the particles (2 cells and more across).
"""

import logging

import numpy as np
import pytest

from tests.support.small_scenes import scene
from vgmpi.commands import cli
from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import ply
from vgmpi.preprocess.meshes.surface_mesh import quaternion_to_normal
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.runtime.config.schema import SceneError
from vgmpi.scene.resume_rules import changes_without_effect

HEAD = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.02
[time]
end = 1
[material.water]
kind = "fluid"
[material.brine]
kind = "fluid"
[material.grains]
kind = "sand"
[material.oak]
kind = "elastic"
youngs_modulus = 1e6
"""
POOL = """[[object]]
name = "pool"
material = "water"
SUBTRACT
shape = { box = [[0, 0, 0], [0.4, 0.4, 0.3]] }
"""
POST = """[[object]]
name = "post"
role = "scenery"
collider = true
shape = { box = [[0.12, 0.12, -0.1], [0.28, 0.28, 0.38]] }
"""
CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + (
    "f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
)
AT = "position = [0.2, 0.2, 0.08]\nheight = 0.16\n"
COLLIDER = 'role = "scenery"\ncollider = true\n'
CUBIC, ROUND = 0.16**3, 4 / 3 * np.pi * 0.08**3  # [m3]
BALL = "shape = { sphere = { center = [0.2, 0.2, 0.16], radius = 0.08 } }\n"
# what begins in the pool: keys, volume [m3], tolerance
KINDS = {
    "shape": (COLLIDER + BALL, ROUND, 0.02),
    "mesh": (COLLIDER + 'mesh = "cube.obj"\n' + AT, CUBIC, 0.02),
    "capture": (COLLIDER + 'gaussians = "ball.ply"\n' + AT, ROUND, 0.25),  # and half a voxel
    "moving collider": (COLLIDER + BALL + "motion = { velocity = [0.1, 0, 0] }\n", ROUND, 0.02),
    "turned collider": (
        COLLIDER + "shape = { box = [[-0.08, -0.08, -0.08], [0.08, 0.08, 0.08]] }\n"
        'origin = [0.2, 0.2, 0.16]\nrotation = { axis = [1, 2, 3], angle = "40 deg" }\n',
        CUBIC,
        0.04,
    ),
    "thin wall": (
        COLLIDER + "thin = true\nshape = { box = [[0.19, -0.1, -0.1], [0.21, 0.5, 0.5]] }\n",
        0.02 * 0.4 * 0.3,
        1e-9,
    ),
    "rigid body": ('material = "oak"\nrigid = true\n' + BALL, ROUND, 0.02),
    "rigid mesh": ('material = "oak"\nrigid = true\nmesh = "cube.obj"\n' + AT, CUBIC, 0.02),
    "solid": ('material = "oak"\n' + BALL, ROUND, 0.02),
    "solid mesh": ('material = "oak"\nmesh = "cube.obj"\n' + AT, CUBIC, 0.1),
}


def ball(count=4000):
    """A hollow ball of Gaussians."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, k * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    unit = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    flat = np.tile([0.04, 0.04, 0.004], (count, 1))
    return GaussianCloud(
        unit, quaternion_to_normal(unit), flat, np.full(count, 0.9), np.zeros((count, 1, 3), "f4")
    )


def made(folder, text):
    (folder / "cube.obj").write_text(CUBE)
    ply.write(folder / "ball.ply", ball())
    return build_scene(scene(folder, HEAD + text))


def pool(text='subtract = ["post"]'):
    return POOL.replace("SUBTRACT", text)


@pytest.mark.parametrize("kind", KINDS)
def test_nothing_is_left_inside(tmp_path, caplog, kind):
    keys, volume, tolerance = KINDS[kind]
    other = f'[[object]]\nname = "thing"\n{keys}'
    with caplog.at_level(logging.INFO, "vgmpi"):
        whole = made(tmp_path, pool("") + other)
        told = caplog.text
        caplog.clear()
        cut = made(tmp_path, pool('subtract = ["thing"]') + other)
    is_pool = whole.object == 0
    removed = whole.vol0[is_pool].sum() - cut.vol0[cut.object == 0].sum()
    assert removed == pytest.approx(volume, rel=tolerance)
    assert "add to object 'pool': subtract = [\"thing\"]" in told
    assert ("overlap by" if kind.startswith("solid") else "'pool' begins with") in told
    assert f"'pool': {1e3 * removed:.3g} l (" in caplog.text and "is cut out" in caplog.text
    assert not cut.warnings and "begins with" not in caplog.text
    for collider in cut.colliders:
        assert collider.distance(cut.x[cut.object == 0]).min() >= 0.0
        assert (collider.distance(whole.x[is_pool]) < 0.0).any()


@pytest.mark.parametrize(
    "body",
    [
        'material = "grains"\nmesh = "cube.obj"\nposition = [0.2, 0.2, 0]\nheight = 0.36\n',
        'material = "water"\ngaussians = "ball.ply"\nposition = [0.2, 0.2, 0]\nheight = 0.36\n',
        'material = "water"\ninitial_pressure = "hydrostatic"\n'
        "shape = { box = [[0, 0, 0], [0.4, 0.4, 0.3]] }\n",
        'material = "water"\nregion = { box = [[0, 0, 0],'
        ' [0.4, 0.2, 0.4]], material = "brine" }\n'
        "shape = { box = [[0, 0, 0], [0.4, 0.4, 0.3]] }\n",
    ],
    ids=["mesh", "capture", "hydrostatic", "regions"],
)
def test_every_body_that_flows_can_be_cut(tmp_path, body):
    head = '[[object]]\nname = "pool"\n'
    whole = made(tmp_path, head + body + POST)
    cut = made(tmp_path, head + "subtract = true\n" + body + POST)
    (post,) = cut.colliders
    outside = post.distance(whole.x) >= 0.0
    assert 0 < outside.sum() < len(outside)
    np.testing.assert_array_equal(cut.x, whole.x[outside])
    np.testing.assert_array_equal(cut.vol0, whole.vol0[outside])
    np.testing.assert_array_equal(cut.theta0, whole.theta0[outside])
    regions = [sum(r["row_count"] for r in m.objects[0].get("regions", ())) for m in (whole, cut)]
    assert regions == [0, 0] or 0 < regions[1] < regions[0]


def test_the_check_says_it_with_volume_names_and_remedy(tmp_path, capfd):
    """The post holds 16 x 16 x 30 of 40 x 40 x 30 lattice points, of 1 cm3 each."""
    path = tmp_path / "scene.toml"
    path.write_text(HEAD + pool("") + POST)
    assert cli.main([str(path), "--check"]) == 0
    out, err = capfd.readouterr()
    line = (
        "'pool' begins with 7.68 l (7,680 of 48,000 particles) inside 'post', where it stays;"
        " add to object 'pool': subtract = [\"post\"]"
    )
    assert line in err and ": 0 errors, 1 warning" in out
    path.write_text(HEAD + pool(line.rsplit(": ", 1)[1]) + POST)  # the remedy, as it is said
    assert cli.main([str(path), "--check"]) == 0
    out, err = capfd.readouterr()
    assert "begins with" not in err and ": 0 errors, 0 warnings" in out
    assert "'pool': 7.68 l (7,680 of 48,000 particles) inside 'post' is cut out" in err


def test_a_remedy_keeps_what_is_cut_out_already(tmp_path, caplog):
    ball_ = (
        f'[[object]]\nname = "ball"\n{COLLIDER}{BALL.replace("0.2, 0.2, 0.16", "0.1, 0.3, 0.2")}'
    )
    made(tmp_path, pool() + POST + ball_)
    assert 'subtract = ["post", "ball"]' in caplog.text


def test_faces_that_meet_are_no_overlap(tmp_path, caplog):
    floor = "shape = { box = [[-0.1, -0.1, -0.1], [0.5, 0.5, 0]] }\n"
    made(tmp_path, pool("") + f'[[object]]\nname = "floor"\n{COLLIDER}{floor}')
    assert "begins" not in caplog.text and "overlap" not in caplog.text


def test_a_solid_in_a_collider_is_told_unless_it_is_held_there(tmp_path, caplog):
    arm = '[[object]]\nname = "arm"\nmaterial = "oak"\n'
    arm += "shape = { box = [[0.1, 0.1, 0.1], [0.2, 0.2, 0.2]] }\n"
    made(tmp_path, arm + POST)
    assert "'arm' begins with 0.64 l (640 of 1,000 particles) inside 'post'" in caplog.text
    assert "subtract" not in caplog.text
    caplog.clear()
    made(tmp_path, arm + 'pinned = { box = [[0.12, 0, 0], [1, 1, 1]], to = "post" }\n' + POST)
    assert "begins" not in caplog.text


@pytest.mark.parametrize(
    "text, message",
    [
        ("subtract = 3", "must be true, or a list of names of objects"),
        ("subtract = [1]", "must be true, or a list of names of objects"),
        ("subtract = []", "must name an object; leave the key out where nothing is cut out"),
        ('subtract = ["pots"]', "there is no object 'pots' (did you mean 'post'?); known: pool,"),
        ('subtract = ["pool"]', "'pool' cannot be cut out of itself"),
        ('subtract = ["rock"]', "'rock' is scenery without collider = true"),
        ('subtract = ["lake"]', "'lake' is no collider, rigid body or solid"),
    ],
)
def test_wrong_values(tmp_path, capfd, text, message):
    rock = POST.replace('"post"', '"rock"').replace("collider = true\n", "")
    lake = pool("").replace('"pool"', '"lake"')
    path = tmp_path / "scene.toml"
    path.write_text(HEAD + pool(text) + POST + rock + lake)
    assert cli.main([str(path), "--check"]) == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith(f"{path}:19: object.pool.subtract") and message in line


def test_what_cannot_be_cut(tmp_path):
    def refused(text):
        with pytest.raises(SceneError) as caught:
            made(tmp_path, text)
        (line,) = caught.value.lines
        return line

    solid = pool("subtract = true").replace('"water"', '"oak"')
    assert "is for bodies of liquids, pastes, sand and snow; cut a solid" in refused(solid + POST)
    rigid = pool("rigid = true\nsubtract = true").replace('"water"', '"oak"')
    lake = pool("").replace('"pool"', '"lake"')
    assert "subtract: is not for rigid bodies" in refused(rigid + lake + POST)
    assert "subtract: is not for scenery" in refused(pool("") + POST + "subtract = true\n")
    assert "there is nothing to cut out" in refused(pool("subtract = true"))
    around = POST.replace("[[0.12, 0.12, -0.1], [0.28, 0.28, 0.38]]", "[[-1, -1, -1], [1, 1, 1]]")
    assert "leaves no particle: all of it lies inside 'post'" in refused(pool() + around)


def test_false_is_the_same_as_no_key(tmp_path):
    plain = scene(tmp_path, HEAD + pool("") + POST).to_json()
    assert scene(tmp_path, HEAD + pool("subtract = false") + POST).to_json() == plain
    assert "subtract" not in plain["object"][0]


def test_a_resumed_run_cannot_cut(tmp_path):
    loaded = scene(tmp_path, HEAD + pool() + POST)
    (wrong,) = changes_without_effect(loaded, [(("object", 0, "subtract"), "was true")])
    assert "the particles are those of the run so far" in wrong[1]


def test_the_key_makes_the_same_particles_as_a_difference(tmp_path):
    """A rigid ball in a pool at rest: as where the ball is cut from the shape by hand."""
    rest = 'initial_pressure = "hydrostatic"\n'
    ball_ = '[[object]]\nname = "ball"\nmaterial = "oak"\nrigid = true\n' + BALL
    by_key = made(tmp_path, pool(rest + 'subtract = ["ball"]') + ball_)
    box_ = "box = [[0, 0, 0], [0.4, 0.4, 0.3]]"
    hole = BALL.strip().removeprefix("shape = ")
    by_hand = pool(rest).replace(f"{{ {box_} }}", f"{{ difference = [{{ {box_} }}, {hole}] }}")
    by_hand = made(tmp_path, by_hand + ball_)
    assert len(by_hand.x) < 48_000
    for name in ("x", "vol0", "theta0", "v0"):
        np.testing.assert_array_equal(getattr(by_key, name), getattr(by_hand, name))
