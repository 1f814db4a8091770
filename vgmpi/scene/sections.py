"""Single-table sections of a scene: domain, time, appearance, accuracy, output."""

import math
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from vgmpi.materials.material import field_error
from vgmpi.runtime.config.schema import ChangeableOnResume, Positive, Quantity, StrictModel

from .gravity import GravityKeyframe

WALLS = ("west", "east", "south", "north", "bottom", "top")
MAX_CELLS = 2**15  # per axis, so that block coordinates fit the sort key
Acceleration = Annotated[float, Quantity("m/s2")]
Transfer = Literal["apic", "apic-corrected", "aflip", "flip", "pic"]


def _wall(value: Any) -> Any:
    return {"kind": value} if isinstance(value, str) else value


class Wall(StrictModel):
    """Effect of a wall on the material that touches it."""

    kind: Literal["stick", "slip", "separate", "open"] | None = None
    """stick: no motion. slip: no motion through the wall, so that it also holds back what pulls
    away from it. separate: material may also leave it. open: particles leave freely; particles
    within a cell of it are removed, as in an outlet of the wall's name. None: slip for liquids,
    separate for everything else"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.0
    """Coulomb friction coefficient; used by separate walls only (slip walls are frictionless, stick
    walls allow no sliding)"""
    removal_time: Annotated[float, Quantity("s", gt=0)] | None = None
    """time at which the wall opens, like a removed gate; it is open from then on"""

    @model_validator(mode="after")
    def _rubs(self) -> "Wall":
        if self.removal_time is not None and self.kind == "open":
            raise ValueError('removal_time is not for kind = "open": it is from the start on')
        if self.friction and self.kind != "separate":
            raise ValueError('friction is for kind = "separate" only')
        return self


AnyWall = Annotated[Wall, BeforeValidator(_wall)]


class Boundary(StrictModel):
    """Six walls: a kind ("slip") or { kind = "separate", friction = 0.2 } each."""

    default: AnyWall = Wall()
    """default for walls that are not listed"""
    west: AnyWall | None = None
    """x = 0"""
    east: AnyWall | None = None
    """x = size"""
    south: AnyWall | None = None
    """y = 0"""
    north: AnyWall | None = None
    """y = size"""
    bottom: AnyWall | None = None
    """z = 0"""
    top: AnyWall | None = None
    """z = size"""


def _boundary(value: Any) -> Any:
    return {"default": value} if isinstance(value, str) else value


class Domain(StrictModel):
    """Box of the simulation, from (0, 0, 0); z is up."""

    size: tuple[Positive, Positive, Positive]
    """edges of the box: whole numbers of cells"""
    cell: Positive
    """grid spacing dx; optional with accuracy.level, if cells of about that size fit all edges"""
    gravity: tuple[Acceleration, Acceleration, Acceleration] = (0.0, 0.0, -9.8)
    """acceleration of gravity"""
    gravity_ramp_time: Annotated[float, Quantity("s", ge=0)] = 0.0
    """time in which gravity grows from 0, as half a cosine; 0: full gravity from the start"""
    gravity_keyframes: tuple[GravityKeyframe, ...] | None = None
    """{ time, gravity } in order of time, as for a container that tilts: from `gravity` at the
    start, direction and magnitude change at a constant rate between keyframes; constant after the
    last one"""
    boundary: Annotated[Boundary, BeforeValidator(_boundary)] = Boundary()
    """behavior of the walls: a kind for all of them, or a table"""

    @property
    def cells(self) -> tuple[int, int, int]:
        """Return the number of cells along x, y and z."""
        nx, ny, nz = (round(edge / self.cell) for edge in self.size)
        return nx, ny, nz

    @property
    def open_walls(self) -> list[str]:
        """Return the names of the walls at which particles end, at once or after a time."""
        walls = zip(WALLS, self.walls, self.wall_opening_times, strict=True)
        return [name for name, (kind, _), time in walls if kind == "open" or time is not None]

    @property
    def wall_opening_times(self) -> list[float | None]:
        """Return the time [s] at which each of the six walls vanishes, None for never."""
        return [wall.removal_time for wall in self._walls]

    @property
    def walls(self) -> list[tuple[str, float]]:
        """Return (kind, friction) for liquids: west, east, south, north, bottom, top wall."""
        return [(wall.kind or "slip", wall.friction) for wall in self._walls]

    @property
    def walls_of_solids(self) -> list[tuple[str, float]]:
        """Return (kind, friction) of the walls for everything that is not a liquid."""
        return [(wall.kind or "separate", wall.friction) for wall in self._walls]

    @property
    def _walls(self) -> list[Wall]:
        return [getattr(self.boundary, name) or self.boundary.default for name in WALLS]


class Time(StrictModel):
    """Simulated time, time step and number of frames."""

    end: Annotated[float, Quantity("s", gt=0), ChangeableOnResume("the run continues to this time")]
    """simulated time"""
    frames: Annotated[
        int,
        Field(strict=True, ge=2, le=100_000),
        ChangeableOnResume(
            "later frames are written at the new times, with consecutive numbers. It counts the"
            " frames of the whole run: a later time.end alone writes them further apart; for the"
            " same time between frames, set it to 1 + (frames - 1) new end / old end"
        ),
    ] = 50
    """number of frames written at equal times, the first at 0 and the last at the end"""
    cfl: Annotated[float, Quantity("", gt=0, le=1)] | None = None
    """Courant number: fraction of the time a wave needs to cross a cell, used as the step; default:
    0.4 with an implicit pressure or a fixed dt, else 0.55"""
    dt: Annotated[float, Quantity("s", ge=0)] = 0.0
    """a fixed step instead of cfl; 0: choose by cfl"""


class Appearance(StrictModel):
    """Color transfer and baked light."""

    color_transfer: Literal["off", "frame", "relax", "step"] = "frame"
    """exchange of colors between particles. off: none. frame: a frame shows the initial colors,
    smoothed over a cell at the current positions. relax: colors mix in the time
    `color_relaxation_time`. These three can also be set in render.toml, without a new run. step: as
    in the paper, the solver smooths colors over a cell in every step: their diffusivity is cell^2 /
    (4 step), so shorter steps mix faster"""
    color_relaxation_time: Annotated[float, Quantity("s", gt=0)] = 1.0
    """relax: time in which colors of neighbors become equal; their diffusivity is cell^2 / (4
    color_relaxation_time)"""
    color_sh_degree: Annotated[int, Field(strict=True, ge=0, le=3)] = 0
    """largest degree of spherical harmonics that is exchanged; 0: view-independent color only"""
    color_objects: tuple[str, ...] | None = None
    """names of the bodies that exchange colors, within one phase and between fluids that mix; with
    step all bodies of their phases; default: all fluids"""
    baked_shading: Annotated[float, Quantity("", ge=0, le=1)] = 0.3
    """light baked on solid shapes and meshes, by the direction of their surface; 0: none. The
    factor is stored in gaussians.h5 (`shade`), so that a renderer with its own light can remove
    it"""


class Accuracy(StrictModel):
    """Accuracy: transfer scheme, precision, and presets."""

    level: Literal["draft", "standard", "high"] | None = None
    """defaults of other keys. draft, standard, high: domain.cell such that the longest
    edge has 32, 64, 96 cells or a few more, precision single, single, double, compression of
    liquids 4 %, 1 %, 1 %; draft prunes bodies made of Gaussians or meshes (prune = "auto")"""
    transfer: Transfer = "apic-corrected"
    """particle-grid transfer scheme. apic-corrected: APIC whose numerical dissipation is
    compensated every few steps, so that waves and vibrations persist. apic: takes 0.8 of its time,
    but dissipates with every step, up to a third of a wave's height in a period. Both conserve
    linear and angular momentum. aflip: retains motion too fine for the grid, for the time
    `flip_decay_time`, and takes 1.3 times as long. flip: without APIC's gradients, at some noise.
    pic: damps"""
    gradient: Literal["mls", "bspline"] = "mls"
    """gradients for strains and forces. mls: moments of moving least squares. bspline: gradients of
    the B-splines, with pic and flip only; a bending body that rotates against the grid keeps its
    stiffness, with 64 particles per cell"""
    volume_correction: Literal["none", "density", "shifting"] = "shifting"
    """volume of liquids. shifting: the volume follows the local filling at the rate of the flow's
    strain, and particles that crowd are moved apart. none: integrated from the velocity divergence
    alone; a splashing or sloshing liquid loses height. density: corrected towards the local filling
    at a constant rate, not of liquids that mix or flow through sand"""
    dilatation: Literal["particles", "cells"] = "particles"
    """divergence that the volume of a liquid follows, unless it shares space with others.
    particles: that at each particle; a liquid much stiffer than its depth asks for locks, and its
    waves are too fast. cells: the mean over the cells around it, for waves and currents in stiff
    liquids, with apic-corrected, apic and pic; a step takes 1.2 to 1.4 times as long"""
    precision: Literal["single", "double"] = "single"
    """precision of the particles' and the grid's numbers. single: half the time and memory of
    double, and changes nothing that a picture shows. double: for conservation to 15 digits, for
    waves and vibrations far smaller than the motion, and for more than 1e5 steps. A resumed run
    keeps its own unless the scene names one"""

    @model_validator(mode="after")
    def _check_dilatation(self) -> "Accuracy":
        if self.dilatation == "cells" and self.is_flip:
            message = "cells is for transfer = 'apic-corrected', 'apic' or 'pic'"
            raise field_error(self, "dilatation", message)
        return self

    @property
    def affine(self) -> bool:
        """Return whether particles carry the velocity gradient (APIC)."""
        return self.transfer in ("apic", "apic-corrected", "aflip")

    @property
    def corrects_transfers(self) -> bool:
        """Return whether the transfer error is compensated every few steps."""
        return self.transfer == "apic-corrected"

    @property
    def is_flip(self) -> bool:
        """Return whether particles keep some motion that the grid does not resolve (FLIP)."""
        return self.transfer in ("aflip", "flip")


def _name(value: str) -> str:
    if "\0" in value:
        raise ValueError("no folder has such a name")
    return value


class Output(StrictModel):
    """Files that the run writes, and how often."""

    folder: Annotated[
        str,
        Field(min_length=1),
        AfterValidator(_name),
        ChangeableOnResume("the run continues in that folder"),
    ] = "out"
    """relative to the scene's folder"""
    fields: Annotated[
        tuple[
            Literal["velocity", "J", "F", "stress", "pressure", "strain", "volume_fraction"], ...
        ],
        ChangeableOnResume("later frames have these fields"),
    ] = ("velocity", "J", "F")
    """fields of the frames besides positions; rendering needs F for elastic bodies and J for all
    others. stress, pressure, strain: of the law of each particle, for other programs.
    volume_fraction: where a coupling of kind mixing or drag lets materials share space"""
    compression: Annotated[
        Literal["none", "gzip"], ChangeableOnResume("applies to later frames")
    ] = "none"
    """gzip: frames are compressed without loss (shuffle and gzip of HDF5, which ParaView and h5py
    read); rank 0 gathers and compresses them, which takes some 10 ms per MB"""
    checkpoint_interval: Annotated[
        float, Quantity("s", ge=0), ChangeableOnResume("applies from now on")
    ] = 600.0
    """wall time between checkpoints; 0: none by time"""
    checkpoint_interval_steps: Annotated[
        int, Field(strict=True, ge=0), ChangeableOnResume("applies from now on")
    ] = 0
    """steps between checkpoints; 0: none by steps"""


class TopLevelKeys(StrictModel):
    """Keys above the first table."""

    title: Annotated[str, ChangeableOnResume("applies from now on")] = ""
    """title of the scene"""
    seed: Annotated[int, Field(strict=True, ge=0, le=2**31)] = 1
    """seed of all random numbers: the points on a mesh's surface"""
    allow_outside: Annotated[bool, ChangeableOnResume("applies from now on")] = False
    """whether files may lie outside the scene's folder"""


SECTIONS: dict[str, type[StrictModel]] = {
    "domain": Domain,
    "time": Time,
    "appearance": Appearance,
    "accuracy": Accuracy,
    "output": Output,
}


def validate_cell_counts(domain: Domain) -> list[tuple[tuple, str]]:
    """Return (path, message) for edges that are no whole number of cells, or too many or few."""
    errors: list[tuple[tuple, str]] = []
    for axis, edge in enumerate(domain.size):
        count, message = edge / domain.cell, ""
        if count > MAX_CELLS:
            message = f"is {count:.3g} cells; at most {MAX_CELLS} are possible"
        elif abs(count - round(count)) > 1e-6 * max(1.0, count):
            low, high = math.floor(count) * domain.cell, math.ceil(count) * domain.cell
            options = f"{low:.6g} m or {high:.6g} m" if low > 0 else f"{high:.6g} m"
            message = (
                f"must be a whole number of cells of {domain.cell:g} m; {edge:g} m is"
                f" {count:.4g} cells, nearest are {options}"
            )
        elif round(count) < 4:
            message = f"must be at least 4 cells of {domain.cell:g} m; got {edge:g} m"
        if message:
            errors.append((("domain", "size", axis), message))
    return errors
