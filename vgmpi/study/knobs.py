"""What a study varies of a scene: each knob's values, as what `--set` takes."""

from dataclasses import dataclass
from math import gcd

from ..planning.studied import PLAIN as AS_IT_IS
from ..scene.scene import Scene

STEP = 2**0.5  # of cells, from one to the next
COARSER, FINER = 3, 1  # such steps from the scene's own cell
FEWEST = 4  # cells along the shortest edge
STIFFER = {"softer": 4.0, "stiffer": 0.25}  # times the compression that liquids are allowed
CFL = (0.2, 0.4)
PER_CELL = 27
SCALES = (0.5, 0.2, 0.05)  # of pruning as the paper has it
DEGREES = (0, 1, 3)  # of the harmonics by which colours travel


@dataclass(frozen=True)
class Setting:
    """One run of a study. knobs: what it sets, by the knob's name; none: the scene as it stands.
    overrides: for --set."""

    knobs: tuple[tuple[str, str], ...]
    overrides: tuple[str, ...]

    @property
    def name(self) -> str:
        """A folder's name."""
        return "_".join(f"{knob}-{value}" for knob, value in self.knobs) or AS_IT_IS

    @property
    def of_grid(self) -> bool:
        """Whether it sets the cells alone, or nothing."""
        return set(dict(self.knobs)) <= {"cells"}

    def and_then(self, other: "Setting") -> "Setting":
        """Both: where they set the same, the other."""
        later = dict(other.knobs)
        kept = [(k, v) for k, v in self.knobs if k not in later]
        keys = {one.partition("=")[0] for one in other.overrides}
        mine = [one for one in self.overrides if one.partition("=")[0] not in keys]
        return Setting((*kept, *other.knobs), (*mine, *other.overrides))


PLAIN = Setting((), ())


def cells(scene: Scene) -> list[int]:
    """Numbers of cells along the longest edge, from few to many, near steps of sqrt(2) around the
    scene's own, of which every edge is a whole number."""
    own, unit = scene.domain.cells, unit_of(scene)
    longest = max(own)
    fewest = max(unit, unit * -(-FEWEST * longest // (min(own) * unit)))
    found = {longest}
    for k in range(-COARSER, FINER + 1):
        count = unit * round(longest * STEP**k / unit)
        if count >= fewest:
            found.add(count)
    return sorted(found)


def unit_of(scene: Scene) -> int:
    """Every edge is a whole number of cells where the longest one is a multiple of so many."""
    return max(scene.domain.cells) // gcd(*scene.domain.cells)


def grid(scene: Scene, count: int) -> Setting:
    """The scene as it stands where it has that many cells."""
    return PLAIN if count == max(scene.domain.cells) else of_cells(scene, count)


def of_cells(scene: Scene, count: int) -> Setting:
    """That many cells along the longest edge."""
    size = max(scene.domain.size)
    return Setting((("cells", str(count)),), (f"domain.cell={size / count!r}",))


def others(scene: Scene, knob: str) -> list[Setting]:
    """Values of a knob beside that of the scene; none where it has nothing to turn."""
    return {
        "precision": _precision,
        "transfer": _transfer,
        "cfl": _cfl,
        "stiffness": _stiffness,
        "particles": _particles,
        "pruning": _pruning,
        "colours": _colours,
    }[knob](scene)


KNOBS = ("cell", "precision", "transfer", "cfl", "stiffness", "particles", "pruning", "colours")


def _precision(scene: Scene) -> list[Setting]:
    other = {"single": "double", "double": "single"}[scene.accuracy.precision]
    return [Setting((("precision", other),), (f"accuracy.precision={other}",))]


def _transfer(scene: Scene) -> list[Setting]:
    kinds = [kind for kind in ("apic", "restored", "aflip") if kind != scene.accuracy.transfer]
    return [Setting((("transfer", kind),), (f"accuracy.transfer={kind}",)) for kind in kinds]


def _cfl(scene: Scene) -> list[Setting]:
    if scene.time.dt:
        return []
    found = [cfl for cfl in CFL if cfl != scene.time.cfl]
    return [Setting((("cfl", f"{cfl:g}"),), (f"time.cfl={cfl!r}",)) for cfl in found]


def _stiffness(scene: Scene) -> list[Setting]:
    found = []
    for label, factor in STIFFER.items():
        overrides = []
        for name, material in scene.material.items():
            if getattr(material, "max_speed", None) or getattr(material, "depth", None):
                allowed = min(material.compression * factor, 0.1)
                overrides.append(f"material.{name}.compression={allowed!r}")
            elif material.family == "fluid" and hasattr(material, "bulk_modulus"):
                overrides.append(f"material.{name}.bulk_modulus={material.bulk_modulus / factor!r}")
        if overrides:
            found.append(Setting((("liquids", label),), tuple(overrides)))
    return found


def _particles(scene: Scene) -> list[Setting]:
    overrides = [
        f"object.{thing.name}.particles_per_cell={PER_CELL}"
        for thing in scene.object
        if thing.role == "body" and thing.shape is not None and thing.particles_per_cell < PER_CELL
    ]
    return [Setting((("particles", str(PER_CELL)),), tuple(overrides))] if overrides else []


def _pruning(scene: Scene) -> list[Setting]:
    """None first, where the scene has some."""
    things = [t for t in scene.object if t.role == "body" and t.source in ("gaussians", "mesh")]
    if not things:
        return []

    def setting(label: str, **values: object) -> Setting:
        keys = [f"object.{t.name}.{key}={v}" for t in things for key, v in values.items()]
        return Setting((("pruning", label),), tuple(keys))

    found = [setting("off", prune="off")] if any(t.prune != "off" for t in things) else []
    if not any(t.prune != "off" for t in things):
        found.append(setting("auto", prune="auto"))
    same = {t.prune_scale for t in things}
    scales = [s for s in SCALES if same != {s}]
    return found + [setting(f"{s:g}", prune="paper", prune_scale=s) for s in scales]


def _colours(scene: Scene) -> list[Setting]:
    """They change the price, and what is drawn, but no motion."""
    look = scene.appearance
    if look.colour_transfer != "step":
        return [Setting((("colours", "step"),), ("appearance.colour_transfer=step",))]
    degrees = [d for d in DEGREES if d != look.colour_degree]
    return [Setting((("colours", f"{d}"),), (f"appearance.colour_degree={d}",)) for d in degrees]


def sweep(scene: Scene, vary: tuple[str, ...]) -> tuple[list[Setting], Setting]:
    """All runs of a study, and among them the finest, which the others are held to where nothing
    else is given: the smallest cells in double precision, all Gaussians."""
    own = max(scene.domain.cells)
    grids = cells(scene) if "cell" in vary else [own]
    series = [grid(scene, n) for n in grids]
    finest = series[-1]
    if "precision" in vary and scene.accuracy.precision == "single":
        finest = finest.and_then(others(scene, "precision")[0])
    if "pruning" in vary and any(t.prune != "off" for t in scene.object):
        finest = finest.and_then(_pruning(scene)[0])
    turned = [one for knob in vary if knob != "cell" for one in others(scene, knob)]
    found = dict.fromkeys([*series, *turned, finest])
    return list(found), finest
