"""Small stages for tests of the studio: liquid of a lattice, a ground, a camera, and their
picture."""

import numpy as np

from vgmpi.gaussians.camera import look_at
from vgmpi.postprocess.studio import (
    compositing,
    deferred_shading,
    density_field,
    lattice_deformation,
    light_rig,
    liquid_radiance,
    studio_ground,
    tone_mapping,
)
from vgmpi.postprocess.studio import cone_occlusion as hiding
from vgmpi.postprocess.studio.ray_scene import CHANNELS, Medium, Stage, View
from vgmpi.postprocess.studio.studio_renderer import STRETCH

INDEX = 1.333
WALLED = np.ones(6, bool)
OPEN = np.zeros(6, bool)
NOTHING = np.zeros((0, 3))


def grid_points(shape, spacing, lower=(0.0, 0.0, 0.0)):
    """Particles at the middles of the cells of a lattice."""
    return (np.indices(shape).reshape(3, -1).T + 0.5) * spacing + lower


def sphere(radius, spacing, middle):
    """Particles of a ball."""
    n = int(np.ceil(2 * radius / spacing)) + 1
    x = grid_points((n, n, n), spacing, -0.5 * n * spacing * np.ones(3))
    return x[np.linalg.norm(x, axis=1) < radius] + middle


def stretched(x0, x, spacing, limits=STRETCH, torn=100.0):
    """Stretches (n, 6) of the lattice x0 (n, 3) that is now at x (n, 3)."""
    n = len(x0)
    every = np.arange(n)
    distance = np.full(n, torn * spacing)
    return lattice_deformation.stretches(
        x,
        every,
        every,
        lattice_deformation.link(x0, spacing),
        np.full(n, spacing),
        distance,
        *limits,
    )


def field_of(x, spacing, box, walls=WALLED, fine=2.0, values=None, stretch=None):
    """The density field of particles, and its interior."""
    n, box = len(x), np.asarray(box, dtype=np.float64)
    spacings = np.full(n, spacing)
    values = np.zeros((n, CHANNELS)) if values is None else values
    if stretch is None:
        stretch = np.tile([1.0, 0, 0, 1, 0, 1], (n, 1))
    inside = density_field.interior(x, spacings, values, box, walls)
    return density_field.liquid_field(x, spacings, stretch, inside, box, walls, fine), inside


def water(x, spacing, box, walls=WALLED, absorbs=(0.0, 0.0, 0.0), index=INDEX, fine=2.0):
    """A liquid without own light that absorbs so much [1/m]."""
    one = np.array([*absorbs, 0.5, 0.5, 0.5, 0.0, 0.0, 0.0])
    found, inside = field_of(x, spacing, box, walls, fine, np.tile(one, (len(x), 1)))
    return Medium(found, inside.means, index, 0.0, True, 0.0, one)


def dark_rig(direction=(0.0, 0.0, -1.0), width=0.01, **said):
    """Lights that are all off, but for those that are said."""
    rig = light_rig.rig(np.array(direction), width=width)
    off = ("key", "horizon", "zenith", "bounce", "mirror_horizon", "mirror_zenith", "mirror_ground")
    rig = rig._replace(boxes=np.zeros(3), **{name: np.zeros(3) for name in off})
    return rig._replace(**{name: np.broadcast_to(v, 3).astype(float) for name, v in said.items()})


def pyramid(x=NOTHING, volume=0.0, low=(0, 0, 0), high=(1, 1, 1), cells=100, albedo=0.5):
    """What hides light: particles of one volume [m3]."""
    n, ends = len(x), (np.array(low, dtype=float), np.array(high, dtype=float))
    return hiding.occlusion(x, np.full(n, volume), np.full((n, 3), albedo), *ends, cells)


def plain(kind, shadows, rig, low=(0, 0, 0), high=(1, 1, 1), backdrop=(0, 0, 0), texels=240):
    """White ground at height 0 without joints."""
    ends = (np.array(low, dtype=float), np.array(high, dtype=float))
    one = np.ones(3)
    return studio_ground.ground(
        kind, 0.0, *ends, shadows, rig, one, one, 0.0, np.array(backdrop, float), 0.0, texels
    )


def oblique(angle, middle, distance=1.5, fov=20, size=120, along=(0.0, -1.0)):
    """A camera that sees a point so many degrees from above."""
    a, middle = np.radians(angle), np.asarray(middle, dtype=float)
    away = np.array([along[0] * np.sin(a), along[1] * np.sin(a), np.cos(a)])
    up = (0, 1, 0) if angle < 1 else (0, 0, 1)
    return look_at(middle + distance * away, middle, up, fov, size, size)


def view_of(camera):
    """What a camera sees where there is nothing."""
    shape = (camera.height, camera.width)
    light, behind = np.zeros((*shape, 3), np.float32), np.zeros((*shape, 3), np.float32)
    depth = np.full(shape, np.inf, np.float32)
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.near_plane])
    pose = np.ascontiguousarray(camera.world_to_camera, dtype=np.float64)
    eye = np.ascontiguousarray(camera.eye, dtype=np.float64)
    return View(light, depth, behind, pose, lens, eye, False)


def wall_at(view, axis, place):
    """Ways along the camera's axis to the plane where a coordinate has a value, and the points."""
    rows, columns = np.indices(view.depth.shape)
    u = (columns + 0.5 - view.lens[2]) / view.lens[0]
    v = (rows + 0.5 - view.lens[3]) / view.lens[1]
    rays = np.stack([u, v, np.ones_like(u)], -1) @ view.pose[:3, :3]
    depth = (place - view.eye[axis]) / rays[..., axis]
    return depth, view.eye + depth[..., None] * rays


def draw(stage, covered=False):
    """The picture in linear light (height, width, 3), one ray a pixel.

    covered: whether the view holds opaque things already.
    """
    view = stage.buffers
    if not covered:
        deferred_shading.shade_background(stage, np.zeros((1, 1, 3), np.float32), 1)
        view.light[:] = view.background
    shape = view.depth.shape
    hits, normals = find(stage)
    left = np.where(np.isfinite(view.depth), 0, 1).astype(np.float32)
    none, turned = np.full(shape, np.inf, np.float32), np.zeros((*shape, 3), np.float32)
    image, alpha, depth = np.empty((*shape, 3)), np.empty(shape), np.empty(shape, np.float32)
    pixel = 1.0 / view.lens[0]
    keys = np.empty(hits.shape, np.float32)
    compositing.compose(
        stage, left, none, turned, hits, normals, pixel, 0, image, alpha, depth, keys
    )
    return tone_mapping.to_linear(image)


def find(stage):
    """Ways to the liquid's first surface (below 0 through walls) and normals there."""
    view = stage.buffers
    hits = np.empty(view.depth.shape, np.float32)
    normals = np.zeros((*hits.shape, 3), np.float32)
    liquid_radiance.find_surface(stage, view.depth, hits, normals, 1.0 / view.lens[0])
    return hits, normals


def stage_of(medium, camera, rig=None, plane=None, shadows=None):
    """All that a ray can meet; without lights, ground and opaque things where none are given."""
    rig = dark_rig() if rig is None else rig
    shadows = pyramid(cells=40) if shadows is None else shadows
    plane = plain(studio_ground.NONE, shadows, rig) if plane is None else plane
    return Stage(medium, shadows, rig, plane, view_of(camera))


def fresnel(angle, index=INDEX):
    """Share of unpolarized light that a surface mirrors at an angle [degrees]."""
    if angle == 0:
        return ((index - 1) / (index + 1)) ** 2
    a = np.radians(angle)
    b = np.arcsin(np.sin(a) / index)
    across = np.sin(a - b) ** 2 / np.sin(a + b) ** 2
    along = np.tan(a - b) ** 2 / np.tan(a + b) ** 2
    return 0.5 * (across + along)


def inner(angle, index=INDEX):
    """Angle of the refracted ray [rad] of one that comes at an angle [degrees]."""
    return np.arcsin(np.sin(np.radians(angle)) / index)


def pixel_of(camera, x):
    """Where a camera sees a point, (2,) [pixels]."""
    x, y, depth = camera.world_to_camera[:3, :3] @ x + camera.world_to_camera[:3, 3]
    return np.array([camera.fx * x / depth + camera.cx, camera.fy * y / depth + camera.cy])


def surface_point(eye, mark, index, deep):
    """Where on z = deep the ray passes that goes from the eye, is refracted and meets the mark; in
    the plane x = 0.3, by bisection."""
    low, high, way = eye[1], mark[1], np.sign(mark[1] - eye[1])
    for _ in range(60):
        y = 0.5 * (low + high)
        a = np.arctan2(abs(y - eye[1]), eye[2] - deep)
        b = np.arcsin(np.sin(a) / index)
        reached = y + (deep - mark[2]) * np.tan(b) * way
        low, high = (y, high) if (reached - mark[1]) * way < 0 else (low, y)
    return np.array([0.3, y, deep])
