"""Photographs of others through `vgmpi photo` and to the end of the run, one row of a table each.

The pictures are those of a folder, and of installed packages: scikit-image, matplotlib,
scikit-learn and ultralytics. The others are at github.com/facebookresearch/segment-anything
(notebooks/images) and github.com/danielgatis/rembg (examples).
"""

import importlib.util
import tomllib
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from vgmpi.commands.command_table import main as vgmpi_main
from vgmpi.io.run_reader import RunReader

PACKAGES = {  # folder of pictures by package
    "skimage": "data", "matplotlib": "mpl-data/sample_data", "sklearn": "datasets/images",
    "ultralytics": "assets",
}  # fmt: skip
SCENE = """[camera]
fov = {fov}
pitch = {pitch}
[scene]
end = "{end}"
frames = 7
cells = {cells}
"""
THING = '[[object]]\nname = "{name}"\nbox = {box}\nheight = "{height}"\nmaterial = "{material}"\n'
SIZE = 320  # [pixels] longest edge of the pictures, which are made smaller
LEAST = -0.1  # [cells] least height of a particle above the floor


class Thing(NamedTuple):
    """An object of a layout."""

    name: str
    box: list[int]  # left, top, right, bottom in pixels
    material: str
    height: str = "20 cm"
    more: str = ""  # further lines of its table
    point: tuple[int, int] | None = None  # a pixel on it


class View(NamedTuple):
    """The camera of a photograph, and what is in it."""

    objects: list[Thing]
    fov: float = 40.0  # [deg]
    pitch: float = 10.0  # [deg]


class Row(NamedTuple):
    """What became of a photograph."""

    picture: str
    objects: str
    codes: tuple[int, ...]  # exit codes of `vgmpi photo` and of the run
    min_height: float  # [cells] least height of a particle above the floor
    end: float  # [s]


FALLS = 'support = "10 cm"\n'
TURNED = 'reconstruction = "revolve"\n'
VIEWS = {
    "astronaut": View([Thing("helmet", [280, 345, 455, 511], "rubber", more=FALLS)]),
    "chelsea": View([Thing("cat", [0, 0, 402, 300], "flesh")]),
    "coffee": View([Thing("cup", [165, 10, 420, 262], "ceramic", "8 cm", FALLS)], pitch=45),
    "rocket": View([Thing("rocket", [300, 55, 340, 390], "sand", more=TURNED)], pitch=-5),
    "motorcycle_left": View([Thing("motorcycle", [75, 20, 712, 440], "metal", more=FALLS)]),
    "coins": View(
        [
            Thing("left coin", [22, 33, 68, 74], "metal", "3 cm", FALLS, (45, 54)),
            Thing("right coin", [305, 15, 365, 72], "metal", "4 cm", FALLS, (335, 44)),
        ]
    ),
    "grace_hopper": View([Thing("cap", [155, 5, 382, 150], "jelly", "10 cm", FALLS)]),
    "china": View([Thing("pagoda", [75, 2, 372, 362], "wood")], pitch=-5),
    "flower": View([Thing("flower", [195, 55, 500, 350], "snow", more=FALLS)]),
    "bus": View(
        [
            Thing("left man", [48, 398, 245, 902], "clay", "18 cm"),
            Thing("right man", [221, 405, 344, 857], "bread", "18 cm", FALLS),
        ]
    ),
    "dog": View(
        [
            Thing("dog", [0, 190, 415, 534], "flesh", "30 cm"),
            Thing("bowl", [490, 105, 690, 240], "metal", "8 cm", FALLS),
        ],
        pitch=15,
    ),
    "truck": View([Thing("truck", [75, 275, 1725, 850], "rubber", more=FALLS)]),
}  # fmt: skip


def find(name: str, folder: Path | None) -> Path | None:
    """Return the picture of a name in a folder, or in an installed package, or None."""
    folders = [] if folder is None else [folder]
    for package, inside in PACKAGES.items():
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.origin is not None:
            folders.append(Path(spec.origin).parent / inside)
    for place in folders:
        for ending in (".png", ".jpg"):
            if (place / f"{name}{ending}").exists():
                return place / f"{name}{ending}"
    return None


def layout_of(view: View, scale: float, cells: int, end: str) -> str:
    """Return the text of a layout.toml; scale: of the picture's pixels."""
    head = SCENE.format(fov=view.fov, pitch=view.pitch, cells=cells, end=end)
    text = head
    for thing in view.objects:
        box = [round(edge * scale) for edge in thing.box]
        text += THING.format(**{**thing._asdict(), "box": box}) + thing.more
        if thing.point is not None:
            text += f"point_prompts = [{[round(c * scale) for c in thing.point]}]\n"
    return text


def run(names: list[str], folder: Path | None, out: Path, cells: int, end: str) -> list[Row]:
    """Make scenes of photographs, run them to their end, and print a row for each."""
    rows = []
    print("picture | objects | photo, run | least z [cells] | end [s]", flush=True)
    for name in names or VIEWS:
        picture = find(name, folder)
        if picture is None:
            print(f"{name} | not found in the folder or an installed package", flush=True)
            continue
        row = _made(picture, VIEWS[name], out / name, cells, end)
        codes = ", ".join(map(str, row.codes))
        print(f"{name} | {row.objects} | {codes} | {row.min_height:.3f} | {row.end:g}", flush=True)
        rows.append(row)
    return rows


def is_right(row: Row) -> bool:
    """Return whether a photograph became a scene that ran to its end above the floor."""
    return row.codes == (0, 0) and row.min_height > LEAST


def _made(picture: Path, view: View, out: Path, cells: int, end: str) -> Row:
    things = ", ".join(f"{thing.name} ({thing.material})" for thing in view.objects)
    out.mkdir(parents=True, exist_ok=True)
    layout, scene = out / "layout.toml", out / "scene.toml"
    with Image.open(picture) as full:
        scale = min(1.0, SIZE / max(full.size))
        small = full.convert("RGB").resize([round(edge * scale) for edge in full.size])
    small.save(out / "photo.png")
    layout.write_text(layout_of(view, scale, cells, end))
    code = vgmpi_main(["photo", str(out / "photo.png"), str(layout), "-o", str(out), "--overwrite"])
    if code:
        return Row(picture.name, things, (code,), float("nan"), float("nan"))
    code = vgmpi_main([str(scene), "-q", "--overwrite"])
    known = RunReader(out / "out")
    cell = tomllib.loads(scene.read_text())["domain"]["cell"]
    least = min(known.frame(k)["positions"][:, 2].min() for k in range(len(known))) / cell
    return Row(picture.name, things, (0, code), float(least), float(known.times[-1]))
