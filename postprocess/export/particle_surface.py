"""Surfaces of particles as triangle meshes, by the reconstruction of pysplashsurf.

Kernels of the particles are summed on a lattice, marching cubes give the surface where the sum is
ISO_VALUE, and the mesh is smoothed by weights that spare drops and thin sheets (Loeschner et al.,
Weighted Laplacian Smoothing for Surface Reconstruction of Particle-based Fluids, 2023). Lengths
follow from the distance of the particles. The choice of the numbers is told in
docs/how-to/paraview-and-blender.md.
"""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.io.run_reader import RunError

# radius of a sphere of a particle's volume over the distance of particles
RADIUS = 0.62
SMOOTHING_LENGTH, CUBE_SIZE = 3.0, 0.75  # in radii; the kernel reaches twice the smoothing length
ISO_VALUE = 0.65  # particles fill space with 1
# particles within the kernel from which on a vertex is smoothed fully; 13 for SMOOTHING_LENGTH = 2
# and a radius of half the distance
FULL_WEIGHT = 70.0
SMOOTHING_STEPS = 15
NEIGHBORS = 8  # particles whose values a vertex has the mean of
# in volumes of a particle: voids inside that are smaller are gaps between particles and no bubbles,
# and closed parts that are smaller are mirror images that were moved onto their wall
MIN_CAVITY, MIN_PART = 27.0, 1e-3


class SurfaceMesh(NamedTuple):
    """Closed triangle mesh: each edge has two triangles."""

    vertices: np.ndarray  # (n, 3) float64 [m]
    triangles: np.ndarray  # (m, 3) int64, outward by the right-hand rule
    fields: dict[str, np.ndarray]  # values at the vertices, (n,) or (n, k) float64


def reconstruct_surface(
    x: np.ndarray, spacing: float, fields: dict[str, np.ndarray], size: np.ndarray | None = None,
    steps: int = SMOOTHING_STEPS,
) -> SurfaceMesh:  # fmt: skip
    """Return the surface of particles.

    With the size of a domain, its walls cut the surface flat: particles close to a wall are
    mirrored, and vertices beyond it are moved onto it. Equal particles give equal bits.

    Args:
        x: Positions, shape (n, 3) [m].
        spacing: Distance of the particles at rest [m].
        fields: Values of the particles, shape (n,) or (n, k), to be interpolated to the vertices.
        size: Edges of the domain from (0, 0, 0), shape (3,) [m], or None.
        steps: Number of smoothing steps of the mesh.

    Raises:
        RunError: If pysplashsurf is not installed.
    """
    try:
        import pysplashsurf
    except ImportError:
        message = "--surface needs pysplashsurf, not installed: pip install 'vgmpi[mesh]'"
        raise RunError(message) from None
    if not len(x):
        return SurfaceMesh(
            np.zeros((0, 3)), np.zeros((0, 3), np.int64), {k: v[:0] for k, v in fields.items()}
        )
    radius = RADIUS * spacing
    sources = np.ascontiguousarray(x, np.float64)
    if size is not None:
        sources = _with_mirror_images(sources, size, 2 * SMOOTHING_LENGTH * radius)
    result, _ = pysplashsurf.reconstruction_pipeline(
        sources,
        particle_radius=radius,
        smoothing_length=SMOOTHING_LENGTH,
        cube_size=CUBE_SIZE,
        iso_surface_threshold=ISO_VALUE,
        multi_threading=False,  # threads add in any order: other bits in each run
        mesh_cleanup=True,
        mesh_smoothing_weights=True,
        mesh_smoothing_weights_normalization=FULL_WEIGHT,
        mesh_smoothing_iters=steps,
    )
    triangle_mesh: Any = result.mesh  # of triangles alone: no quads were asked for
    vertices = np.array(triangle_mesh.vertices, np.float64)
    triangles = np.array(triangle_mesh.triangles).astype(np.int64).reshape(-1, 3)
    vertices, triangles = _in_order(vertices, triangles)
    if size is not None:
        vertices = np.clip(vertices, 0.0, size)
    vertices, triangles = _without_small_cavities(vertices, triangles, spacing**3)
    return SurfaceMesh(vertices, triangles, _interpolated(vertices, x, spacing, fields))


def _interpolated(
    vertices: np.ndarray, x: np.ndarray, spacing: float, fields: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return means of the values of the nearest particles by their inverse squared distances.

    Args:
        vertices: Positions of the mesh, shape (m, 3) [m].
        x: Positions of the particles, shape (n, 3) [m].
        spacing: Distance of the particles at rest [m].
        fields: Values of the particles, shape (n,) or (n, k).
    """
    from scipy.spatial import cKDTree

    count = min(NEIGHBORS, len(x))
    distance, rows = cKDTree(x).query(vertices, count)
    distance, rows = distance.reshape(-1, count), rows.reshape(-1, count)
    weight = 1.0 / (distance**2 + (0.25 * spacing) ** 2)
    weight /= weight.sum(1, keepdims=True)
    return {
        name: np.einsum("mk,mk...->m...", weight, np.asarray(values, np.float64)[rows])
        for name, values in fields.items()
    }


def _without_small_cavities(
    vertices: np.ndarray, triangles: np.ndarray, volume: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh without small voids and without closed parts of no volume.

    Args:
        vertices: Positions, shape (n, 3) [m].
        triangles: Numbers of vertices, shape (m, 3).
        volume: Volume of a particle [m3].
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count, t = len(vertices), triangles
    pairs = np.tile(t[:, 0], 2), t[:, 1:].T.ravel()
    edges = coo_array((np.ones(2 * len(t)), pairs), (count, count))
    part = connected_components(edges, directed=False)[1]
    a, b, c = (vertices[t[:, k]] for k in range(3))
    sixfold = np.bincount(part[t[:, 0]], np.einsum("na,na->n", a, np.cross(b, c)), part.max() + 1)
    is_small = (sixfold > -6.0 * MIN_CAVITY * volume) & (sixfold < 6.0 * MIN_PART * volume)
    vertex_mask = ~is_small[part]
    number = np.cumsum(vertex_mask) - 1
    return vertices[vertex_mask], number[t[vertex_mask[t[:, 0]]]]


def _with_mirror_images(x: np.ndarray, size: np.ndarray, reach: float) -> np.ndarray:
    """Return positions with their mirror images in walls that are closer than `reach`, (m, 3)."""
    for axis in range(3):
        for wall in (0.0, float(size[axis])):
            image = x[np.abs(x[:, axis] - wall) < reach]
            image[:, axis] = 2.0 * wall - image[:, axis]
            x = np.concatenate([x, image])
    return x


def _in_order(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the mesh with vertices by their coordinates, and triangles by their vertices."""
    order = np.lexsort(vertices.T[::-1])
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    triangles = number[triangles]
    first = (triangles.argmin(1)[:, None] + np.arange(3)) % 3
    triangles = np.take_along_axis(triangles, first, 1)
    return vertices[order], triangles[np.lexsort(triangles.T[::-1])]
