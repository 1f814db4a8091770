"""Images from fixed cameras, their rendering time, and their similarity."""

import time
from dataclasses import dataclass, replace

import numpy as np

from vgmpi.gaussians.camera import HEIGHT, Camera, fit_orbit_to_box, look_at, orbit_eye
from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames.appearance import Appearance, view_dependent_splats
from vgmpi.postprocess.frames.frame_renderer import domain_box
from vgmpi.postprocess.raster import rasterize
from vgmpi.postprocess.raster.psnr import psnr as decibels
from vgmpi.postprocess.raster.rasterize import ProjectableGaussians

CAMERAS, FOV = 12, 40.0  # number of cameras around the domain; [degrees]
TIMING_ROUNDS = 2  # repetitions of each image for its timing


@dataclass(frozen=True)
class Portraits:
    """Images of a frame from every camera.

    pictures: (height, width, 3) float32 in 0..1 each. splats: Gaussians drawn, by camera. seconds:
    median processor time per image, from the arrays of a frame to pixels. colors: processor time
    of the transfer of color, once for all cameras.
    """

    pictures: list[np.ndarray]
    splats: list[ProjectableGaussians]
    seconds: float
    colors: float


def cameras(run: RunReader, pixels: int) -> list[Camera]:
    """Return twelve fixed cameras on a circle that show the whole domain."""
    box = domain_box(run)
    angles = 360.0 / CAMERAS * np.arange(CAMERAS)
    target, distance, height = fit_orbit_to_box(*box, FOV, 1.0, angles)
    assert np.isclose(height, HEIGHT * distance)
    eyes = [orbit_eye(target, distance, height, angle) for angle in angles]
    return [look_at(eye, target, (0.0, 0.0, 1.0), FOV, pixels, pixels) for eye in eyes]


def render_portraits(
    look: Appearance, index: int, views: list[Camera], alpha_min: float
) -> Portraits:
    """Render frame `index` of a run over white, as a video shows it.

    Args:
        look: Appearance of the run.
        index: Number of the frame.
        views: Cameras.
        alpha_min: Alpha below which a Gaussian is left out of a pixel.
    """
    frame = look.run.frame(index)
    begin = time.process_time()
    sh = look.colors.at_frame(index, frame)
    colors = time.process_time() - begin
    frame = frame if sh is None else {**frame, "sh": sh}
    # this call compiles
    draw(view_dependent_splats(look.parts(frame), views[0].eye), views[0], alpha_min)
    pictures, splats_by_view, times = [], [], []
    for view in views:
        for _ in range(TIMING_ROUNDS):
            begin = time.process_time()
            splats = view_dependent_splats(look.parts(frame), view.eye)
            picture = draw(splats, view, alpha_min)[0]
            times.append(time.process_time() - begin)
        pictures.append(picture)
        splats_by_view.append(splats)
    return Portraits(pictures, splats_by_view, float(np.median(times)), colors)


def draw(
    splats: ProjectableGaussians, view: Camera, alpha_min: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the image (height, width, 3) in 0..1 and transmittance (height, width)."""
    picture, transmittance = rasterize.render(splats, view, alpha_min=alpha_min)[:2]
    return np.clip(picture, 0.0, 1.0), transmittance


def masks(
    splats_by_view: list[ProjectableGaussians],
    rows: np.ndarray,
    views: list[Camera],
    alpha_min: float,
) -> list[np.ndarray]:
    """Return bool images of the pixels of which some Gaussians, drawn alone, cover half.

    Args:
        splats_by_view: Gaussians by camera.
        rows: Gaussians to draw, bool (n,).
        views: Cameras.
        alpha_min: Alpha below which a Gaussian is left out of a pixel.
    """
    return [
        draw(select_rows(s, rows), view, alpha_min)[1] < 0.5
        for s, view in zip(splats_by_view, views)
    ]


def select_rows(splats: ProjectableGaussians, rows: np.ndarray) -> ProjectableGaussians:
    """Return some of the Gaussians; rows: indices or bool (n,)."""
    return ProjectableGaussians(
        splats.x[rows], splats.cov[rows], splats.opacity[rows], splats.color[rows]
    )


def random_subset_images(
    splats_by_view: list[ProjectableGaussians],
    parts: list[tuple[np.ndarray, int]],
    views: list[Camera],
    alpha_min: float,
    seed: int,
) -> list[np.ndarray]:
    """Render a random subset of the Gaussians.

    The Gaussians that remain are widened by the cube root of the number that each represents.

    Args:
        splats_by_view: Gaussians by camera.
        parts: Rows (m,) of one part of a body and how many remain; all other rows remain.
        views: Cameras.
        alpha_min: Alpha below which a Gaussian is left out of a pixel.
        seed: Random seed.
    """
    generator = np.random.default_rng(seed)
    scale = np.ones(len(splats_by_view[0].x))
    for rows, count in parts:
        selected = generator.choice(rows, count, replace=False)
        scale[rows] = 0.0
        scale[selected] = (len(rows) / max(count, 1)) ** (2 / 3)
    remaining = np.flatnonzero(scale)
    out = []
    for splats, view in zip(splats_by_view, views):
        subset = select_rows(splats, remaining)
        subset = replace(subset, cov=subset.cov * scale[remaining, None])
        out.append(draw(subset, view, alpha_min)[0])
    return out


def psnr(
    wanted: list[np.ndarray], got: list[np.ndarray], inside: list[np.ndarray] | None = None
) -> float:
    """Return the PSNR [dB] over all images; inside: masks of the pixels that count."""
    squares = [((a.astype(np.float64) - b) ** 2).mean(axis=2) for a, b in zip(wanted, got)]
    if inside is not None:
        squares = [square[mask] for square, mask in zip(squares, inside)]
    return decibels(np.concatenate([square.ravel() for square in squares]))
