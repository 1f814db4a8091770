"""Pictures of frames from fixed cameras, the time they take, and how much two sets look alike."""

import time
from dataclasses import dataclass, replace

import numpy as np

from postprocess.look import Look, seen
from postprocess.painter import domain_box
from vgmpi.output.read import RunFiles
from vgmpi.splatting import splat
from vgmpi.splatting.camera import HEIGHT, Camera, look_at, orbit_eye, overview
from vgmpi.splatting.decibels import decibels
from vgmpi.splatting.splat import Splats

CAMERAS, FOV = 12, 40.0  # around the domain, all of it in view; degrees
ROUNDS = 2  # times each picture is drawn for its time


@dataclass(frozen=True)
class Portraits:
    """A frame from every camera.

    pictures: (height, width, 3) float32 in 0..1 each. splats: what was drawn, for every camera.
    seconds: of processor time per picture, the median: from the arrays of a frame to pixels.
    colours: the same for the transfer of colour through the grid, once for all cameras.
    """

    pictures: list[np.ndarray]
    splats: list[Splats]
    seconds: float
    colours: float


def cameras(run: RunFiles, pixels: int) -> list[Camera]:
    """Twelve fixed cameras on a circle around the domain, which is wholly in view."""
    box = domain_box(run)
    angles = 360.0 / CAMERAS * np.arange(CAMERAS)
    target, distance, height = overview(*box, FOV, 1.0, angles)
    assert np.isclose(height, HEIGHT * distance)
    eyes = [orbit_eye(target, distance, height, angle) for angle in angles]
    return [look_at(eye, target, (0.0, 0.0, 1.0), FOV, pixels, pixels) for eye in eyes]


def portraits(look: Look, index: int, views: list[Camera], alpha_min: float) -> Portraits:
    """Frame `index` of a run as a video shows it, before white."""
    frame = look.run.frame(index)
    begin = time.process_time()
    sh = look.colours.at(index, frame)
    colours = time.process_time() - begin
    frame = frame if sh is None else {**frame, "sh": sh}
    draw(seen(look.parts(frame), views[0].eye), views[0], alpha_min)  # compiles
    pictures, drawn, spent = [], [], []
    for view in views:
        for _ in range(ROUNDS):
            begin = time.process_time()
            splats = seen(look.parts(frame), view.eye)
            picture = draw(splats, view, alpha_min)[0]
            spent.append(time.process_time() - begin)
        pictures.append(picture)
        drawn.append(splats)
    return Portraits(pictures, drawn, float(np.median(spent)), colours)


def draw(splats: Splats, view: Camera, alpha_min: float) -> tuple[np.ndarray, np.ndarray]:
    """Picture (height, width, 3) in 0..1 and transmittance (height, width)."""
    picture, left = splat.render(splats, view, alpha_min=alpha_min)[:2]
    return np.clip(picture, 0.0, 1.0), left


def masks(
    of: list[Splats], rows: np.ndarray, views: list[Camera], alpha_min: float
) -> list[np.ndarray]:
    """Where the Gaussians `rows` (n,) bool, drawn alone, cover more than half: bool pictures."""
    return [draw(rows_of(s, rows), view, alpha_min)[1] < 0.5 for s, view in zip(of, views)]


def rows_of(splats: Splats, rows: np.ndarray) -> Splats:
    """Some of the Gaussians; rows: indices or bool (n,)."""
    return Splats(splats.x[rows], splats.cov[rows], splats.opacity[rows], splats.color[rows])


def by_chance(
    of: list[Splats],
    parts: list[tuple[np.ndarray, int]],
    views: list[Camera],
    alpha_min: float,
    seed: int,
) -> list[np.ndarray]:
    """Pictures with some of the Gaussians, kept by chance.

    parts: rows (m,) of one part of a body and how many of them stay; rows in none all do. What
    stays is drawn wider by the cube root of what it stands for.
    """
    random = np.random.default_rng(seed)
    wider = np.ones(len(of[0].x))
    for rows, count in parts:
        kept = random.choice(rows, count, replace=False)
        wider[rows] = 0.0
        wider[kept] = (len(rows) / max(count, 1)) ** (2 / 3)
    left = np.flatnonzero(wider)
    out = []
    for splats, view in zip(of, views):
        some = rows_of(splats, left)
        some = replace(some, cov=some.cov * wider[left, None])
        out.append(draw(some, view, alpha_min)[0])
    return out


def psnr(
    wanted: list[np.ndarray], got: list[np.ndarray], inside: list[np.ndarray] | None = None
) -> float:
    """Peak signal-to-noise ratio [dB] over all pictures; inside: of these pixels only."""
    squares = [((a.astype(np.float64) - b) ** 2).mean(axis=2) for a, b in zip(wanted, got)]
    if inside is not None:
        squares = [square[mask] for square, mask in zip(squares, inside)]
    return decibels(np.concatenate([square.ravel() for square in squares]))
