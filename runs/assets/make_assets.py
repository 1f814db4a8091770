"""Write the Gaussians of the examples: python runs/assets/make_assets.py [folder].

A toy duck of ellipsoids, about 31,000 flat Gaussians with painted light and a soft sheen. The same
bytes every time. Without a folder it goes to runs/splash/assets, where its scene looks for it.
--gaussians N: another number of them, before hidden ones are left out. --things duck ball: also a
ball with a belt, of a third as many. --width W: their radii over their spacing.
"""

import argparse
import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # also without an installed vgmpi

from vgmpi.gaussians.cloud import GaussianCloud
from vgmpi.gaussians.formats import ply
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb

GAUSSIANS = 46_000  # of all parts, before hidden ones are left out
WIDTH = 0.6  # standard deviation of a disc over the spacing
LEAST = 1 / 115  # share of the Gaussians that the smallest parts have
LIGHT = np.array([0.36, -0.48, 0.80])
BALL_SHARE = 3  # a ball has a third of the duck's Gaussians
SHEEN = 0.16  # how much brighter a surface is seen head-on than from the side
C1 = 0.4886025119029199  # factor of the first-degree spherical harmonics

YELLOW, DEEP, ORANGE = (1.0, 0.80, 0.12), (0.98, 0.68, 0.08), (0.95, 0.42, 0.08)
WHITE, BLACK = (0.97, 0.97, 0.97), (0.04, 0.04, 0.06)
RED = (0.85, 0.20, 0.23)

# name: middle, half axes, tilt about y [deg], color; the duck looks along +x, z is up
DUCK = {
    "body": ((0.00, 0.00, 0.36), (0.56, 0.40, 0.35), -6, YELLOW),
    "tail": ((-0.50, 0.00, 0.52), (0.22, 0.18, 0.10), 38, YELLOW),
    "left wing": ((-0.08, 0.36, 0.42), (0.30, 0.09, 0.17), 14, DEEP),
    "right wing": ((-0.08, -0.36, 0.42), (0.30, 0.09, 0.17), 14, DEEP),
    "neck": ((0.26, 0.00, 0.62), (0.21, 0.20, 0.22), 0, YELLOW),
    "head": ((0.32, 0.00, 0.86), (0.27, 0.26, 0.26), 0, YELLOW),
    "upper beak": ((0.62, 0.00, 0.86), (0.17, 0.15, 0.045), 10, ORANGE),
    "lower beak": ((0.60, 0.00, 0.81), (0.13, 0.12, 0.035), -4, DEEP),
    "left eye": ((0.505, 0.135, 0.95), (0.062, 0.062, 0.075), 0, WHITE),
    "right eye": ((0.505, -0.135, 0.95), (0.062, 0.062, 0.075), 0, WHITE),
    "left pupil": ((0.548, 0.150, 0.955), (0.034, 0.034, 0.046), 0, BLACK),
    "right pupil": ((0.548, -0.150, 0.955), (0.034, 0.034, 0.046), 0, BLACK),
}


def sphere_points(count: int) -> np.ndarray:
    """Evenly spread unit vectors (n, 3): the golden spiral."""
    k = np.arange(count) + 0.5
    z, angle = 1 - 2 * k / count, k * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def area(radii: np.ndarray) -> float:
    """Surface of an ellipsoid, within 1.2 % (Thomsen's formula)."""
    a, b, c = radii**1.6075
    return float(4 * np.pi * ((a * b + a * c + b * c) / 3) ** (1 / 1.6075))


def part(spec: tuple, count: int, width: float) -> GaussianCloud:
    """Flat Gaussians on one ellipsoid: discs of the unit sphere, stretched with it."""
    middle, radii, tilt, color = spec
    turn = Rotation.from_euler("y", tilt, degrees=True).as_matrix()
    stretch = turn @ np.diag(radii)
    unit = sphere_points(count)
    x = unit @ stretch.T + middle
    normal = unit @ np.linalg.inv(stretch)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    spread = width**2 * 4 * np.pi / count  # variance of a disc: (width sqrt(area / count))^2
    flat = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    cov = stretch @ (spread * flat) @ stretch.T
    values, axes = np.linalg.eigh(cov)
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]  # rotations, not reflections
    scale = np.sqrt(np.maximum(values, 0.0))
    scale[:, 0] = 0.1 * scale[:, 1]
    quat = Rotation.from_matrix(axes).as_quat()[:, (3, 0, 1, 2)]
    return GaussianCloud(x, quat, scale, np.full(count, 0.95), harmonics(normal, color, x))


def harmonics(normal: np.ndarray, color: tuple | np.ndarray, x: np.ndarray) -> np.ndarray:
    """Color coefficients (n, 4, 3): painted light, darker below, and a sheen towards the eye."""
    lit = 0.62 + 0.38 * (0.5 + 0.5 * normal @ LIGHT)
    grain = 1 + 0.02 * np.sin(40 * x[:, 0]) * np.sin(37 * x[:, 1]) * np.sin(43 * x[:, 2])
    rgb = np.asarray(color) * (lit * grain)[:, None]
    sh = np.zeros((len(normal), 4, 3))
    sh[:, 0] = dc_from_rgb(np.clip(rgb, 0, 1))
    # the basis is C1 (-y, z, -x) of the direction from the eye; head-on it is minus the normal
    sh[:, 1:] = (SHEEN / C1 * normal[:, (1, 2, 0)] * (1, -1, 1))[:, :, None] * rgb[:, None, :]
    return sh.astype(np.float32)


def hidden(x: np.ndarray, spec: tuple) -> np.ndarray:
    """Points (n, 3) that lie inside an ellipsoid."""
    middle, radii, tilt, _ = spec
    turn = Rotation.from_euler("y", tilt, degrees=True).as_matrix()
    return (((x - middle) @ turn / radii) ** 2).sum(axis=1) < 0.98


def duck(count: int, width: float) -> GaussianCloud:
    """All parts; what lies inside another part is left out of `count`."""
    total = sum(area(np.array(spec[1])) for spec in DUCK.values())
    clouds = []
    for name, spec in DUCK.items():
        share = area(np.array(spec[1])) / total
        cloud = part(spec, max(round(LEAST * count), round(share * count)), width)
        others = [hidden(cloud.x, other) for key, other in DUCK.items() if key != name]
        clouds.append(cloud.select(~np.any(others, axis=0)))
    names = ("x", "quat", "scale", "opacity", "sh")
    return GaussianCloud(*(np.concatenate([getattr(c, n) for c in clouds]) for n in names))


def ball(count: int, width: float) -> GaussianCloud:
    """A red ball with a white belt that fades into it; its radius is 1."""
    z = sphere_points(count // BALL_SHARE)[:, 2:]
    belt = 1 / (1 + np.exp((np.abs(z) - 0.3) / 0.03))
    color = belt * np.array(WHITE) + (1 - belt) * np.array(RED)
    return part(((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 0, color), len(z), width)


THINGS = {"duck": duck, "ball": ball}


def main() -> None:
    default = Path(__file__).resolve().parents[1] / "splash" / "assets"
    p = argparse.ArgumentParser(description=__doc__)
    p.add_argument("folder", nargs="?", type=Path, default=default)
    p.add_argument("--gaussians", type=int, default=GAUSSIANS, help="of a duck's parts")
    p.add_argument("--things", nargs="+", choices=THINGS, default=["duck"])
    p.add_argument("--width", type=float, default=WIDTH, help="standard deviation over spacing")
    given = p.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for name in given.things:
        cloud = THINGS[name](given.gaussians, given.width)
        path = given.folder / f"{name}.ply"
        ply.write(path, cloud)
        print(f"{path}: {len(cloud):,} Gaussians, {path.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    main()
