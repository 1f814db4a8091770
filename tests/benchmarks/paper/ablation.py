"""Ablation study of a splash: python -m tests.benchmarks.paper ablation [OUT]

The splash is drawn with one part of the method left out at a time. Without the folder of a run,
runs/ablation/scene.toml is run first (about 20 s on one core). The command writes one labeled
picture of all variants and a table of image metrics (docs/benchmarks/studies.md).
"""

import argparse
import io
import logging
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.benchmarks.paper import contact_sheet
from tests.benchmarks.paper.image_metrics import ImageMetrics, Regions, kinds, measured, regions
from vgmpi.gaussians.shape_evolution import FAMILIES_DRAWN_AS_SPHERES
from vgmpi.io.run_reader import RunError, RunReader
from vgmpi.postprocess.frames import image_io, render_config
from vgmpi.postprocess.frames.appearance import view_dependent_splats
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer

log = logging.getLogger("vgmpi")

ROOT = Path(__file__).resolve().parents[3]
HOME = ROOT / "runs" / "ablation"
FULL = {
    "preset": "paper",  # the studio draws no Gaussians for fluids
    "covariance": "evolve",
    "rotate_sh": True,
    "opacity": "scaled",
    "covariance_normalization": "volume",
}
# differences from FULL, by keys of [look]
VARIANTS = {
    "full method": {},
    "covariance fixed": {"covariance": "fixed"},
    "harmonics fixed": {"rotate_sh": False},
    "opacity fixed": {"opacity": "fixed"},
    "normalised by radius": {"covariance_normalization": "radius"},
    "normalised by deformation": {"covariance_normalization": "none"},
}


@dataclass(frozen=True)
class Variant:
    """One way to draw the frame. picture: uint8 (height, width, 3)."""

    name: str
    picture: np.ndarray
    figures: ImageMetrics


def variant_settings(base: render_config.Settings, variant: str) -> render_config.Settings:
    """Return the settings of a variant: those of render.toml except the compared ones."""
    look = base.look.model_copy(update={**FULL, **VARIANTS[variant]})
    return base.model_copy(update={"look": look})


def study(
    run: RunReader, base: render_config.Settings, settings_folder: Path, index: int
) -> tuple[list[Variant], Regions]:
    """Draw frame `index` of a run in every variant, the full method first.

    Args:
        run: Files of the run.
        base: Contents of a render.toml.
        settings_folder: Folder of render.toml.
        index: Number of the frame.

    Returns:
        The variants, and the measured pixels.

    Raises:
        RunError: If the frame cannot be read.
        SettingsError: If render.toml does not suit the study.
    """
    if base.background == "none":
        message = "'none': what fluids let through is compared, before a color or a picture"
        raise render_config.SettingsError([f"picture.background: {message}"])
    done: list[Variant] = []
    # the position that python -m vgmpi render --frame uses
    part = index / max(len(run) - 1, 1)
    for name in VARIANTS:
        painter = FrameRenderer(run, variant_settings(base, name), settings_folder)
        picture = painter.draw(index, part)
        if not done:
            where = _regions(painter, index, part)
            _log_limits(painter)
            # the default depends on the opacities, and is not to differ between variants
            splatting = base.splatting.model_copy(update={"alpha_min": painter.alpha_min})
            base = base.model_copy(update={"splatting": splatting})
        full = done[0].picture if done else picture
        done.append(Variant(name, picture, measured(picture, full, where)))
    return done, where


def _regions(painter: FrameRenderer, index: int, part: float) -> Regions:
    """Return the measured pixels of the frame."""
    frame = painter.look.frame(index)
    camera = painter.views[0].camera_at(part, float(painter.run.times[index]))
    splats = view_dependent_splats(painter.look.parts(frame), camera.eye)
    options = {"alpha_min": painter.alpha_min, **painter.chosen.splatting.options()}
    return regions(splats, kinds(painter.look, frame, len(splats.x)), camera, **options)


def _log_limits(painter: FrameRenderer) -> None:
    """Log which variants this run cannot show."""
    flowing = [
        entry for entry in painter.look.objects if entry.get("family") in FAMILIES_DRAWN_AS_SPHERES
    ]
    if not flowing:
        log.info("nothing flows in this run: only solids are compared")
    elif not any(entry.get("tracks_deformation") for entry in flowing):
        log.info(
            "nothing that flows has track_deformation = true: by deformation is J^(2/3) cov0 here"
        )


def table(variants: list[Variant]) -> str:
    """Return the metrics as Markdown."""
    lines = [
        "| variant | PSNR [dB] | edges of solids | grain | streaks | saturation | saturated |",
        "|---|---|---|---|---|---|---|",
    ]
    for variant in variants:
        metrics = variant.figures
        same_text = "-" if variant is variants[0] else "the same picture"
        psnr = same_text if np.isinf(metrics.psnr) else f"{metrics.psnr:.1f}"
        numbers = [
            f"{metrics.edge:.1f}",
            f"{metrics.grain:.2f}",
            f"{metrics.streaks:.2f}",
            f"{metrics.saturation:.2f}",
        ]
        cells = [variant.name, psnr, *numbers, f"{100 * metrics.saturated_fraction:.0f} %"]
        lines.append("| " + " | ".join(c.replace("nan", "-") for c in cells) + " |")
    return "\n".join(lines) + "\n"


def make_run(folder: Path) -> None:
    """Run the scene of the study into `folder`. Raises RunError."""
    scene, duck = HOME / "scene.toml", HOME / "assets" / "duck.ply"
    if not scene.is_file():  # an installed package has no scenes
        raise RunError(f"{scene}: no such file: give the folder of a run")
    if not duck.is_file():
        maker = ROOT / "runs" / "assets" / "make_assets.py"
        _run_command([sys.executable, str(maker), str(duck.parent)])
    _run_command([sys.executable, "-m", "vgmpi", str(scene), "-o", str(folder), "--overwrite"])


def _run_command(command: list[str]) -> None:
    """Run a command. Raises RunError."""
    code = subprocess.run(command, cwd=ROOT, stdout=sys.stderr).returncode
    if code:
        raise RunError(f"{' '.join(command)}: ended with exit code {code}")


def parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    p = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.paper ablation", description=__doc__
    )
    p.add_argument("out", nargs="?", help="folder of a run [runs/ablation is run]")
    p.add_argument("--settings", help="render.toml: camera and picture [runs/ablation's; none]")
    p.add_argument("--frame", type=int, help="the frame that is drawn [the last]")
    p.add_argument("-o", "--output", help="the picture, .jpg or .png [OUT/ablation.jpg]")
    return p


def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    args = parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        folder = Path(args.out) if args.out else HOME / "out"
        output = Path(args.output) if args.output else folder / "ablation.jpg"
        if output.suffix not in (".jpg", ".png"):
            raise RunError(f"-o: {output}: allowed: a name that ends in .jpg or .png")
        default_path = None if args.out else HOME / "render.toml"
        path = Path(args.settings) if args.settings else default_path
        base = render_config.load(path)
        if not args.out:
            make_run(folder)
        run = RunReader(folder)
        index = len(run) - 1 if args.frame is None else args.frame
        if not 0 <= index < len(run):
            raise RunError(f"--frame: {index}: the run has the frames 0..{len(run) - 1}")
        variants, where = study(run, base, path.parent if path else Path("."), index)
        text = table(variants)
        _write(output, contact_sheet.sheet(variants, where))
        image_io.write(folder / "ablation.md", text.encode())
    except render_config.SettingsError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (RunError, image_io.VideoError) as error:
        print(error, file=sys.stderr)
        return 2
    print(text + str(output))
    return 0


def _write(path: Path, picture: np.ndarray) -> None:
    """Write a picture as PNG or JPEG."""
    from PIL import Image

    if path.suffix == ".png":
        return image_io.write_png(path, picture)
    data = io.BytesIO()
    Image.fromarray(picture).save(data, "jpeg", quality=85)
    image_io.write(path, data.getvalue())
