"""Sand and snow drawn as many small Gaussians: children of the particles that may be visible.

All random numbers are hashes of the particle's and the child's number, so that from frame to frame
only moving particles change.

References:
    M. Roberts. The unreasonable effectiveness of quasirandom sequences. 2018 (R3).
    R. Cranley, T. N. L. Patterson. Randomization of number theoretic methods for multiple
    integration. SIAM J. Numer. Anal. 13, 1976.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.runtime.compile_cache import njit_cached

from .particle_hash import low_discrepancy
from .value_grid import KERNEL, deposit, new_grid, trilinear

REACH = 2.6  # [spacings] radius of the kernels whose sum is the density
BURIED = 0.85  # [-] density of all cells around a particle that hides it
OPACITY = 0.95  # [-] of a grain
SIZE = 0.28  # [spacings] standard deviation of one of eight children
SAND_CHROMA = 0.62  # [-] factor on the chroma of unlit sand
FOOT = 3.0, 4.0  # [spacings] largest displacement of grains at a heap's foot, its height
HIDDEN_COSINE = -0.35  # [-] cosine of normal and view direction that hides a dense particle


class Grains(NamedTuple):
    """Gaussians of sand and snow.

    Attributes:
        x: Centers, shape (n, 3) [m].
        cov: Upper triangles of covariances, shape (n, 6) [m2].
        opacity: Opacities, shape (n,).
        color: Display values, shape (n, 3).
        normal: Normals, shape (n, 3).
        sandy: Whether of sand, shape (n,).
    """

    x: np.ndarray
    cov: np.ndarray
    opacity: np.ndarray
    color: np.ndarray
    normal: np.ndarray
    sandy: np.ndarray


class Seeds(NamedTuple):
    """Particles that get children, a row each.

    Attributes:
        x: Positions, shape (n, 3) [m].
        ids: Particle numbers, shape (n,) uint64.
        spacing: Spacings, shape (n,) [m].
        stretch: Stretches of the lattice around them, shape (n, 6).
        color: Display values, shape (n, 3).
        sandy: Whether of sand, shape (n,).
        density: Density around them, 1 inside of bodies, shape (n,).
        normal: Normals, shape (n, 3).
        lonely: Isolation from neighbors, 0..1, shape (n,).
        dusty: Whether they have dust, shape (n,).
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


class VisibleParticles(NamedTuple):
    """Potentially visible particles of sand and snow, independent of the camera.

    Attributes:
        rows: Their rows, shape (m,).
        density: Density around them, 1 inside of bodies, shape (m,).
        normal: Unit vectors towards lower density, shape (m, 3).
    """

    rows: np.ndarray
    density: np.ndarray
    normal: np.ndarray


def find_visible_particles(
    x: np.ndarray, spacing: np.ndarray, floor: float = -np.inf
) -> VisibleParticles:
    """Return densities and normals of the particles of sand and snow that may be visible.

    Args:
        x: Positions, shape (n, 3) [m].
        spacing: Spacings, shape (n,) [m].
        floor: Height of the ground, below which the material continues [m].
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
    cells = np.round((x - total.lower) / s).astype(int)
    rows = np.flatnonzero(full[cells[:, 0], cells[:, 1], cells[:, 2]] <= BURIED)
    smooth = ndimage.gaussian_filter(total.values, 0.9)
    density, normal = np.empty(len(rows)), np.empty((len(rows), 3))
    positions = np.ascontiguousarray((x[rows] - total.lower) / s)
    _normals(positions, total.values, smooth, density, normal)
    return VisibleParticles(rows, density, normal)


def _mirror(values: np.ndarray, plane: float) -> None:
    """Mirror the density above a plane (in nodes along z), corrected for the kernels' loss."""
    from .density_field import wall_share

    nodes = np.arange(values.shape[2])
    above = nodes >= plane
    share = wall_share(nodes[above], plane, np.inf, REACH / np.sqrt(11.0))
    values[:, :, above] /= share.astype(np.float32)
    for k in nodes[~above]:
        source = min(int(round(2 * plane - k)), values.shape[2] - 1)
        values[:, :, k] = values[:, :, max(source, int(np.ceil(plane)))]


@njit_cached(nogil=True, error_model="numpy")
def _normals(positions, density, smooth, out, normal):
    """Write densities (n,) and unit normals (n, 3) at grid coordinates."""
    for p in range(len(positions)):
        x, y, z = positions[p, 0], positions[p, 1], positions[p, 2]
        out[p] = trilinear(density, x, y, z)
        a = trilinear(smooth, x - 1.0, y, z) - trilinear(smooth, x + 1.0, y, z)
        b = trilinear(smooth, x, y - 1.0, z) - trilinear(smooth, x, y + 1.0, z)
        c = trilinear(smooth, x, y, z - 1.0) - trilinear(smooth, x, y, z + 1.0)
        size = 1.0 / max(np.sqrt(a * a + b * b + c * c), 1e-9)
        normal[p, 0], normal[p, 1], normal[p, 2] = a * size, b * size, c * size


def grains(
    x: np.ndarray, ids: np.ndarray, spacing: np.ndarray, stretch: np.ndarray, color: np.ndarray,
    sandy: np.ndarray, pile: VisibleParticles, eye: np.ndarray, floor: float, children: int,
    dust: float,
) -> Grains:  # fmt: skip
    """Return the Gaussians of sand and snow as seen from `eye`.

    Args:
        x: Positions, shape (n, 3) [m].
        ids: Particle numbers, shape (n,).
        spacing: Spacings, shape (n,) [m].
        stretch: Stretches of the lattice around them, shape (n, 6).
        color: Display values, shape (n, 3).
        sandy: Whether of sand, or else of snow, shape (n,).
        pile: Result of `find_visible_particles`.
        eye: Position of the camera, shape (3,) [m].
        floor: Height below which no grain lies [m].
        children: Children of a particle.
        dust: Opacity of the dust between separated particles.
    """
    toward = eye - x[pile.rows]
    toward /= np.maximum(np.linalg.norm(toward, axis=1, keepdims=True), 1e-9)
    facing = (toward * pile.normal).sum(axis=1)
    front = np.flatnonzero((facing > HIDDEN_COSINE) | (pile.density < 0.6))
    rows = pile.rows[front]
    lonely = np.clip((0.45 - pile.density[front]) / 0.35, 0.0, 1.0)
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
        stretch[rows], base[rows], sandy[rows], pile.density[front], pile.normal[front], lonely,
        dusty,
    )  # fmt: skip
    _scatter(seeds, low_discrepancy(children), float(floor), float(dust), out)
    return out


@njit_cached(nogil=True, error_model="numpy")
def _random(number, stream):
    """Return a random number in 0..1, as particle_hash.uniform."""
    bits = number * np.uint64(256) + np.uint64(stream + 1)
    bits *= np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return float((bits ^ (bits >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53


@njit_cached(nogil=True, error_model="numpy")
def _scatter(seeds, points, floor, dust, out):
    """Fill in the children and the dust of all particles."""
    row = 0
    axis = np.empty(3)
    for p in range(len(seeds.x)):
        for c in range(len(points)):
            _place_child(seeds, p, c, points, floor, axis, row, out)
            row += 1
        if seeds.dusty[p]:
            _place_dust(seeds, p, dust, row, out)
            row += 1


@njit_cached(nogil=True, error_model="numpy")
def _loose(V):
    """Return the deviation of a lattice of stretch V (6,) from the undeformed one, 0..1."""
    deviation2 = (V[0] - 1.0) ** 2 + (V[3] - 1.0) ** 2 + (V[5] - 1.0) ** 2
    deviation2 += 2.0 * (V[1] ** 2 + V[2] ** 2 + V[4] ** 2)
    return min(2.0 * np.sqrt(deviation2), 1.0)


@njit_cached(nogil=True, error_model="numpy")
def _place_child(seeds, p, c, points, floor, axis, row, out):
    """Fill in a row with child c of particle p. points: (children, 3) in the unit cube."""
    s, V, number, sandy = seeds.spacing[p], seeds.stretch[p], seeds.ids[p], seeds.sandy[p]
    count, stream = len(points), 8 * (c % 16)
    sparsity = min(max((0.75 - seeds.density[p]) / 0.5, 0.0), 1.0)
    # children of a sparse particle spread around it, those of a dense one fill its cell
    width = s * (1.15 + (1.3 if sandy else 0.35) * sparsity)
    flatness = 0.0 if sandy else 0.8 * seeds.lonely[p]
    u0 = (points[c, 0] + _random(number, 0)) % 1.0 - 0.5
    u1 = (points[c, 1] + _random(number, 1)) % 1.0 - 0.5
    u2 = (points[c, 2] + _random(number, 2)) % 1.0 - 0.5
    spread = _random(number, 10 + stream) + _random(number, 11 + stream) - 1.0
    sd = SIZE * s * (8.0 / count) ** (1.0 / 3.0) * (1.0 - 0.45 * sparsity)
    sd *= np.exp(0.55 * spread) * (1.0 + 0.5 * flatness)
    x = seeds.x[p]
    # at the foot of a heap the rows of the lattice separate: grains roll aside
    displacement = FOOT[0] * s * _loose(V) if sandy else 0.0
    displacement *= min(max(FOOT[1] - (x[2] - floor) / s, 0.0), 1.0)
    aside = 150 + 4 * (c % 16)
    r0 = displacement * (_random(number, aside) + _random(number, aside + 1) - 1.0)
    r1 = displacement * (_random(number, aside + 2) + _random(number, aside + 3) - 1.0)
    out.x[row, 0] = x[0] + width * (V[0] * u0 + V[1] * u1 + V[2] * u2) + r0
    out.x[row, 1] = x[1] + width * (V[1] * u0 + V[3] * u1 + V[4] * u2) + r1
    out.x[row, 2] = max(x[2] + width * (V[2] * u0 + V[4] * u1 + V[5] * u2), floor + 0.3 * sd)
    tone, roughness = (0.42, 0.8) if sandy else (0.06, 0.35)
    size = 0.0
    for m in range(3):
        axis[m] = _random(number, 12 + m + stream) - 0.5
        out.normal[row, m] = seeds.normal[p, m] + roughness * axis[m]
        size += axis[m] * axis[m]
    size, k = 1.0 / max(np.sqrt(size), 1e-6), 0
    # loose snow consists of flakes: discs of random orientation
    for a in range(3):
        for b in range(a, 3):
            flake = flatness * axis[a] * axis[b] * size * size
            out.cov[row, k] = sd * sd * ((1.0 if a == b else 0.0) - flake)
            k += 1
    out.opacity[row], out.sandy[row] = OPACITY, sandy
    tint = 1.0 + tone * (_random(number, 15 + stream) + _random(number, 16 + stream) - 1.0)
    hue = 0.05 * (_random(number, 17 + stream) - 0.5) if sandy else 0.0
    color = seeds.color[p]
    out.color[row, 0] = min(max(color[0] * tint * (1.0 + hue), 0.0), 1.0)
    out.color[row, 1] = min(max(color[1] * tint, 0.0), 1.0)
    out.color[row, 2] = min(max(color[2] * tint * (1.0 - 1.6 * hue), 0.0), 1.0)


@njit_cached(nogil=True, error_model="numpy")
def _place_dust(seeds, p, dust, row, out):
    """Fill in a row with the dust around particle p. dust: its opacity where p is isolated."""
    s, V, number, k = seeds.spacing[p], seeds.stretch[p], seeds.ids[p], 0
    sd = s * (1.2 + 1.6 * _random(number, 140))
    for a in range(3):
        for b in range(a, 3):
            squared_stretch = 0.0
            for m in range(3):
                i = min(a, m) * (5 - min(a, m)) // 2 + max(a, m)
                j = min(b, m) * (5 - min(b, m)) // 2 + max(b, m)
                squared_stretch += V[i] * V[j]
            out.cov[row, k] = sd * sd * (0.25 * squared_stretch + (0.75 if a == b else 0.0))
            k += 1
    for m in range(3):
        out.x[row, m] = seeds.x[p, m] + 1.2 * s * (_random(number, 141 + m) - 0.5)
        out.color[row, m] = min(seeds.color[p, m] * 1.03, 1.0)
        out.normal[row, m] = seeds.normal[p, m]
    out.opacity[row] = dust * seeds.lonely[p]
    out.sandy[row] = seeds.sandy[p]
