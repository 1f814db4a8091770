"""Surface meshes: reading, and even sampling with flat Gaussians."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from vgmpi.gaussians.cloud import GaussianCloud, rotation_matrices
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.runtime import process_limits
from vgmpi.runtime.config.toml_source import escape_control_characters, truncate

from .bounded_reader import SUFFIXES, read_by_library
from .mesh_formats import read_obj, read_ply, read_stl
from .triangle_mesh import Mesh

_READERS: dict[str, Callable[[Path], Mesh]] = {
    ".obj": read_obj, ".stl": read_stl, ".ply": read_ply,
    **dict.fromkeys(SUFFIXES, read_by_library),
}  # fmt: skip
FORMATS = tuple(_READERS)
MIN_SAMPLES = 20_000  # Gaussians on a surface, so that small objects are drawn smoothly
FLATNESS = 0.1  # [-] thickness of a disc relative to its radius
RADIUS = 0.6  # [-] standard deviation of a disc relative to sqrt(area / number)
MIN_SIZE, MAX_SIZE = 1e-100, 1e100  # [file units] size of a mesh
_MIN_AREA = 1e-200  # [m2]
_EXPANSION = 1.5  # [bytes] in memory per byte of the file, at least
_MIN_BATCH, _PAIRS_PER_POINT = 4096, 50  # points whose pairs always fit; usual are 10 pairs
_BYTES_PER_CANDIDATE = 80  # [bytes] of a candidate, at least
_CANDIDATES_PER_POINT = 5  # candidates per retained point
_POISSON_DISC_RATIO = 0.72  # [-] minimum distance of two points relative to sqrt(area / number)


class MeshError(ValueError):
    """Error for a file that is no usable surface mesh; one line that names the file."""


def read(path: Path) -> Mesh:
    """Read the triangles of a mesh file; polygons are cut into fans. Raises MeshError."""
    if path.suffix.lower() not in FORMATS:
        raise MeshError(f"{path}: cannot be read as a mesh: allowed are {', '.join(FORMATS)}")
    try:
        process_limits.require_memory(
            _EXPANSION * path.stat().st_size, f"its {path.stat().st_size:,} bytes take at least"
        )
        mesh = _READERS[path.suffix.lower()](path)
    except (ValueError, OSError, MemoryError, LookupError, ArithmeticError, EOFError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        lines = (reason or "needs more memory than there is").splitlines()
        reason = truncate(escape_control_characters(lines[0]))
        raise MeshError(f"{path}: cannot be read as a mesh: {reason}") from None
    if not len(mesh.triangles):
        raise MeshError(f"{path}: holds no triangles or polygons")
    low, high = mesh.triangles.min(), mesh.triangles.max()
    if not np.isfinite(mesh.points).all() or low < 0 or high >= len(mesh.points):
        raise MeshError(f"{path}: has points that are not finite or triangles without points")
    extent = float(np.ptp(mesh.points[mesh.triangles.ravel()], axis=0).max())
    if not MIN_SIZE <= extent <= MAX_SIZE or np.abs(mesh.points).max() > MAX_SIZE:
        raise MeshError(f"{path}: is {extent:.3g} large; allowed are {MIN_SIZE:g} to {MAX_SIZE:g}")
    return mesh


def sample(
    mesh: Mesh,
    spacing: float,
    color: tuple,
    opacity: float,
    key: list[int],
    min_count: int = MIN_SAMPLES,
) -> GaussianCloud:
    """Sample a placed mesh evenly (Poisson disc) with flat Gaussians, `spacing` / 2 [m] apart.

    Args:
        mesh: Placed mesh.
        spacing: Particle spacing [m].
        color: Color where the mesh has none.
        opacity: Opacity of all.
        key: Seed; equal keys give equal points.
        min_count: Lower limit of the number of Gaussians.

    Raises MeshError for a mesh without area, InsufficientMemoryError.
    """
    corner = mesh.corners()
    with np.errstate(over="ignore", under="ignore"):  # such an area is refused
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        double = np.linalg.norm(cross, axis=1)
        area = double.sum() / 2
    if not (_MIN_AREA < area < np.inf):
        raise MeshError(f"its triangles have an area of {area:.3g} m2: they are lines or points")
    count = max(min_count, area / (spacing / 2) ** 2)
    message = f"{count:.3g} Gaussians, {spacing / 2:g} m apart on a surface of {area:.3g} m2, take"
    process_limits.require_memory(
        _BYTES_PER_CANDIDATE * _CANDIDATES_PER_POINT * count, f"{message} at least"
    )
    count = int(count)
    random = np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))
    draw = random.random((_CANDIDATES_PER_POINT * count, 3))
    edges = np.cumsum(double)
    chosen = np.minimum(np.searchsorted(edges, draw[:, 0] * edges[-1]), len(edges) - 1)
    root, v = np.sqrt(draw[:, 1:2]), draw[:, 2:3]
    weights = np.concatenate([1 - root, root * (1 - v), root * v], axis=1)  # barycentric (n, 3)
    x = (weights[:, :, None] * corner[chosen]).sum(axis=1)
    retained = poisson_disc_subset(x, _POISSON_DISC_RATIO * np.sqrt(area / count))
    normal = cross[chosen[retained]] / double[chosen[retained], None]
    rgb = np.tile(np.asarray(color, dtype=float), (len(retained), 1))
    if mesh.triangle_rgb is not None:
        own = mesh.triangle_rgb[chosen[retained]]
        rgb = np.where(np.isfinite(own), own, rgb)
    if mesh.rgb is not None:
        rgb = (weights[retained, :, None] * mesh.rgb[mesh.triangles[chosen[retained]]]).sum(axis=1)
    if mesh.textures is not None:
        rgb = mesh.textures.color(chosen[retained], weights[retained], rgb)
    radius = RADIUS * np.sqrt(area / len(retained))
    return GaussianCloud(
        x[retained], quaternion_to_normal(normal),
        np.tile([radius, radius, FLATNESS * radius], (len(retained), 1)),
        np.full(len(retained), opacity), dc_from_rgb(rgb)[:, None, :].astype(np.float32),
    )  # fmt: skip


def quaternion_to_normal(normal: np.ndarray) -> np.ndarray:
    """Return quaternions w, x, y, z (n, 4) that rotate the z axis to unit normals (n, 3)."""
    x, y, z = normal.T
    zero = np.zeros_like(x)
    quat = np.stack([1.0 + z, -y, x, zero], axis=1)
    quat = np.where((z > -0.999999)[:, None], quat, (0.0, 1.0, 0.0, 0.0))  # half a turn
    return quat / np.linalg.norm(quat, axis=1, keepdims=True)


def poisson_disc_subset(x: np.ndarray, distance: float) -> np.ndarray:
    """Return indices of points no two of which are closer than `distance` [m]; earlier points win.

    The result is that of testing points one by one, in a few vectorized rounds. If points are so
    close that their pairs would fill the memory, as on overlapping triangles, they are taken in
    batches: points near a taken one are removed before pairs are searched.
    """
    taken = np.empty(0, dtype=np.int64)
    first, batch_size = 0, len(x)
    while first < len(x):
        rows = np.arange(first, min(first + batch_size, len(x)))
        if len(taken):
            beyond = np.nextafter(distance, np.inf)
            rows = rows[
                scipy.spatial.cKDTree(x[taken]).query(x[rows], distance_upper_bound=beyond)[0]
                > distance
            ]
        tree = scipy.spatial.cKDTree(x[rows]) if len(rows) else None
        if tree and _is_overcrowded(tree, distance, _PAIRS_PER_POINT * len(x)):
            batch_size = max(len(rows) // 8, _MIN_BATCH)
            continue
        if tree:
            pairs = tree.query_pairs(distance, output_type="ndarray")  # (m, 2), first < second
            taken = np.concatenate([taken, rows[_greedy_independent(len(rows), pairs)]])
        first += batch_size
        batch_size = first  # as many again
    return taken


def _is_overcrowded(tree: Any, distance: float, limit: int) -> bool:
    """Return whether samples of points suggest more than about `limit` neighbors in all."""
    if tree.n <= _MIN_BATCH:
        return False
    # The first sample is small, since crowded points take long.
    for sample_count in (64, _MIN_BATCH):
        sample = tree.data[:: max(1, tree.n // sample_count)]
        neighbor_counts = tree.query_ball_point(sample, distance, return_length=True)
        if neighbor_counts.mean() * tree.n > limit:
            return True
    return False


def _greedy_independent(count: int, pairs: np.ndarray) -> np.ndarray:
    """Return which of `count` items to take, in order, if no pair (m, 2) may be taken."""
    taken = np.zeros(count, dtype=bool)
    open_ = np.ones(count, dtype=bool)
    while open_.any():
        blocked = np.zeros(count, dtype=bool)
        blocked[pairs[:, 1]] = True
        accepted = open_ & ~blocked
        taken |= accepted
        open_ &= ~accepted
        excluded = pairs[:, 1][accepted[pairs[:, 0]]]
        open_[excluded] = False
        pairs = pairs[open_[pairs].all(axis=1)]
    return np.flatnonzero(taken)


def normals(cloud: GaussianCloud) -> np.ndarray:
    """Return the directions (n, 3) in which flat Gaussians face: their third axes."""
    return rotation_matrices(cloud.quat)[:, :, 2]
