"""Runs of one frame with solids of meshes and shapes, and what a camera of the studio sees."""

import numpy as np

from tests.support.drawn_runs import write_run
from tests.support.small_scenes import scene
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer
from vgmpi.postprocess.raster.rasterize import supersampled_camera
from vgmpi.postprocess.studio.ray_scene import view_of

MIDDLE = np.array([0.2, 0.2, 0.2])  # [m] of the domain
ROOM = """
[domain]
size = [0.4, 0.4, 0.4]
cell = 0.01
[time]
end = 1
[material.clay]
kind = "elastic"
density = 400
youngs_modulus = 1e5
[[object]]
name = "pebble"
material = "clay"
shape = { box = [[0.01, 0.37, 0.01], [0.03, 0.39, 0.03]] }
"""
CAMERA = """
[camera]
kind = "fixed"
eye = [0.2, -0.7, 0.55]
target = [0.2, 0.2, 0.2]
fov = 22
[picture]
width = 200
height = 200
"""


def write(folder, objects, deformation=None):
    """Write a run of one frame at rest, or deformed about the middle, and return its reader.

    Args:
        folder: Folder of the scene and of the run.
        objects: Tables [[object]] of the scene.
        deformation: Matrix (3, 3) of the whole room, or None.
    """
    F = np.eye(3) if deformation is None else np.asarray(deformation, dtype=float)
    return RunReader(write_run(scene(folder, ROOM + objects), folder, F, MIDDLE))


def painter(run, folder, text=CAMERA):
    """Return a renderer of a run in the studio."""
    (folder / "render.toml").write_text(text)
    return FrameRenderer(run, render_config.load(folder / "render.toml"), folder)


def painted(renderer):
    """Return points (m, 3) [m] of opaque surfaces in a picture, and their painted normals (m, 3).

    The outermost pixels of the silhouette are left out.
    """
    studio, camera = renderer.studio, renderer.camera(0.0)
    moment = studio.moment(renderer.look.frame(0), 0)
    fine = supersampled_camera(camera, studio.times)
    view = view_of(fine)
    options = {"alpha_min": renderer.alpha_min, **renderer.chosen.splatting.options()}
    splats, normal, kind = studio._splats(moment, camera.eye)
    _, normals, _, left = studio._paint(splats, normal, kind, fine, view, options)
    solid = left < 0.02
    for axis in (0, 1):
        solid &= np.roll(solid, 3, axis) & np.roll(solid, -3, axis)
    rows, columns = np.nonzero(solid)
    u = (columns + 0.5 - view.lens[2]) / view.lens[0]
    v = (rows + 0.5 - view.lens[3]) / view.lens[1]
    depth = view.depth[rows, columns][:, None]
    points = view.eye + depth * (np.column_stack([u, v, np.ones_like(u)]) @ view.pose[:3, :3])
    n = normals[rows, columns] / (1.0 - left[rows, columns])[:, None] * 2.0 - 1.0
    return points, n / np.linalg.norm(n, axis=1, keepdims=True)


def write_obj(path, points, triangles):
    """Write a triangle mesh."""
    lines = [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in points]
    lines += [f"f {a} {b} {c}" for a, b, c in np.asarray(triangles) + 1]
    path.write_text("\n".join(lines) + "\n")


def surface_of_revolution(radius, height, around=96):
    """Return vertices and outward triangles of a closed profile that turns about the z axis.

    Args:
        radius, height: Profile, its inside on its left, shape (n,).
        around: Vertices around the axis.
    """
    turn = 2 * np.pi * np.arange(around) / around
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    points = np.concatenate(
        [np.column_stack([r * circle, np.full(around, h)]) for r, h in zip(radius, height)]
    )
    triangles = []
    for i in range(len(radius) - 1):
        for j in range(around):
            a, b = i * around + j, i * around + (j + 1) % around
            triangles += [(a, b, b + around), (a, b + around, a + around)]
    return points, np.array(triangles)


def cube(edge):
    """Return vertices and outward triangles of a cube that stands on z = 0, about the z axis."""
    corner = (np.indices((2, 2, 2)).reshape(3, -1).T - [0.5, 0.5, 0]) * edge
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corner, np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))])
