"""Spray drawn as stretched drops, and foam.

Spray consists of the particles outside of the liquid's density field.

References:
    M. Ihmsen, N. Akinci, G. Akinci, M. Teschner. Unified spray, foam and air bubbles for
    particle-based fluids. The Visual Computer 28, 2012.
"""

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .compile_options import RAY
from .density_field import Field, densities
from .environment_radiance import far_light, project
from .light_rig import mirrored_sky
from .liquid_radiance import AMBIENT, DIRECT, look_up_tint, own_light, shade_ray
from .particle_hash import uniform
from .ray_marching import first_hit
from .value_grid import KERNEL, deposit, new_grid, sample

ALONE = 0.46  # [-] density at a particle below which it is a drop
TOUCHES = 0.9  # [spacings] distance from the liquid's surface without drops
DROPS = 6  # [drops] of a particle
EXPOSED = 0.008  # [s] exposure that stretches a drop along its velocity
LIFE = 0.35  # [s] decay time of foam
RATE = 10.2  # [1/s] largest growth rate of foam
THICK = 2.0  # [cells of the field] path length through a drop


def spray_drops(
    x: np.ndarray, velocity: np.ndarray, ids: np.ndarray, liquid: Field, spacing: float
):
    """Return the drops of the spray as spheroids.

    Args:
        x: Positions of the liquid's particles, shape (n, 3) [m].
        velocity: Velocities, shape (n, 3) [m/s].
        ids: Particle numbers, shape (n,).
        liquid: Density field of the liquid's body.
        spacing: Distance of particles [m].

    Returns:
        Centers (m, 3) [m], unit axes (m, 3), long and short half axes (m,) [m].
    """
    density = densities(liquid, x)
    rows = np.flatnonzero(density < ALONE)
    touches = np.zeros(len(rows), bool)
    for direction in np.concatenate([np.eye(3), -np.eye(3)]):
        touches |= densities(liquid, x[rows] + TOUCHES * spacing * direction) >= 0.5
    rows = rows[~touches]
    if not len(rows):
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    ids, v = ids[rows], velocity[rows]
    speed = np.linalg.norm(v, axis=1)
    axis = np.where(speed[:, None] > 1e-3, v / np.maximum(speed, 1e-3)[:, None], [0.0, 0.0, 1.0])
    crowding = np.clip((density[rows] - 0.16) / 0.3, 0, 1)
    middles, longs, shorts = [], [], []
    for c in range(DROPS):
        size = spacing * (0.06 + 0.24 * uniform(ids, 5 + c) ** 2.5) * (0.8 + 0.6 * crowding)
        offset = np.stack([uniform(ids, 12 + 3 * c + a) for a in range(3)], axis=1) - 0.5
        middles.append(x[rows] + offset * spacing * 1.3 * (1 - 0.4 * crowding)[:, None])
        longs.append(size + np.minimum(0.5 * EXPOSED * speed, 2.0 * size))
        shorts.append(size)
    axes = np.tile(axis, (DROPS, 1))
    return np.concatenate(middles), axes, np.concatenate(longs), np.concatenate(shorts)


@njit_cached(nogil=True, error_model="numpy")
def paint_drops(x, axis, long, short, view, depth, normal):
    """Draw the nearest spheroids.

    Args:
        x, axis: Centers [m] and unit axes, shape (n, 3).
        long, short: Half axes, shape (n,) [m].
        view: View with the depth of opaque surfaces.
        depth: (in/out) Depths, shape (height, width) [m].
        normal: (out) Normals in the world, shape (height, width, 3).
    """
    height, width = depth.shape
    w, lens = view.pose, view.lens
    for i in range(len(x)):
        Z = w[2, 0] * x[i, 0] + w[2, 1] * x[i, 1] + w[2, 2] * x[i, 2] + w[2, 3]
        if Z < lens[4]:
            continue
        X = w[0, 0] * x[i, 0] + w[0, 1] * x[i, 1] + w[0, 2] * x[i, 2] + w[0, 3]
        Y = w[1, 0] * x[i, 0] + w[1, 1] * x[i, 1] + w[1, 2] * x[i, 2] + w[1, 3]
        px, py = lens[0] * X / Z + lens[2], lens[1] * Y / Z + lens[3]
        R = 1.2 * long[i] * lens[0] / Z + 1.0
        if not (px + R > 0 and py + R > 0 and px - R < width and py - R < height):
            continue
        a0 = w[0, 0] * axis[i, 0] + w[0, 1] * axis[i, 1] + w[0, 2] * axis[i, 2]
        a1 = w[1, 0] * axis[i, 0] + w[1, 1] * axis[i, 1] + w[1, 2] * axis[i, 2]
        a2 = w[2, 0] * axis[i, 0] + w[2, 1] * axis[i, 1] + w[2, 2] * axis[i, 2]
        s2, l2 = short[i] ** 2, long[i] ** 2
        kk = 1.0 / l2 - 1.0 / s2
        # the surface is |y|^2 / s2 + kk (a . y)^2 = 1 with y = t (u, v, 1) - c
        for j in range(max(0, int(py - R)), min(height - 1, int(py + R)) + 1):
            for k in range(max(0, int(px - R)), min(width - 1, int(px + R)) + 1):
                u, v = (k + 0.5 - lens[2]) / lens[0], (j + 0.5 - lens[3]) / lens[1]
                da, ca = u * a0 + v * a1 + a2, X * a0 + Y * a1 + Z * a2
                A = (u * u + v * v + 1.0) / s2 + kk * da * da
                B = (u * X + v * Y + Z) / s2 + kk * da * ca
                C = (X * X + Y * Y + Z * Z) / s2 + kk * ca * ca - 1.0
                D = B * B - A * C
                if D <= 0.0:
                    continue
                t = (B - np.sqrt(D)) / A
                if t < depth[j, k] and t < view.depth[j, k]:
                    depth[j, k] = t
                    y0, y1, y2 = t * u - X, t * v - Y, t - Z
                    along = y0 * a0 + y1 * a1 + y2 * a2
                    n0 = y0 / s2 + kk * along * a0
                    n1 = y1 / s2 + kk * along * a1
                    n2 = y2 / s2 + kk * along * a2
                    size = 1.0 / np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
                    for m in range(3):
                        normal[j, k, m] = size * (w[0, m] * n0 + w[1, m] * n1 + w[2, m] * n2)


@njit_cached(**RAY)
def shade_drop(stage, p, d, n, background, work, out):
    """Write the light of a drop along the eye's ray to out (8,).

    Args:
        stage: The scene.
        p, d, n: Point [m], direction of the ray and normal, shape (3,).
        background: Light beside the drop, shape (3,).
        work: Scratch, shape (72,).
        out: (out) Light, shape (8,).
    """
    t, mirrored, transmitted = work[:3], work[3:6], work[6:9]
    own, medium, rig = work[12:21], stage.medium, stage.rig
    cosine = max(-(d[0] * n[0] + d[1] * n[1] + d[2] * n[2]), 0.02)
    distance = _distance_to_opaque(stage.buffers, p, d, work[9:12])
    if _liquid_behind(stage, p, d, distance, work, out):
        for m in range(3):
            transmitted[m] = out[m]
    elif distance > 1e6:
        size = 0.0
        for m in range(3):
            t[m] = d[m] - 0.55 * n[m] * np.sqrt(1.0 - cosine)
            size += t[m] * t[m]
        size = 1.0 / np.sqrt(size)
        far_light(
            stage, p[0], p[1], p[2], t[0] * size, t[1] * size, t[2] * size, True, 0.1, work[9:12],
            transmitted,
        )  # fmt: skip
        for m in range(3):
            transmitted[m] = 0.6 * transmitted[m] + 0.4 * background[m]
    else:  # a close background looks as beside the drop
        for m in range(3):
            transmitted[m] = background[m]
    mirrored_sky(
        rig, d[0] + 2.0 * cosine * n[0], d[1] + 2.0 * cosine * n[1], d[2] + 2.0 * cosine * n[2],
        0.15, mirrored,
    )  # fmt: skip
    # a turbid liquid scatters light of its own, as in shade_ray of liquid_radiance.py
    look_up_tint(medium.tint, p, own)
    share = (0.02 + 0.98 * (1.0 - cosine) ** 5) * (1.0 - own[8])
    glow = 1.0 - (1.0 - own[8]) * np.exp(-own[7] * THICK * medium.field.cell)
    for m in range(3):
        inside = own_light(own, m, DIRECT * rig.key[m] + AMBIENT * rig.horizon[m])
        through = (1.0 - glow) * transmitted[m] + glow * inside
        out[m] = share * min(mirrored[m], 4.0) + (1.0 - share) * through


@njit_cached(**RAY)
def _distance_to_opaque(view, p, d, pixel):
    """Return the distance [m] from p (3,) along d (3,) to an opaque surface, 1e9 for none."""
    if not project(view, p[0], p[1], p[2], pixel):
        return 1e9
    k, j = int(np.floor(pixel[0])), int(np.floor(pixel[1]))
    if not (0 <= j < view.depth.shape[0] and 0 <= k < view.depth.shape[1]):
        return 1e9
    w = view.pose
    along = w[2, 0] * d[0] + w[2, 1] * d[1] + w[2, 2] * d[2]
    return min((view.depth[j, k] - pixel[2]) / max(along, 1e-3), 1e9)


@njit_cached(**RAY)
def _liquid_behind(stage, p, d, max_distance, work, out):
    """Trace the ray d (3,) from p (3,) to the liquid and write its light to out (8,).

    Returns whether the ray meets the liquid within max_distance [m].
    """
    field = stage.medium.field
    t, wall = first_hit(field, p[0], p[1], p[2], d[0], d[1], d[2], 0.5 * field.cell, max_distance)
    if t < 0.0:
        return False
    q = work[69:72]
    for m in range(3):
        q[m] = p[m] + t * d[m]
        out[4 + m] = 0.0
    shade_ray(stage, q, d, wall, field.cell, 0.1, work, out)
    return True


def foam_source(x: np.ndarray, velocity: np.ndarray, spacing: float) -> np.ndarray:
    """Return the air that particles trap, 0..1 (n,), where the flow is rough, fast and thin.

    Args:
        x: Positions, shape (n, 3) [m].
        velocity: Velocities, shape (n, 3) [m/s].
        spacing: Distance of particles [m].
    """
    total = new_grid(x.min(axis=0) - 3 * spacing, x.max(axis=0) + 3 * spacing, 2 * spacing)
    sums = total._replace(values=np.zeros((*total.values.shape, 4), np.float32))
    values = np.column_stack([velocity, (velocity**2).sum(axis=1)])
    deposit(x, np.full(len(x), 3.0 * spacing), np.full(len(x), KERNEL / 27), values, total, sums)
    mean = sums.values / np.maximum(total.values, 1e-6)[..., None]
    spread = np.maximum(mean[..., 3] - (mean[..., :3] ** 2).sum(axis=-1), 0.0)
    roughness = sample(total._replace(values=np.sqrt(spread).astype(np.float32)), x)
    density = sample(total, x)
    thinness = np.clip((0.95 - density / max(float(np.percentile(density, 90)), 1e-9)) / 0.4, 0, 1)
    speed = np.linalg.norm(velocity, axis=1)
    source = np.clip((roughness - 0.09) / 0.25, 0, 1) * np.clip((speed - 0.4) / 1.2, 0, 1)
    return source * (0.35 + 0.65 * thinness)


def advance_foam(foam: np.ndarray, ids: np.ndarray, source: np.ndarray, dt: float) -> None:
    """Advance the foam of all particles by a time dt [s] in place: it decays and grows.

    Args:
        foam: (in/out) Foam fraction of every particle, shape (all,).
        ids: Numbers of the liquid's particles in the frame, shape (n,).
        source: Result of `foam_source`, shape (n,).
        dt: Time step [s].
    """
    foam *= np.exp(-dt / LIFE)
    foam[ids] = np.minimum(foam[ids] + RATE * dt * source, 1.0)
