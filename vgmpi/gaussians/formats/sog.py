"""Reader and writer of SOG files, spatially ordered Gaussians (PlayCanvas), as one ZIP archive.

Version 2 is written. Every property is a lossless WebP picture with a pixel per Gaussian.
SuperSplat, PlayCanvas and Spark read these files, also as streams.
"""

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.runtime.user_files import replace_file

from .residual_coding import morton_order
from .sog_reader import read
from .validation import GaussianFileError

__all__ = ["PALETTE", "read", "write"]

CODEBOOK = 256  # values that a byte selects
PALETTE = 1 << 16  # view-dependent colors that a file can hold
COLUMNS = 64  # palette entries in a row of their picture
MIN_SCALE = 1e-9  # [m] sizes below have no logarithm worth keeping
_ROUNDS = 12  # iterations of Lloyd's method for a codebook
_COMPONENTS = 6  # principal components by which a palette is searched
_DATE = (1980, 1, 1, 0, 0, 0)  # of the archive's members: the same Gaussians give the same bytes


def write(path: str | Path, cloud: GaussianCloud) -> None:
    """Write `cloud` in its axes, in the order of a Morton curve.

    Raises:
        GaussianFileError: If the cloud is empty.
        OSError: If the file cannot be written.
    """
    if not len(cloud):
        raise GaussianFileError(f"{path}: a .sog holds at least one Gaussian")
    spacing = float(np.ptp(cloud.x, axis=0).max()) / 1024 or 1.0
    cloud = cloud.select(morton_order(cloud.x, spacing))
    width = 4 * -(-int(np.ceil(np.sqrt(len(cloud)))) // 4)
    meta: dict[str, Any] = {"version": 2, "asset": {"generator": "vgmpi"}, "count": len(cloud)}
    if cloud.is_antialiased:  # as splat-transform has it, and as the format was proposed
        meta |= {"model": "antialiased", "antialias": True}
    pictures: dict[str, np.ndarray] = {}
    _add_positions(meta, pictures, cloud)
    _add_shapes(meta, pictures, cloud)
    _add_colors(meta, pictures, cloud)
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w") as archive:
        archive.writestr(zipfile.ZipInfo("meta.json", _DATE), json.dumps(meta))
        for name, rows in pictures.items():
            picture = rows if rows.ndim == 3 else _picture(rows, width)
            archive.writestr(zipfile.ZipInfo(name, _DATE), _webp(picture))
    replace_file(path, data.getvalue())


def _add_positions(meta: dict, pictures: dict, cloud: GaussianCloud) -> None:
    """Add the positions, 16 bits of sign(x) log(1 + |x|) per axis."""
    values = np.sign(cloud.x) * np.log1p(np.abs(cloud.x))
    low, high = values.min(axis=0), values.max(axis=0)
    steps = np.rint((values - low) / np.maximum(high - low, 1e-30) * 65535).astype(np.uint16)
    files = ["means_l.webp", "means_u.webp"]
    meta["means"] = {"mins": low.tolist(), "maxs": high.tolist(), "files": files}
    pictures["means_l.webp"] = (steps & 255).astype(np.uint8)
    pictures["means_u.webp"] = (steps >> 8).astype(np.uint8)


def _add_shapes(meta: dict, pictures: dict, cloud: GaussianCloud) -> None:
    """Add the logarithms of the sizes by a codebook, and the rotations by three components."""
    codebook, labels = _codebook(np.log(np.maximum(cloud.scale, MIN_SCALE)))
    meta["scales"] = {"codebook": codebook.tolist(), "files": ["scales.webp"]}
    pictures["scales.webp"] = labels
    leading_index = np.abs(cloud.quat).argmax(axis=1)
    leading = np.take_along_axis(cloud.quat, leading_index[:, None], axis=1)
    quat = cloud.quat * np.where(leading < 0, -1.0, 1.0)
    others = np.array([[k for k in range(4) if k != n] for n in range(4)])[leading_index]
    small = np.take_along_axis(quat, others, axis=1)
    rows = np.empty((len(cloud), 4), np.uint8)
    rows[:, :3] = np.rint(np.clip(small * np.sqrt(0.5) + 0.5, 0, 1) * 255)
    rows[:, 3] = 252 + leading_index
    meta["quats"] = {"files": ["quats.webp"]}
    pictures["quats.webp"] = rows


def _add_colors(meta: dict, pictures: dict, cloud: GaussianCloud) -> None:
    """Add colors and opacities, and the view dependence by a palette."""
    codebook, labels = _codebook(cloud.sh[:, 0].astype(np.float64))
    opacity = np.rint(np.clip(cloud.opacity, 0, 1) * 255).astype(np.uint8)
    meta["sh0"] = {"codebook": codebook.tolist(), "files": ["sh0.webp"]}
    pictures["sh0.webp"] = np.column_stack([labels, opacity])
    higher = cloud.sh[:, 1:].astype(np.float64)
    if not higher.any():
        return
    palette, entries = _palette(higher)
    codebook, codes = _codebook(palette)
    count, terms = palette.shape[:2]
    rows = -(-count // COLUMNS)
    centroids = np.zeros((rows * COLUMNS, terms, 3), np.uint8)
    centroids[:count] = codes
    files = ["shN_centroids.webp", "shN_labels.webp"]
    meta["shN"] = {
        "count": count, "bands": round((terms + 1) ** 0.5) - 1, "codebook": codebook.tolist(),
        "files": files,
    }  # fmt: skip
    pictures["shN_centroids.webp"] = centroids.reshape(rows, COLUMNS * terms, 3)
    labels = np.zeros((len(cloud), 3), np.uint8)
    labels[:, 0], labels[:, 1] = entries & 255, entries >> 8
    pictures["shN_labels.webp"] = labels


def _codebook(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return 256 numbers and the index (uint8) of the nearest one for each value."""
    flat = np.sort(values, axis=None)
    unique = np.unique(flat)
    if len(unique) <= CODEBOOK:
        book = np.concatenate([unique, np.full(CODEBOOK - len(unique), unique[-1])])
    else:  # half of the first guess follows the density, half the range
        density = flat[np.linspace(0, len(flat) - 1, CODEBOOK // 2).astype(int)]
        book = np.sort(np.concatenate([density, np.linspace(flat[0], flat[-1], CODEBOOK // 2)]))
        totals = np.concatenate([[0.0], np.cumsum(flat)])
        for _ in range(_ROUNDS):
            edges = np.searchsorted(flat, 0.5 * (book[1:] + book[:-1]))
            edges = np.concatenate([[0], edges, [len(flat)]])
            count = np.diff(edges)
            mean = np.diff(totals[edges]) / np.maximum(count, 1)
            book = np.sort(np.where(count > 0, mean, book))
    labels = np.searchsorted(0.5 * (book[1:] + book[:-1]), values).astype(np.uint8)
    return book, labels


def _palette(higher: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return palette entries (k, terms, 3) and the entry of each Gaussian (n,).

    Entry 0 has no view dependence. Up to PALETTE - 1 others have an entry of their own; beyond,
    a sample of them stands for all.
    """
    rows = higher.reshape(len(higher), -1)
    shiny = np.flatnonzero(rows.any(axis=1))
    entries = np.zeros(len(rows), np.int64)
    chosen = shiny
    if len(shiny) >= PALETTE:
        from scipy.spatial import cKDTree  # only large clouds need it

        chosen = np.random.default_rng(0).choice(shiny, PALETTE - 1, replace=False)
        axes = np.linalg.svd(rows[chosen[:4096]], full_matrices=False)[2][:_COMPONENTS].T
        entries[shiny] = 1 + cKDTree(rows[chosen] @ axes).query(rows[shiny] @ axes)[1]
    else:
        entries[shiny] = 1 + np.arange(len(shiny))
    palette = np.concatenate([np.zeros((1, *higher.shape[1:])), higher[chosen]])
    return palette, entries


def _picture(rows: np.ndarray, width: int) -> np.ndarray:
    """Return rows (n, channels) as a picture (height, width, channels) filled with zeros."""
    height = -(-len(rows) // width)
    out = np.zeros((height * width, rows.shape[1]), np.uint8)
    out[: len(rows)] = rows
    return out.reshape(height, width, rows.shape[1])


def _webp(picture: np.ndarray) -> bytes:
    """Return a lossless WebP file; `exact` keeps colors where the fourth channel is 0."""
    from PIL import Image  # only this format needs it

    data = io.BytesIO()
    Image.fromarray(picture).save(data, "webp", lossless=True, exact=True, quality=60, method=4)
    return data.getvalue()
