"""Topology of a triangle mesh: shells, boundary edges, holes, and which side of it is outside.

Points at the same place are one point here, as at the seams of textures and in .stl files. A shell
is a set of triangles joined by edges of two triangles each.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from vgmpi.runtime import process_limits

from .triangle_mesh import Mesh

_SEAM = 1e-6  # [-] of the extent: gap of two boundary points that are one
_FLAT = 1e-6  # [-] volume relative to area**1.5 below which a shell has no inside
# [-] area of the holes relative to a shell's own up to which it has an inside; a bowl or a
# terrain has none
_OPENNESS = 0.1
_BYTES_PER_PAIR = 40  # [bytes] of two points that coincide
_MAX_PROBES, _MAX_ANGLES = 1000, 1 << 25  # points, and points times triangles, of an inclusion


@dataclass(frozen=True)
class MeshTopology:
    """Shells and holes of a mesh.

    Attributes:
        shell: Shell of every triangle, shape (m,); -1 for triangles without area.
        is_closed: Whether a shell has no boundary edge, shape (s,).
        flips: Whether a triangle has to be turned so that its shell's outside is outside, shape
            (m,).
        inside_out: Whether most of a shell is to be turned, shape (s,).
        is_mixed: Whether the triangles of a shell face both ways, shape (s,).
        boundary_edges: Number of edges of one triangle.
        branching_edges: Number of edges of more than two triangles.
        hole_size: Largest extent of every hole [file units], the largest first, shape (h,).
        hole_center: Center of the extent of every hole, shape (h, 3).
    """

    shell: np.ndarray
    is_closed: np.ndarray
    flips: np.ndarray
    inside_out: np.ndarray
    is_mixed: np.ndarray
    boundary_edges: int
    branching_edges: int
    hole_size: np.ndarray
    hole_center: np.ndarray

    @property
    def is_open(self) -> bool:
        """Return whether the mesh has boundary edges."""
        return self.boundary_edges > 0

    def describe_opening(self, unit: str = "") -> str:
        """Return text on boundary edges and the largest hole; unit: that of lengths."""
        center = ", ".join(f"{each:.4g}" for each in self.hole_center[0])
        holes = len(self.hole_size)
        which = "one hole" if holes == 1 else f"{holes:,} holes, the largest"
        return (
            f"open: {self.boundary_edges:,} boundary edges; {which}"
            f" {self.hole_size[0]:.3g}{unit} wide at ({center}){unit}"
        )


@dataclass(frozen=True)
class _Edges:
    """Edges that directed edges of triangles make; directed edge 3 t + k leaves corner k of t."""

    directed: np.ndarray  # (k,) directed edges, sorted by their two points
    is_forward: np.ndarray  # (k,) whether it goes from the lower to the higher point
    ends: np.ndarray  # (k, 2) its points, the lower one first
    first: np.ndarray  # (e,) row at which each edge begins
    count: np.ndarray  # (e,) its triangles

    def rows(self, is_chosen: np.ndarray) -> np.ndarray:
        """Return the rows of the chosen edges (e,)."""
        return np.flatnonzero(np.repeat(is_chosen, self.count))


def analyze_mesh(mesh: Mesh) -> MeshTopology:
    """Return the topology of a mesh."""
    label = _joined_points(mesh)
    placed = label[mesh.triangles]
    is_proper = (placed != np.roll(placed, 1, axis=1)).all(axis=1)
    directed = np.flatnonzero(np.repeat(is_proper, 3))
    # parts that touch, but have points of their own, stay apart
    own = _edges(mesh.triangles, directed)
    remaining = _edges(placed, np.sort(own.directed[own.rows(own.count != 2)]))
    shell, side = _shells([own, remaining], is_proper)
    count = shell.max(initial=-1) + 1
    rim, branches = remaining.rows(remaining.count == 1), remaining.rows(remaining.count > 2)
    if not count:  # lines and points
        none = np.zeros(0, dtype=bool)
        flips = np.zeros(len(placed), dtype=bool)
        return MeshTopology(shell, none, flips, none, none, 0, 0, *_holes(placed, label, none))
    is_closed, is_whole = np.ones(count, dtype=bool), np.ones(count, dtype=bool)
    is_closed[shell[remaining.directed[rim] // 3]] = False
    is_whole[shell[remaining.directed[branches] // 3]] = (
        False  # it ends at others: no side of its own
    )
    flips, is_mixed = _orientation(mesh, shell, side, remaining.directed[rim], is_whole)
    total = np.bincount(shell[is_proper], minlength=count)
    size, center = _holes(mesh.points, label, remaining.ends[rim])
    return MeshTopology(
        shell, is_closed, flips, 2 * np.bincount(shell[flips], minlength=count) > total, is_mixed,
        len(rim), int((remaining.count > 2).sum()), size, center,
    )  # fmt: skip


def oriented(mesh: Mesh, topology: MeshTopology) -> Mesh:
    """Return the mesh with the triangles turned that face the wrong way."""
    if not topology.flips.any():
        return mesh
    triangles = mesh.triangles.copy()
    triangles[topology.flips] = triangles[topology.flips][:, ::-1]
    textures = mesh.textures
    if textures is not None:
        uv = textures.uv.copy()
        uv[topology.flips] = uv[topology.flips][:, ::-1]
        textures = replace(textures, uv=uv)
    return replace(mesh, triangles=triangles, textures=textures)


def describe_surface(topology: MeshTopology) -> str:
    """Return text on whether a mesh is watertight, and on its holes."""
    parts = [topology.describe_opening()] if topology.is_open else []
    if topology.branching_edges:
        parts.append(f"{topology.branching_edges:,} edges of more than two triangles")
    return "; ".join(parts) or "watertight"


def describe_shells(topology: MeshTopology) -> str:
    """Return text on the shells of a mesh: how many, which are open, and which way they face."""
    count, closed = len(topology.is_closed), int(topology.is_closed.sum())
    parts = [f"{count:,}"]
    if closed < count:
        parts.append(f"{count - closed:,} of them open")
    if topology.inside_out.any():
        parts.append(f"{int(topology.inside_out.sum()):,} inside out")
    mixed = int((topology.is_mixed & ~topology.inside_out).sum())
    if mixed:
        parts.append(f"{mixed:,} with triangles that face both ways")
    return ", ".join(parts)


def describe_turned_shells(topology: MeshTopology) -> str:
    """Return text on shells that face the wrong way, empty without any."""
    parts = []
    count = len(topology.inside_out)
    wrong = int(topology.inside_out.sum())
    if wrong:
        text = "its only shell" if count == 1 else f"{wrong:,} of its {count:,} shells"
        parts.append(f"{text} {'is' if wrong == 1 else 'are'} inside out")
    mixed = int((topology.is_mixed & ~topology.inside_out).sum())
    if mixed:
        parts.append(f"triangles of {mixed:,} of its {count:,} shells face both ways")
    return " and ".join(parts) + (": turned outward" if parts else "")


def _joined_points(mesh: Mesh) -> np.ndarray:
    """Return for every point the number (n,) of its place; boundary points close by are one."""
    used = np.unique(mesh.triangles)
    x = mesh.points[used] + 0.0  # -0 is 0
    _, place = np.unique(x, axis=0, return_inverse=True)
    label = np.zeros(len(mesh.points), dtype=np.int64)
    label[used] = place.ravel()
    triangles = label[mesh.triangles]
    edges = _edges(triangles, np.arange(triangles.size))
    rim = np.unique(edges.ends[edges.rows(edges.count == 1)])
    if not len(rim):
        return label
    point_at = np.zeros(label.max() + 1, dtype=np.int64)
    point_at[label[used]] = used
    extent = float(np.ptp(x, axis=0).max())
    tree = scipy.spatial.cKDTree(mesh.points[point_at[rim]] / extent)
    count = int(tree.count_neighbors(tree, _SEAM)) // 2
    process_limits.require_memory(
        _BYTES_PER_PAIR * count, f"{count:,} pairs of points that coincide take at least"
    )
    pairs = tree.query_pairs(_SEAM, output_type="ndarray")
    links = scipy.sparse.coo_array((np.ones(len(pairs)), pairs.T), (len(rim), len(rim)))
    part = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
    lowest = np.full(part.max() + 1, label.max())
    np.minimum.at(lowest, part, rim)
    merged = np.arange(label.max() + 1)
    merged[rim] = lowest[part]
    return merged[label]


def _edges(triangles: np.ndarray, directed: np.ndarray) -> _Edges:
    """Return the edges of the given directed edges (k,) of triangles (m, 3)."""
    start = triangles.ravel()[directed]
    end = np.roll(triangles, -1, axis=1).ravel()[directed]
    ends = np.sort(np.stack([start, end], axis=1), axis=1)
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends = ends[order]
    is_new = np.ones(len(ends), dtype=bool)
    is_new[1:] = (ends[1:] != ends[:-1]).any(axis=1)
    first = np.flatnonzero(is_new)
    count = np.diff(np.append(first, len(ends)))
    return _Edges(directed[order], (start < end)[order], ends, first, count)


def _shells(tables: list[_Edges], is_proper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the shell of every triangle (m,), and its side in the shell: 1, -1, or 0 for none.

    Two triangles face the same way if they pass along their edge in opposite directions. Every
    triangle is there twice, once for either side: the two are linked in a shell without two sides.
    """
    count, pairs, crossings = len(is_proper), [], []
    for edges in tables:
        row = edges.first[edges.count == 2]
        pairs.append(np.stack([edges.directed[row], edges.directed[row + 1]]) // 3)
        crossings.append(edges.is_forward[row] == edges.is_forward[row + 1])
    (a, b), crossed = np.concatenate(pairs, axis=1), count * np.concatenate(crossings)
    rows = np.concatenate([a, a + count])
    columns = np.concatenate([b + crossed, b + count - crossed])
    links = scipy.sparse.coo_array((np.ones(len(rows)), (rows, columns)), (2 * count, 2 * count))
    part = scipy.sparse.csgraph.connected_components(links, directed=False)[1]
    side = np.sign(part[count:].astype(np.int64) - part[:count])
    links = scipy.sparse.coo_array((np.ones(len(a)), (a, b)), (count, count))
    shell = scipy.sparse.csgraph.connected_components(links, directed=False)[1].astype(np.int64)
    shell[~is_proper] = -1
    shell[is_proper] = np.unique(shell[is_proper], return_inverse=True)[1].ravel()
    return shell, side


def _holes(x: np.ndarray, label: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return size and center of the holes that boundary edges (k, 2) make, the largest first."""
    if not len(ends):
        return np.empty(0), np.empty((0, 3))
    place = np.zeros((label.max() + 1, 3))
    place[label] = x
    nodes, edge = np.unique(ends, return_inverse=True)
    edge = edge.reshape(-1, 2)
    links = scipy.sparse.coo_array((np.ones(len(edge)), edge.T), (len(nodes), len(nodes)))
    count, part = scipy.sparse.csgraph.connected_components(links, directed=False)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, part, place[nodes])
    np.maximum.at(high, part, place[nodes])
    size = (high - low).max(axis=1)
    order = np.argsort(-size, kind="stable")
    return size[order], ((low + high) / 2)[order]


def _orientation(
    mesh: Mesh, shell: np.ndarray, side: np.ndarray, rim: np.ndarray, is_whole: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return which triangles (m,) are to be turned, and which shells (s,) face both ways.

    Args:
        mesh: The mesh.
        shell: Shell of every triangle, shape (m,).
        side: Side of every triangle in its shell, shape (m,).
        rim: Directed edges that are boundary edges.
        is_whole: Whether a shell has two sides of its own, shape (s,).
    """
    count, in_shell = len(is_whole), shell >= 0
    corner = mesh.corners()
    low = corner.reshape(-1, 3).min(axis=0)
    extent = float((corner.reshape(-1, 3).max(axis=0) - low).max())
    corner = (corner - low) / extent
    # volumes about the middle of a shell's rim, as if its holes were closed from there
    middle = (corner[rim // 3, rim % 3] + corner[rim // 3, (rim % 3 + 1) % 3]) / 2
    about = _means(corner[in_shell].mean(axis=1), shell[in_shell], count)
    of_rim = np.bincount(shell[rim // 3], minlength=count) > 0
    about = np.where(of_rim[:, None], _means(middle, shell[rim // 3], count), about)
    a, b, c = (corner - about[shell][:, None]).transpose(1, 0, 2)
    volume = (a * np.cross(b, c)).sum(axis=1) / 6
    cross = np.cross(b - a, c - a) / 2
    area = np.bincount(shell[in_shell], np.linalg.norm(cross, axis=1)[in_shell], count)
    facing_area = _means((cross * side[:, None])[in_shell], shell[in_shell], count)
    own = np.bincount(shell[in_shell], (volume * side)[in_shell], count)
    facing = np.bincount(shell[in_shell], side[in_shell], count)
    size = np.bincount(shell[in_shell], minlength=count)
    is_mixed = np.abs(facing) < size
    is_twisted = np.bincount(shell[in_shell], (side == 0)[in_shell], count) > 0
    may_turn = is_whole & ~is_twisted
    # side that is outside, 0 where there is none
    has_inside = np.linalg.norm(facing_area, axis=1) * size < _OPENNESS * area
    has_inside &= np.abs(own) > _FLAT * area**1.5
    outward = np.sign(own) * has_inside
    majority = np.where(facing < 0, -1.0, 1.0)
    wanted = np.where(has_inside, outward, majority)  # sheets face one way at least
    is_backward = has_inside & (majority != outward) & may_turn
    if is_backward.any():
        is_cavity = _cavities(corner, shell, side, is_backward, may_turn & has_inside)
        wanted = np.where(is_cavity, -wanted, wanted)
    turned = may_turn[shell] & in_shell & (side != wanted[shell])
    return turned, is_mixed


def _means(values: np.ndarray, group: np.ndarray, count: int) -> np.ndarray:
    """Return the means (count, 3) of values (n, 3) by group (n,), 0 where there is none."""
    size = np.maximum(np.bincount(group, minlength=count), 1)
    return np.stack([np.bincount(group, values[:, k], count) / size for k in range(3)], axis=1)


def _cavities(corner, shell, side, is_backward, is_solid) -> np.ndarray:
    """Return which shells (s,) are cavities: those that face the other way than what holds them.

    Args:
        corner: Corners of the triangles, shape (m, 3, 3).
        shell: Shell of every triangle, shape (m,).
        side: Side of every triangle in its shell, shape (m,).
        is_backward: Whether a shell faces inward, shape (s,).
        is_solid: Whether a shell has an inside, shape (s,).
    """
    count = len(is_solid)
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    in_shell = shell >= 0
    np.minimum.at(low, shell[in_shell], corner[in_shell].min(axis=1))
    np.maximum.at(high, shell[in_shell], corner[in_shell].max(axis=1))
    order = np.argsort(-np.prod(high - low, axis=1), kind="stable")  # what holds comes first
    rows = np.split(np.argsort(shell, kind="stable"), np.searchsorted(np.sort(shell), range(count)))
    rows = rows[1:]  # the first are triangles of no shell
    is_cavity = np.zeros(count, dtype=bool)
    done: list[int] = []
    for k in order[is_solid[order]]:
        holds = [d for d in done if (low[d] <= low[k]).all() and (high[k] <= high[d]).all()]
        for holder in reversed(holds):  # the smallest one that holds it
            probes = corner[rows[k]].reshape(-1, 3)
            if _lies_inside(probes, corner[rows[holder]], side[rows[holder]]):
                differs = is_backward[k] != is_backward[holder]
                is_cavity[k] = differs != is_cavity[holder]
                break
        done.append(int(k))
    return is_cavity


def _lies_inside(x: np.ndarray, corner: np.ndarray, side: np.ndarray) -> bool:
    """Return whether points (n, 3) lie inside a shell: the solid angle of its triangles.

    References: van Oosterom and Strackee (1983), doi:10.1109/TBME.1983.325207.
    """
    probes = int(np.clip(_MAX_ANGLES // len(corner), 16, _MAX_PROBES))
    x = np.unique(x, axis=0)
    for point in x[:: max(1, len(x) // probes)]:
        a, b, c = (corner - point).transpose(1, 0, 2)
        la, lb, lc = (np.sqrt((each**2).sum(axis=1)) for each in (a, b, c))
        top = (a * np.cross(b, c)).sum(axis=1)
        bottom = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        if abs((2 * np.arctan2(top, bottom) * side).sum()) < 2 * np.pi * (1 + 1e-9):
            return False
    return True
