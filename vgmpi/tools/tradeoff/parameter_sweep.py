"""Parameters that a study varies, and their values as `--set` takes them."""

from dataclasses import dataclass
from math import gcd

from vgmpi.planning.cost import tradeoff_results
from vgmpi.scene.scene import Scene

REFINEMENT = 2**0.5  # [-] refinement factor of the cells from one run to the next
COARSER_STEPS, FINER_STEPS = 3, 1  # refinement steps from the scene's own cell
MIN_CELLS = 4  # [cells] at least this many along the shortest edge
COMPRESSION_FACTORS = {
    "softer": 4.0,
    "stiffer": 0.25,
}  # [-] factors of the largest compression of liquids
CFL_NUMBERS = (0.2, 0.4)
PARTICLES_PER_CELL = 27  # particles per cell
PRUNE_SCALES = (0.5, 0.2, 0.05)  # [-] scales of the published pruning
COLOR_DEGREES = (0, 1, 3)  # of the harmonics that transport colors


@dataclass(frozen=True)
class Setting:
    """One run of a study; without knobs it is the scene as it stands."""

    knobs: tuple[tuple[str, str], ...]  # (parameter, value) pairs
    overrides: tuple[str, ...]  # for --set

    @property
    def name(self) -> str:
        """Return the name of the run's folder."""
        return (
            "_".join(f"{knob}-{value}" for knob, value in self.knobs) or tradeoff_results.BASELINE
        )

    @property
    def of_grid(self) -> bool:
        """Return whether the setting changes nothing but the cells."""
        return set(dict(self.knobs)) <= {"cells"}

    def and_then(self, other: "Setting") -> "Setting":
        """Return the combination of both; the other one takes precedence."""
        later = dict(other.knobs)
        inherited = [(k, v) for k, v in self.knobs if k not in later]
        keys = {override.partition("=")[0] for override in other.overrides}
        own = [override for override in self.overrides if override.partition("=")[0] not in keys]
        return Setting((*inherited, *other.knobs), (*own, *other.overrides))


BASELINE = Setting((), ())


def cells(scene: Scene, coarser: int = COARSER_STEPS, finer: int = FINER_STEPS) -> list[int]:
    """Return cell counts along the longest edge, ascending, in steps of about sqrt(2).

    They lie around the scene's own count and fit a whole number of cells on every edge.

    Args:
        scene: The scene.
        coarser: Steps to larger cells than the scene's.
        finer: Steps to smaller cells.
    """
    own, unit = scene.domain.cells, cell_unit(scene)
    longest = max(own)
    min_cells = max(unit, unit * -(-MIN_CELLS * longest // (min(own) * unit)))
    counts = {longest}
    for k in range(-coarser, finer + 1):
        count = unit * round(longest * REFINEMENT**k / unit)
        if count >= min_cells:
            counts.add(count)
    return sorted(counts)


def cell_unit(scene: Scene) -> int:
    """Return the smallest cell count of the longest edge that gives whole cells on every edge."""
    return max(scene.domain.cells) // gcd(*scene.domain.cells)


def grid(scene: Scene, count: int) -> Setting:
    """Return the setting with a cell count, the baseline if it is the scene's own."""
    return BASELINE if count == max(scene.domain.cells) else with_cells(scene, count)


def with_cells(scene: Scene, count: int) -> Setting:
    """Return the setting with a cell count along the longest edge."""
    size = max(scene.domain.size)
    return Setting((("cells", str(count)),), (f"domain.cell={size / count!r}",))


def alternatives(scene: Scene, knob: str) -> list[Setting]:
    """Return the other values of a parameter; an empty list if it has none for this scene."""
    return {
        "precision": _precision,
        "transfer": _transfer,
        "cfl": _cfl,
        "stiffness": _stiffness,
        "particles": _particles,
        "pruning": _pruning,
        "colors": _colors,
    }[knob](scene)


PARAMETERS = (
    "cell",
    "precision",
    "transfer",
    "cfl",
    "stiffness",
    "particles",
    "pruning",
    "colors",
)


def _precision(scene: Scene) -> list[Setting]:
    other = {"single": "double", "double": "single"}[scene.accuracy.precision]
    return [Setting((("precision", other),), (f"accuracy.precision={other}",))]


def _transfer(scene: Scene) -> list[Setting]:
    kinds = [
        kind for kind in ("apic", "apic-corrected", "aflip") if kind != scene.accuracy.transfer
    ]
    return [Setting((("transfer", kind),), (f"accuracy.transfer={kind}",)) for kind in kinds]


def _cfl(scene: Scene) -> list[Setting]:
    if scene.time.dt:
        return []
    values = [cfl for cfl in CFL_NUMBERS if cfl != scene.courant_number]
    return [Setting((("cfl", f"{cfl:g}"),), (f"time.cfl={cfl!r}",)) for cfl in values]


def _stiffness(scene: Scene) -> list[Setting]:
    settings = []
    for label, factor in COMPRESSION_FACTORS.items():
        overrides = []
        for name, material in scene.material.items():
            if getattr(material, "max_speed", None) or getattr(material, "max_depth", None):
                allowed = min(material.max_compression * factor, 0.1)
                overrides.append(f"material.{name}.max_compression={allowed!r}")
            elif material.family == "fluid" and hasattr(material, "tait_coefficient"):
                overrides.append(
                    f"material.{name}.tait_coefficient={material.tait_coefficient / factor!r}"
                )
        if overrides:
            settings.append(Setting((("liquids", label),), tuple(overrides)))
    return settings


def _particles(scene: Scene) -> list[Setting]:
    overrides = [
        f"object.{obj.name}.particles_per_cell={PARTICLES_PER_CELL}"
        for obj in scene.object
        if obj.role == "body"
        and obj.shape is not None
        and obj.particles_per_cell < PARTICLES_PER_CELL
    ]
    return (
        [Setting((("particles", str(PARTICLES_PER_CELL)),), tuple(overrides))] if overrides else []
    )


def _pruning(scene: Scene) -> list[Setting]:
    """Return other prunings, first of all no pruning if the scene has one."""
    objects = [t for t in scene.object if t.role == "body" and t.source in ("gaussians", "mesh")]
    if not objects:
        return []

    def setting(label: str, **values: object) -> Setting:
        """Return the setting of one pruning for all prunable objects."""
        keys = [f"object.{t.name}.{key}={v}" for t in objects for key, v in values.items()]
        return Setting((("pruning", label),), tuple(keys))

    settings = [setting("off", prune="off")] if any(t.prune != "off" for t in objects) else []
    if not any(t.prune != "off" for t in objects):
        settings.append(setting("auto", prune="auto"))
    scales_in_use = {t.prune_scale for t in objects}
    scales = [s for s in PRUNE_SCALES if scales_in_use != {s}]
    return settings + [setting(f"{s:g}", prune="versagauss", prune_scale=s) for s in scales]


def _colors(scene: Scene) -> list[Setting]:
    """Return other color transports, which change cost and pictures but no motion."""
    look = scene.appearance
    if look.color_transfer != "step":
        return [Setting((("colors", "step"),), ("appearance.color_transfer=step",))]
    degrees = [d for d in COLOR_DEGREES if d != look.color_sh_degree]
    return [Setting((("colors", f"{d}"),), (f"appearance.color_sh_degree={d}",)) for d in degrees]


def quick_sweep(scene: Scene) -> tuple[list[Setting], Setting]:
    """Return the scene between one coarser and one finer run, and the finer one.

    Raises:
        SceneError: No such cell size divides every edge of the domain.
    """
    own = max(scene.domain.cells)
    counts = cells(scene, coarser=1, finer=1)
    if counts[0] == own or counts[-1] == own:
        missing = "larger" if counts[0] == own else "smaller"
        message = (
            f"no cell size that is {missing} by about sqrt(2) divides every edge of the domain, as"
            f" --quick requires: its {' x '.join(map(str, scene.domain.cells))} cells have too"
            " small a common divisor; change domain.size"
        )
        raise scene.error([(("domain", "cell"), message)])
    return [grid(scene, count) for count in counts], grid(scene, counts[-1])


def sweep(scene: Scene, vary: tuple[str, ...]) -> tuple[list[Setting], Setting]:
    """Return all settings of a study, and the finest of them.

    The finest one, with the smallest cells, double precision and all Gaussians, is the reference of
    the others unless a curve is given.
    """
    own = max(scene.domain.cells)
    grids = cells(scene) if "cell" in vary else [own]
    series = [grid(scene, n) for n in grids]
    finest = series[-1]
    if "precision" in vary and scene.accuracy.precision == "single":
        finest = finest.and_then(alternatives(scene, "precision")[0])
    if "pruning" in vary and any(t.prune != "off" for t in scene.object):
        finest = finest.and_then(_pruning(scene)[0])
    varied = [setting for knob in vary if knob != "cell" for setting in alternatives(scene, knob)]
    settings = dict.fromkeys([*series, *varied, finest])
    return list(settings), finest
