"""Surface meshes: read, sample the surface evenly with flat Gaussians, find what is inside."""

import contextlib
import io
import logging
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from vgmpi import room
from vgmpi.gaussians.cloud import Cloud, rotation_matrices
from vgmpi.gaussians.sh import dc_from_rgb
from vgmpi.prepare import texture
from vgmpi.prepare.bounded import bounded
from vgmpi.prepare.texture import Paint
from vgmpi.source import printable, short

log = logging.getLogger("vgmpi")

FORMATS = (".obj", ".stl", ".ply", ".vtk", ".vtu")
FEWEST = 20_000  # Gaussians on a surface, so that a small object is drawn smoothly
FLATNESS = 0.1  # thickness of a disc relative to its radius
RADIUS = 0.6  # standard deviation of a disc relative to sqrt(area / number)
LEAST, MOST = 1e-100, 1e100  # size of a mesh in the units of its file
_LEAST_AREA = 1e-200  # [m2]
_FILE = 1.5  # bytes that a byte of a file becomes, at least
_MANY = 64  # crossings on one line that are looked at one by one
_CROSSINGS = 1 << 22  # of triangles with lines that are looked at together
_FEW, _PAIRS = 4096, 50  # points whose pairs always fit; pairs per point in all, usual are 10
_CANDIDATE = 80  # bytes of a candidate, at least
_CROWD = 5  # candidates per point that is kept
_SNUG = 0.72  # least distance of two points relative to sqrt(area / number)


class MeshError(ValueError):
    """A file that is no usable surface mesh; one line that names the file."""


@dataclass(frozen=True)
class Mesh:
    """points (n, 3) in the file's units, triangles (m, 3) of point numbers, rgb (n, 3) or None.

    paint: pictures on its triangles, which go before rgb.
    """

    points: np.ndarray
    triangles: np.ndarray
    rgb: np.ndarray | None = None
    paint: Paint | None = None

    def corners(self) -> np.ndarray:
        """Corners of every triangle (m, 3 corners, 3)."""
        return self.points[self.triangles]


def read(path: Path) -> Mesh:
    """The triangles of a mesh file; polygons are cut into fans. Raises MeshError."""
    if path.suffix.lower() not in FORMATS:
        raise MeshError(f"{path}: cannot be read as a mesh: allowed are {', '.join(FORMATS)}")
    try:
        room.check(_FILE * path.stat().st_size, f"its {path.stat().st_size:,} bytes take at least")
        found = _read_obj(path) if path.suffix.lower() == ".obj" else _read_any(path)
    except (Exception, SystemExit) as error:  # meshio's readers raise anything, and may exit
        said = str(error).splitlines()
        ours = not said or isinstance(error, SystemExit)
        reason = "no mesh meshio reads" if ours else short(printable(said[0]))
        raise MeshError(f"{path}: cannot be read as a mesh: {reason}") from None
    if not len(found.triangles):
        raise MeshError(f"{path}: holds no triangles or polygons")
    low, high = found.triangles.min(), found.triangles.max()
    if not np.isfinite(found.points).all() or low < 0 or high >= len(found.points):
        raise MeshError(f"{path}: has points that are not finite or triangles without points")
    extent = float(np.ptp(found.points[found.triangles.ravel()], axis=0).max())
    if not LEAST <= extent <= MOST or np.abs(found.points).max() > MOST:
        raise MeshError(f"{path}: is {extent:.3g} large; allowed are {LEAST:g} to {MOST:g}")
    return found


def _read_any(path: Path) -> Mesh:
    import meshio  # half a second to import: only scenes with such a mesh pay it

    said = io.StringIO()
    with contextlib.redirect_stdout(said), contextlib.redirect_stderr(said), bounded(path):
        found = meshio.read(path)
    points = np.asarray(found.points, dtype=np.float64)
    points = np.pad(points, ((0, 0), (0, 3 - points.shape[1])))  # a flat mesh has no z
    fans = [np.empty((0, 3), dtype=np.int64)]
    for block in found.cells:
        if block.type in ("triangle", "quad", "polygon"):
            cells = np.asarray(block.data)
            fans += [cells[:, (0, k, k + 1)] for k in range(1, cells.shape[1] - 1)]
    colors = _vertex_colors(found.point_data, len(points))
    return Mesh(points, np.concatenate(fans).astype(np.int64), colors)


def _read_obj(path: Path) -> Mesh:
    """Points, their colours, faces and textures of a Wavefront file.

    Read here, because meshio refuses files with more texture coordinates than points.
    """
    points: list[list[float]] = []
    places: list[list[float]] = []
    corners: list[tuple[int, int]] = []  # point and texture coordinate (-1: none), 3 per triangle
    painted, libraries, material = [], [], ""
    for line in _lines(path):
        words = line.split()
        match words[:1]:
            case ["v"]:
                points.append([float(word) for word in words[1:]])
            case ["vt"]:
                places.append([float(word) for word in (*words[1:3], "0")[:2]])
            case ["f"]:
                face = [_corner(word, len(points), len(places)) for word in words[1:]]
                for k in range(1, len(face) - 1):
                    corners += (face[0], face[k], face[k + 1])
                    painted.append(material)
            case ["mtllib"]:
                libraries.append(line.split(maxsplit=1)[1])
            case ["usemtl"]:
                material = line.split(maxsplit=1)[1].strip() if len(words) > 1 else ""
    colored = bool(points) and all(len(point) >= 6 for point in points)
    rgb = np.clip([point[3:6] for point in points], 0.0, 1.0) if colored else None
    x = np.array([point[:3] for point in points], dtype=np.float64).reshape(-1, 3)
    index = np.array(corners, dtype=np.int64).reshape(-1, 3, 2)
    return Mesh(x, index[:, :, 0], rgb, _paint(path, libraries, painted, places, index[:, :, 1]))


def _lines(path: Path) -> Iterator[str]:
    with open(path, errors="replace") as file:
        for line in file:
            yield from line.splitlines()  # also at the ends of lines that few systems know


def _corner(word: str, points: int, places: int) -> tuple[int, int]:
    """Numbers of point and texture coordinate of "3", "3/1" or "3/1/2"; -1 for none."""
    point, _, more = word.partition("/")
    place = more.partition("/")[0]
    # from 1; negative: from the last one
    found = [
        n - 1 if n > 0 else count + n
        for n, count in ((int(point), points), (int(place or 0), places))
    ]
    return found[0], found[1] if place else -1


def _paint(path: Path, libraries, painted, places, index: np.ndarray) -> Paint | None:
    """The textures of triangles with materials `painted` and texture coordinates `index` (m, 3)."""
    if not libraries or not places:
        return None
    try:
        known = texture.pictures(path, libraries)
        used = sorted({name for name in painted if name in known})
        images = [texture.image(known[name]) for name in used]
    except texture.TextureError as error:  # many meshes travel without their pictures
        log.warning("%s: %s: its colours are those of its points or the object", path, error)
        return None
    if not used:
        return None
    which = np.array([used.index(name) if name in used else -1 for name in painted])
    if index.max() >= len(places):
        raise ValueError("has faces without texture coordinates")
    which[(index < 0).any(axis=1)] = -1
    uv = np.array(places, dtype=np.float64)[np.maximum(index, 0)]
    if not np.isfinite(uv).all():
        raise ValueError("has texture coordinates that are not finite")
    return Paint(uv, which, images)


def _vertex_colors(data: dict, count: int) -> np.ndarray | None:
    """Colours 0..1 (n, 3) where the file has any."""
    if all(name in data for name in ("red", "green", "blue")):
        rgb = np.stack([data[name] for name in ("red", "green", "blue")], axis=1)
    else:
        names = [
            n for n in data if n.lower() in ("rgb", "rgba", "color", "colors", "vertex_colors")
        ]
        rgb = np.asarray(data[names[0]]) if names else np.empty(0)
    if rgb.ndim != 2 or len(rgb) != count or rgb.shape[1] < 3:
        return None
    whole = np.issubdtype(rgb.dtype, np.integer)
    return np.clip(rgb[:, :3].astype(np.float64) / (255.0 if whole else 1.0), 0.0, 1.0)


def sample(mesh: Mesh, spacing: float, color: tuple, opacity: float, key: list[int]) -> Cloud:
    """Flat Gaussians spread evenly (Poisson disc) over a placed mesh, `spacing` / 2 [m] apart.

    key: integers that choose the random numbers; the same ones give the same points. Raises
    MeshError for a mesh without area, room.TooLarge.
    """
    corner = mesh.corners()
    with np.errstate(over="ignore", under="ignore"):  # such an area is refused
        cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        double = np.linalg.norm(cross, axis=1)
        area = double.sum() / 2
    if not (_LEAST_AREA < area < np.inf):
        raise MeshError(f"its triangles have an area of {area:.3g} m2: they are lines or points")
    wanted = max(FEWEST, area / (spacing / 2) ** 2)
    said = f"{wanted:.3g} Gaussians, {spacing / 2:g} m apart on a surface of {area:.3g} m2, take"
    room.check(_CANDIDATE * _CROWD * wanted, f"{said} at least")
    wanted = int(wanted)
    random = np.random.Generator(np.random.Philox(np.random.SeedSequence(key)))
    draw = random.random((_CROWD * wanted, 3))
    edges = np.cumsum(double)
    chosen = np.minimum(np.searchsorted(edges, draw[:, 0] * edges[-1]), len(edges) - 1)
    root, v = np.sqrt(draw[:, 1:2]), draw[:, 2:3]
    share = np.concatenate([1 - root, root * (1 - v), root * v], axis=1)  # barycentric (n, 3)
    x = (share[:, :, None] * corner[chosen]).sum(axis=1)
    kept = spread(x, _SNUG * np.sqrt(area / wanted))
    normal = cross[chosen[kept]] / double[chosen[kept], None]
    rgb = np.tile(np.asarray(color, dtype=float), (len(kept), 1))
    if mesh.rgb is not None:
        rgb = (share[kept, :, None] * mesh.rgb[mesh.triangles[chosen[kept]]]).sum(axis=1)
    if mesh.paint is not None:
        rgb = mesh.paint.color(chosen[kept], share[kept], rgb)
    radius = RADIUS * np.sqrt(area / len(kept))
    return Cloud(
        x[kept],
        toward(normal),
        np.tile([radius, radius, FLATNESS * radius], (len(kept), 1)),
        np.full(len(kept), opacity),
        dc_from_rgb(rgb)[:, None, :].astype(np.float32),
    )


def toward(normal: np.ndarray) -> np.ndarray:
    """Quaternions w, x, y, z (n, 4) that turn the z axis to unit normals (n, 3)."""
    x, y, z = normal.T
    zero = np.zeros_like(x)
    quat = np.stack([1.0 + z, -y, x, zero], axis=1)
    quat = np.where((z > -0.999999)[:, None], quat, (0.0, 1.0, 0.0, 0.0))  # half a turn
    return quat / np.linalg.norm(quat, axis=1, keepdims=True)


def spread(x: np.ndarray, distance: float) -> np.ndarray:
    """Indices of points no two of which are closer than `distance` [m]; earlier points win.

    What taking the points one by one would give, but in a few vectorised rounds. Where points lie
    so close that their pairs would fill the memory, as on triangles that lie over each other, part
    after part: what is near a point that was taken is out before pairs are looked for.
    """
    taken = np.empty(0, dtype=np.int64)
    first, part = 0, len(x)
    while first < len(x):
        rest = np.arange(first, min(first + part, len(x)))
        if len(taken):
            beyond = np.nextafter(distance, np.inf)
            rest = rest[cKDTree(x[taken]).query(x[rest], distance_upper_bound=beyond)[0] > distance]
        tree = cKDTree(x[rest]) if len(rest) else None
        if tree and _crowded(tree, distance, _PAIRS * len(x)):
            part = max(len(rest) // 8, _FEW)
            continue
        if tree:
            pairs = tree.query_pairs(distance, output_type="ndarray")  # (m, 2), first < second
            taken = np.concatenate([taken, rest[_first_ones(len(rest), pairs)]])
        first += part
        part = first  # as many again
    return taken


def _crowded(tree: cKDTree, distance: float, most: int) -> bool:
    """Whether points have more than about `most` neighbours in all: as some of them tell, at first
    few, since those of a crowd take long."""
    if tree.n <= _FEW:
        return False
    for some in (64, _FEW):
        seen = tree.data[:: max(1, tree.n // some)]
        near = tree.query_ball_point(seen, distance, return_length=True)
        if near.mean() * tree.n > most:
            return True
    return False


def _first_ones(count: int, pairs: np.ndarray) -> np.ndarray:
    """Which of `count` things to take, in their order, where no pair (m, 2) may be taken."""
    taken = np.zeros(count, dtype=bool)
    open_ = np.ones(count, dtype=bool)
    while open_.any():
        waits = np.zeros(count, dtype=bool)
        waits[pairs[:, 1]] = True
        new = open_ & ~waits
        taken |= new
        open_ &= ~new
        fallen = pairs[:, 1][new[pairs[:, 0]]]
        open_[fallen] = False
        pairs = pairs[open_[pairs].all(axis=1)]
    return np.flatnonzero(taken)


def inside(mesh: Mesh, points: np.ndarray, spacing: float) -> np.ndarray:
    """Which points (n, 3) of a lattice of the given spacing [m] lie inside a placed mesh.

    Along each axis a line through the points counts the signed crossings below each; two of three
    axes must agree, so that a hole in the mesh does not turn a whole line inside out.
    """
    corner = mesh.corners()

    def along(axis: int, points: np.ndarray) -> np.ndarray:
        order = [(axis + 1) % 3, (axis + 2) % 3, axis]
        return _winding(corner[:, :, order], points[:, order], spacing) != 0

    votes, other = along(0, points), along(1, points)
    differ = np.flatnonzero(votes != other)  # elsewhere the third has nothing to say
    if len(differ):
        votes[differ] = along(2, points[differ])
    return votes


def _winding(corner: np.ndarray, points: np.ndarray, h: float) -> np.ndarray:
    """Signed crossings (n,) of the mesh below each point, along the third coordinate.

    points: on a lattice of spacing h in the first two coordinates.
    """
    column = np.floor(points[:, :2] / h).astype(np.int64)
    start = column.min(axis=0)
    size = column.max(axis=0) - start + 1
    # a line exactly through an edge would count twice or never: lines stand a little aside
    aside = h * np.array([3.1e-6, 7.7e-6])
    low = np.ceil((corner[:, :, :2].min(axis=1) - aside) / h - 0.5).astype(np.int64)
    high = np.floor((corner[:, :, :2].max(axis=1) - aside) / h - 0.5).astype(np.int64)
    low, high = np.maximum(low, start), np.minimum(high, start + size - 1)
    span = np.maximum(high - low + 1, 0)
    count = span[:, 0] * span[:, 1]
    below = np.zeros(len(points), dtype=np.int64)
    columns = _flat(column - start, size)
    # part after part: of many large triangles each has a crossing on every line
    last = np.cumsum(count)
    ends = np.searchsorted(last, np.arange(_CROSSINGS, last[-1] + _CROSSINGS, _CROSSINGS), "right")
    for part in np.split(np.arange(len(corner)), np.unique(np.minimum(ends, len(corner)))):
        tri = np.repeat(part, count[part])
        nth = np.arange(len(tri)) - np.repeat(np.cumsum(count[part]) - count[part], count[part])
        cell = low[tri] + np.stack([nth // span[tri, 1], nth % span[tri, 1]], axis=1)
        hit, height, sign = _hits(corner[tri], (cell + 0.5) * h + aside)
        below += _crossings_below(_flat(cell[hit] - start, size), height, sign, columns, points)
    return below


def _hits(corner: np.ndarray, line: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Which of the triangles (n, 3, 3) their lines (n, 2) along the third coordinate meet, where,
    and with which sign."""
    a, b, c = (corner[:, k] for k in range(3))
    u, v, w = (_area(p, q, line) for p, q in ((b, c), (c, a), (a, b)))
    twice = u + v + w
    hit = (((u > 0) & (v > 0) & (w > 0)) | ((u < 0) & (v < 0) & (w < 0))) & (twice != 0)
    u, v, w, twice = u[hit], v[hit], w[hit], twice[hit]
    return hit, (u * a[hit, 2] + v * b[hit, 2] + w * c[hit, 2]) / twice, np.sign(twice)


def _area(p: np.ndarray, q: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Twice the signed area of the triangles p, q, x in the plane of the first two coordinates."""
    return (p[:, 0] - x[:, 0]) * (q[:, 1] - x[:, 1]) - (p[:, 1] - x[:, 1]) * (q[:, 0] - x[:, 0])


def _flat(cell: np.ndarray, size: np.ndarray) -> np.ndarray:
    return cell[:, 0] * size[1] + cell[:, 1]


def _crossings_below(lines, heights, signs, columns, points) -> np.ndarray:
    """For each point the sum of `signs` of the crossings on its line that lie lower."""
    if not len(lines):
        return np.zeros(len(points), dtype=np.int64)
    count = np.bincount(lines, minlength=columns.max() + 1)
    if count.max() > _MANY:
        return _by_sorting(lines, heights, signs, columns, points)
    order = np.lexsort((heights, lines))
    z, sign = heights[order], signs[order].astype(np.int64)
    first = np.cumsum(count) - count
    out = np.zeros(len(points), dtype=np.int64)
    at = np.flatnonzero(count[columns])  # points above all crossings of their lines so far
    here, left = first[columns[at]], count[columns[at]]
    for _ in range(count.max()):
        below = z[here] <= points[at, 2]
        out[at] += np.where(below, sign[here], 0)
        more = below & (left > 1)
        at, here, left = at[more], here[more] + 1, left[more] - 1
    return out


def _by_sorting(lines, heights, signs, columns, points) -> np.ndarray:
    """The same for lines with any number of crossings."""
    line = np.concatenate([lines, columns])
    z = np.concatenate([heights, points[:, 2]])
    sign = np.concatenate([signs, np.zeros(len(columns))]).astype(np.int64)
    order = np.lexsort((z, line))
    total = np.cumsum(sign[order])
    first = np.searchsorted(line[order], line[order], side="left")
    before = np.concatenate([[0], total])[first]  # what lines further left have summed up
    out = np.empty(len(line), dtype=np.int64)
    out[order] = total - before
    return out[len(lines) :]


def normals(cloud: Cloud) -> np.ndarray:
    """The directions (n, 3) in which flat Gaussians face: their third axes."""
    return rotation_matrices(cloud.quat)[:, :, 2]
