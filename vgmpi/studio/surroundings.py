"""Light that a ray meets outside of the liquid: opaque things, ground, backdrop and sky."""

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY
from vgmpi.studio.grid import trilinear_values
from vgmpi.studio.ground import NONE, SHADOW, backdrop, ground_color
from vgmpi.studio.lighting import mirrored_sky
from vgmpi.studio.occlusion import SOLID, TINT, level_value


@cached(**RAY)
def project(view, x, y, z, out):
    """Pixel and depth of a point, into out (3,); whether it lies before the camera."""
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


@cached(**RAY)
def _blend(light, depth, u, v, near, thick, out):
    """Light between the pixels that show the same thing, into out (3,)."""
    u, v = u - 0.5, v - 0.5
    k0, j0 = int(np.floor(u)), int(np.floor(v))
    fu, fv, total = u - k0, v - j0, 0.0
    out[0] = out[1] = out[2] = 0.0
    for b in range(2):
        for a in range(2):
            j, k = min(max(j0 + b, 0), depth.shape[0] - 1), min(max(k0 + a, 0), depth.shape[1] - 1)
            if abs(depth[j, k] - near) < thick or (near > 1e30 and depth[j, k] > 1e30):
                w = abs(1.0 - b - fv) * abs(1.0 - a - fu) + 1e-6
                total += w
                for m in range(3):
                    out[m] += w * light[j, k, m]
    if total > 0.0:
        for m in range(3):
            out[m] /= total


@cached(**RAY)
def opaque_at(stage, x, y, z, thick, place, out):
    """Whether a point lies in something opaque; its light, into out (3,).

    What the camera sees is taken from its picture, the rest from the colors of the pyramid.
    """
    view, pyramid = stage.buffers, stage.pyramid
    on = project(view, x, y, z, place)
    k, j = int(np.floor(place[0])), int(np.floor(place[1]))
    if on and 0 <= j < view.depth.shape[0] and 0 <= k < view.depth.shape[1]:
        near = view.depth[j, k]
        if place[2] <= near:
            return False
        if place[2] < near + thick:
            _blend(view.light, view.depth, place[0], place[1], near, thick, out)
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
    # its light is guessed: half of the key, most of the sky
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


@cached(**RAY)
def far_light(stage, x, y, z, d0, d1, d2, straight, blur, place, out):
    """Light from ground, sky and background along a ray that meets nothing else, into out (3,).

    straight: whether the ray goes on away from the camera, so that it sees the backdrop and not the
    soft boxes.
    """
    plane, view = stage.plane, stage.buffers
    if d2 < -1e-3 and plane.kind != NONE and z > plane.height - 4.0 * stage.pyramid.cell:
        t = max(z - plane.height, 0.0) / -d2
        if plane.kind != SHADOW:
            ground_color(plane, x + t * d0, y + t * d1, 0.002 + 0.002 * t, out)
            return
        if _seen_behind(view, x + t * d0, y + t * d1, plane.height, place, out):
            return
    if straight and view.picture:
        t = 2.0 * stage.pyramid.cell * 100.0
        if _seen_behind(view, x + t * d0, y + t * d1, z + t * d2, place, out):
            return
    if straight:
        backdrop(plane, d2, out)
    else:
        mirrored_sky(stage.rig, d0, d1, d2, blur, out)


@cached(**RAY)
def _seen_behind(view, x, y, z, place, out):
    """Light of the background's picture where a point is seen; whether it is in the picture."""
    if not project(view, x, y, z, place):
        return False
    rows, columns = view.behind.shape[0], view.behind.shape[1]
    u, v = (
        min(max(place[0] - 0.5, 0.0), columns - 1.001),
        min(max(place[1] - 0.5, 0.0), rows - 1.001),
    )
    k, j = int(u), int(v)
    a, b = u - k, v - j
    k1, j1 = min(k + 1, columns - 1), min(j + 1, rows - 1)
    for m in range(3):
        one = view.behind[j, k, m] + a * (view.behind[j, k1, m] - view.behind[j, k, m])
        two = view.behind[j1, k, m] + a * (view.behind[j1, k1, m] - view.behind[j1, k, m])
        out[m] = one + b * (two - one)
    return True
