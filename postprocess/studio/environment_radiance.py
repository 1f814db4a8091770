"""Light that a ray meets outside of the liquid: opaque surfaces, ground, backdrop and sky."""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import LEAF, RAY
from .cone_occlusion import SOLID, TINT, level_value
from .light_rig import mirrored_sky
from .studio_ground import NONE, SHADOW, backdrop, ground_color
from .value_grid import trilinear_values


@njit_cached(**RAY)
def project(view, x, y, z, out):
    """Write pixel and depth of a point to out.

    Args:
        view: The view.
        x, y, z: Point [m].
        out: (out) Column, row [pixels] and depth [m], shape (3,).

    Returns:
        Whether the point lies before the camera.
    """
    w = view.pose
    depth = w[2, 0] * x + w[2, 1] * y + w[2, 2] * z + w[2, 3]
    if depth < view.lens[4]:
        return False
    out[0] = (
        view.lens[0] * (w[0, 0] * x + w[0, 1] * y + w[0, 2] * z + w[0, 3]) / depth + view.lens[2]
    )
    out[1] = (
        view.lens[1] * (w[1, 0] * x + w[1, 1] * y + w[1, 2] * z + w[1, 3]) / depth + view.lens[3]
    )
    out[2] = depth
    return True


@njit_cached(**RAY)
def _blend(light, depth, u, v, surface_depth, thickness, out):
    """Interpolate the light between the pixels of one surface, to out (3,)."""
    u, v = u - 0.5, v - 0.5
    k0, j0 = int(np.floor(u)), int(np.floor(v))
    fu, fv, total = u - k0, v - j0, 0.0
    out[0] = out[1] = out[2] = 0.0
    for b in range(2):
        for a in range(2):
            j, k = min(max(j0 + b, 0), depth.shape[0] - 1), min(max(k0 + a, 0), depth.shape[1] - 1)
            if abs(depth[j, k] - surface_depth) < thickness or (
                surface_depth > 1e30 and depth[j, k] > 1e30
            ):
                w = abs(1.0 - b - fv) * abs(1.0 - a - fu) + 1e-6
                total += w
                for m in range(3):
                    out[m] += w * light[j, k, m]
    if total > 0.0:
        for m in range(3):
            out[m] /= total


@njit_cached(**LEAF)
def opaque_at(stage, x, y, z, thickness, pixel, out):
    """Return whether a point lies inside of an opaque surface, and write its light to out.

    Surfaces that the camera sees are taken from its picture, others from the colors of the pyramid.

    Args:
        stage: The scene.
        x, y, z: Point [m].
        thickness: Thickness of visible surfaces [m].
        pixel: Scratch, shape (3,).
        out: (out) Light, shape (3,).
    """
    view, pyramid = stage.buffers, stage.pyramid
    in_front = project(view, x, y, z, pixel)
    k, j = int(np.floor(pixel[0])), int(np.floor(pixel[1]))
    if in_front and 0 <= j < view.depth.shape[0] and 0 <= k < view.depth.shape[1]:
        surface_depth = view.depth[j, k]
        if pixel[2] <= surface_depth:
            return False
        if pixel[2] < surface_depth + thickness:
            _blend(view.light, view.depth, pixel[0], pixel[1], surface_depth, thickness, out)
            return True
    if level_value(pyramid, 0, x, y, z) < SOLID:
        return False
    size = TINT * pyramid.cell
    trilinear_values(
        pyramid.color,
        (x - pyramid.lower[0]) / size,
        (y - pyramid.lower[1]) / size,
        (z - pyramid.lower[2]) / size,
        3,
        out,
    )
    # the light on it is estimated: half of the key, most of the sky
    e = pyramid.cell
    g = level_value(pyramid, 1, x, y, z - 3 * e) - level_value(pyramid, 1, x, y, z + 3 * e)
    up = 0.5 + 0.5 * min(max(g, -1.0), 1.0)
    for m in range(3):
        out[m] *= (
            (0.25 + 0.5 * up) * stage.rig.key[m]
            + stage.rig.bounce[m]
            + up * (stage.rig.zenith[m] - stage.rig.bounce[m])
        )
    return True


@njit_cached(**RAY)
def far_light(stage, x, y, z, d0, d1, d2, is_straight, blur, pixel, out):
    """Write the light of ground, sky and background along a ray that hits nothing else to out.

    Args:
        stage: The scene.
        x, y, z, d0, d1, d2: Origin [m] and unit direction.
        is_straight: Whether the ray continues away from the camera, so that it shows the backdrop
            and not the soft boxes.
        blur: Angle of the average of reflections.
        pixel: Scratch, shape (3,).
        out: (out) Light, shape (3,).
    """
    plane, view = stage.plane, stage.buffers
    if d2 < -1e-3 and plane.kind != NONE and z > plane.height - 4.0 * stage.pyramid.cell:
        t = max(z - plane.height, 0.0) / -d2
        if plane.kind != SHADOW:
            ground_color(plane, x + t * d0, y + t * d1, 0.002 + 0.002 * t, out)
            return
        if _background_at(view, x + t * d0, y + t * d1, plane.height, pixel, out):
            return
    if is_straight and view.picture:
        t = 2.0 * stage.pyramid.cell * 100.0
        if _background_at(view, x + t * d0, y + t * d1, z + t * d2, pixel, out):
            return
    if is_straight:
        backdrop(plane, d2, out)
    else:
        mirrored_sky(stage.rig, d0, d1, d2, blur, out)


@njit_cached(**RAY)
def _background_at(view, x, y, z, pixel, out):
    """Write the background's light at a point to out; return whether the picture shows it."""
    if not project(view, x, y, z, pixel):
        return False
    rows, columns = view.background.shape[0], view.background.shape[1]
    u, v = (
        min(max(pixel[0] - 0.5, 0.0), columns - 1.001),
        min(max(pixel[1] - 0.5, 0.0), rows - 1.001),
    )
    k, j = int(u), int(v)
    a, b = u - k, v - j
    k1, j1 = min(k + 1, columns - 1), min(j + 1, rows - 1)
    for m in range(3):
        upper = view.background[j, k, m] + a * (
            view.background[j, k1, m] - view.background[j, k, m]
        )
        lower = view.background[j1, k, m] + a * (
            view.background[j1, k1, m] - view.background[j1, k, m]
        )
        out[m] = upper + b * (lower - upper)
    return True
