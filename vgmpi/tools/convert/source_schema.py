"""Keys of PhysGaussian's and VersaGauss's configurations, with the defaults of their readers.

The readers are utils/decode_param.py of each. Lengths are those of their box, times in s, all else
in SI units. Keys that are not listed here are stored separately: their readers ignore them, too.
"""

from dataclasses import dataclass
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from vgmpi.runtime.config.schema import Quantity


@dataclass(frozen=True, slots=True)
class Plain(Quantity):
    """Number, without text and unit, since their files have none."""

    def _number(self, value: Any) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ValueError("must be a number")
        try:
            return float(value)
        except OverflowError:
            raise ValueError("must be a number that fits in 64 bits") from None


def _flag(value: Any) -> bool:
    if isinstance(value, bool) or (isinstance(value, int) and value in (0, 1)):
        return bool(value)
    raise ValueError("must be true or false")


Number = Annotated[float, Plain("")]
Positive = Annotated[float, Plain("", gt=0)]
NotNegative = Annotated[float, Plain("", ge=0)]
Ratio = Annotated[float, Plain("", ge=0, lt=0.5)]
Share = Annotated[float, Plain("", ge=0, le=1)]
Byte = Annotated[float, Plain("", ge=0, le=255)]
Vector = tuple[Number, Number, Number]
Extent = tuple[Positive, Positive, Positive]
Box = tuple[Number, Number, Number, Number, Number, Number]  # x low, x high, y low, ...
Pair = tuple[Number, Number]
Flag = Annotated[bool, BeforeValidator(_flag)]
Whole = Annotated[int, Field(strict=True, ge=0)]
Text = Annotated[str, Field(strict=True)]


class Keys(BaseModel):
    """Base of tables that are read: frozen; unknown keys are in `model_extra`."""

    model_config = ConfigDict(extra="allow", frozen=True)

    def has_key(self, key: str) -> bool:
        """Return whether the file has this key."""
        return key in self.model_fields_set


class Filling(Keys):
    """Keys of particle_filling of a capture. `max_partciels_per_cell` is their spelling."""

    n_grid: Annotated[int, Field(strict=True, ge=1)] | None = None
    density_threshold: Number = 5.0
    search_threshold: Number = 3.0
    search_exclude_direction: Annotated[int, Field(strict=True)] = 5
    ray_cast_direction: Annotated[int, Field(strict=True)] = 4
    max_particles_num: Positive = 2e6
    max_partciels_per_cell: Positive = 1.0
    boundary: Box | None = None
    smooth: Flag = False
    visualize: Flag = False
    surface: Flag = True


class Part(Keys):
    """Keys of additional_material_params: other numbers for the particles in a box at the start."""

    point: Vector
    size: Extent
    E: Positive
    nu: Ratio
    density: Positive | None = None


class Law(Keys):
    """Material of a body."""

    density: Positive = 200.0
    E: Positive = 1e5
    nu: Ratio = 0.4
    yield_stress: NotNegative = 0.0
    hardening: Number = 0.0
    xi: NotNegative = 0.0
    friction_angle: Annotated[float, Plain("", gt=0, lt=90)] = 25.0
    plastic_viscosity: NotNegative = 0.0
    softening: NotNegative = 0.1
    rpic_damping: Number = 0.0
    pic_damping: Number = 0.0
    additional_material_params: tuple[Part, ...] = ()


class PhysGaussianLaw(Law):
    """Material of PhysGaussian."""

    material: Literal["jelly", "metal", "sand", "foam", "snow", "plasticine"] = "jelly"


class VersaGaussLaw(Law):
    """Material of VersaGauss: one item of material_params."""

    material: Literal[
        "jelly", "metal", "sand", "foam", "snow", "plasticine", "fluid", "jam"
    ] = "jelly"  # fmt: skip
    bulk_modulus: Positive | None = None
    gamma: Annotated[float, Plain("", ge=1, le=20)] = 3.0
    porosity: Annotated[float, Plain("", ge=0, lt=1)] = 0.0
    permeability: Positive | None = None
    compression: Annotated[float, Plain("", gt=0, lt=0.5)] = 2.5e-2
    stretch: Annotated[float, Plain("", gt=0, lt=1)] = 7.5e-3
    hardening_coe: Annotated[float, Plain("", ge=0, le=50)] = 10.0
    diff_coe: NotNegative = 0.0
    static: Flag = False
    static_inf: Flag = False
    type: Text | None = None


class Stand(Keys):
    """Placement of a capture in their box."""

    scale: Positive = 1.0
    opacity_threshold: Share = 0.02
    rotation_degree: tuple[Number, ...] = ()
    rotation_axis: tuple[Literal[0, 1, 2], ...] = ()
    sim_area: Box | None = None
    particle_filling: Filling | None = None


class VersaGaussStand(Stand):
    """Item of preprocess_params."""

    model_path: Text
    camera_path: Text | None = None
    center_point: Vector = (1.0, 1.0, 1.0)
    opacity_scale: Share = 1.0
    object_area: Box | None = None
    sim_selected_area: Box | None = None
    color: tuple[Byte, Byte, Byte] | None = None


class Run(Keys):
    """Box, times and camera."""

    substep_dt: Positive = 1e-4
    frame_dt: Positive = 1e-2
    frame_num: Annotated[float, Plain("", ge=1, le=99_999)] = 100.0
    grid_v_damping_scale: NotNegative = 1.1
    boundary_conditions: tuple[Any, ...] = ()


class PhysGaussian(Run, PhysGaussianLaw, Stand):
    """Configuration of PhysGaussian: one body, all keys side by side."""

    g: Vector
    grid_lim: Positive = 2.0
    n_grid: Annotated[int, Field(strict=True, ge=12, le=10_000)] = 50


class AddParticle(Keys):
    """Keys of add_particle: copies of the particles in a box come with every frame."""

    boundary: Box
    start_time: NotNegative = 0.0
    end_time: Positive = 1e3
    move_pos: Vector = (0.0, 0.0, 0.0)
    object_material_index: Whole = 0
    additional: Flag = False


class VersaGauss(Run):
    """Configuration of VersaGauss: several bodies."""

    object_num: Annotated[int, Field(strict=True, ge=1, le=1000)] = 1
    g: Vector = (0.0, 0.0, -9.8)
    grid_lim: Positive = 4.0
    n_grid: Annotated[int, Field(strict=True, ge=16, le=10_000)] = 200
    material_params: tuple[VersaGaussLaw, ...]
    preprocess_params: tuple[VersaGaussStand, ...]
    add_particle: AddParticle | None = None
    modify_material: dict[str, Any] | None = None


class Condition(Keys):
    """Base of one item of boundary_conditions."""

    type: Text


class BoundingBox(Condition):
    """Frictionless walls some cells inside their box."""


class Cuboid(Condition):
    """Prescribed velocity of nodes in a box."""

    point: Vector
    size: Extent
    velocity: Vector
    start_time: NotNegative = 0.0
    end_time: NotNegative = 1e3
    reset: Number = 0.0


class SurfaceCollider(Condition):
    """Plane behind which nodes are at rest."""

    point: Vector
    normal: Vector
    surface: Text
    friction: NotNegative
    start_time: NotNegative
    end_time: NotNegative


class Impulse(Condition):
    """Keys of particle_impulse: an equal force on every particle in a box, for some steps."""

    force: Vector
    point: Vector = (1.0, 1.0, 1.0)
    size: Extent = (1.0, 1.0, 1.0)
    num_dt: Annotated[float, Plain("", gt=0)] = 1.0
    start_time: NotNegative = 0.0
    end_time: NotNegative = 0.0
    interval: Positive = 1e3


class Translation(Condition):
    """Keys of enforce_particle_translation: velocity of particles that begin in a box."""

    point: Vector
    size: Extent
    velocity: Vector
    start_time: NotNegative
    end_time: NotNegative
    object_index: Whole = 0


class Turning(Condition):
    """Keys of enforce_particle_velocity_rotation: particles that begin in a cylinder rotate."""

    point: Vector
    normal: Vector
    half_height_and_radius: tuple[Positive, Positive]
    rotation_scale: Number
    translation_scale: Number
    start_time: NotNegative
    end_time: NotNegative
    object_index: Whole = 0


class Release(Condition):
    """Keys of release_particles_sequentially: release layer by layer."""

    normal: Vector
    start_position: Number
    end_position: Number
    num_layers: Annotated[int, Field(strict=True, ge=1)]
    start_time: NotNegative
    end_time: Positive
    point: Vector = (0.0, 0.0, 0.0)


class Plane(Condition):
    """Keys of add_plane: frictionless walls around all matter."""

    x_plane: Pair
    y_plane: Pair
    z_plane: Pair


CONDITIONS: dict[str, type[Condition]] = {
    "bounding_box": BoundingBox,
    "cuboid": Cuboid,
    "surface_collider": SurfaceCollider,
    "particle_impulse": Impulse,
    "enforce_particle_translation": Translation,
    "enforce_particle_velocity_rotation": Turning,
    "release_particles_sequentially": Release,
}
CAMERA = (
    "mpm_space_viewpoint_center", "mpm_space_vertical_upward_axis", "default_camera_index",
    "show_hint", "init_azimuthm", "init_elevation", "init_radius", "delta_a", "delta_e", "delta_r",
    "move_camera", "first_move_frame", "multi_camera", "camera_delta_a", "camera_delta_e",
    "camera_nums",
)  # fmt: skip
