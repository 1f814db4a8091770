"""Surface meshes: reading, and even sampling with flat Gaussians."""

import contextlib
import io
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from vgmpi.gaussians.cloud import GaussianCloud, rotation_matrices
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.runtime import memory_budget
from vgmpi.runtime.config.toml_source import escape_control_characters, truncate

from . import texture
from .meshio_guard import limited
from .texture import Textures

log = logging.getLogger("vgmpi")

FORMATS = (".obj", ".stl", ".ply", ".vtk", ".vtu")
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


@dataclass(frozen=True)
class Mesh:
    """Triangle mesh.

    points (n, 3) in the file's units, triangles (m, 3) of point numbers, rgb (n, 3) or None;
    textures on its triangles take precedence over rgb.
    """

    points: np.ndarray
    triangles: np.ndarray
    rgb: np.ndarray | None = None
    textures: Textures | None = None

    def corners(self) -> np.ndarray:
        """Return the corners of every triangle, shape (m, 3 corners, 3)."""
        return self.points[self.triangles]


def read(path: Path) -> Mesh:
    """Read the triangles of a mesh file; polygons are cut into fans. Raises MeshError."""
    if path.suffix.lower() not in FORMATS:
        raise MeshError(f"{path}: cannot be read as a mesh: allowed are {', '.join(FORMATS)}")
    try:
        memory_budget.require_memory(
            _EXPANSION * path.stat().st_size, f"its {path.stat().st_size:,} bytes take at least"
        )
        mesh = _read_obj(path) if path.suffix.lower() == ".obj" else _read_any(path)
    except (Exception, SystemExit) as error:  # meshio's readers raise anything, and may exit
        lines = str(error).splitlines()
        no_reason = not lines or isinstance(error, SystemExit)
        reason = (
            "no mesh meshio reads" if no_reason else truncate(escape_control_characters(lines[0]))
        )
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


def _read_any(path: Path) -> Mesh:
    """Read a mesh by meshio."""
    import meshio  # half a second to import: only scenes with such a mesh pay it

    output = io.StringIO()
    with contextlib.redirect_stdout(output), contextlib.redirect_stderr(output), limited(path):
        data = meshio.read(path)
    points = np.asarray(data.points, dtype=np.float64)
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))  # a flat mesh has no z
    fans = [np.empty((0, 3), dtype=np.int64)]
    for block in data.cells:
        if block.type in ("triangle", "quad", "polygon"):
            cells = np.asarray(block.data)
            fans += [cells[:, (0, k, k + 1)] for k in range(1, cells.shape[1] - 1)]
    colors = _vertex_colors(data.point_data, len(points))
    return Mesh(points, np.concatenate(fans).astype(np.int64), colors)


def _read_obj(path: Path) -> Mesh:
    """Return points, their colors, faces and textures of a Wavefront file.

    It is read here, because meshio refuses files with more texture coordinates than points.
    """
    points: list[list[float]] = []
    uv: list[list[float]] = []
    corners: list[tuple[int, int]] = []  # point and texture coordinate (-1: none), 3 per triangle
    materials, libraries, material = [], [], ""
    for line in _lines(path):
        words = line.split()
        match words[:1]:
            case ["v"]:
                points.append([float(word) for word in words[1:]])
            case ["vt"]:
                uv.append([float(word) for word in (*words[1:3], "0")[:2]])
            case ["f"]:
                face = [_corner(word, len(points), len(uv)) for word in words[1:]]
                for k in range(1, len(face) - 1):
                    corners += (face[0], face[k], face[k + 1])
                    materials.append(material)
            case ["mtllib"]:
                libraries.append(line.split(maxsplit=1)[1])
            case ["usemtl"]:
                material = line.split(maxsplit=1)[1].strip() if len(words) > 1 else ""
    colored = bool(points) and all(len(point) >= 6 for point in points)
    rgb = np.clip([point[3:6] for point in points], 0.0, 1.0) if colored else None
    x = np.array([point[:3] for point in points], dtype=np.float64).reshape(-1, 3)
    index = np.array(corners, dtype=np.int64).reshape(-1, 3, 2)
    return Mesh(x, index[:, :, 0], rgb, _textures(path, libraries, materials, uv, index[:, :, 1]))


def _lines(path: Path) -> Iterator[str]:
    """Yield the lines of a text file."""
    with open(path, errors="replace") as file:
        for line in file:
            yield from line.splitlines()  # this includes rare line separators


def _corner(word: str, points: int, uvs: int) -> tuple[int, int]:
    """Return the numbers of point and texture coordinate of "3", "3/1" or "3/1/2"; -1 for none."""
    point, _, more = word.partition("/")
    uv = more.partition("/")[0]
    # Numbers count from 1; negative ones count from the last.
    numbers = [
        n - 1 if n > 0 else count + n for n, count in ((int(point), points), (int(uv or 0), uvs))
    ]
    return numbers[0], numbers[1] if uv else -1


def _textures(path: Path, libraries, materials, uvs, index: np.ndarray) -> Textures | None:
    """Return the textures of triangles with given materials and uv numbers `index` (m, 3)."""
    if not libraries or not uvs:
        return None
    try:
        images_of = texture.material_images(path, libraries)
        used = sorted({name for name in materials if name in images_of})
        images = [texture.read_texture(images_of[name]) for name in used]
    except texture.TextureError as error:  # many meshes come without their images
        log.warning("%s: %s: its colors are those of its points or the object", path, error)
        return None
    if not used:
        return None
    row = np.array([used.index(name) if name in used else -1 for name in materials])
    if index.max() >= len(uvs):
        raise ValueError("has faces without texture coordinates")
    row[(index < 0).any(axis=1)] = -1
    uv = np.array(uvs, dtype=np.float64)[np.maximum(index, 0)]
    if not np.isfinite(uv).all():
        raise ValueError("has texture coordinates that are not finite")
    return Textures(uv, row, images)


def _vertex_colors(data: dict, count: int) -> np.ndarray | None:
    """Return colors 0..1 (n, 3) if the file has any."""
    if all(name in data for name in ("red", "green", "blue")):
        rgb = np.stack([data[name] for name in ("red", "green", "blue")], axis=1)
    else:
        names = [
            n for n in data if n.lower() in ("rgb", "rgba", "color", "colors", "vertex_colors")
        ]
        rgb = np.asarray(data[names[0]]) if names else np.empty(0)
    if rgb.ndim != 2 or len(rgb) != count or rgb.shape[1] < 3:
        return None
    is_integer = np.issubdtype(rgb.dtype, np.integer)
    return np.clip(rgb[:, :3].astype(np.float64) / (255.0 if is_integer else 1.0), 0.0, 1.0)


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
    memory_budget.require_memory(
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
