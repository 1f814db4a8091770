"""Objects of a scene, made of Gaussians, meshes or shapes, and their placement."""

import math
import re
from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, PrivateAttr, model_validator

from vgmpi.gaussians.capture_conventions import RenderModel
from vgmpi.runtime.config.schema import (
    Color,
    Length,
    Point,
    Positive,
    Quantity,
    Share,
    StrictModel,
    Switch,
    as_list,
)
from vgmpi.runtime.message_text import did_you_mean

from .captures import Frame, Select, validate_select
from .point_sets import Points, as_table, validate_points
from .regions import Region, validate_regions
from .rigid_motion import Motion, validate_motion
from .rigid_objects import FreeBody, validate_rigid
from .shapes import Axis, Shape, validate_shape
from .subtraction import Subtraction

SOURCES = ("gaussians", "mesh", "shape", "points")
SIZES = ("height", "width", "depth", "scale")
MAX_NAME_BYTES = 120  # [bytes] of a name in UTF-8; a file's name has 255 with what is added to it
PER_CELL = (1, 8, 27, 64)
BODY_ONLY_KEYS = tuple(
    "material region velocity angular_velocity velocity_mode volume_fraction"
    " volume_fraction_profile initial_pressure subtract phase prune prune_scale passive_gaussians"
    " track_deformation".split()
)


def checked_name(value: Any) -> str:
    """Return a name that can stand in messages and file names; raise ValueError for others."""
    if not isinstance(value, str) or not re.fullmatch(r"[^\W\d][\w -]*", value):
        raise ValueError("must begin with a letter and hold letters, digits, spaces, _ and - only")
    size = len(value.encode(errors="surrogatepass"))
    if size > MAX_NAME_BYTES:
        raise ValueError(f"is {size} bytes long; at most {MAX_NAME_BYTES} are possible")
    return value


def per_cell(value: Any) -> int:
    """Return a number of particles per cell that is a cube; raise ValueError for others."""
    if isinstance(value, bool) or value not in PER_CELL:
        raise ValueError("must be 1, 8, 27 or 64: a whole number of particles per cell and axis")
    return int(value)


Velocity = tuple[
    Annotated[float, Quantity("m/s")],
    Annotated[float, Quantity("m/s")],
    Annotated[float, Quantity("m/s")],
]
Wavenumber = Annotated[float, Quantity("rad/m")]
Spin = tuple[
    Annotated[float, Quantity("rad/s")],
    Annotated[float, Quantity("rad/s")],
    Annotated[float, Quantity("rad/s")],
]


class VelocityMode(StrictModel):
    """Wave of velocities at the start: amplitude sin(wave_vector . x + phase_angle)."""

    amplitude: Velocity
    """largest velocity"""
    wave_vector: tuple[Wavenumber, Wavenumber, Wavenumber]
    """wave vector k, 2 pi / wavelength along its direction; x is the position in the domain"""
    phase_angle: Annotated[float, Quantity("rad")] = 0.0
    """"90 deg" makes the sine a cosine"""


class FractionProfile(StrictModel):
    """Volume fraction that changes along one axis, piecewise linear, constant beyond its points."""

    axis: Literal["x", "y", "z"]
    """axis along which it changes"""
    positions: tuple[Length, ...]
    """ascending positions in the domain, two or more"""
    values: tuple[Share, ...]
    """volume fraction at each of them; no particles where it is 0"""

    @model_validator(mode="after")
    def _matches(self) -> "FractionProfile":
        if len(self.positions) < 2 or len(self.positions) != len(self.values):
            raise ValueError("positions and values must be of one length, 2 or more")
        if any(a >= b for a, b in zip(self.positions, self.positions[1:])):
            raise ValueError("positions must ascend")
        return self


class Rotation(StrictModel):
    """Rotation about an axis through the object."""

    axis: Axis
    """"x", "-x", "y", "-y", "z", "-z" or three numbers"""
    angle: Annotated[float, Quantity("rad")]
    """right-handed angle"""


class Object(StrictModel):
    """Object of the scene: exactly one of gaussians, mesh, shape, points."""

    name: Annotated[str, BeforeValidator(checked_name)]
    """unique name: letters, digits, spaces, _ and -, beginning with a letter"""
    role: Literal["body", "scenery"] = "body"
    """body: has mass and moves. scenery: rendered only, or a collider"""
    material: str | None = None
    """name of a [material.*] table; required for a body, absent for scenery"""
    region: Annotated[tuple[Region, ...] | None, BeforeValidator(as_list)] = None
    """parts of another material of the same kind, a list of tables: [[object.region]]"""
    gaussians: str | None = None
    """a Gaussian file (.ply .splat .spz .sog .glb .gltf .ksplat), relative to the scene's folder"""
    mesh: str | None = None
    """a surface mesh (.obj .stl .ply .vtk .vtp .vtu .msh), relative to the scene's folder; colored
    by the textures (map_Kd) and colors (Kd) of an .obj's materials, its points or its triangles"""
    shape: Shape | None = None
    """a solid made of simple shapes"""
    points: Annotated[Points | None, BeforeValidator(as_table)] = None
    """a body of given particles: a file (.ply .npz .vtp), or arrays of a program"""
    frame: Frame | None = None
    """directions of x, y and z in a capture (gaussians), one each of R/L, U/D and F/B (right, left,
    up, down, forward, back), if they are not those of a .ply, "RDF": "RUB", for example. The
    capture is turned to RDF before `select` and `up`. Default: what the file says, else "RDF\""""
    select: Select | None = None
    """which part of a capture (gaussians) to take"""
    render_model: RenderModel | None = None
    """how the opacities of a capture (gaussians) are meant, for files that do not say it. classic:
    as the first captures, the renderer widens small Gaussians and they become more opaque.
    antialiased: trained with gsplat's `antialiased`, opacities are compensated for 0.3 pixels^2.
    mip: the same for 0.1 pixels^2, as by Mip-Splatting, Brush and LichtFeld Studio. Default: mip if
    the file says that it was trained antialiased, else classic"""
    up: Literal["x", "-x", "y", "-y", "z", "-z"] = "z"
    """axis of the file that points up; most captures have "-y", most meshes "y\""""
    height: Positive | None = None
    """scale the object to this extent along z (before `rotation`); the extent of a capture is that
    of the Gaussians that are seen, without floaters (see `select.keep_floaters`)"""
    width: Positive | None = None
    """scale the object to this extent along x (before `rotation`)"""
    depth: Positive | None = None
    """scale the object to this extent along y (before `rotation`)"""
    scale: Annotated[float, Quantity("", gt=0)] | None = None
    """linear scale from the file's units to meters; default 1"""
    rotation: Annotated[tuple[Rotation, ...], BeforeValidator(as_list)] = ()
    """{ axis, angle } or a list of them, applied in order"""
    position: Point | None = None
    """position of the center of its base: center of the extent in x and y, lowest z"""
    origin: Point | None = None
    """instead of `position`: position of the origin of its own coordinates. Parts of one capture
    with the same scale, rotation and origin stay together. Default for shapes: 0, 0, 0"""
    velocity: Velocity = (0.0, 0.0, 0.0)
    """velocity at the start"""
    angular_velocity: Spin = (0.0, 0.0, 0.0)
    """angular velocity at the start, about the center of mass"""
    velocity_mode: Annotated[tuple[VelocityMode, ...], BeforeValidator(as_list)] = ()
    """waves of velocity at the start, besides `velocity` and `angular_velocity`:
    { amplitude, wave_vector, phase_angle } or a list of them"""
    volume_fraction: Annotated[float, Quantity("", gt=0, le=1)] = 1.0
    """volume fraction: where two objects overlap, their fractions should add up to 1. The volumes
    and masses of its particles are scaled by it"""
    volume_fraction_profile: FractionProfile | None = None
    """instead of `volume_fraction`: { axis, positions, values }, a volume fraction that changes
    along an axis"""
    initial_pressure: Literal["zero", "hydrostatic"] = "zero"
    """fluids only. hydrostatic: at rest under gravity from the start, the pressure is the weight of
    the fluid between each particle and the object's top; with zero a deep pool first bounces"""
    subtract: Subtraction = None
    """liquids, pastes, sand and snow only: objects that are cut out of it at the start, a list of
    the names of colliders, rigid bodies and bodies of solids, or true for all of them. Particles
    whose centers lie inside one are left out"""
    phase: str | None = None
    """bodies with the same phase share one velocity field: they stick together instead of
    colliding. Bodies of different kinds, such as a ball and snow, must all name it. One phase for
    the whole scene corresponds to single-field methods. Default: all fluids share one, all sand,
    all snow, each solid has its own"""
    particles_per_cell: Annotated[int, BeforeValidator(per_cell)] = 8
    """particles per full cell inside shapes, meshes and fillings: 1, 8, 27 or 64"""
    fill: Literal[True, False, "closed", "visible"] = True
    """filling of a capture's interior. true: fill it even if the surface has holes; interior
    particles of a solid that are visible through a hole have mass but are not rendered. "visible":
    as true, and render all of them (for bodies that break). "closed": fill only regions enclosed by
    the surface. false: leave a hollow shell one voxel thick"""
    prune: Literal["off", "auto", "versagauss"] = "off"
    """removal of particles of a capture or a mesh; the remaining ones take over mass and
    appearance. auto: down to 8 per cell (or `particles_per_cell`), as long as images at rest agree
    to 40 dB inside the outline. versagauss: the ratios of VersaGauss for surface and interior, see
    `prune_scale`. Rigid bodies have no particles and keep all Gaussians"""
    prune_scale: Annotated[float, Quantity("", gt=0, le=1)] | None = None
    """for prune = "versagauss", the volume scale s' (a linear scale cubed): of the interior s' is
    kept, of the surface s'^(2/3) up to s' = 0.5, s'^(1/3) up to 0.7, above 0.7 all"""
    passive_gaussians: Switch = False
    """solids only: render the pruned Gaussians, too. Each follows the 4 particles nearest to it at
    rest and has no mass. Rigid bodies render all anyway"""
    color: Color = (0.7, 0.7, 0.7)
    """color of shapes, and of meshes without colors: "#rrggbb" or three numbers 0..1. It goes
    before the colors (Kd) of an .obj's materials"""
    opacity: Share = 0.95
    """opacity of the Gaussians made for shapes, meshes and fillings"""
    opacity_scale: Share = 1.0
    """fluids only: factor on opacities in rendering; water looks realistic at 0.005 .. 0.05"""
    track_deformation: Switch | None = None
    """store the total deformation gradient F in the frames and deform the Gaussians with it.
    Default: true for solids. Not recommended for fluids, sand or snow, where unbounded shear turns
    Gaussians into needles"""
    alpha_min: Annotated[float, Quantity("", ge=1e-5, le=0.5)] | None = None
    """contributions below this alpha are skipped in rendering; default 1/255, and 1e-4 where
    opacity_scale is below 0.1"""
    collider: Switch = False
    """scenery only: bodies collide with it"""
    motion: Motion | None = None
    """prescribed motion of a collider or a body, independent of contact. A body with prescribed
    motion is rigid; when its motion ends it moves on freely, with its velocity at that time. A
    collider without it is at rest"""
    friction: Annotated[float, Quantity("", ge=0)] | None = None
    """colliders only: Coulomb friction coefficient of all bodies on it. Default: that of each
    body's material"""
    rigid: Switch = False
    """bodies of solids only: a free rigid body. It does not deform, moves by its momentum, and has
    no particles. Density and friction are those of its material"""
    restitution: Annotated[float, Quantity("", ge=0, le=1)] | None = None
    """rigid bodies only: speed after over speed before a collision with another rigid body, a
    collider or a wall; default 0"""

    _free_body: FreeBody | None = PrivateAttr(None)  # set by scene/rigid_objects.py

    @property
    def free_body(self) -> FreeBody | None:
        """Return its properties as a free rigid body, which is a collider that moves freely."""
        return self._free_body

    @property
    def source(self) -> str:
        """Return which of SOURCES it is made from."""
        return next(key for key in SOURCES if getattr(self, key) is not None)

    @property
    def speed(self) -> float:
        """Return an upper bound [m/s] of its speed at the start, without its rotation."""
        waves = sum(math.hypot(*m.amplitude) for m in self.velocity_mode)
        return math.hypot(*self.velocity) + waves + (self.points.speed if self.points else 0.0)

    @property
    def alpha_threshold(self) -> float:
        """Return the opacity below which a contribution is not drawn."""
        if self.alpha_min is not None:
            return self.alpha_min
        return default_alpha_min(self.opacity_scale)


def default_alpha_min(opacity_scale: float) -> float:
    """Return the default opacity below which a contribution is not drawn."""
    return 1 / 255 if opacity_scale >= 0.1 else 1e-4


def validate_body_name(name: Any, role: dict[str, str] | None) -> str:
    """Return why `name` is not the name of a body, or an empty text.

    Args:
        name: Name to check.
        role: Role of each object by its name, or None if the names are unknown because of errors.
    """
    if role is None or not isinstance(name, str):
        return ""
    if name not in role:
        return f"there is no object '{name}'{did_you_mean(name, role)}; known: {', '.join(role)}"
    if role[name] == "rigid":
        return f"'{name}' is rigid: it has no particles"
    return "" if role[name] == "body" else f"'{name}' is scenery: it has no mass and does not move"


def validate_exactly_one(raw: dict, keys: Iterable[str], without: str) -> list[tuple[tuple, str]]:
    """Return (path, message) where not exactly one of `keys` is present.

    Args:
        raw: Table as read.
        keys: Keys that exclude each other.
        without: Text about a table that has none of them.
    """
    present = [key for key in keys if key in raw]
    if not present:
        return [((), f"{without}: give one of {', '.join(keys)}")]
    if len(present) > 1:
        return [((present[1],), f"{' and '.join(present)} given at once: give exactly one")]
    return []


def validate_object(raw: dict) -> list[tuple[tuple, str]]:
    """Return (path, message) for every pair of keys of one object that exclude each other.

    Only the presence of keys is looked at, not their values, so that it works on a table that has
    other errors.
    """
    errors: list[tuple[tuple, str]] = []
    sources = [key for key in SOURCES if key in raw]
    errors += validate_exactly_one(raw, SOURCES, "has no source")
    sizes = [key for key in SIZES if key in raw]
    if len(sizes) > 1:
        errors.append(((sizes[1],), f"{' and '.join(sizes)} given at once: give one"))
    if "position" in raw and "origin" in raw:
        errors.append((("origin",), "position and origin given at once: give one"))
    placed = {"shape", "points", "position", "origin"}.intersection(raw)
    if sources and not placed:
        errors.append(((), "needs a position (of the middle of its base) or an origin"))
    if sources == ["shape"]:
        errors += validate_shape(raw["shape"], ("shape",))
    for key in ("frame", "select", "fill", "render_model"):
        if key in raw and sources and "gaussians" not in raw:
            errors.append(((key,), f"is only for objects made of gaussians, not of a {sources[0]}"))
    errors += validate_select(raw.get("select")) + _validate_pruning(raw, sources)
    scenery = raw.get("role") == "scenery"
    if scenery:
        for key in BODY_ONLY_KEYS:
            if key in raw:
                errors.append(((key,), "is not for scenery: it has no mass and does not move"))
    elif "material" not in raw:
        errors.append((("material",), "required key is missing: what the body is made of"))
    if "volume_fraction" in raw and "volume_fraction_profile" in raw:
        message = "volume_fraction and volume_fraction_profile given at once: give one"
        errors.append((("volume_fraction_profile",), message))
    if raw.get("collider") is True and not scenery:
        errors.append((("collider",), 'is only for role = "scenery": bodies collide anyway'))
    collider = raw.get("collider") is True
    if "friction" in raw and not collider:
        errors.append((("friction",), "is only for scenery with collider = true"))
    if "motion" in raw and scenery and not collider:
        errors.append((("motion",), "is for bodies, and for scenery with collider = true"))
    errors += validate_motion(raw.get("motion"), ("motion",))
    rigid = validate_rigid(raw, scenery)
    excluded = {path for path, _ in rigid}  # each key has one line
    errors = [error for error in errors if error[0] not in excluded] + rigid
    errors += [error for error in validate_regions(raw) if error[0] not in excluded]
    errors += validate_points(raw, scenery)
    return errors


def _validate_pruning(raw: dict, sources: list[str]) -> list[tuple[tuple, str]]:
    """Return (path, message) for keys about pruning that do not go together."""
    mode, errors = raw.get("prune", "off"), []
    if mode != "off" and sources == ["shape"]:
        errors.append((("prune",), "is only for objects made of gaussians or a mesh"))
    if mode == "versagauss" and "prune_scale" not in raw:
        errors.append((("prune",), "needs prune_scale: VersaGauss keeps shares by a volume scale"))
    if "prune_scale" in raw and mode != "versagauss" and raw.get("prune") != "off":
        errors.append((("prune_scale",), 'is only for prune = "versagauss"'))
    if mode == "off" and raw.get("passive_gaussians") is True:
        errors.append(
            (
                ("passive_gaussians",),
                'needs prune = "auto" or "versagauss": what is pruned rides along',
            )
        )
    if "volume_fraction_profile" in raw and raw.get("passive_gaussians") is True:
        errors.append((("passive_gaussians",), "is not for objects with a volume_fraction_profile"))
    return errors
