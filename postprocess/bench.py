"""python -m postprocess.bench: seconds per picture of an object as generators of Gaussians make it.

A lumpy ball of flat discs (opacity 0.95, plain colours) that fills most of a picture of 800 x 800
pixels, half of its kernels on the closed surface and half inside, drawn from 12 sides by the same
calls as a video. With --fluid all of it is faint balls (opacity 0.02, alpha_min 1e-4), which hide
nothing; with --surface they are a liquid with a surface. Times are of the processor, so other work
on the machine disturbs them less.
"""

import argparse
import multiprocessing
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from postprocess.liquids import Liquids
from postprocess.look import Look
from postprocess.settings import LiquidSettings
from vgmpi.gaussians.sh import dc_from_rgb
from vgmpi.splatting import splat
from vgmpi.splatting.camera import Camera, look_at, orbit_eye
from vgmpi.splatting.light import Light

PAPER = {71_000: 0.07, 191_000: 0.13, 368_000: 0.26}  # kernels: seconds on an A100 (its Table I)
ASKED = {71_000: 0.09, 191_000: 0.16, 368_000: 0.26}
CAMERAS, SIZE = 12, 800
SURFACE = 0.5  # part of the kernels on the surface
OPACITY, FAINT = 0.95, 0.02  # of the body; of fluids
_GOLDEN = np.pi * (1 + np.sqrt(5))


def lumpy_ball(count: int, fluid: bool = False) -> tuple[SimpleNamespace, np.ndarray]:
    """Rest Gaussians as gaussians.h5 holds them, and the positions of a frame (count, 3) [m].

    The radius is 0.4 m with lumps of 15 %. Discs: sigma_t = 0.6 sqrt(area / n), sigma_n = 0.1
    sigma_t. Inside: balls of 0.45 times their spacing, on a jittered lattice.
    """
    outer = 0 if fluid else int(SURFACE * count)
    at = np.arange(outer) + 0.5
    z = 1 - 2 * at / outer
    ring = np.sqrt(1 - z * z)
    d = np.stack([ring * np.cos(_GOLDEN * at), ring * np.sin(_GOLDEN * at), z], axis=1)
    r, slope = _radius(d)
    normal = d * r[:, None] - slope  # of a star-shaped surface, slope tangential
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    area = 4 * np.pi / max(outer, 1) * r**2 / np.einsum("ni,ni->n", normal, d)
    variance = 0.36 * area
    outside = np.einsum("ni,nj->nij", normal, normal) * (0.01 - 1) + np.eye(3)
    x_in, spacing = _inside(count - outer)
    inside = np.broadcast_to((0.45 * spacing) ** 2 * np.eye(3), (len(x_in), 3, 3))
    cov = np.concatenate([outside * variance[:, None, None], inside])
    x = np.concatenate([d * r[:, None], x_in])
    rgb = 0.5 + 0.4 * np.sin(9 * x)
    rest = SimpleNamespace(
        x0=x,
        object=np.zeros(count, dtype="i4"),
        opacity=np.full(count, FAINT if fluid else OPACITY, dtype="f4"),
        vol0=np.full(count, spacing**3),
        cov0=cov.reshape(-1, 9)[:, (0, 1, 2, 4, 5, 8)].astype("f4"),
        sh=dc_from_rgb(rgb)[:, None].astype("f4"),
    )
    return rest, x.astype("f4")


def _radius(d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Radius [m] towards unit vectors d (n, 3) and its gradient along the sphere (n, 3)."""
    wave = np.sin(5 * d)
    r = 0.4 * (1 + 0.15 * wave.prod(axis=1))
    others = np.stack([wave[:, (1, 2, 0)[i]] * wave[:, (2, 0, 1)[i]] for i in range(3)], axis=1)
    slope = 0.4 * 0.15 * 5 * np.cos(5 * d) * others
    return r, slope - d * np.einsum("ni,ni->n", slope, d)[:, None]


def _inside(count: int) -> tuple[np.ndarray, float]:
    """`count` positions (count, 3) within the ball on a jittered lattice, and its spacing [m]."""
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


def turned(angle: float) -> np.ndarray:
    """F (9,) of a body turned about z by `angle` [degrees]."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return np.array([c, -s, 0, s, c, 0, 0, 0, 1])


class Subject:
    """The object and 12 cameras around it. surface: of a fluid, whether it gets one."""

    def __init__(self, kernels: int, fluid: bool = False, surface: bool = False):
        rest, x = lumpy_ball(kernels, fluid)
        family = "fluid" if fluid else "solid"
        entry = {"name": "object", "family": family, "deforms": not fluid, "opacity_scale": 1.0}
        self.look = Look(SimpleNamespace(gaussians=rest, objects=[entry]))
        self.alpha_min = self.look.alpha_min(None)
        # turned by nothing, but worked out like any solid's frame
        F = np.tile(turned(0).astype("f4"), (kernels, 1))
        J = np.ones(kernels, dtype="f4")
        self.frame = {"id": np.arange(kernels), "x": x, "F": F, "J": J}
        box = (np.full(3, -0.5), np.full(3, 0.5))
        chosen = (LiquidSettings(), Light(), lambda: box, Path())
        self.liquids = Liquids(self.look, *chosen) if surface else None

    @staticmethod
    def camera(number: int) -> Camera:
        eye = orbit_eye(np.zeros(3), 1.2, 0.4, 360 / CAMERAS * number)
        return look_at(eye, np.zeros(3), (0, 0, 1), 40, SIZE, SIZE)

    def draw(self, number: int) -> tuple[float, float, np.ndarray]:
        """Seconds of processor time to Gaussians and to pixels, and the picture."""
        camera = self.camera(number % CAMERAS)
        if self.liquids is not None:
            return self._draw_surface(camera)
        begin = time.process_time()
        splats = self.look.splats(self.frame, camera.eye)
        between = time.process_time()
        image, _ = splat.render(splats, camera, alpha_min=self.alpha_min)
        return between - begin, time.process_time() - between, image

    def _draw_surface(self, camera: Camera) -> tuple[float, float, np.ndarray]:
        background = np.ones((SIZE, SIZE, 3), dtype=np.float32)
        options = {"lowpass": 0.3, "antialias": False, "alpha_min": splat.ALPHA_MIN}
        begin = time.process_time()
        parts = self.look.parts(self.frame)
        between = time.process_time()
        image, _ = self.liquids.render(self.frame, parts, camera, background, None, **options)
        return between - begin, time.process_time() - between, image


def measured(kernels: int, rounds: int, fluid: bool = False, surface: bool = False) -> np.ndarray:
    """Seconds of processor time to Gaussians and to pixels, (12 rounds, 2)."""
    subject = Subject(kernels, fluid, surface)
    subject.draw(0)  # compiles, or loads what is compiled
    return np.array([subject.draw(number)[:2] for number in range(rounds * CAMERAS)])


_subject: Subject | None = None  # of a worker process


def _start_worker(kernels: int) -> None:
    global _subject
    _subject = Subject(kernels)
    _subject.draw(0)


def _work(start: float) -> float:
    """Draw all sides from the time `start` on; when it was done."""
    time.sleep(max(0.0, start - time.monotonic()))
    for number in range(CAMERAS):
        _subject.draw(number)
    return time.monotonic()


def throughput(kernels: int, jobs: int, rounds: int) -> np.ndarray:
    """Pictures per second of `jobs` processes over those of one, alone and together in turns."""
    context = multiprocessing.get_context("spawn")
    ratios = []
    pools = [context.Pool(1, _start_worker, (kernels,)) for _ in range(jobs)]
    try:
        for _ in range(1 + rounds):
            spent = []
            for running in (pools[:1], pools):
                start = time.monotonic() + 0.1
                ends = [pool.apply_async(_work, (start,)) for pool in running]
                spent.append(max(end.get() for end in ends) - start)
            ratios.append(jobs * spent[0] / spent[1])
    finally:
        for pool in pools:
            pool.terminate()
    return np.array(ratios[1:])  # the first one waits for the processes to be ready


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m postprocess.bench", description=__doc__)
    p.add_argument("--kernels", type=int, nargs="+", default=list(PAPER), help="sizes to measure")
    p.add_argument("--rounds", type=int, default=3, help="times that each side is drawn [3]")
    p.add_argument("--fluid", action="store_true", help="faint balls instead of a solid body")
    p.add_argument("--surface", action="store_true", help="a liquid with a surface instead")
    p.add_argument("--jobs", type=int, default=1, help="measure the gain of this many processes")
    return p


def main(argv: list[str] | None = None) -> int:
    args = parser().parse_args(argv)
    if min(args.kernels) < 1000 or args.rounds < 1 or args.jobs < 1:
        print("allowed: --kernels from 1000, --rounds and --jobs from 1", file=sys.stderr)
        return 2
    if args.jobs > 1:
        for kernels in args.kernels:
            gain = throughput(kernels, args.jobs, args.rounds)
            said = f"{np.median(gain):.2f} times the pictures per second of one"
            print(f"{kernels} kernels, {args.jobs} processes: {said} (largest {gain.max():.2f})")
        return 0
    print(f"{SIZE} x {SIZE} pixels, {CAMERAS} cameras, seconds of processor time per picture")
    print("                    median                              minimum   paper's")
    print(" kernels  to Gaussians   to pixels       both   asked       both      A100")
    fluid = args.fluid or args.surface
    tables = ({}, {}) if fluid else (ASKED, PAPER)
    for kernels in args.kernels:
        seconds = measured(kernels, args.rounds, fluid, args.surface)
        to_gaussians, to_pixels = np.median(seconds, axis=0)
        both = seconds.sum(axis=1)
        asked, paper = (f"{table[kernels]:.2f}" if kernels in table else "-" for table in tables)
        print(
            f"{kernels:8d} {to_gaussians:13.3f} {to_pixels:11.3f} {np.median(both):10.3f} "
            f"{asked:>7} {both.min():10.3f} {paper:>9}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
