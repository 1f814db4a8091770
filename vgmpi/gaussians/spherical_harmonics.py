"""Spherical harmonics up to degree 3: the view-dependent color of a Gaussian.

The basis has the order and the signs of the 3D Gaussian Splatting files (Kerbl 2023): coefficient 0
is constant, 1-3 are (-y, z, -x), and so on. A color is `max(basis . sh + 0.5, 0)`, so that a gray
Gaussian has sh = 0.
"""

import numpy as np

C0 = 0.28209479177387814  # 1 / (2 sqrt(pi)), the constant basis function
C1 = 0.4886025119029199
C2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)
C3 = (
    0.5900435899266435,
    2.890611442640554,
    0.4570457994644658,
    0.3731763325901154,
    1.445305721320277,
)
COEFFICIENTS = (1, 4, 9, 16)  # [-] number K of coefficients for degree 0, 1, 2, 3

_CHUNK = 1 << 14  # [rows] rotated together, which bounds the scratch memory


def rgb_from_dc(dc: np.ndarray) -> np.ndarray:
    """Return the color in 0..1 (not clamped) of constant coefficients (..., 3)."""
    return np.asarray(dc) * C0 + 0.5


def dc_from_rgb(rgb: np.ndarray) -> np.ndarray:
    """Return the constant coefficients of a color in 0..1 (..., 3)."""
    return (np.asarray(rgb) - 0.5) / C0


def basis(directions: np.ndarray, count: int) -> np.ndarray:
    """Return the first `count` basis functions at unit `directions` (..., 3), as (..., count)."""
    if count not in COEFFICIENTS:
        raise ValueError(f"{count} coefficients per channel: allowed 1, 4, 9 or 16")
    d = np.asarray(directions, dtype=np.float64)
    x, y, z = d[..., 0], d[..., 1], d[..., 2]
    out = np.empty((*d.shape[:-1], count))
    out[..., 0] = C0
    if count > 1:
        out[..., 1] = -C1 * y
        out[..., 2] = C1 * z
        out[..., 3] = -C1 * x
    if count > 4:
        out[..., 4] = C2[0] * x * y
        out[..., 5] = -C2[0] * y * z
        out[..., 6] = C2[1] * (2 * z * z - x * x - y * y)
        out[..., 7] = -C2[0] * x * z
        out[..., 8] = C2[2] * (x * x - y * y)
    if count > 9:
        out[..., 9] = -C3[0] * y * (3 * x * x - y * y)
        out[..., 10] = C3[1] * x * y * z
        out[..., 11] = -C3[2] * y * (4 * z * z - x * x - y * y)
        out[..., 12] = C3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y)
        out[..., 13] = -C3[2] * x * (4 * z * z - x * x - y * y)
        out[..., 14] = C3[4] * z * (x * x - y * y)
        out[..., 15] = -C3[0] * x * (x * x - 3 * y * y)
    return out


def evaluate(sh: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return the colors (n, 3) >= 0 of `sh` (n, K, 3) seen along `directions` (n, 3).

    The directions point away from the camera and need not have unit length; a zero direction
    sees the constant part only.
    """
    sh = np.asarray(sh)
    if sh.shape[1] == 1:
        return np.maximum(rgb_from_dc(sh[:, 0].astype(np.float64)), 0.0)
    d = np.asarray(directions, dtype=np.float64)
    length = np.linalg.norm(d, axis=-1, keepdims=True)
    d = d / np.where(length > 0, length, 1.0)
    return np.maximum(np.einsum("nk,nkc->nc", basis(d, sh.shape[1]), sh) + 0.5, 0.0)


def limit_degree(sh: np.ndarray) -> np.ndarray:
    """Return coefficients (n, K, 3) of a file up to the highest degree that is drawn, 3."""
    return sh[:, : COEFFICIENTS[-1]]


def degree_omissions(degree: int) -> tuple[str, ...]:
    """Return a clause on the colors of a file of some degree that `limit_degree` leaves out."""
    limit = len(COEFFICIENTS) - 1
    if degree <= limit:
        return ()
    return (f"colors of degree {degree} are left out, the highest is {limit}",)


def rotate(sh: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return the coefficients (n, K, 3) after a rotation (3, 3) or (n, 3, 3) of the Gaussians.

    The rotated object shows towards d what it showed towards R^T d before. Both sides lie in the
    span of one degree's functions, so values at a few fixed directions give the new coefficients
    exactly (no Wigner matrices). This holds for matrices that mirror, too.
    """
    sh = np.asarray(sh)
    count = sh.shape[1]
    rotation = np.asarray(rotation, dtype=np.float64)
    out = sh.astype(np.float64)  # a copy; degree 0 is invariant
    if count == 1:
        return out.astype(sh.dtype)
    samples = _sphere(24)
    at_samples = basis(samples, count)
    for first, last in ((1, 4), (4, 9), (9, 16)):
        if first >= count:
            break
        inverse = np.linalg.pinv(at_samples[:, first:last])
        if rotation.ndim == 2:
            turn = inverse @ basis(samples @ rotation, count)[:, first:last]
            out[:, first:last] = np.einsum("ij,njc->nic", turn, sh[:, first:last])
            continue
        for start in range(0, len(sh), _CHUNK):
            rows = slice(start, start + _CHUNK)
            turned = basis(samples @ rotation[rows], count)[..., first:last]
            out[rows, first:last] = (inverse @ turned) @ sh[rows, first:last]
    return out.astype(sh.dtype)


def _sphere(count: int) -> np.ndarray:
    """Return `count` unit vectors spread evenly (golden spiral), (count, 3)."""
    i = np.arange(count) + 0.5
    z = 1 - 2 * i / count
    angle = np.pi * (1 + np.sqrt(5)) * i
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
