"""How much two sets of Gaussians look alike: the signal-to-noise ratio of their pictures."""

from dataclasses import dataclass

import numpy as np

from vgmpi.gaussians import sh as harmonics
from vgmpi.gaussians.cloud import Cloud
from vgmpi.splatting.camera import Camera, look_at
from vgmpi.splatting.decibels import decibels
from vgmpi.splatting.splat import ALPHA_MIN, Splats, render

PIXELS = 400  # edge of a picture
ANGLES = 4  # cameras on each of the three circles
HEIGHTS = (-0.35, 0.15, 0.7)  # sines of the circles' heights above the middle
FOV = 40.0  # [degrees]
_MARGIN = 1.1  # of the picture's half edge relative to the object's radius


@dataclass(frozen=True)
class Likeness:
    """Peak signal-to-noise ratios [dB]: inside the object's outline, and of whole pictures."""

    inside: float
    whole: float


def cameras(x: np.ndarray, pixels: int = PIXELS) -> list[Camera]:
    """Twelve fixed cameras around points (n, 3) [m], which fill most of each picture."""
    low, high = x.min(axis=0), x.max(axis=0)
    middle, radius = (low + high) / 2, max(float(np.linalg.norm(high - low)) / 2, 1e-9)
    away = _MARGIN * radius / np.sin(np.radians(FOV / 2))
    found = []
    for row, sine in enumerate(HEIGHTS):
        for k in range(ANGLES):
            angle = 2 * np.pi * (k + row / len(HEIGHTS)) / ANGLES
            level = np.sqrt(1 - sine * sine)
            toward = np.array([level * np.cos(angle), level * np.sin(angle), sine])
            eye = middle + away * toward
            found.append(look_at(eye, middle, (0.0, 0.0, 1.0), FOV, pixels, pixels))
    return found


def pictures(
    cloud: Cloud, views: list[Camera], cov: np.ndarray | None = None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """(picture before white, 0..1; transmittance) of a cloud for every camera.

    cov: covariances (n, 6) [m2] to draw instead of its own.
    """
    cov = cloud.cov() if cov is None else cov
    out = []
    for view in views:
        color = harmonics.evaluate(cloud.sh, cloud.x - view.eye)
        splats = Splats(cloud.x, cov, cloud.opacity, color)
        picture, through = render(splats, view, alpha_min=ALPHA_MIN)
        out.append((np.clip(picture, 0.0, 1.0), through))
    return out


def likeness(wanted: list, got: list) -> Likeness:
    """Of `pictures` for the same cameras: mean square errors over all of them, as decibels.

    Inside is where less than half of the background is seen through the wanted object.
    """
    inside, whole = [], []
    for (a, through), (b, _) in zip(wanted, got, strict=True):
        square = ((a.astype(np.float64) - b) ** 2).mean(axis=2)
        inside.append(square[through < 0.5])
        whole.append(square.ravel())
    return Likeness(decibels(np.concatenate(inside)), decibels(np.concatenate(whole)))
