"""What a file holds that a body can be made of: --inspect of Gaussian files and meshes."""

import math
from pathlib import Path

import numpy as np

from ..gaussians import files
from ..gaussians.files import GaussianFileError
from . import mesh
from .mesh import MeshError


def known(path: Path) -> bool:
    """Whether its name is that of such a file."""
    return path.suffix.lower() in (*files.KINDS, *mesh.FORMATS)


def inspect(path: Path) -> str:
    """Lines of text. Raises GaussianFileError or MeshError, one line that names the file."""
    suffix = path.suffix.lower()
    if suffix not in files.KINDS:
        return _mesh(path)
    try:
        return _gaussians(path)
    except GaussianFileError as error:
        try:  # a .ply may be either
            return _mesh(path)
        except MeshError:
            raise error from None


def _gaussians(path: Path) -> str:
    cloud = files.read(path)
    degree = math.isqrt(cloud.sh.shape[1]) - 1
    low, middle, high = np.percentile(cloud.opacity, [5, 50, 95])
    scale = np.sort(cloud.scale, axis=1)
    return "\n".join(
        [
            f"{path}: {len(cloud):,} Gaussians, colours of degree {degree}",
            f"  reaches  {_reach(cloud.x)}",
            f"  scale    {_middle(scale[:, 2])} along, {_middle(scale[:, 0])} across (medians)",
            f"  opacity  {middle:.2f} ({low:.2f} to {high:.2f} of nine in ten)",
        ]
    )


def _mesh(path: Path) -> str:
    found = mesh.read(path)
    looks = "a picture" if found.paint else "colours" if found.rgb is not None else "no colours"
    return "\n".join(
        [
            f"{path}: a mesh of {len(found.triangles):,} triangles, {len(found.points):,} points,"
            f" {looks}",
            f"  reaches  {_reach(found.points)}",
        ]
    )


def _reach(x: np.ndarray) -> str:
    """In the file's own units: a scene gives it its size."""
    ends = zip("xyz", x.min(axis=0), x.max(axis=0), strict=True)
    return ", ".join(f"{axis} {low:.4g} .. {high:.4g}" for axis, low, high in ends)


def _middle(values: np.ndarray) -> str:
    return f"{np.median(values):.3g}"
