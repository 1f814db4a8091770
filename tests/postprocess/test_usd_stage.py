"""The OpenUSD file of a run: opened again by OpenUSD it holds the run's frames."""

import sys

import numpy as np
import pytest

from tests.support import drawn_runs
from vgmpi.commands import cli
from vgmpi.gaussians import spherical_harmonics as harmonics
from vgmpi.gaussians.cloud import GaussianCloud, rotation_matrices
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.postprocess.commands import export
from vgmpi.postprocess.export import usd_stage
from vgmpi.postprocess.export.export_moving import RunMotion
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.frames.camera_paths import CameraPath
from vgmpi.postprocess.frames.collider_meshes import collider_meshes
from vgmpi.postprocess.frames.frame_renderer import visible_extent

FRAMES = 5


def is_usd_missing():
    try:
        usd_stage.load_usd()
    except RunError:
        return True
    return False


needs_usd = pytest.mark.skipif(is_usd_missing(), reason="needs usd-core: pip install 'vgmpi[usd]'")


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    folder = drawn_runs.write(tmp_path_factory.mktemp("run") / "out", frames=FRAMES, k=4)
    return folder


@pytest.fixture(scope="module")
def stage(out, tmp_path_factory):
    from pxr import Usd

    path = tmp_path_factory.mktemp("usd") / "scene.usdc"
    assert export.main([str(out), "--format", "usd", "-o", str(path), "-q"]) == 0
    return Usd.Stage.Open(str(path))


def splats(stage):
    return [p for p in stage.Traverse() if p.GetTypeName() == "ParticleField3DGaussianSplat"]


def cloud_at(stage, time):
    """All splats of a stage at a time code, as one cloud."""
    columns = []
    for prim in splats(stage):
        x, quat, scale, opacity, sh = (
            np.array(prim.GetAttribute(name).Get(time), dtype=np.float64)
            for name in (
                "positions", "orientations", "scales", "opacities",
                "radiance:sphericalHarmonicsCoefficients",
            )
        )  # fmt: skip
        quat = np.array(prim.GetAttribute("orientations").Get(time))
        quat = np.array([[q.GetReal(), *q.GetImaginary()] for q in list(
            prim.GetAttribute("orientations").Get(time))])  # fmt: skip
        degree = prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get()
        columns.append((x, quat, scale, opacity, sh.reshape(len(x), (degree + 1) ** 2, 3)))
    return GaussianCloud(*(np.concatenate(column) for column in zip(*columns)))


@needs_usd
def test_the_stage_has_the_units_and_times_of_the_run(stage):
    from pxr import UsdGeom

    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert stage.GetDefaultPrim().GetPath() == "/World"
    assert stage.GetTimeCodesPerSecond() == pytest.approx(25)  # a frame each 0.04 s
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, FRAMES - 1)
    names = {prim.GetName() for prim in splats(stage)}
    assert names == {"scenery", "pool", "bar"}
    moving = stage.GetPrimAtPath("/World/bar").GetAttribute("positions")
    assert moving.GetTimeSamples() == [float(k) for k in range(FRAMES)]
    assert not stage.GetPrimAtPath("/World/scenery").GetAttribute("positions").GetTimeSamples()


@needs_usd
@pytest.mark.parametrize("index", [0, 2, FRAMES - 1])
def test_the_samples_are_the_frames(out, stage, index):
    """Positions to 1e-6 m, covariances to 1e-5 of the largest, colors to 1e-5."""
    look = Appearance(RunReader(out))
    motion = RunMotion(look, FRAMES // 2)
    parts = look.parts(look.frame(index))
    first = {"scenery": 0, "particles": len(parts[0].x)}
    rows = np.concatenate([first[part] + ids for part, ids in motion.members])
    x, cov, opacity = (np.concatenate([part[k] for part in parts])[rows] for k in range(3))
    got = cloud_at(stage, index)
    np.testing.assert_allclose(got.x, x, atol=1e-6)
    largest = cov[:, (0, 3, 5)].max(axis=1, keepdims=True)
    assert (np.abs(got.cov() - cov) < 1e-5 * largest).all()
    np.testing.assert_allclose(got.opacity, opacity, atol=1e-6)
    eye = np.array([2.0, -1, 1])
    color = np.concatenate([part.view_from(eye).color for part in parts])[rows]
    seen = np.maximum(harmonics.evaluate(got.sh, got.x - eye), 0)
    np.testing.assert_allclose(seen, color, atol=1e-5)
    other = cloud_at(stage, (index + 2) % FRAMES)
    assert np.abs(other.x - x).max() > 0.02  # the measure tells frames apart


@needs_usd
def test_between_frames_a_viewer_sees_the_turning_bar(stage):
    """Rotations and sizes change steadily: half way they give the shape half way."""
    a, half, b = (cloud_at(stage, time) for time in (1, 1.5, 2))
    bar = slice(len(a) - drawn_runs.BAR, None)
    assert np.abs(np.sum(a.quat[bar] * b.quat[bar], axis=1)).min() > 0.97
    turn = drawn_runs.rotation(0.5 * np.pi / (FRAMES - 1) / 2)
    want = turn @ rotation_matrices(a.quat[bar]) * a.scale[bar][:, None, :]
    got = rotation_matrices(half.quat[bar] / np.linalg.norm(half.quat[bar], axis=1)[:, None])
    got = got * half.scale[bar][:, None, :]
    np.testing.assert_allclose(
        got @ got.transpose(0, 2, 1), want @ want.transpose(0, 2, 1), atol=2e-6
    )


def test_axes_keep_their_order_when_sizes_cross():
    """An axis that grows past another one stays in its column, and its sign too."""
    tracker, turn = usd_stage.AxesTracker(), drawn_runs.rotation(0.3)
    scales = [np.array([1.0, 2.0, 3.0]), np.array([2.5, 2.0, 3.0]), np.array([4.0, 2.0, 3.0])]
    quats = []
    for scale in scales:
        quat, got = tracker.advance((turn @ np.diag(scale**2) @ turn.T)[None])
        np.testing.assert_allclose(got[0], scale, rtol=1e-12)
        quats.append(quat[0])
    np.testing.assert_allclose(quats, np.tile(quats[0], (3, 1)), atol=1e-12)


@needs_usd
def test_the_camera_is_the_renderers(out, stage):
    """Gf's own projection of a point lands on the renderer's pixel."""
    from pxr import Gf, UsdGeom

    settings = render_config.load(None)
    box = visible_extent(RunReader(out))
    camera = CameraPath(settings.views()[0], settings.picture, lambda: box, None).camera_at(0, 0)
    prims = [p for p in stage.Traverse() if p.IsA(UsdGeom.Camera)]
    assert len(prims) == 1
    frustum = UsdGeom.Camera(prims[0]).GetCamera(0).frustum
    point = np.array([0.3, 0.6, 0.2])
    matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    x, y, _ = matrix.Transform(Gf.Vec3d(*point))
    p = camera.world_to_camera[:3, :3] @ point + camera.world_to_camera[:3, 3]
    u, v = camera.fx * p[0] / p[2] + camera.cx, camera.fy * p[1] / p[2] + camera.cy
    assert 0.5 * (x + 1) * camera.width == pytest.approx(u, abs=0.01)
    assert 0.5 * (1 - y) * camera.height == pytest.approx(v, abs=0.01)


def validation_errors(path):
    """What all validators of OpenUSD say of a file."""
    from pxr import Usd, UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    context = UsdValidation.ValidationContext(validators)
    return [str(error.GetMessage()) for error in context.Validate(Usd.Stage.Open(str(path)))]


@needs_usd
@pytest.mark.parametrize("suffix", ["usdc", "usda", "usdz"])
def test_the_validators_of_openusd_find_nothing(out, tmp_path, suffix):
    path = tmp_path / f"scene.{suffix}"
    argv = [str(out), "--format", "usd", "-o", str(path), "-q", "--frames", "0:2"]
    assert export.main(argv) == 0
    assert validation_errors(path) == []
    assert [p.name for p in tmp_path.iterdir()] == [path.name]  # nothing temporary is left


@needs_usd
def test_the_validators_see_a_mistake(tmp_path):
    from pxr import Usd

    stage = Usd.Stage.CreateNew(str(tmp_path / "a.usda"))
    stage.DefinePrim("/a", "Mesh")
    stage.Save()
    assert validation_errors(tmp_path / "a.usda")


@needs_usd
def test_removed_gaussians_are_transparent(tmp_path):
    """A Gaussian that is absent in a frame has no opacity there, and its own before."""
    from pxr import Usd

    from vgmpi.gaussians.formats.motion_stream import GroupState, MotionGroup, RestGaussians

    x = np.arange(9.0).reshape(3, 3)
    root = np.tile([0.1, 0, 0, 0.1, 0, 0.1], (3, 1))
    rest = RestGaussians(x, root, np.full(3, 0.5), np.zeros((3, 1, 3)))
    group = MotionGroup("a", 3, "free", "size")
    path = tmp_path / "a.usda"
    stage = usd_stage.UsdStage(path, [group], rest, frames=3, rate=10)
    for present in ([1, 1, 1], [1, 0, 1], [1, 1, 1]):
        mask = np.array(present, bool)
        stage.add_frame([GroupState(mask, x[mask], np.ones(mask.sum()))], [], {})
    stage.save()
    opened = Usd.Stage.Open(str(path))
    opacity = splats(opened)[0].GetAttribute("opacities")
    for time, want in enumerate(([0.5, 0.5, 0.5], [0.5, 0, 0.5], [0.5, 0.5, 0.5])):
        np.testing.assert_allclose(opacity.Get(time), want)


def mesh_volume(mesh):
    triangles = [(f[0], f[k], f[k + 1]) for f in mesh.faces for k in range(1, len(f) - 1)]
    a, b, c = mesh.points[np.array(triangles)].transpose(1, 0, 2)
    return np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6


def is_closed(mesh):
    """Whether each edge has two faces, which run along it in opposite directions."""
    edges = [edge for face in mesh.faces for edge in zip(face, face[1:] + face[:1])]
    return len(set(edges)) == len(edges) and {(b, a) for a, b in edges} == set(edges)


ENDS = [[0, 0, 1], [1, 2, 3]]  # 3 apart
SHAPES = {  # volumes of the shapes, and the tolerance that their 48 faces leave
    "box": ({"box": [[0, 0, 0], [1, 2, 3]]}, 6, 1e-12),
    "sphere": ({"sphere": {"center": [0, 0, 1], "radius": 0.5}}, np.pi / 6, 0.01),
    "ellipsoid": ({"ellipsoid": {"center": [0, 0, 1], "radii": [1, 2, 3]}}, 8 * np.pi, 0.01),
    "cylinder": ({"cylinder": {"endpoints": ENDS, "radius": 0.5}}, 0.75 * np.pi, 0.004),
    "capsule": ({"capsule": {"endpoints": ENDS, "radius": 0.5}}, (0.75 + 1 / 6) * np.pi, 0.01),
    "cone": ({"cone": {"endpoints": ENDS, "radii": [0.5, 0]}}, 0.25 * np.pi, 0.004),
    "frustum": ({"cone": {"endpoints": ENDS, "radii": [1, 2]}}, 7 * np.pi, 0.004),
    "torus": ({"torus": {"center": [0, 1, 0], "axis": [0.6, 0, 0.8], "major_radius": 1,
                         "minor_radius": 0.5}}, 0.5 * np.pi**2, 0.01),
    "union": ({"union": [{"box": [[0, 0, 0], [1, 2, 3]]}, {"box": [[2, 0, 0], [3, 1, 1]]}]}, 7,
              1e-12),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
def test_meshes_of_colliders(name):
    """Closed surfaces with outward normals, of the right volume, at the object's place."""
    shape, volume, rtol = SHAPES[name]
    transform = np.eye(4)
    transform[:3, :3] *= 2
    transform[:3, 3] = [1, 2, 3]
    objects = [{"name": "wall", "collider": True, "transform": transform.tolist()}]
    (mesh,), without = collider_meshes(objects, {"object": [{"name": "wall", "shape": shape}]})
    assert without == [] and mesh.pose == -1
    assert is_closed(mesh) and mesh_volume(mesh) == pytest.approx(8 * volume, rel=rtol)
    if name == "torus":
        np.testing.assert_allclose(mesh.points.mean(axis=0), [1, 4, 3], atol=1e-9)


def test_colliders_without_a_mesh():
    """A difference is named; poses count the objects that move."""
    ball = {"sphere": {"center": [0, 0, 0], "radius": 1}}
    shapes = {"knot": {"difference": [ball, ball]}, "pot": {"union": [ball, {"difference": []}]},
              "still": ball, "ball": ball}  # fmt: skip
    objects = [{"name": n, "collider": True, "transform": np.eye(4).tolist()} for n in shapes]
    objects[0]["is_moving"] = objects[3]["is_moving"] = True
    scene = {"object": [{"name": n, "shape": s} for n, s in shapes.items()]}
    meshes, without = collider_meshes(objects, scene)
    assert without == ["knot", "pot"] and [mesh.pose for mesh in meshes] == [-1, 1]


STIRRED = """
title = "stirred"
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.02
[time]
end = 0.03
frames = 4
[material.water]
kind = "fluid"
density = 1000
[[object]]
name = "pool"
material = "water"
shape = { box = [[0, 0, 0], [0.4, 0.4, 0.04]] }
[[object]]
name = "rod"
role = "scenery"
collider = true
shape = { capsule = { endpoints = [[-0.1, 0, 0], [0.1, 0, 0]], radius = 0.02 } }
position = [0.2, 0.2, 0.18]
motion = { velocity = [1, 0, 0], angular_velocity = 10 }
"""


@needs_usd
def test_a_moving_collider_moves_in_the_stage(tmp_path):
    """The mesh of a rod that a scene moves stands where the scene has it at each frame's time."""
    from pxr import Usd, UsdGeom

    scene = tmp_path / "scene.toml"
    scene.write_text(STIRRED)
    assert cli.main([str(scene), "-q", "-o", str(tmp_path / "out")]) == 0
    path = tmp_path / "scene.usda"
    assert export.main([str(tmp_path / "out"), "--format", "usd", "-o", str(path), "-q"]) == 0
    assert validation_errors(path) == []
    stage = Usd.Stage.Open(str(path))
    (prim,) = [p for p in stage.Traverse() if p.IsA(UsdGeom.Mesh)]
    rest, center = np.array(prim.GetAttribute("points").Get()), np.array([0.2, 0.2, 0.2])
    np.testing.assert_allclose(rest.max(axis=0), center + [0.12, 0.02, 0.02], atol=1e-3)
    for code in range(4):
        matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(code))
        time = 0.01 * code
        want = (rest - center) @ drawn_runs.rotation(10 * time).T + center + [time, 0, 0]
        got = rest @ matrix[:3, :3] + matrix[3, :3]
        np.testing.assert_allclose(got, want, atol=1e-6)


def test_without_usd_core_one_line_says_what_to_install(out, tmp_path, monkeypatch, capfd):
    monkeypatch.setitem(sys.modules, "pxr", None)
    path = tmp_path / "a.usdc"
    assert export.main([str(out), "--format", "usd", "-o", str(path), "-q"]) == 2
    text = capfd.readouterr().err.strip()
    assert text == "not installed: pip install 'vgmpi[usd]'" and not list(tmp_path.iterdir())


def test_another_suffix_is_refused(out, tmp_path, capfd):
    assert export.main([str(out), "--format", "usd", "-o", str(tmp_path / "a.obj"), "-q"]) == 2
    assert "ends in .usdc, .usda, .usd, .usdz" in capfd.readouterr().err
