"""Draw sheets of finished runs: five pictures in the paper's way above, in the studio's below.

    python runs/sheets.py                       of all runs that are there
    python runs/sheets.py faucet guitar         of these
    python runs/sheets.py --runs FOLDER         of runs in FOLDER/NAME, not where they are made
    python runs/sheets.py --pictures FOLDER     keep the studio's pictures in full size, too

docs/pictures/studio-NAME.jpg are the sheets of docs/explanation/studio.md. Both rows have the
camera of the scene's render.toml. The paper's way has the colors, the floor and the light that made
the best of it in each scene; the studio has no other setting. Scenes of clear liquids, which the
paper's way draws as Gaussians only, have the studio's row alone.
"""

import argparse
from pathlib import Path
from typing import Any, NamedTuple

import imageio.v3 as iio
import numpy as np
from gallery import FAST, TIMES
from PIL import Image

from vgmpi.io.run_reader import RunReader
from vgmpi.postprocess.frames import render_config
from vgmpi.postprocess.frames.frame_renderer import FrameRenderer

HERE = Path(__file__).resolve().parent
PICTURES = HERE.parent / "docs" / "pictures"
WIDE = 200  # pixels of each picture
PALE = {"background": "#e4ebf1"}
SQUARES = {"height": 0, "color": "#cfcac2", "checker_size": 0.08, "checker_color": "#c2bcb2"}
SUN = [0.5, 0.4, -1]


class Sheet(NamedTuple):
    """A scene on a sheet.

    Attributes:
        folder: of its render.toml, and of its run in `out`, below runs/.
        before: tables of render.toml for the paper's way, or None for the studio alone.
        times: parts 0..1 of the run.
    """

    folder: str
    before: dict[str, dict[str, Any]] | None
    times: tuple[float, ...] = TIMES


def _paper(shadow: float, shade: float, **tables: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Tables of a render.toml: squares on the floor, a light, and others."""
    light = {"direction": SUN, "shadow": shadow, "shade": shade}
    return {"picture": {**PALE, "floor": SQUARES}, "light": light, **tables}


_BEIGE = {"picture": {"background": "#f2efe8"}}
SHEETS = {
    "splash": Sheet("splash", _BEIGE),
    "photo": Sheet("photo/made", {}, tuple(k / 30 for k in (0, 5, 8, 15, 30))),
    "guitar": Sheet("capture", _BEIGE),
    "faucet": Sheet("faucet", None),
    "castle_falls": Sheet(
        "castle_falls", _paper(0.5, 0.35, look={"brightness_jitter": {"castle": 0.18}})
    ),
    "snowball": Sheet(
        "snowball",
        _paper(0.35, 0.25, look={"brightness_jitter": {"ground": 0.06, "ball": 0.06}}),
        FAST["snowball"],
    ),
    "water_on_snow": Sheet("water_on_snow", None),
    "castle_flood": Sheet("castle_flood", None),
    "snowman": Sheet(
        "snowman",
        _paper(0.35, 0.25, look={"brightness_jitter": {"snowman": 0.06}}),
        FAST["snowman"],
    ),
    "two_liquids": Sheet("two_liquids", None),
    "sandbox": Sheet("sandbox", _paper(0.5, 0.35, look={"brightness_jitter": {"sand": 0.18}})),
}


def before(
    chosen: render_config.Settings, tables: dict[str, dict[str, Any]]
) -> render_config.Settings:
    """Settings in the paper's way, with other tables.

    Args:
        chosen: of the scene's render.toml.
        tables: what is said beside the camera and the size of the picture.
    """
    said = chosen.model_dump(exclude_unset=True, exclude={"light"})
    said["camera"] = list(said.get("camera", [{}]))
    for name, table in tables.items():
        said[name] = {**said.get(name, {}), **table}
    said["look"] = {**said.get("look", {}), "preset": "paper"}
    return render_config.Settings.model_validate(said)


def pictures(run: RunReader, chosen: render_config.Settings, folder: Path, times: tuple) -> list:
    """Pictures of a run, (height, width, 3) uint8 each.

    Args:
        run: a finished run.
        chosen: how it is drawn.
        folder: of render.toml.
        times: parts 0..1 of the run.
    """
    painter, last = FrameRenderer(run, chosen, folder), len(run.times) - 1
    numbers = [round(part * last) for part in times]
    return [painter.draw(number, number / last)[..., :3] for number in numbers]


def small(picture: np.ndarray) -> np.ndarray:
    """The picture in the size of the sheets."""
    height = round(WIDE * picture.shape[0] / picture.shape[1])
    return np.asarray(Image.fromarray(picture).resize((WIDE, height), Image.Resampling.LANCZOS))


def draw(name: str, folder: Path, kept: Path | None, to: Path) -> None:
    """Draw the sheet of a scene.

    Args:
        name: of the sheet.
        folder: of the run.
        kept: folder for the studio's pictures in full size.
        to: folder of the sheet.
    """
    one, run = SHEETS[name], RunReader(folder)
    home = HERE / one.folder
    chosen = render_config.load(home / "render.toml")
    rows = []
    ways = [] if one.before is None else [before(chosen, one.before)]
    for way in (*ways, chosen):
        shown = pictures(run, way, home, one.times)
        rows.append(np.hstack([small(picture) for picture in shown]))
    if kept is not None:
        kept.mkdir(parents=True, exist_ok=True)
        for k, picture in enumerate(shown):
            iio.imwrite(kept / f"{name}_{k}.png", picture)
    iio.imwrite(to / f"studio-{name}.jpg", np.vstack(rows), quality=88)


def main() -> None:
    """Command line."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    p.add_argument("scenes", nargs="*", metavar="NAME", help=", ".join(SHEETS))
    p.add_argument("--runs", type=Path, metavar="FOLDER", help="where runs are, as FOLDER/NAME")
    p.add_argument("--pictures", type=Path, metavar="FOLDER", help="for pictures in full size")
    p.add_argument("-o", "--output", type=Path, default=PICTURES, help="folder of the sheets")
    given = p.parse_args()
    unknown = set(given.scenes) - set(SHEETS)
    if unknown:
        p.error(f"there is no {', '.join(sorted(unknown))}; allowed: {', '.join(SHEETS)}")
    given.output.mkdir(parents=True, exist_ok=True)
    for name in given.scenes or SHEETS:
        folder = given.runs / name if given.runs else HERE / SHEETS[name].folder / "out"
        if not (folder / "gaussians.h5").is_file():
            print(f"{name}: there is no run in {folder}")
            continue
        draw(name, folder, given.pictures, given.output)
        print(f"{name}: {given.output / f'studio-{name}.jpg'}", flush=True)


if __name__ == "__main__":
    main()
