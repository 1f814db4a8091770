"""Sand and snow as many small Gaussians: children of the particles that may be seen.

All that is random is a hash of the particle's number and the child's, so that nothing changes from
frame to frame but what moves.

References:
    M. Roberts. The unreasonable effectiveness of quasirandom sequences. 2018 (R3).
    R. Cranley, T. N. L. Patterson. Randomization of number theoretic methods for multiple
    integration. SIAM J. Numer. Anal. 13, 1976.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.caching import cached
from vgmpi.studio.grid import KERNEL, deposit, new_grid, trilinear
from vgmpi.studio.hashing import low_discrepancy

REACH = 2.6  # spacings of the kernels whose sum says how dense it is
BURIED = 0.85  # density of all cells around, from which on a particle is not seen
OPACITY = 0.95
SIZE = 0.28  # spacings: standard deviation of one of eight children
SAND_CHROMA = 0.62  # of what looks like sand without a light
FOOT = 3.0, 4.0  # spacings by which grains at a heap's foot roll aside at most, and its height
BEHIND = -0.35  # cosine between normal and way to the eye, below which a dense particle is hidden


class Grains(NamedTuple):
    """x: (n, 3) [m]. cov: (n, 6) [m2]. opacity: (n,). color: (n, 3) display values. normal: (n, 3).
    sandy: (n,) whether of sand."""

    x: np.ndarray
    cov: np.ndarray
    opacity: np.ndarray
    color: np.ndarray
    normal: np.ndarray
    sandy: np.ndarray


class Seeds(NamedTuple):
    """Particles that get children, a row each.

    Attributes:
        x: positions [m].
        ids: numbers, uint64.
        spacing: [m].
        stretch: (n, 6) of the lattice around them.
        color: (n, 3) display values.
        sandy: whether of sand.
        density: around them, 1 inside of bodies.
        normal: (n, 3).
        lonely: 0..1, how much they have come apart.
        dusty: whether they have dust.
    """

    x: np.ndarray
    ids: np.ndarray
    spacing: np.ndarray
    stretch: np.ndarray
    color: np.ndarray
    sandy: np.ndarray
    density: np.ndarray
    normal: np.ndarray
    lonely: np.ndarray
    dusty: np.ndarray


class Heap(NamedTuple):
    """What is known of the particles of sand and snow before anybody looks at them.

    Attributes:
        rows: those that may be seen.
        density: (m,) around them, 1 inside of bodies.
        normal: (m, 3) unit vectors away from where it is denser.
    """

    rows: np.ndarray
    density: np.ndarray
    normal: np.ndarray


def heap(x: np.ndarray, spacing: np.ndarray, floor: float = -np.inf) -> Heap:
    """Densities and normals of the particles of sand and snow that may be seen.

    Args:
        x: (n, 3) positions [m].
        spacing: (n,) [m].
        floor: height of what they lie on, which goes on below [m].
    """
    from scipy import ndimage

    s = float(np.median(spacing))
    total = new_grid(x.min(axis=0) - 4 * s, x.max(axis=0) + 4 * s, s)
    s = total.cell  # coarser where particles are far apart
    none = total._replace(values=np.zeros((1, 1, 1, 0), np.float32))
    weight = np.full(len(x), KERNEL / REACH**3)
    deposit(x, REACH * spacing, weight, np.zeros((len(x), 0)), total, none)
    if np.isfinite(floor):
        _mirror(total.values, (floor - total.lower[2]) / s)
    full = ndimage.minimum_filter(total.values, 5)
    at = np.round((x - total.lower) / s).astype(int)
    rows = np.flatnonzero(full[at[:, 0], at[:, 1], at[:, 2]] <= BURIED)
    smooth = ndimage.gaussian_filter(total.values, 0.9)
    density, normal = np.empty(len(rows)), np.empty((len(rows), 3))
    places = np.ascontiguousarray((x[rows] - total.lower) / s)
    _normals(places, total.values, smooth, density, normal)
    return Heap(rows, density, normal)


def _mirror(values: np.ndarray, plane: float) -> None:
    """Let what lies above a plane (in nodes along z) go on below it, and count on both sides."""
    from vgmpi.studio.field import wall_share

    nodes = np.arange(values.shape[2])
    above = nodes >= plane
    share = wall_share(nodes[above], plane, np.inf, REACH / np.sqrt(11.0))
    values[:, :, above] /= share.astype(np.float32)
    for k in nodes[~above]:
        other = min(int(round(2 * plane - k)), values.shape[2] - 1)
        values[:, :, k] = values[:, :, max(other, int(np.ceil(plane)))]


@cached(nogil=True, error_model="numpy")
def _normals(at, density, smooth, out, normal):
    for p in range(len(at)):
        x, y, z = at[p, 0], at[p, 1], at[p, 2]
        out[p] = trilinear(density, x, y, z)
        a = trilinear(smooth, x - 1.0, y, z) - trilinear(smooth, x + 1.0, y, z)
        b = trilinear(smooth, x, y - 1.0, z) - trilinear(smooth, x, y + 1.0, z)
        c = trilinear(smooth, x, y, z - 1.0) - trilinear(smooth, x, y, z + 1.0)
        size = 1.0 / max(np.sqrt(a * a + b * b + c * c), 1e-9)
        normal[p, 0], normal[p, 1], normal[p, 2] = a * size, b * size, c * size


def grains(
    x: np.ndarray, ids: np.ndarray, spacing: np.ndarray, stretch: np.ndarray, color: np.ndarray,
    sandy: np.ndarray, seen: Heap, eye: np.ndarray, floor: float, children: int, dust: float,
) -> Grains:  # fmt: skip
    """The Gaussians of sand and snow as seen from `eye`.

    Args:
        x: (n, 3) positions [m].
        ids: (n,) numbers of the particles.
        spacing: (n,) [m].
        stretch: (n, 6) of the lattice around them.
        color: (n, 3) display values.
        sandy: (n,) whether of sand, or else of snow.
        seen: of `heap`.
        eye: (3,) [m].
        floor: height below which no grain lies [m].
        children: of a particle.
        dust: opacity of the dust between what has come apart.
    """
    toward = eye - x[seen.rows]
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-9)
    facing = (toward * seen.normal).sum(axis=1)
    front = np.flatnonzero((facing > BEHIND) | (seen.density < 0.6))
    rows = seen.rows[front]
    lonely = np.clip((0.45 - seen.density[front]) / 0.35, 0.0, 1.0)
    dusty = (lonely > 0.05) & (dust > 0)
    n = len(rows) * children + np.count_nonzero(dusty)
    out = Grains(
        np.empty((n, 3)), np.empty((n, 6)), np.empty(n), np.empty((n, 3)), np.empty((n, 3)),
        np.empty(n, bool),
    )  # fmt: skip
    gray = color.mean(axis=1, keepdims=True)
    base = np.where(sandy[:, None], gray + SAND_CHROMA * (color - gray), color)
    seeds = Seeds(
        np.ascontiguousarray(x[rows], dtype=np.float64), ids[rows].astype(np.uint64), spacing[rows],
        stretch[rows], base[rows], sandy[rows], seen.density[front], seen.normal[front], lonely,
        dusty,
    )  # fmt: skip
    _scatter(seeds, low_discrepancy(children), float(floor), float(dust), out)
    return out


@cached(nogil=True, error_model="numpy")
def _random(number, stream):
    """In 0..1, as hashing.uniform."""
    bits = number * np.uint64(256) + np.uint64(stream + 1)
    bits *= np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((bits ^ (bits >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


@cached(nogil=True, error_model="numpy")
def _scatter(seeds, points, floor, dust, out):
    at = 0
    axis = np.empty(3)
    for p in range(len(seeds.x)):
        for c in range(len(points)):
            _place_child(seeds, p, c, points, floor, axis, at, out)
            at += 1
        if seeds.dusty[p]:
            _place_dust(seeds, p, dust, at, out)
            at += 1


@cached(nogil=True, error_model="numpy")
def _loose(V):
    """How far a lattice of stretch V (6,) is from that at rest, 0..1."""
    square = (V[0] - 1.0) ** 2 + (V[3] - 1.0) ** 2 + (V[5] - 1.0) ** 2
    square += 2.0 * (V[1] ** 2 + V[2] ** 2 + V[4] ** 2)
    return min(2.0 * np.sqrt(square), 1.0)


@cached(nogil=True, error_model="numpy")
def _place_child(seeds, p, c, points, floor, axis, at, out):
    """Fill row `at` with child c of particle p. points: (children, 3) in the unit cube."""
    s, V, number, sandy = seeds.spacing[p], seeds.stretch[p], seeds.ids[p], seeds.sandy[p]
    count, stream = len(points), 8 * (c % 16)
    thin = min(max((0.75 - seeds.density[p]) / 0.5, 0.0), 1.0)
    # sparse: a puff around the particle; dense: fills its cell
    wide = s * (1.15 + (1.3 if sandy else 0.35) * thin)
    flat = 0.0 if sandy else 0.8 * seeds.lonely[p]
    u0 = (points[c, 0] + _random(number, 0)) % 1.0 - 0.5
    u1 = (points[c, 1] + _random(number, 1)) % 1.0 - 0.5
    u2 = (points[c, 2] + _random(number, 2)) % 1.0 - 0.5
    spread = _random(number, 10 + stream) + _random(number, 11 + stream) - 1.0
    sd = SIZE * s * (8.0 / count) ** (1.0 / 3.0) * (1.0 - 0.45 * thin)
    sd *= np.exp(0.55 * spread) * (1.0 + 0.5 * flat)
    x = seeds.x[p]
    # at the foot of a heap rows of the lattice come apart: grains roll aside
    rolls = FOOT[0] * s * _loose(V) if sandy else 0.0
    rolls *= min(max(FOOT[1] - (x[2] - floor) / s, 0.0), 1.0)
    aside = 150 + 4 * (c % 16)
    r0 = rolls * (_random(number, aside) + _random(number, aside + 1) - 1.0)
    r1 = rolls * (_random(number, aside + 2) + _random(number, aside + 3) - 1.0)
    out.x[at, 0] = x[0] + wide * (V[0] * u0 + V[1] * u1 + V[2] * u2) + r0
    out.x[at, 1] = x[1] + wide * (V[1] * u0 + V[3] * u1 + V[4] * u2) + r1
    out.x[at, 2] = max(x[2] + wide * (V[2] * u0 + V[4] * u1 + V[5] * u2), floor + 0.3 * sd)
    tone, rough = (0.42, 0.8) if sandy else (0.06, 0.35)
    size = 0.0
    for m in range(3):
        axis[m] = _random(number, 12 + m + stream) - 0.5
        out.normal[at, m] = seeds.normal[p, m] + rough * axis[m]
        size += axis[m] * axis[m]
    size, k = 1.0 / max(np.sqrt(size), 1e-6), 0
    # flakes: discs that lie about, where snow has come apart
    for a in range(3):
        for b in range(a, 3):
            flake = flat * axis[a] * axis[b] * size * size
            out.cov[at, k] = sd * sd * ((1.0 if a == b else 0.0) - flake)
            k += 1
    out.opacity[at], out.sandy[at] = OPACITY, sandy
    tint = 1.0 + tone * (_random(number, 15 + stream) + _random(number, 16 + stream) - 1.0)
    hue = 0.05 * (_random(number, 17 + stream) - 0.5) if sandy else 0.0
    color = seeds.color[p]
    out.color[at, 0] = min(max(color[0] * tint * (1.0 + hue), 0.0), 1.0)
    out.color[at, 1] = min(max(color[1] * tint, 0.0), 1.0)
    out.color[at, 2] = min(max(color[2] * tint * (1.0 - 1.6 * hue), 0.0), 1.0)


@cached(nogil=True, error_model="numpy")
def _place_dust(seeds, p, dust, at, out):
    """Fill row `at` with the dust around particle p; dust: its opacity where p is alone."""
    s, V, number, k = seeds.spacing[p], seeds.stretch[p], seeds.ids[p], 0
    sd = s * (1.2 + 1.6 * _random(number, 140))
    for a in range(3):
        for b in range(a, 3):
            square = 0.0
            for m in range(3):
                i = min(a, m) * (5 - min(a, m)) // 2 + max(a, m)
                j = min(b, m) * (5 - min(b, m)) // 2 + max(b, m)
                square += V[i] * V[j]
            out.cov[at, k] = sd * sd * (0.25 * square + (0.75 if a == b else 0.0))
            k += 1
    for m in range(3):
        out.x[at, m] = seeds.x[p, m] + 1.2 * s * (_random(number, 141 + m) - 0.5)
        out.color[at, m] = min(seeds.color[p, m] * 1.03, 1.0)
        out.normal[at, m] = seeds.normal[p, m]
    out.opacity[at] = dust * seeds.lonely[p]
    out.sandy[at] = seeds.sandy[p]
