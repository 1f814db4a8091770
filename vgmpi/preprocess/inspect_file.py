"""Description of a file that a body can be made of: --inspect of Gaussian files and meshes."""

import math
from pathlib import Path

import numpy as np

from vgmpi.gaussians.capture_conventions import PLY_FRAME, capture_extras
from vgmpi.gaussians.cloud import CaptureRecord, GaussianCloud
from vgmpi.gaussians.formats import registry
from vgmpi.gaussians.formats.registry import GaussianFileError
from vgmpi.preprocess.capture_selection import find_floaters
from vgmpi.preprocess.meshes import surface_mesh
from vgmpi.preprocess.meshes.mesh_topology import (
    analyze_mesh,
    describe_shells,
    describe_surface,
)
from vgmpi.preprocess.meshes.surface_mesh import MeshError
from vgmpi.preprocess.meshes.triangle_mesh import Mesh

_UNBUNDLED = ("meta.json", "lod-meta.json")  # headers of folders of PlayCanvas
_VALUES_TOLD = 8  # values of a column of labels


def is_inspectable(path: Path) -> bool:
    """Return whether the file's name is that of such a file."""
    suffix = path.suffix.lower()
    if suffix == ".json":  # runs have such files, too
        return path.name.lower() in _UNBUNDLED
    return suffix in (*registry.KINDS, *registry.UNREADABLE, *surface_mesh.FORMATS)


def describe_file(path: Path) -> str:
    """Return lines of text about a file.

    Raises GaussianFileError or MeshError, one line that names the file.
    """
    if path.exists() and not path.is_file():  # a reader of a pipe or a device may wait forever
        raise GaussianFileError(f"{path}: is no regular file")
    suffix = path.suffix.lower()
    if suffix in surface_mesh.FORMATS and suffix not in registry.KINDS:
        return _mesh(path)
    try:
        return _gaussians(path)
    except GaussianFileError as error:
        try:  # a .ply may be either
            return _mesh(path)
        except MeshError:
            raise error from None


def _gaussians(path: Path) -> str:
    """Return lines about a Gaussian file."""
    cloud = registry.read(path)
    degree = math.isqrt(cloud.sh.shape[1]) - 1
    low, middle, high = np.percentile(cloud.opacity, [5, 50, 95])
    scale = np.sort(cloud.scale, axis=1)
    record = cloud.record or CaptureRecord(path.suffix.lower())
    return "\n".join(
        [
            f"{path}: {len(cloud):,} Gaussians, colors of degree {degree}",
            f"  format   {record.encoding}",
            f"  axes     {_axes(record)}",
            f"  training {_training(record, cloud.is_antialiased)}",
            f"  extent   {_reach(cloud.x)}, in the units of the file",
            f"  sizes    longest axis {_middle(scale[:, 2])}, shortest {_middle(scale[:, 0])}"
            " (medians of the standard deviations)",
            f"  opacity  {middle:.2f} (median), {low:.2f} to {high:.2f} for nine in ten",
            *_label_lines(cloud.labels),
            *_floaters(cloud),
            *(f"  note     {text}" for text in _empty_degrees(cloud) + capture_extras(record)),
            *(f"  doubt    {text}" for text in record.doubts),
            *(f"  comment  {text}" for text in record.comments),
        ]
    )


def _empty_degrees(cloud: GaussianCloud) -> list[str]:
    """Return a clause if the file has room for view-dependent colors, and none: writers do that."""
    has_room = cloud.sh.shape[1] > 1
    return ["all colors above degree 0 are zero"] if has_room and not cloud.sh[:, 1:].any() else []


def _axes(record: CaptureRecord) -> str:
    """Return the frame of the file and why it was taken."""
    if record.frame:
        return f"{record.frame}: {record.frame_source}"
    return f"{PLY_FRAME} (x right, y down, z forward) is assumed: the file does not say"


def _training(record: CaptureRecord, is_antialiased: bool) -> str:
    """Return the render model of the file and why it was taken."""
    if record.render_model_source:
        model = "antialiased" if is_antialiased else "not antialiased"
        return f"{model}: {record.render_model_source}"
    return "not antialiased is assumed: the file does not say"


def _label_lines(labels: dict[str, np.ndarray]) -> list[str]:
    """Return a line for each column of labels: its most frequent values and their counts."""
    lines = []
    for name, label in labels.items():
        values, counts = np.unique(label, return_counts=True)
        if len(values) == len(label) > 1:
            lines.append(f"  labels   {name}: {values[0]} to {values[-1]}, all different")
            continue
        order = np.argsort(-counts, kind="stable")[:_VALUES_TOLD]
        some = ", ".join(f"{values[k]} ({counts[k]:,})" for k in order)
        more = f", ... of {len(values):,} values" if len(values) > len(order) else ""
        lines.append(f"  labels   {name}: {some}{more}")
    return lines


def _floaters(cloud: GaussianCloud) -> list[str]:
    """Return a line about floaters, which do not count for the size of an object."""
    floaters = find_floaters(cloud)
    if floaters is None:
        return []
    count, share = int(floaters.mask.sum()), 100 * floaters.share
    reach = _reach(cloud.x[~floaters.mask])
    return [f"  floaters {count:,} ({share:.2g} % of the opacity); the others reach {reach}"]


def _mesh(path: Path) -> str:
    """Return lines about a mesh."""
    surface = surface_mesh.read(path)
    topology = analyze_mesh(surface)
    return "\n".join(
        [
            f"{path}: a mesh of {len(surface.triangles):,} triangles,"
            f" {len(surface.points):,} points",
            f"  extent   {_reach(surface.points)}, in the units of the file",
            f"  surface  {describe_surface(topology)}",
            f"  shells   {describe_shells(topology)}",
            f"  colors   {_mesh_colors(surface)}",
        ]
    )


def _mesh_colors(surface: Mesh) -> str:
    """Return text on where the colors of a mesh come from, and their range."""
    sources = []
    if surface.textures is not None:
        count = len(surface.textures.images)
        sources.append(f"of {'a picture' if count == 1 else f'{count} pictures'}")
    if surface.rgb is not None:
        sources.append(f"of its points, {_color_range(surface.rgb)}")
    elif surface.triangle_rgb is not None:
        colored = np.isfinite(surface.triangle_rgb).all(axis=1)
        own = surface.triangle_rgb[colored]
        which = "its triangles" if colored.all() else f"{colored.sum():,} of its triangles"
        if len(own):
            sources.append(f"of {which}, {_color_range(own)}")
    return "; ".join(sources) or "none: the scene gives one"


def _color_range(rgb: np.ndarray) -> str:
    """Return the lowest and highest red, green and blue of colors (n, 3)."""
    ends = zip(("red", "green", "blue"), rgb.min(axis=0), rgb.max(axis=0), strict=True)
    return ", ".join(f"{name} {low:.2f} to {high:.2f}" for name, low, high in ends)


def _reach(x: np.ndarray) -> str:
    """Return the extent in the file's own units: a scene gives it its size."""
    ends = zip("xyz", x.min(axis=0), x.max(axis=0), strict=True)
    return ", ".join(f"{axis} {low:.4g} .. {high:.4g}" for axis, low, high in ends)


def _middle(values: np.ndarray) -> str:
    """Return the median as text."""
    return f"{np.median(values):.3g}"
