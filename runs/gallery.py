"""Run the scenes of the gallery on two ranks, draw their videos and write docs/gallery.md.

    python runs/gallery.py                    all of them: about an hour
    python runs/gallery.py faucet snowman     these; the page keeps what is known of the others
    python runs/gallery.py --variants         also the variants of each
    python runs/gallery.py --small            cells of twice the size, and no page: minutes
    python runs/gallery.py --draw             videos and page of runs that are there
    python runs/gallery.py --ranks 1          each run on one rank, where other programs run beside
    python runs/gallery.py --stills           five pictures of each, no videos; no second run of any

Each scene's frames, video and record.json lie in runs/NAME/out (small ones in out/small), the
variants of a scene in folders below it. The page has five pictures of each and what it cost.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path

import imageio.v3 as iio
import numpy as np

from vgmpi.io import csv_log, file_layout
from vgmpi.parallel.launch import OPEN_MPI
from vgmpi.runtime.cpu_features import vector_bytes
from vgmpi.tools.bench.__main__ import machine

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
PAGE, PICTURES = ROOT / "docs" / "gallery.md", ROOT / "docs" / "pictures"
TIMES = (0.0, 0.15, 0.3, 0.5, 1.0)  # of a run, of its five pictures
FAST = {"snowman": (0.0, 0.041, 0.062, 0.09, 0.3), "snowball": (0.0, 0.1, 0.15, 0.35, 1.0)}
VECTORS = {64: "AVX-512", 32: "AVX2"}  # by their bytes
WIDE = 320  # pixels of each
IDLE = 0.9  # of one core per rank, the part that a run has where nothing else runs
ONE = ["object.snowman.phase=one", "object.ball.phase=one"]
BEST = {  # of a scene's five pictures, the one of the first page
    "faucet": 2, "castle_falls": 4, "snowball": 1, "water_on_snow": 2, "castle_flood": 1,
    "snowman": 2, "two_liquids": 2, "sandbox": 4, "driftwood": 2, "water_wheel": 3,
    "honey_dipper": 3, "rubber_sheet": 3,
}  # fmt: skip
SLOW = ["object.ball.velocity=[1, 0, 0.5]", "time.end=1"]
# folder: its variants, each a name, what is said of it and what is set. One that has a scene of its
# own, NAME/VARIANT.toml, keeps its cells
SCENES: dict[str, list[tuple[str, str, list[str]]]] = {
    "faucet": [],
    "castle_falls": [("poured", "the same sand, poured slowly", [])],
    "snowball": [],
    "water_on_snow": [],
    "castle_flood": [
        ("fine", "permeability 1 mm/s", ["coupling.0.hydraulic_conductivity=1e-3"]),
        ("gravel", "permeability 10 cm/s", ["coupling.0.hydraulic_conductivity=0.1"]),
        ("cobbles", "permeability 1 m/s", ["coupling.0.hydraulic_conductivity=1"]),
    ],
    "snowman": [
        ("one_field", "all bodies in one velocity field", ONE),
        ("slow", "the ball at 1 m/s", SLOW),
        ("slow_one_field", "the ball at 1 m/s, all bodies in one velocity field", SLOW + ONE),
    ],
    "two_liquids": [
        ("sharp", "no diffusion", ["coupling.0.diffusivity=0"]),
        ("fast", "diffusion 20 cm2/s", ["coupling.0.diffusivity=2e-3"]),
    ],
    "sandbox": [],
    "driftwood": [],
    "water_wheel": [],
    "honey_dipper": [],
    "rubber_sheet": [],
}


def call(*words: str | Path) -> tuple[float, float]:
    """Run a command; seconds by the clock, and of processors. Ends the program where it fails."""
    before = os.times()
    environment = {**OPEN_MPI, **os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([str(w) for w in words], cwd=ROOT, env=environment)
    if done.returncode:
        sys.exit(done.returncode)
    after = os.times()
    processors = after.children_user - before.children_user
    processors += after.children_system - before.children_system
    return after.elapsed - before.elapsed, processors


def simulate(
    name: str, label: str, out: Path, sets: list[str], small: bool, ranks: int
) -> tuple[float, float]:
    """Seconds that it took by the clock, and the part of one core per rank that it had."""
    scene = HERE / name / f"{label or 'scene'}.toml"
    if not scene.is_file():
        scene = HERE / name / "scene.toml"
    if small and scene.stem == "scene":
        sets = [*sets, 'domain.cell="2 cm"']
    flags = [word for one in sets for word in ("--set", one)]
    solver = ["mpirun", "-n", str(ranks), sys.executable, "-m", "vgmpi", scene]
    seconds, processors = call(*solver, "-o", out, "--overwrite", "-q", *flags)
    return seconds, processors / (ranks * seconds)


def draw(name: str, out: Path) -> tuple[float, int]:
    """Seconds that the video took, and how many pictures it has."""
    drawing = [sys.executable, "-m", "vgmpi", "render", out, HERE / name / "render.toml"]
    last = ["--jobs", "2", "-q", "-o", out / "video.mp4", "--frames", out / "png"]
    took, _ = call(*drawing, *last)
    return took, len(list((out / "png").glob("*.png")))


def draw_stills(name: str, out: Path) -> tuple[float, int]:
    """Seconds that the page's pictures took, and how many they are."""
    count, took = len(list((out / file_layout.FRAMES).glob("*.vtkhdf"))), 0.0
    numbers = sorted({round(part * (count - 1)) for part in FAST.get(name, TIMES)})
    for number in numbers:
        picture = out / "png" / f"frame_{number:05d}.png"
        drawing = [sys.executable, "-m", "vgmpi", "render", out, HERE / name / "render.toml"]
        took += call(*drawing, "--frame", str(number), "-q", "-o", picture)[0]
    return took, len(numbers)


def known_of(
    out: Path, simulated: float, drawn: float, pictures: int, cores_part: float = 1.0, ranks=2
) -> dict:
    """What a run cost and kept; cores_part: of one core per rank, the part that it had."""
    rows = csv_log.read_rows(out / file_layout.LEDGER)
    first, last = ([r for r in rows if r["time"] == rows[k]["time"]] for k in (0, -1))
    count, mass = (sum(r[key] for r in last) for key in ("particles", "mass"))
    # all that ever came, or what was there at first
    flows = "mass_in" in rows[0]
    came = sum(r["mass_in"] for r in last) if flows else sum(r["mass"] for r in first)
    gone = sum(r["mass_out"] for r in last) if flows else 0.0
    known = {"simulated": simulated, "drawn": drawn, "pictures": pictures, "particles": int(count)}
    known |= {"cores_part": cores_part, "ranks": ranks}
    return {**known, "mass_lost": abs(came - gone - mass) / came}


def small(out: Path, part: float) -> np.ndarray:
    """The picture at a part 0..1 of a run."""
    count = len(list((out / file_layout.FRAMES).glob("*.vtkhdf")))
    picture = iio.imread(out / "png" / f"frame_{round(part * (count - 1)):05d}.png")
    step = max(picture.shape[1] // WIDE, 1)
    height, width = (n // step * step for n in picture.shape[:2])
    blocks = picture[:height, :width].reshape(height // step, step, width // step, step, 3)
    return blocks.mean(axis=(1, 3)).round().astype(np.uint8)


def strip(name: str, out: Path, to: Path) -> None:
    """Five pictures of a scene's run side by side."""
    shown = [small(out, part) for part in FAST.get(name, TIMES)]
    iio.imwrite(to, np.hstack(shown), quality=85)


def sheet(to: Path) -> None:
    """The best picture of each scene on the page, four in a row."""
    shown = []
    for name, best in BEST.items():
        image = PICTURES / f"gallery-{name}.jpg"
        if image.is_file():
            shown.append(np.hsplit(iio.imread(image), len(TIMES))[best])
    shown += [np.full_like(shown[0], 255)] * (-len(shown) % 4)
    rows = [np.hstack(shown[first : first + 4]) for first in range(0, len(shown), 4)]
    iio.imwrite(to, np.vstack(rows), quality=88)


def told() -> str:
    """What the times are of."""
    known, vectors = machine(), VECTORS.get(vector_bytes(), "")
    return f"{known['cores']} cores of {known['name']}" + (f" with {vectors}" if vectors else "")


def sections_by_title() -> dict[str, str]:
    """The sections of the page as it is."""
    parts = PAGE.read_text().split("\n## ")[1:] if PAGE.is_file() else []
    return {part.split("\n", 1)[0]: f"## {part.rstrip()}\n" for part in parts}


def page(machine: str) -> str:
    """docs/gallery.md of the records that there are; other scenes keep their sections."""
    before = sections_by_title()
    out = [
        "# Gallery",
        "",
        "<!-- made by: python runs/gallery.py -->",
        "",
        "Scenes after those of the paper. Each folder has its scene, its render.toml and a README",
        "that says what one should see and what one sees. Pictures are the studio's, with no",
        "setting but a camera. Times are by the clock on two ranks, the pictures by two processes,",
        f"of {machine}.",
        "",
    ]
    for name, variants in SCENES.items():
        title = (HERE / name / "README.md").read_text().splitlines()[0].lstrip("# ")
        if not (HERE / name / "out" / "record.json").is_file():
            out += [before[title]] if title in before else []
            continue
        out += [f"## {title}", "", f"`runs/{name}`", ""]
        for label, said in [("", "")] + [(label, said) for label, said, _ in variants]:
            record = HERE / name / "out" / label / "record.json"
            image = PICTURES / f"gallery-{name}{'-' + label if label else ''}.jpg"
            if not (record.is_file() and image.is_file()):
                continue
            known = json.loads(record.read_text())
            also = f"{said}: " if said else ""
            ranks, part = known.get("ranks", 2), known.get("cores_part", 1)
            cost = f"{known['simulated']:.0f} s" + (" on one rank" if ranks == 1 else "")
            if part < IDLE:
                cost += f" beside other programs, with {ranks * part:.1f} cores"
            elif known.get("pictures", 0) > len(TIMES) + 1:  # a few tell the program's start
                cost += f", and {known['drawn']:.0f} s for {known['pictures']} pictures"
            kept = "no mass lost"
            if known["mass_lost"]:
                kept = f"{known['mass_lost']:.0e} of the mass lost, by rounding"
            out += [f"![{title} {said}](pictures/{image.name})".replace(" ]", "]"), ""]
            out += [f"{also}{known['particles']:,} particles at the end, {cost}; {kept}.", ""]
    return "\n".join(out).rstrip() + "\n"


def main() -> None:
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    p.add_argument("scenes", nargs="*", metavar="NAME", help=", ".join(SCENES))
    p.add_argument("--small", action="store_true", help="cells of 2 cm")
    p.add_argument("--draw", action="store_true", help="only the videos, of runs that are there")
    p.add_argument(
        "--stills", action="store_true", help="the page's pictures, no videos and no runs again"
    )
    p.add_argument("--variants", action="store_true", help="also those of each scene")
    p.add_argument("--ranks", type=int, choices=(1, 2), default=2, help="of each run, default 2")
    given = p.parse_args()
    unknown = set(given.scenes) - set(SCENES)
    if unknown:
        p.error(f"there is no {', '.join(sorted(unknown))}; allowed: {', '.join(SCENES)}")
    call(sys.executable, HERE / "assets" / "make_assets.py", HERE / "faucet" / "assets")
    for name in given.scenes or SCENES:
        chosen = [("", "", []), *(SCENES[name] if given.variants else [])]
        for label, _, sets in chosen:
            base = HERE / name / "out" / ("small" if given.small else "")
            record = base / label / "record.json"
            out = base / label
            if given.draw or given.stills and record.is_file():
                before = json.loads(record.read_text())
                took, cores_part = before["simulated"], before.get("cores_part", 1.0)
                ranks = before.get("ranks", 2)
            else:
                ranks = given.ranks
                took, cores_part = simulate(name, label, out, sets, given.small, ranks)
            drawn = draw_stills(name, out) if given.stills else draw(name, out)
            known = known_of(out, took, *drawn, cores_part, ranks)
            record.write_text(json.dumps(known))
            print(name, label, known, flush=True)
            if not given.small:
                image = PICTURES / f"gallery-{name}{'-' + label if label else ''}.jpg"
                strip(name, base / label, image)
    if not given.small:
        sheet(PICTURES / "gallery.jpg")
        PAGE.write_text(page(told()))


if __name__ == "__main__":
    main()
