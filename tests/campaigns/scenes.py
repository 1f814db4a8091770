"""Spoiled scenes through --check and --plan: each passes, or each mistake gets its line."""

import random
import re
import shutil
import subprocess
import sys
from pathlib import Path

from tests.campaigns import worker
from tests.campaigns.result import Result
from tests.campaigns.spoiled import Spoiler
from tests.support import small_scenes, wrong_scenes

NAME = "scenes"
COUNT = 3000
SMALL = 25

# keys that the other scenes have not
LOADED = """
[accuracy]
precision = "double"
[domain]
size = ["40 cm", "40 cm", "40 cm"]
cell = "2 cm"
gravity_ramp_time = "0.1 s"
boundary = { default = "slip", bottom = { kind = "separate", friction = 0.4 } }
[time]
end = "0.2 s"
frames = 3
cfl = 0.3
[material.rubber]
kind = "elastic"
density = 500
youngs_modulus = "0.1 MPa"
[material.water]
kind = "fluid"
tait_coefficient = "50 kPa"
[[object]]
name = "bar"
material = "rubber"
shape = { cylinder = { endpoints = [[0.1, 0.2, 0.2], [0.3, 0.2, 0.2]], radius = "4 cm" } }
rotation = { axis = "z", angle = "30 deg" }
origin = [0.1, 0, 0]
angular_velocity = [0, 0, "60 rpm"]
velocity_mode = { amplitude = [0, 0, 0.1], wave_vector = [10, 0, 0], phase_angle = "30 deg" }
[[object]]
name = "duck"
material = "rubber"
gaussians = "assets/duck.ply"
height = "8 cm"
up = "z"
position = ["30 cm", "30 cm", "25 cm"]
fill = "closed"
prune = "auto"
passive_gaussians = true
[[object]]
name = "block"
material = "water"
mesh = "water.obj"
height = "5 cm"
volume_fraction = 0.5
position = ["20 cm", "20 cm", "4 cm"]
[[object]]
name = "ring"
role = "scenery"
collider = true
[object.shape.torus]
center = [0.2, 0.2, 0.3]
axis = [0, 1, 1]
major_radius = 0.08
minor_radius = 0.03
[[object]]
name = "hat"
material = "rubber"
shape = { difference = [
    { cone = { endpoints = [[0.08, 0.3, 0.05], [0.08, 0.3, 0.15]], radii = [0.06, 0] } },
    { capsule = { endpoints = [[0.08, 0.3, 0], [0.08, 0.3, 0.1]], radius = 0.02 } },
] }
volume_fraction_profile = { axis = "z", positions = [0, 0.1], values = [1, 0.5] }
[[object]]
name = "half"
role = "scenery"
gaussians = "assets/ball.ply"
select = { sphere = { center = [0, 0, 0], radius = 5 }, min_opacity = 0.1, outlier_sigma = 3 }
height = 0.05
position = [0.3, 0.1, 0.1]
[[load]]
object = "bar"
force = [0, 0, "1 N"]
region = { box = [[0.1, 0, 0], [0.3, 0.4, 0.4]] }
start_time = 0
end_time = "0.1 s"
ramp_time = "10 ms"
[[load]]
object = ["bar", "duck"]
pressure = "1 kPa"
face = "top"
[[probe]]
name = "depth"
surface_height = [0.2, 0.2]
sampling_rate = 100
[[probe]]
name = "bar"
object = "bar"
sampling_interval = "10 ms"
"""


def bases(folder: Path) -> list[str]:
    """Good scenes whose files lie in `folder`, with coarse cells."""
    make = [sys.executable, worker.ROOT / "runs/assets/make_assets.py", folder / "assets"]
    make += ["--things", "duck", "ball", "--gaussians", "600"]
    subprocess.run(make, check=True, capture_output=True, cwd=worker.ROOT)
    shutil.copy(worker.ROOT / "runs/ablation/water.obj", folder)
    found = [path.read_text() for path in sorted(worker.ROOT.glob("runs/*/scene.toml"))]
    found = [_coarse(re.sub(r"(?m)^#.*\n", "", text)) for text in found]
    for text in (small_scenes.MIXED, small_scenes.SHARED):
        found.append(text.replace("PRECISION", "single"))
    return [*found, small_scenes.every_law("double"), wrong_scenes.GOOD, LOADED]


def _coarse(text: str) -> str:
    """With cells twice as large, where these are small."""
    two = [('= "2 cm"', '= "4 cm"')] if "mesh " in text else []  # a body of many triangles
    for small, large in (*two, ('= "1 cm"', '= "2 cm"'), ("= 0.0073", "= 0.0146")):
        text = re.sub(f"(?m)^(cell *){small}", f"\\1{large}", text)
    return text


def keys() -> list[str]:
    """Names of all keys there are."""
    return re.findall(r"(?m)^\| `(\w+)` \|", (worker.ROOT / "docs/reference/scene.md").read_text())


def campaign(count: int, seed: int, folder: Path) -> Result:
    """count: of scenes. Those that fail stay in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    return spoiled_scenes(Spoiler(bases(folder), keys()), count, seed, folder)


def spoiled_scenes(spoiler: Spoiler, count: int, seed: int, folder: Path) -> Result:
    """What --check and --plan say to `count` spoiled scenes. Those that fail stay in the folder."""
    cases, paths = [], []
    for draw, path in spoiler.files(count, seed, folder):
        paths.append(path)
        sets = _overrides(spoiler, draw) if draw.random() < 0.15 else []
        flags = [f"--set={each}" for each in sets]
        cases.append([["vgmpi", str(path), what, *flags] for what in ("--check", "--plan")])
    first, *_, last = spoiler.good(folder)  # a pruned mesh, and all kinds of keys are compiled
    warm = [["vgmpi", str(path), what] for path in (first, last) for what in ("--check", "--plan")]
    return worker.judged(paths, cases, warm, _where, _named)


def _named(path: Path, command: list[str], code: int) -> str:
    return f"refused by {command[2]}" if code else "passed"


def _where(path: Path, command: list[str]) -> re.Pattern:
    """How lines begin: with a place, or for the whole of the file or the scene."""
    name = re.escape(str(path))
    return re.compile(
        rf"(?:{name}:\d+: |--set ).+: .+|{name}:\d+: not valid TOML|--set .+: expected key=value"
        rf"|{name}: not (?:UTF-8 text|valid TOML: nested too deeply)"
        r"|needs about .* GiB on this machine"
    )


def _overrides(spoiler: Spoiler, draw: random.Random) -> list[str]:
    """What may follow --set."""
    places = ["domain", "time", "object.duck", "object.ball", "object.0", "material.water",
              "accuracy", "output", "appearance", "object", "load.0", "probe.0", "coupling.0",
              "domain.boundary", "", "x.y"]  # fmt: skip
    return [
        f"{draw.choice(places)}.{draw.choice(spoiler.keys)}{draw.choice('=====.')}{spoiler.value(draw)}"
        for _ in range(draw.choice((1, 1, 2)))
    ]
