"""Nodes of a glTF scene: which meshes stand in it, and where."""

from dataclasses import dataclass

import numpy as np

from vgmpi.gaussians.cloud import rotation_matrices

from .json_header import JsonObject
from .validation import GaussianFileError

_MAX_NODES = 100_000
_TOLERANCE = 1e-6  # [-] by which sizes along the axes of a node differ that count as equal
_SKEW = 1e-2  # [-] by which axes of a node may miss a right angle
_KEYS = ("matrix", "translation", "rotation", "scale")


@dataclass(frozen=True)
class NodeTransform:
    """Transformation x -> matrix @ x + shift of a node.

    Attributes:
        matrix: Shape (3, 3).
        shift: Shape (3,).
        rotation: Rotation in `matrix`, shape (3, 3).
        factor: Size in `matrix`, the same along all axes; None if it differs among them.
    """

    matrix: np.ndarray
    shift: np.ndarray
    rotation: np.ndarray
    factor: float | None


def scene_meshes(header: JsonObject) -> list[tuple[int, NodeTransform | None]]:
    """Return number and transformation of each mesh of the scene; None where nothing moves it.

    Without a scene, all nodes count. Children follow their parents, in the order of the file.

    Raises:
        GaussianFileError: If the nodes are no tree, or a transformation mirrors or shears a mesh.
    """
    nodes = header.items("nodes")
    if len(nodes) > _MAX_NODES:
        raise GaussianFileError(f"has {len(nodes):,} nodes: the most is {_MAX_NODES:,}")
    meshes: list[tuple[int, NodeTransform | None]] = []
    pending: list[tuple[object, np.ndarray | None]] = [(k, None) for k in reversed(_roots(header))]
    visited: set[int] = set()
    while pending:
        index, above = pending.pop()
        node = header.entry("nodes", index)
        if index in visited:
            raise GaussianFileError(f"has {node.name} twice in its scene: its nodes are no tree")
        visited.add(index)  # type: ignore[arg-type]  # entry() accepts whole numbers only
        own = _local_matrix(node)
        matrix = own if above is None else above if own is None else above @ own
        if "mesh" in node:
            meshes.append((node.integer("mesh"), _transform(node.name, matrix)))
        pending += [(child, matrix) for child in reversed(node.items("children"))]
    return meshes


def _roots(header: JsonObject) -> list:
    """Return the numbers of the nodes that have no parent."""
    if header.items("scenes"):
        return list(header.entry("scenes", header.values.get("scene", 0)).items("nodes"))
    count = len(header.items("nodes"))
    tables = (header.entry("nodes", k) for k in range(count))
    children = {str(child) for table in tables for child in table.items("children")}
    return [k for k in range(count) if str(k) not in children]


def _local_matrix(node: JsonObject) -> np.ndarray | None:
    """Return the 4 x 4 matrix of a node; None if it has no transformation."""
    if not any(key in node for key in _KEYS):
        return None
    if "matrix" in node:
        return node.numbers("matrix", 16).reshape(4, 4).T
    matrix = np.eye(4)
    if "rotation" in node:
        x, y, z, w = node.numbers("rotation", 4)
        length = np.sqrt(w * w + x * x + y * y + z * z)
        if not 0.9 < length < 1.1:
            raise GaussianFileError(f"has a rotation of {node.name} that is no unit quaternion")
        matrix[:3, :3] = rotation_matrices(np.array([[w, x, y, z]]) / length)[0]
    if "scale" in node:
        matrix[:3, :3] *= node.numbers("scale", 3)
    if "translation" in node:
        matrix[:3, 3] = node.numbers("translation", 3)
    return matrix


def _transform(name: str, matrix: np.ndarray | None) -> NodeTransform | None:
    """Return the transformation of a 4 x 4 matrix in its parts."""
    if matrix is None or np.array_equal(matrix, np.eye(4)):
        return None
    linear, shift = matrix[:3, :3], matrix[:3, 3]
    with np.errstate(all="ignore"):  # numbers of any size
        sizes = np.linalg.norm(linear, axis=0)
        axes = linear / sizes
        gram = axes.T @ axes
        is_proper = np.isfinite(matrix).all() and np.linalg.det(axes) > 0
    if not is_proper or np.abs(gram - np.eye(3)).max() > _SKEW:
        raise GaussianFileError(f"has {name} mirrored, sheared or without a size: not supported")
    u, _, vt = np.linalg.svd(axes)  # the nearest rotation
    mean = float(sizes.mean())
    is_uniform = np.abs(sizes / mean - 1).max() < _TOLERANCE
    if is_uniform:
        linear = mean * (u @ vt)
    return NodeTransform(linear, shift, u @ vt, mean if is_uniform else None)
