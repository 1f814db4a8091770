"""A slow renderer to trust: float64, every Gaussian at every pixel, written from the formulas.

It shares no code with vgmpi/splatting: matrices where that has scalars, no tiles, no boxes, no
polynomial for the exponential, and spherical harmonics from associated Legendre functions.
"""

from math import factorial

import numpy as np
from scipy.special import lpmv


def harmonics(directions, count):
    """Real spherical harmonics (n, count) with the Condon-Shortley phase, order l, m = -l..l."""
    d = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    azimuth = np.arctan2(d[:, 1], d[:, 0])
    columns = []
    for degree in range(int(np.sqrt(count))):
        for m in range(-degree, degree + 1):
            a = abs(m)
            norm = (2 * degree + 1) / (4 * np.pi) * factorial(degree - a) / factorial(degree + a)
            wave = {1: np.cos, -1: np.sin, 0: np.ones_like}[np.sign(m)](a * azimuth)
            legendre = lpmv(a, degree, d[:, 2])
            columns.append((np.sqrt(2) if m else 1) * np.sqrt(norm) * legendre * wave)
    return np.stack(columns, axis=1)


def colors(sh, directions):
    """max(SH + 0.5, 0), (n, 3)."""
    basis = harmonics(directions, sh.shape[1])
    return np.maximum((basis[:, :, None] * sh).sum(axis=1) + 0.5, 0)


def project(x, cov, w2c, fx, fy, cx, cy, width, height):
    """Depth (n,), mean (n, 2), covariance (n, 2, 2) on the picture without lowpass."""
    rotation = w2c[:3, :3]
    p = x @ rotation.T + w2c[:3, 3]
    depth = p[:, 2]
    ratio = p[:, :2] / depth[:, None]
    mean = ratio * [fx, fy] + [cx, cy]
    margin = 0.3 * np.array([0.5 * width / fx, 0.5 * height / fy])
    low = -np.array([cx / fx, cy / fy]) - margin
    high = np.array([(width - cx) / fx, (height - cy) / fy]) + margin
    t = np.clip(ratio, low, high) * depth[:, None]
    jacobian = np.zeros((len(x), 2, 3))
    jacobian[:, 0, 0] = fx / depth
    jacobian[:, 1, 1] = fy / depth
    jacobian[:, 0, 2] = -fx * t[:, 0] / depth**2
    jacobian[:, 1, 2] = -fy * t[:, 1] / depth**2
    m = jacobian @ rotation
    return depth, mean, m @ cov @ m.transpose(0, 2, 1)


def render(
    x,
    cov,
    opacity,
    color,
    camera,
    background,
    *,
    lowpass=0.3,
    antialias=False,
    alpha_min=1 / 255,
):
    """Picture (height, width, 3) and transmittance (height, width)."""
    height, width = camera.height, camera.width
    image, left = np.zeros((height, width, 3)), np.ones((height, width))
    for i, _, alpha in blended(x, cov, opacity, camera, lowpass, antialias, alpha_min):
        image += (left * alpha)[..., None] * color[i]
        left *= 1 - alpha
    return image + left[..., None] * np.asarray(background), left


def depths(x, cov, opacity, camera, *, lowpass=0.3, antialias=False, alpha_min=1 / 255):
    """Expected and median depth (height, width), infinite where there is none."""
    total, left = np.zeros((2, camera.height, camera.width))
    left += 1
    median = np.full(left.shape, np.inf)
    for _, depth, alpha in blended(x, cov, opacity, camera, lowpass, antialias, alpha_min):
        total += left * alpha * depth
        median[(left > 0.5) & (left * (1 - alpha) <= 0.5)] = depth
        left *= 1 - alpha
    with np.errstate(divide="ignore", invalid="ignore"):
        return {"expected": np.where(left < 1, total / (1 - left), np.inf), "median": median}


def blended(x, cov, opacity, camera, lowpass, antialias, alpha_min):
    """Number, depth and alpha (height, width), 0 where it does not count, from near to far.

    lowpass, antialias: of all, or of each (n,).
    """
    width, height = camera.width, camera.height
    lens = camera.fx, camera.fy, camera.cx, camera.cy
    depth, mean, flat = project(x, cov, camera.world_to_camera, *lens, width, height)
    wide = flat + np.broadcast_to(lowpass, len(x))[:, None, None] * np.eye(2)
    ratio = np.linalg.det(flat) / np.linalg.det(wide)
    opacity = opacity * np.where(antialias, np.sqrt(np.maximum(ratio, 0.005**2)), 1.0)
    px, py = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    left = np.ones((height, width))
    stopped = np.zeros((height, width), dtype=bool)
    for i in np.argsort(depth, kind="stable"):
        if depth[i] < camera.near_plane:
            continue
        d = np.stack([px - mean[i, 0], py - mean[i, 1]], axis=-1)
        s = 0.5 * np.einsum("...i,ij,...j", d, np.linalg.inv(wide[i]), d)
        alpha = np.minimum(0.99, opacity[i] * np.exp(-s))
        takes = (alpha >= alpha_min) & ~stopped
        stopped |= takes & (left * (1 - alpha) < 1e-4)
        alpha = np.where(takes & ~stopped, alpha, 0)
        yield i, depth[i], alpha
        left *= 1 - alpha
