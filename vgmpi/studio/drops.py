"""Spray: particles that the liquid's field does not hold, as stretched drops; and foam.

References:
    M. Ihmsen, N. Akinci, G. Akinci, M. Teschner. Unified spray, foam and air bubbles for
    particle-based fluids. The Visual Computer 28, 2012.
"""

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.compiling import RAY
from vgmpi.studio.field import Field, densities
from vgmpi.studio.grid import KERNEL, deposit, new_grid, sample
from vgmpi.studio.hashing import uniform
from vgmpi.studio.lighting import mirrored_sky
from vgmpi.studio.liquid import AMBIENT, DIRECT, look_up_tint, shade_ray
from vgmpi.studio.rays import first_hit
from vgmpi.studio.surroundings import far_light, project

ALONE = 0.46  # density at a particle below which it is a drop
TOUCHES = 0.9  # spacings from the liquid's surface within which nothing is a drop
DROPS = 6  # of a particle
EXPOSED = 0.008  # s: over which a drop is drawn out along its way
LIFE = 0.35  # s: in which foam fades
RATE = 10.2  # 1/s at most that it grows by
THICK = 2.0  # cells of the field: way through a drop


def spray(x: np.ndarray, velocity: np.ndarray, ids: np.ndarray, liquid: Field, spacing: float):
    """Drops as spheroids.

    Args:
        x: (n, 3) positions of the liquid's particles [m].
        velocity: (n, 3) [m/s].
        ids: (n,) their numbers.
        liquid: what holds the others.
        spacing: [m].

    Returns:
        middles (m, 3) [m], unit axes (m, 3), long and short half axes (m,) [m].
    """
    density = densities(liquid, x)
    alone = np.flatnonzero(density < ALONE)
    touch = np.zeros(len(alone), bool)
    for way in np.concatenate([np.eye(3), -np.eye(3)]):
        touch |= densities(liquid, x[alone] + TOUCHES * spacing * way) >= 0.5
    alone = alone[~touch]
    if not len(alone):
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0)
    ids, v = ids[alone], velocity[alone]
    speed = np.linalg.norm(v, axis=1)
    axis = np.where(speed[:, None] > 1e-3, v / np.maximum(speed, 1e-3)[:, None], [0.0, 0.0, 1.0])
    near = np.clip((density[alone] - 0.16) / 0.3, 0, 1)
    middles, longs, shorts = [], [], []
    for c in range(DROPS):
        size = spacing * (0.06 + 0.24 * uniform(ids, 5 + c) ** 2.5) * (0.8 + 0.6 * near)
        off = np.stack([uniform(ids, 12 + 3 * c + a) for a in range(3)], axis=1) - 0.5
        middles.append(x[alone] + off * spacing * 1.3 * (1 - 0.4 * near)[:, None])
        longs.append(size + np.minimum(0.5 * EXPOSED * speed, 2.0 * size))
        shorts.append(size)
    axes = np.tile(axis, (DROPS, 1))
    return np.concatenate(middles), axes, np.concatenate(longs), np.concatenate(shorts)


@cached(nogil=True, error_model="numpy")
def paint_drops(x, axis, long, short, view, depth, normal):
    """Nearest spheroids: depth (height, width) [m] and world normal (height, width, 3) per
    pixel."""
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
        # |y|^2 / s2 + kk (a . y)^2 = 1 of y = t (u, v, 1) - c
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


@cached(**RAY)
def shade_drop(stage, p, d, n, behind, work, out):
    """Light of a drop at p (3,) with normal n (3,) along the eye's ray d (3,), into out (8,).

    behind: (3,) light of what is seen beside it. work: (72,) scratch.
    """
    t, mirrored, seen = work[:3], work[3:6], work[6:9]
    own, medium, rig = work[12:20], stage.medium, stage.rig
    cosine = max(-(d[0] * n[0] + d[1] * n[1] + d[2] * n[2]), 0.02)
    far = _way_to_opaque(stage.buffers, p, d, work[9:12])
    if _liquid_behind(stage, p, d, far, work, out):
        for m in range(3):
            seen[m] = out[m]
    elif far > 1e6:
        size = 0.0
        for m in range(3):
            t[m] = d[m] - 0.55 * n[m] * np.sqrt(1.0 - cosine)
            size += t[m] * t[m]
        size = 1.0 / np.sqrt(size)
        far_light(
            stage, p[0], p[1], p[2], t[0] * size, t[1] * size, t[2] * size, True, 0.1, work[9:12],
            seen,
        )  # fmt: skip
        for m in range(3):
            seen[m] = 0.6 * seen[m] + 0.4 * behind[m]
    else:  # what is near behind is seen as beside the drop
        for m in range(3):
            seen[m] = behind[m]
    mirrored_sky(
        rig, d[0] + 2.0 * cosine * n[0], d[1] + 2.0 * cosine * n[1], d[2] + 2.0 * cosine * n[2],
        0.15, mirrored,
    )  # fmt: skip
    # what is turbid has light of its own, as in liquid.shade_ray
    look_up_tint(medium.tint, p, own)
    share = 0.02 + 0.98 * (1.0 - cosine) ** 5
    glow = 1.0 - np.exp(-own[7] * THICK * medium.field.cell)
    for m in range(3):
        inside = own[3 + m] * (DIRECT * rig.key[m] + AMBIENT * rig.horizon[m])
        through = (1.0 - glow) * seen[m] + glow * inside
        out[m] = share * min(mirrored[m], 4.0) + (1.0 - share) * through


@cached(**RAY)
def _way_to_opaque(view, p, d, place):
    """Way [m] from p (3,) along the eye's ray d (3,) to what is opaque, 1e9 for none."""
    if not project(view, p[0], p[1], p[2], place):
        return 1e9
    k, j = int(np.floor(place[0])), int(np.floor(place[1]))
    if not (0 <= j < view.depth.shape[0] and 0 <= k < view.depth.shape[1]):
        return 1e9
    w = view.pose
    along = w[2, 0] * d[0] + w[2, 1] * d[1] + w[2, 2] * d[2]
    return min((view.depth[j, k] - place[2]) / max(along, 1e-3), 1e9)


@cached(**RAY)
def _liquid_behind(stage, p, d, far, work, out):
    """Whether the ray d (3,) from p (3,) on meets the liquid on its way `far` [m]; its light, into
    out (8,)."""
    field = stage.medium.field
    t, wall = first_hit(field, p[0], p[1], p[2], d[0], d[1], d[2], 0.5 * field.cell, far)
    if t < 0.0:
        return False
    q = work[68:71]
    for m in range(3):
        q[m] = p[m] + t * d[m]
    shade_ray(stage, q, d, wall, field.cell, 0.1, work, out)
    return True


def foam_made(x: np.ndarray, velocity: np.ndarray, spacing: float) -> np.ndarray:
    """How much air particles trap, 0..1: where the flow is rough, fast and thin.

    Args:
        x: (n, 3) positions [m].
        velocity: (n, 3) [m/s].
        spacing: [m].
    """
    total = new_grid(x.min(axis=0) - 3 * spacing, x.max(axis=0) + 3 * spacing, 2 * spacing)
    sums = total._replace(values=np.zeros((*total.values.shape, 4), np.float32))
    values = np.column_stack([velocity, (velocity**2).sum(axis=1)])
    deposit(x, np.full(len(x), 3.0 * spacing), np.full(len(x), KERNEL / 27), values, total, sums)
    mean = sums.values / np.maximum(total.values, 1e-6)[..., None]
    spread = np.maximum(mean[..., 3] - (mean[..., :3] ** 2).sum(axis=-1), 0.0)
    rough = sample(total._replace(values=np.sqrt(spread).astype(np.float32)), x)
    dense = sample(total, x)
    top = np.clip((0.95 - dense / max(float(np.percentile(dense, 90)), 1e-9)) / 0.4, 0, 1)
    speed = np.linalg.norm(velocity, axis=1)
    made = np.clip((rough - 0.09) / 0.25, 0, 1) * np.clip((speed - 0.4) / 1.2, 0, 1)
    return made * (0.35 + 0.65 * top)


def foam_later(before: np.ndarray, ids: np.ndarray, made: np.ndarray, dt: float) -> None:
    """Foam of all particles a time dt [s] later, in place: it hangs on them, fades, and is made.

    Args:
        before: (all,) share of foam of every particle.
        ids: (n,) numbers of the liquid's particles that are there.
        made: (n,) of `foam_made`.
        dt: [s].
    """
    before *= np.exp(-dt / LIFE)
    before[ids] = np.minimum(before[ids] + RATE * dt * made, 1.0)
