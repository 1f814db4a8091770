"""Rendering benchmark: python -m tests.benchmarks.render_speed

It measures seconds per image of an object like those of Gaussian generators: a lumpy ball of flat
discs (opacity 0.95, plain colors) that fills most of an image of 800 x 800 pixels, half of its
kernels on the closed surface and half inside, drawn from 12 sides by the calls of a video. With
--fluid all Gaussians are faint spheres (opacity 0.02, alpha_min 1e-4), which occlude nothing.
Processor time is measured, because other work on the machine disturbs it less.
"""

import argparse
import multiprocessing
import sys
import time
from types import SimpleNamespace

import numpy as np

from vgmpi.gaussians.camera import Camera, look_at, orbit_eye
from vgmpi.gaussians.spherical_harmonics import dc_from_rgb
from vgmpi.postprocess.frames.appearance import Appearance
from vgmpi.postprocess.raster import rasterize

# kernels: seconds on an A100 (Table I)
PAPER_SECONDS = {71_000: 0.07, 191_000: 0.13, 368_000: 0.26}
TARGET_SECONDS = {71_000: 0.09, 191_000: 0.16, 368_000: 0.26}
CAMERAS, SIZE = 12, 800
SURFACE_SHARE = 0.5  # [-] share of the kernels on the surface
OPACITY, FAINT_OPACITY = 0.95, 0.02  # [-] of the body; of fluids
_GOLDEN_ANGLE = np.pi * (1 + np.sqrt(5))


def lumpy_ball(count: int, fluid: bool = False) -> tuple[SimpleNamespace, np.ndarray]:
    """Return rest Gaussians like those of gaussians.h5, and positions of a frame (count, 3) [m].

    The radius is 0.4 m with lumps of 15 %. Discs: sigma_t = 0.6 sqrt(area / n), sigma_n = 0.1
    sigma_t. Inside: spheres of 0.45 times their spacing, on a jittered lattice.
    """
    outer = 0 if fluid else int(SURFACE_SHARE * count)
    index = np.arange(outer) + 0.5
    z = 1 - 2 * index / outer
    ring_radius = np.sqrt(1 - z * z)
    d = np.stack(
        [
            ring_radius * np.cos(_GOLDEN_ANGLE * index),
            ring_radius * np.sin(_GOLDEN_ANGLE * index),
            z,
        ],
        axis=1,
    )
    r, slope = _radius(d)
    normal = d * r[:, None] - slope  # normal of a star-shaped surface; the slope is tangential
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    area = 4 * np.pi / max(outer, 1) * r**2 / np.einsum("ni,ni->n", normal, d)
    variance = 0.36 * area
    outside = np.einsum("ni,nj->nij", normal, normal) * (0.01 - 1) + np.eye(3)
    x_in, spacing = _inside(count - outer)
    inside = np.broadcast_to((0.45 * spacing) ** 2 * np.eye(3), (len(x_in), 3, 3))
    cov = np.concatenate([outside * variance[:, None, None], inside])
    x = np.concatenate([d * r[:, None], x_in])
    rgb = 0.5 + 0.4 * np.sin(9 * x)
    gaussians = SimpleNamespace(
        x0=x,
        object=np.zeros(count, dtype="i4"),
        opacity=np.full(count, FAINT_OPACITY if fluid else OPACITY, dtype="f4"),
        vol0=np.full(count, spacing**3),
        cov0=cov.reshape(-1, 9)[:, (0, 1, 2, 4, 5, 8)].astype("f4"),
        sh=dc_from_rgb(rgb)[:, None].astype("f4"),
    )
    return gaussians, x.astype("f4")


def _radius(d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the radius [m] towards unit vectors d (n, 3) and its tangential gradient (n, 3)."""
    wave = np.sin(5 * d)
    r = 0.4 * (1 + 0.15 * wave.prod(axis=1))
    others = np.stack([wave[:, (1, 2, 0)[i]] * wave[:, (2, 0, 1)[i]] for i in range(3)], axis=1)
    slope = 0.4 * 0.15 * 5 * np.cos(5 * d) * others
    return r, slope - d * np.einsum("ni,ni->n", slope, d)[:, None]


def _inside(count: int) -> tuple[np.ndarray, float]:
    """Return `count` positions inside on a jittered lattice, and its spacing [m]."""
    spacing = (4 / 3 * np.pi * 0.39**3 / count) ** (1 / 3)
    rng = np.random.default_rng(0)
    while True:
        line = np.arange(-0.47, 0.47, spacing)
        x = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
        x = x + rng.uniform(-0.3, 0.3, x.shape) * spacing
        length = np.maximum(np.linalg.norm(x, axis=1), 1e-9)
        x = x[length < _radius(x / length[:, None])[0] - 0.5 * spacing]
        if len(x) >= count:
            return x[np.sort(rng.permutation(len(x))[:count])], spacing
        spacing *= 0.99


def rotation_gradient(angle: float) -> np.ndarray:
    """Return F (9,) of a body rotated about z by `angle` [degrees]."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([c, -s, 0, s, c, 0, 0, 0, 1])


class Subject:
    """The object and 12 cameras around it."""

    def __init__(self, kernels: int, fluid: bool = False):
        gaussians, x = lumpy_ball(kernels, fluid)
        family = "fluid" if fluid else "solid"
        entry = {
            "name": "object",
            "family": family,
            "tracks_deformation": not fluid,
            "opacity_scale": 1.0,
        }
        self.look = Appearance(SimpleNamespace(gaussians=gaussians, objects=[entry]))
        self.alpha_min = self.look.alpha_min(None)
        # the rotation is zero, but is processed like that of any solid
        F = np.tile(rotation_gradient(0).astype("f4"), (kernels, 1))
        J = np.ones(kernels, dtype="f4")
        self.frame = {"id": np.arange(kernels), "positions": x, "F": F, "J": J}

    @staticmethod
    def camera(number: int) -> Camera:
        """Return a camera by its number."""
        eye = orbit_eye(np.zeros(3), 1.2, 0.4, 360 / CAMERAS * number)
        return look_at(eye, np.zeros(3), (0, 0, 1), 40, SIZE, SIZE)

    def draw(self, number: int) -> tuple[float, float, np.ndarray]:
        """Return seconds of processor time to Gaussians and to pixels, and the image."""
        camera = self.camera(number % CAMERAS)
        begin = time.process_time()
        splats = self.look.splats(self.frame, camera.eye)
        between = time.process_time()
        image, _ = rasterize.render(splats, camera, alpha_min=self.alpha_min)
        return between - begin, time.process_time() - between, image


def measured(kernels: int, rounds: int, fluid: bool = False) -> np.ndarray:
    """Measure seconds of processor time to Gaussians and to pixels, (12 rounds, 2).

    Args:
        kernels: Number of Gaussians.
        rounds: Number of times that each side is drawn.
        fluid: Whether the object is a fluid.
    """
    subject = Subject(kernels, fluid)
    subject.draw(0)  # this call compiles, or loads compiled code
    return np.array([subject.draw(number)[:2] for number in range(rounds * CAMERAS)])


_subject: Subject | None = None  # subject of a worker process


def _start_worker(kernels: int) -> None:
    """Create the subject of a worker process."""
    global _subject
    _subject = Subject(kernels)
    _subject.draw(0)


def _work(start: float) -> float:
    """Draw all sides from the time `start` on and return the end time."""
    time.sleep(max(0.0, start - time.monotonic()))
    for number in range(CAMERAS):
        _subject.draw(number)
    return time.monotonic()


def throughput(kernels: int, jobs: int, rounds: int) -> np.ndarray:
    """Return the images per second of `jobs` processes over that of one.

    One process and all of them are measured in turns.
    """
    context = multiprocessing.get_context("spawn")
    ratios = []
    pools = [context.Pool(1, _start_worker, (kernels,)) for _ in range(jobs)]
    try:
        for _ in range(1 + rounds):
            durations = []
            for running in (pools[:1], pools):
                start = time.monotonic() + 0.1
                ends = [pool.apply_async(_work, (start,)) for pool in running]
                durations.append(max(end.get() for end in ends) - start)
            ratios.append(jobs * durations[0] / durations[1])
    finally:
        for pool in pools:
            pool.terminate()
    return np.array(ratios[1:])  # the first round waits for the processes to be ready


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = argparse.ArgumentParser(prog="python -m tests.benchmarks.render_speed", description=__doc__)
    p.add_argument(
        "--kernels", type=int, nargs="+", default=list(PAPER_SECONDS), help="sizes to measure"
    )
    p.add_argument("--rounds", type=int, default=3, help="times that each side is drawn [3]")
    p.add_argument("--fluid", action="store_true", help="faint balls instead of a solid body")
    p.add_argument("--jobs", type=int, default=1, help="measure the gain of this many processes")
    return p


def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parser().parse_args(argv)
    if min(args.kernels) < 1000 or args.rounds < 1 or args.jobs < 1:
        print("allowed: --kernels from 1000, --rounds and --jobs from 1", file=sys.stderr)
        return 2
    if args.jobs > 1:
        for kernels in args.kernels:
            gain = throughput(kernels, args.jobs, args.rounds)
            message = f"{np.median(gain):.2f} times the pictures per second of one"
            print(f"{kernels} kernels, {args.jobs} processes: {message} (largest {gain.max():.2f})")
        return 0
    print(f"{SIZE} x {SIZE} pixels, {CAMERAS} cameras, seconds of processor time per picture")
    print("                    median                              minimum   paper's")
    print(" kernels  to Gaussians   to pixels       both   asked       both      A100")
    tables = ({}, {}) if args.fluid else (TARGET_SECONDS, PAPER_SECONDS)
    for kernels in args.kernels:
        seconds = measured(kernels, args.rounds, args.fluid)
        to_gaussians, to_pixels = np.median(seconds, axis=0)
        both = seconds.sum(axis=1)
        target, paper = (f"{table[kernels]:.2f}" if kernels in table else "-" for table in tables)
        print(
            f"{kernels:8d} {to_gaussians:13.3f} {to_pixels:11.3f} {np.median(both):10.3f} "
            f"{target:>7} {both.min():10.3f} {paper:>9}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
