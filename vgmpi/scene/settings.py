"""The parts of a scene beside its objects and materials: box, time, looks, accuracy, output."""

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from vgmpi.scene.gravity import GravityKeyframe
from vgmpi.tables import MayChange, Positive, Quantity, Table

WALLS = ("west", "east", "south", "north", "floor", "roof")
MOST_CELLS = 2**15  # per axis: block coordinates fit the sort key
Acceleration = Annotated[float, Quantity("m/s2")]
Transfer = Literal["apic", "restored", "aflip", "flip", "pic"]


def _wall(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


class Wall(Table):
    """What a wall does to the material that touches it."""

    kind: Literal["stick", "slip", "separate", "open"] = "slip"
    """stick: no motion. slip: no motion through the wall. separate: material may also leave it.
    open: nothing holds; particles within a cell of it end as in a sink of the wall's name"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.0
    """Coulomb coefficient, for separate walls: the others do not rub or do not slide"""
    until: Annotated[float, Quantity("s", gt=0)] | None = None
    """when the wall vanishes, as a gate that is torn away: from then on it is open"""

    @model_validator(mode="after")
    def _rubs(self) -> "Wall":
        if self.until is not None and self.kind == "open":
            raise ValueError('until is not for kind = "open": it is from the start on')
        if self.friction and self.kind != "separate":
            raise ValueError('friction is for kind = "separate" only')
        return self


AnyWall = Annotated[Wall, BeforeValidator(_wall)]


class Boundary(Table):
    """The six walls: a kind ("slip") or { kind = "separate", friction = 0.2 } each."""

    default: AnyWall = Wall()
    """every wall not named"""
    west: AnyWall | None = None
    """x = 0"""
    east: AnyWall | None = None
    """x = size"""
    south: AnyWall | None = None
    """y = 0"""
    north: AnyWall | None = None
    """y = size"""
    floor: AnyWall | None = None
    """z = 0"""
    roof: AnyWall | None = None
    """z = size"""


def _boundary(value: Any) -> Any:
    return {"default": value} if isinstance(value, str) else value


class Domain(Table):
    """The box the simulation lives in, from (0, 0, 0); z is up."""

    size: tuple[Positive, Positive, Positive]
    """edges of the box: whole numbers of cells"""
    cell: Positive
    """grid spacing dx; with accuracy.level it need not be given, where cells of about that size fit
    all edges"""
    gravity: tuple[Acceleration, Acceleration, Acceleration] = (0.0, 0.0, -9.8)
    """acceleration of gravity"""
    gravity_ramp: Annotated[float, Quantity("s", ge=0)] = 0.0
    """time in which gravity grows from 0, as half a cosine; 0: it is there at once"""
    gravity_keyframes: tuple[GravityKeyframe, ...] | None = None
    """{ time, gravity } in order of time: from `gravity` at the start it turns and changes at an
    even pace from one to the next, as in a container that tilts; after the last it stays"""
    boundary: Annotated[Boundary, BeforeValidator(_boundary)] = Boundary()
    """what the walls do: a kind for all of them, or a table"""

    @property
    def cells(self) -> tuple[int, int, int]:
        """Number of cells along x, y and z."""
        nx, ny, nz = (round(edge / self.cell) for edge in self.size)
        return nx, ny, nz

    @property
    def open_walls(self) -> list[str]:
        """Names of the walls at which particles end, at once or after a time."""
        walls = zip(WALLS, self.walls, self.opens, strict=True)
        return [name for name, (kind, _), time in walls if kind == "open" or time is not None]

    @property
    def opens(self) -> list[float | None]:
        """When each of the six vanishes [s]; None: never."""
        return [wall.until for wall in self._walls]

    @property
    def walls(self) -> list[tuple[str, float]]:
        """(kind, friction) of the west, east, south, north, floor and roof wall."""
        return [(wall.kind, wall.friction) for wall in self._walls]

    @property
    def _walls(self) -> list[Wall]:
        return [getattr(self.boundary, name) or self.boundary.default for name in WALLS]


class Time(Table):
    """How long, how finely, and how often the state is written."""

    end: Annotated[float, Quantity("s", gt=0), MayChange("the run goes on to this time")]
    """simulated time"""
    frames: Annotated[
        int,
        Field(strict=True, ge=2, le=100_000),
        MayChange(
            "from here on, frames are written at the new times; numbers go on. It counts the frames"
            " of the whole run: a later time.end alone writes them further apart, and for the same"
            " time between them it grows too, to 1 + (frames - 1) new end / old end"
        ),
    ] = 50
    """number of frames written at equal times, the first at 0 and the last at the end"""
    cfl: Annotated[float, Quantity("", gt=0, le=1)] = 0.4
    """share of the time a wave needs to cross a cell, taken as the step"""
    dt: Annotated[float, Quantity("s", ge=0)] = 0.0
    """a fixed step instead of cfl; 0: choose by cfl"""


class Appearance(Table):
    """What is drawn, beyond the objects' own colours."""

    colour_transfer: Literal["off", "frame", "relax", "step"] = "frame"
    """whether colours travel between particles. off: each keeps its own. frame: a frame shows the
    colours at the start, smoothed over a cell where the particles are now. relax: colours mix in
    the time `colour_time`. These three also in render.toml: a run need not be made again. step: as
    the paper has it, the solver smooths them over a cell with every step: the shorter the step, the
    faster they become alike; they spread by cell^2 / (4 step)"""
    colour_time: Annotated[float, Quantity("s", gt=0)] = 1.0
    """relax: time in which colours of neighbours become alike; they spread by cell^2 / (4
    colour_time)"""
    colour_degree: Annotated[int, Field(strict=True, ge=0, le=3)] = 0
    """up to which degree of spherical harmonics colours travel; 0: what looks alike from all
    sides"""
    colour_bodies: tuple[str, ...] | None = None
    """names of the bodies whose colours travel, among those of one phase and of fluids that mix;
    with step all bodies of their phases; default: all fluids"""
    shade: Annotated[float, Quantity("", ge=0, le=1)] = 0.3
    """light painted on solid shapes and meshes, by the way their surface faces; 0: none. The factor
    is kept in gaussians.h5 (`shade`), so that a renderer with a light of its own can take it out"""


class Accuracy(Table):
    """Numbers and their transfer between particles and grid."""

    level: Literal["draft", "standard", "high"] | None = None
    """what keys are that are not given. draft, standard, high: domain.cell such that the longest
    edge has 32, 64, 96 cells or a few more, precision single, single, double, compression of
    liquids 4 %, 1 %, 1 %; draft prunes bodies made of Gaussians or meshes (prune = "auto")"""
    transfer: Transfer = "restored"
    """restored is apic that gives back, every few steps, what transfers took, so that waves and
    vibrations last; apic takes .8 of its time and loses with every step, up to a third of a wave's
    height in a period. Both keep linear and angular momentum. aflip keeps what is too fine for the
    grid, for the time `damping`, and takes 1.3 times as long; flip does without apic's gradients,
    at some noise; pic damps"""
    damping: Annotated[float, Quantity("s", gt=0)] = 0.1
    """aflip, flip: time in which particles lose all but 1/e of what the grid does not see"""
    flip: Annotated[float, Quantity("", gt=0, le=1)] | None = None
    """aflip, flip: share of it that they keep in each step, in place of `damping`: then losses
    depend on the step"""
    gradient: Literal["moments", "splines"] = "moments"
    """how strains and forces are taken. splines: by the gradients of the B-splines, with pic and
    flip alone; a bending body that turns against the grid keeps its stiffness, with 64 particles
    per cell"""
    volume: Literal["followed", "kept"] = "followed"
    """of liquids that do not mix and flow through no sand. followed: as the grid expands along
    their way, by which water that splashes or sways for long loses height; kept: held besides to
    the space that they take, which takes some time more"""
    precision: Literal["double", "single"] = "double"
    """of the particles' and the grid's numbers"""

    @property
    def affine(self) -> bool:
        """Whether particles carry the velocity's gradient (APIC)."""
        return self.transfer in ("apic", "restored", "aflip")

    @property
    def restores(self) -> bool:
        """Whether motion gets back, every few steps, what transfers took of it."""
        return self.transfer == "restored"

    @property
    def keeps(self) -> bool:
        """Whether particles keep what the grid does not see (FLIP), for a time or by a share."""
        return self.transfer in ("aflip", "flip")


def _name(value: str) -> str:
    if "\0" in value:
        raise ValueError("no folder has such a name")
    return value


class Output(Table):
    """What is written, where and how often."""

    folder: Annotated[
        str,
        Field(min_length=1),
        AfterValidator(_name),
        MayChange("the run goes on in that folder"),
    ] = "out"
    """relative to the scene's folder"""
    fields: Annotated[
        tuple[Literal["velocity", "J", "F"], ...], MayChange("frames from here on have these")
    ] = ("velocity", "J", "F")
    """besides the positions; drawings need F for elastic bodies and J for all others"""
    checkpoint: Annotated[float, Quantity("s", ge=0), MayChange("holds from here on")] = 600.0
    """wall time between checkpoints; 0: none by time"""
    checkpoint_steps: Annotated[int, Field(strict=True, ge=0), MayChange("holds from here on")] = 0
    """steps between checkpoints; 0: none by steps"""


class Top(Table):
    """Keys above the first table."""

    title: Annotated[str, MayChange("is noted from here on")] = ""
    """for people"""
    seed: Annotated[int, Field(strict=True, ge=0, le=2**31)] = 1
    """of everything random: the points on a mesh's surface"""
    allow_outside: Annotated[bool, MayChange("holds from here on")] = False
    """whether files may lie outside the scene's folder"""


SECTIONS: dict[str, type[Table]] = {
    "domain": Domain,
    "time": Time,
    "appearance": Appearance,
    "accuracy": Accuracy,
    "output": Output,
}
