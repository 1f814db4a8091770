"""python -m postprocess.study ablation [OUT]: a splash without one part of the method at a time.

Without the folder of a run, runs/ablation/scene.toml is run first (about 20 s on one core). Writes
one labelled picture of all variants and a table of what is measured in each (docs/studies.md).
"""

import argparse
import io
import logging
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from postprocess import settings, sheet, video
from postprocess.figures import Figures, Regions, kinds, measured, regions
from postprocess.look import seen
from postprocess.painter import Painter
from vgmpi.gaussians.evolve import BALLS
from vgmpi.output.read import RunError, RunFiles

log = logging.getLogger("vgmpi")

ROOT = Path(__file__).resolve().parents[1]
HOME = ROOT / "runs" / "ablation"
FULL = {
    "preset": "paper",  # the studio draws fluids by no Gaussians
    "covariance": "evolve",
    "harmonics": "rotate",
    "opacity": "scaled",
    "normalise": "volume",
}
# what differs from FULL, by the names of [look]
VARIANTS = {
    "full method": {},
    "covariance fixed": {"covariance": "fixed"},
    "harmonics fixed": {"harmonics": "fixed"},
    "opacity fixed": {"opacity": "fixed"},
    "normalised by radius": {"normalise": "radius"},
    "normalised by deformation": {"normalise": "deformation"},
}


@dataclass(frozen=True)
class Variant:
    """One way to draw the frame. picture: uint8 (height, width, 3)."""

    name: str
    picture: np.ndarray
    figures: Figures


def chosen_for(base: settings.Settings, variant: str) -> settings.Settings:
    """The settings of a variant: those of the render.toml but for what is compared."""
    look = base.look.model_copy(update={**FULL, **VARIANTS[variant]})
    return base.model_copy(update={"look": look})


def study(
    run: RunFiles, base: settings.Settings, beside: Path, index: int
) -> tuple[list[Variant], Regions]:
    """Frame `index` of a run in every variant, the full method first, and the pixels measured.

    base: settings of a render.toml in the folder `beside`. Raises RunError, SettingsError.
    """
    if base.background == "none":
        said = "'none': what fluids let through is compared, before a colour or a picture"
        raise settings.SettingsError([f"picture.background: {said}"])
    done: list[Variant] = []
    part = index / max(len(run) - 1, 1)  # as python -m postprocess.render --frame draws it
    for name in VARIANTS:
        painter = Painter(run, chosen_for(base, name), beside)
        picture = painter.draw(index, part)
        if not done:
            where = _regions(painter, index, part)
            _explain(painter)
            # the usual one depends on the opacities: it is no part of what is compared
            same = base.splatting.model_copy(update={"alpha_min": painter.alpha_min})
            base = base.model_copy(update={"splatting": same})
        full = done[0].picture if done else picture
        done.append(Variant(name, picture, measured(picture, full, where)))
    return done, where


def _regions(painter: Painter, index: int, part: float) -> Regions:
    frame = painter.look.frame(index)
    camera = painter.views[0].at(part, float(painter.run.times[index]))
    splats = seen(painter.look.parts(frame), camera.eye)
    options = {"alpha_min": painter.alpha_min, **painter.chosen.splatting.options()}
    return regions(splats, kinds(painter.look, frame, len(splats.x)), camera, **options)


def _explain(painter: Painter) -> None:
    """Say which variants this run cannot show."""
    flows = [entry for entry in painter.look.objects if entry.get("family") in BALLS]
    if not flows:
        log.info("nothing flows in this run: only solids are compared")
    elif not any(entry.get("deforms") for entry in flows):
        log.info("nothing that flows has deforms = true: by deformation is J^(2/3) cov0 here")


def table(variants: list[Variant]) -> str:
    """The figures in Markdown."""
    lines = [
        "| variant | PSNR [dB] | edges of solids | grain | streaks | saturation | saturated |",
        "|---|---|---|---|---|---|---|",
    ]
    for one in variants:
        f = one.figures
        same = "-" if one is variants[0] else "the same picture"
        psnr = same if np.isinf(f.psnr) else f"{f.psnr:.1f}"
        numbers = [f"{f.edge:.1f}", f"{f.grain:.2f}", f"{f.streaks:.2f}", f"{f.saturation:.2f}"]
        cells = [one.name, psnr, *numbers, f"{100 * f.rich:.0f} %"]
        lines.append("| " + " | ".join(c.replace("nan", "-") for c in cells) + " |")
    return "\n".join(lines) + "\n"


def make_run(folder: Path) -> None:
    """Run the scene of the study into `folder`. Raises RunError."""
    scene, duck = HOME / "scene.toml", HOME / "assets" / "duck.ply"
    if not scene.is_file():  # an installed package has no scenes
        raise RunError(f"{scene}: no such file: give the folder of a run")
    if not duck.is_file():
        maker = ROOT / "runs" / "assets" / "make_assets.py"
        _do([sys.executable, str(maker), str(duck.parent)])
    _do([sys.executable, "-m", "vgmpi", str(scene), "-o", str(folder), "--overwrite"])


def _do(command: list[str]) -> None:
    code = subprocess.run(command, cwd=ROOT, stdout=sys.stderr).returncode
    if code:
        raise RunError(f"{' '.join(command)}: ended with exit code {code}")


def parser() -> argparse.ArgumentParser:
    p = argparse.ArgumentParser(prog="python -m postprocess.study ablation", description=__doc__)
    p.add_argument("out", nargs="?", help="folder of a run [runs/ablation is run]")
    p.add_argument("--settings", help="render.toml: camera and picture [runs/ablation's; none]")
    p.add_argument("--frame", type=int, help="the frame that is drawn [the last]")
    p.add_argument("-o", "--output", help="the picture, .jpg or .png [OUT/ablation.jpg]")
    return p


def main(argv: list[str] | None = None) -> int:
    args = parser().parse_args(argv)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        folder = Path(args.out) if args.out else HOME / "out"
        output = Path(args.output) if args.output else folder / "ablation.jpg"
        if output.suffix not in (".jpg", ".png"):
            raise RunError(f"-o: {output}: allowed: a name that ends in .jpg or .png")
        own = None if args.out else HOME / "render.toml"
        path = Path(args.settings) if args.settings else own
        base = settings.load(path)
        if not args.out:
            make_run(folder)
        run = RunFiles(folder)
        index = len(run) - 1 if args.frame is None else args.frame
        if not 0 <= index < len(run):
            raise RunError(f"--frame: {index}: the run has the frames 0..{len(run) - 1}")
        variants, where = study(run, base, path.parent if path else Path("."), index)
        text = table(variants)
        _write(output, sheet.sheet(variants, where))
        video.write(folder / "ablation.md", text.encode())
    except settings.SettingsError as error:
        print("\n".join(error.lines), file=sys.stderr)
        return 2
    except (RunError, video.VideoError) as error:
        print(error, file=sys.stderr)
        return 2
    print(text + str(output))
    return 0


def _write(path: Path, picture: np.ndarray) -> None:
    from PIL import Image

    if path.suffix == ".png":
        return video.write_png(path, picture)
    data = io.BytesIO()
    Image.fromarray(picture).save(data, "jpeg", quality=85)
    video.write(path, data.getvalue())
