"""Comparison of Gaussians with what the bits of a file format leave of them, and of files of other
programs with the .ply that they were made of."""

from types import SimpleNamespace

import numpy as np

from tests.support.splat_converters import read_table
from vgmpi.gaussians.cloud import GaussianCloud, rotation_matrices
from vgmpi.gaussians.spherical_harmonics import C0

COUNT = 300
SINGLE = 1e-5  # [-] several roundings of float32 at coordinates up to 16, logarithms, logits

# the largest errors that the bits of a format leave: positions, logarithms of sizes, components of
# unit quaternions, opacities, coefficients of degree 0 and above
FLOAT = {"x": 2e-6, "log_scale": 2e-6, "quat": 1e-6, "opacity": 1e-6, "dc": 1e-6, "sh": 1e-6}
BYTE = 0.5 / 255
SMALLEST_THREE = {bits: 0.5 * np.sqrt(2) / (2**bits - 1) for bits in (8, 10)}
SPZ = {
    "x": 0.5 / 2**16,
    "log_scale": 0.5 / 16,
    "quat": 0.5 * np.sqrt(0.5) / 511,
    "opacity": BYTE,
    "dc": BYTE / 0.15,
    "sh": 0.5 / 128,
}
SPZ_12 = SPZ | {"x": 0.5 / 2**12 + 1e-6}  # 12 fractional bits, of numbers in float32
SPZ_5 = SPZ_12 | {"sh": 8.5 / 128}  # 4 bits of colors above degree 1, rounded before as well
SPLAT = FLOAT | {"quat": 1 / 128, "opacity": BYTE, "dc": BYTE / C0}
KSPLAT = FLOAT | {"opacity": 2 * BYTE, "dc": 2 * BYTE / C0}  # bytes are rounded down
KSPLAT_1 = KSPLAT | {"x": 2.5 / 32767, "log_scale": 2**-10, "quat": 2**-10, "sh": 2**-10}
KSPLAT_2 = KSPLAT_1 | {"sh": 3 / 255}


def cloud(degree, seed=5):
    """Gaussians with sizes 1 to 150, within the colors that a .spz holds; antialiased or not."""
    rng = np.random.default_rng([degree, seed])
    quat = rng.normal(size=(COUNT, 4))
    sh = np.clip(rng.normal(0, 0.25, (COUNT, (degree + 1) ** 2, 3)), -0.95, 0.95)
    sh[:, 0] = rng.uniform(-1.4, 1.4, (COUNT, 3))
    return GaussianCloud(
        rng.normal(size=(COUNT, 3)) * [2, 1, 4],
        quat / np.linalg.norm(quat, axis=1)[:, None],
        np.exp(rng.uniform(-6, -1, (COUNT, 3))),
        rng.uniform(0.02, 0.98, COUNT),
        sh,
        is_antialiased=degree in (0, 3),
    )


def steps_of_compressed(c):
    """Errors of SuperSplat's layout; bounds of 256 Gaussians are taken as those of all."""
    bits = np.array([2**11 - 1, 2**10 - 1, 2**11 - 1])
    return {
        "x": (0.5 * np.ptp(c.x, axis=0) / bits + 1e-6),
        "log_scale": 0.5 * np.ptp(np.log(c.scale), axis=0) / bits + 1e-6,
        "quat": SMALLEST_THREE[10],
        "opacity": BYTE,
        "dc": 0.5 * np.ptp(c.sh[:, 0], axis=0) / 255 + 1e-6,
        "sh": 0.5 * 8 / 256,
    }


def steps_of_sog(c, steps=0.5):
    """Errors of a .sog, as parts of a step; values of codebooks are not among them."""
    unit = np.ptp(np.sign(c.x) * np.log1p(np.abs(c.x)), axis=0) / 65535 * (1 + np.abs(c.x))
    return {
        "x": 1.001 * steps * unit + 1e-6,
        "quat": 2 * steps * SMALLEST_THREE[8],
        "opacity": 2 * steps * BYTE,
    }


def turn_error(component):
    """The angle [rad] by which errors of three components of a unit quaternion turn it; the fourth,
    at least 1/2, follows from them."""
    return 2 * 2 * np.sqrt(3) * component


def columns_of(path):
    """Columns of a .ply of another program, without this program's reader."""
    comments, table = read_table(path)

    def stack(prefix, count):
        return np.stack([table[f"{prefix}{k}"] for k in range(count)], axis=1)

    higher = sum(name.startswith("f_rest_") for name in table)
    sh = stack("f_dc_", 3)[:, None]
    if higher:
        rest = stack("f_rest_", higher).reshape(len(sh), 3, -1).transpose(0, 2, 1)
        sh = np.concatenate([sh, rest], axis=1)
    quat = stack("rot_", 4)
    return SimpleNamespace(
        x=np.stack([table[axis] for axis in "xyz"], axis=1),
        scale=np.exp(stack("scale_", 3)),
        quat=quat / np.linalg.norm(quat, axis=1)[:, None],
        opacity=1 / (1 + np.exp(-table["opacity"])),
        sh=sh,
        is_antialiased="SplatRenderMode: mip" in comments,
    )


def in_order_of(c, x):
    """Gaussians of `c` in the order of positions x; each once."""
    row = np.linalg.norm(x[:, None] - c.x, axis=2).argmin(axis=1)
    assert sorted(row) == list(range(len(c)))
    return c.select(row)


def covariances(c):
    root = rotation_matrices(c.quat) * c.scale[:, None, :]
    return root @ root.transpose(0, 2, 1)


def check_bound(name, errors, bound):
    worst = (np.abs(errors) / bound).max()
    assert worst <= 1.0001, f"{name}: {worst:.3g} of what the bits leave"


def check_same(found, want, steps, terms=16):
    """Compare with `want`, in any order; steps: errors by name, a function of `want` or values."""
    want = in_order_of(want, found.x)
    steps = steps(want) if callable(steps) else steps
    check_bound("x", found.x - want.x, steps["x"])
    check_bound("opacity", found.opacity - want.opacity, steps["opacity"] + 1e-7)
    log_scale = steps.get("log_scale", np.log(found.scale / want.scale))  # codebook: as it is
    check_bound("sizes", np.log(found.scale / want.scale), np.abs(log_scale) + 1e-6)
    stretch = np.expm1(2 * np.max(np.abs(log_scale)))
    bound = stretch + 2 * turn_error(steps["quat"]) + 1e-6
    largest = want.scale.max(axis=1)[:, None, None] ** 2
    check_bound("covariances", (covariances(found) - covariances(want)) / largest, bound)
    kept = min(terms, want.sh.shape[1])
    assert found.sh.shape == (COUNT, kept, 3)
    for name, part in (("dc", slice(0, 1)), ("sh", slice(1, kept))):
        if name in steps and kept > part.start:
            error = (found.sh[:, part] - want.sh[:, part]).astype(np.float64)
            check_bound(name, error, steps[name] + 2e-6)
