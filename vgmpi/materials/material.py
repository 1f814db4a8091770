"""Bases of all materials: the table of a scene, and a law as plain scalar Python.

A material class names its `kind` (a Literal), its `family`, the state of its particles with the
values at rest, and turns its table into a `Law`, a NamedTuple of numbers. The law's functions take
the law, the particle's state (a tuple of scalars) and return scalars or tuples. They use operators
and numpy ufuncs only, so that the same text runs on numpy arrays (the tests' reference) and,
compiled, on the particles of the solver. No function of a law branches in Python on a particle's
value: it selects with minimum, maximum and materials/tensor_math/select.py.
materials/tensor_math/tensor.py and materials/tensor_math/symmetric_eigen.py have products,
rotations and eigenvalues of 3x3 tensors; materials/tensor_math/hencky.py, viscoplastic_flow.py and
materials/tensor_math/tait.py the common parts of laws.

    advance(law, state, L, dt) -> state     L = grad v [1/s], nine numbers, row by row; dt [s]
    stress(law, state, L) -> (t00, t11, t22, t01, t02, t12)     Kirchhoff stress [Pa]
    volume_ratio(law, state) -> J, or its elastic part for a law with plasticity
    wave_speed2(law, state) -> c^2 [m2/s2], a bound on the fastest wave in the present state
    energy(law, state) -> psi [J per m3 of rest volume]

HyperelasticMaterial is the base of solids that carry H = F - I, ElastoplasticMaterial that of laws
with a return mapping.
"""

import inspect
import math
from collections.abc import Iterable
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, TypeVar, get_args

from pydantic import BaseModel, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from vgmpi.materials.tensor_math.tensor import det_minus_one, update_deformation_gradient
from vgmpi.runtime.config.schema import Quantity, StrictModel
from vgmpi.runtime.message_text import did_you_mean

from .tensor_math import hencky

FUNCTIONS = ("advance", "stress", "volume_ratio", "wave_speed2", "energy")

# Bodies of a family share a velocity field: all fluids, all sand, all snow; a solid has its own.
Family = Literal["fluid", "sand", "snow", "solid"]
# rubber (natural, unfilled), silicone, cork, wood (balsa, mean of its directions): Gibson and
# Ashby, Cellular Solids, 2nd ed. 1997, and Ashby, Materials Selection in Mechanical Design,
# 4th ed. 2011, appendix A; jelly, gelatine of some percent: Markidou et al., J. Food Eng. 68
# (2005) 295. Rubber, silicone and jelly have a Poisson ratio near 0.5, which locks: 0.45
ELASTIC_PRESETS: dict[str, dict] = {
    "rubber": {"density": 930.0, "youngs_modulus": 2e6, "poisson_ratio": 0.45},
    "silicone": {"density": 1150.0, "youngs_modulus": 5e5, "poisson_ratio": 0.45},
    "jelly": {"density": 1020.0, "youngs_modulus": 1e4, "poisson_ratio": 0.45},
    "cork": {"density": 170.0, "youngs_modulus": 2e7, "poisson_ratio": 0.05},
    "balsa": {"density": 160.0, "youngs_modulus": 1e9, "poisson_ratio": 0.3},
}


class Material(StrictModel):
    """Table with the keys of every material; a law overrides what differs."""

    family: ClassVar[Family]
    carries: ClassVar[dict[str, tuple[float, ...]]]  # state of a particle at rest
    Law: ClassVar[type]

    kind: str
    preset: str = ""
    """name of a preset; sets the keys that are not set here"""

    presets: ClassVar[dict[str, dict]] = {}  # preset name -> values of keys in SI units
    kinematic_viscosity: ClassVar[float] = 0.0  # [m2/s] bounds the time step by diffusion

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, raw: Any) -> Any:
        """Fill missing keys from the preset."""
        name = raw.get("preset", "") if isinstance(raw, dict) else ""
        if name == "":
            return raw
        if not isinstance(name, str) or name not in cls.presets:
            names = ", ".join(cls.presets) or "none"
            others = kinds_with_preset(name) if isinstance(name, str) else []
            if others:
                message = f'preset "{name}" is of kind "{others[0]}"'
            else:
                hint = did_you_mean(name, cls.presets)
                message = f"there is no such preset{hint}; known here: {names}"
            raise field_error(cls, "preset", message, name)
        return {**cls.presets[name], **raw}

    @staticmethod
    def is_liquid(law: tuple) -> bool:
        """Return whether a law is that of a liquid; compiled code knows it by the law's type."""
        return False

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        raise NotImplementedError

    @property
    def bulk_density(self) -> float:
        """Return the mass per volume at rest, pores included [kg/m3]."""
        return self.density  # type: ignore[attr-defined]

    @property
    def dynamic_viscosity(self) -> float:
        """Return the viscosity of a liquid [Pa s], infinite if it depends on the shear rate.

        Other materials have none: 0.
        """
        return getattr(self, "viscosity", math.inf) if self.family == "fluid" else 0.0

    @property
    def solid_share(self) -> float:
        """Return the volume fraction of the matter itself at rest; below 1 if there are pores."""
        return 1.0

    @property
    def stiffening(self) -> float:
        """Return the largest factor on the law's moduli in a run, used by --plan.

        Elastic strains are not included.
        """
        return 1.0


registry: dict[str, type[Material]] = {}


def kinds_with_preset(name: str) -> list[str]:
    """Return the kinds that have a preset of this name, in the order of the registry.

    Solids share their presets: "elastic" comes before "corotated", which is slower.
    """
    kinds = [kind for kind, cls in registry.items() if name in cls.presets]
    return sorted(kinds, key=lambda kind: kind != "elastic")


def unknown_material(name: str, materials: Iterable[str]) -> str:
    """Return the text of the error of a name that no [material.*] table has.

    Args:
        name: Name that a scene refers to.
        materials: Names of the materials that the scene defines.
    """
    names = list(materials)
    defined = f"defined are {', '.join(names)}" if names else "none is defined"
    return f"there is no [material.{name}]{did_you_mean(name, names)}; {defined}"


MaterialClass = TypeVar("MaterialClass", bound=Material)


def field_error(table: Any, key: str, message: str, value: Any = None) -> ValidationError:
    """Return the validation error of a table's own check of one of its keys.

    Args:
        table: Table or its class.
        key: Name of the key.
        message: Text of the error.
        value: Value in the input, by default that of the table.
    """
    value = getattr(table, key) if isinstance(table, BaseModel) else value
    kind = PydanticCustomError("table", "{said}", {"said": message})
    details = InitErrorDetails(type=kind, loc=(key,), input=value)
    return ValidationError.from_exception_data("table", [details])


def lame(youngs_modulus: float, poisson_ratio: float) -> tuple[float, float]:
    """Return the shear modulus mu and Lame's first parameter lambda [Pa]."""
    E, nu = youngs_modulus, poisson_ratio
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def material(cls: type[MaterialClass]) -> type[MaterialClass]:
    """Register a material's table under its kind."""
    kind = get_args(cls.model_fields["kind"].annotation)[0]
    if kind in registry:
        raise TypeError(f"two materials call themselves {kind!r}")
    own = [inspect.getattr_static(cls, name, None) for name in FUNCTIONS]
    missing = [f for f, member in zip(FUNCTIONS, own) if not isinstance(member, staticmethod)]
    if missing:
        raise TypeError(f"material {kind!r} lacks the static functions {', '.join(missing)}")
    registry[kind] = cls
    return cls


def law_function(law: tuple, name: str):
    """Return the plain Python function `name` of the material that made `law`."""
    return getattr(law_owner(type(law)), name)


def law_owner(law_type: type) -> type[Material]:
    """Return the material whose Law is `law_type`; raise KeyError if there is none."""
    for cls in registry.values():
        if cls.Law is law_type:
            return cls
    raise KeyError(law_type)


def state_channels(law_type: type) -> int:
    """Return the number of state variables per particle of a law."""
    return sum(len(values) for values in law_owner(law_type).carries.values())


class HyperelasticMaterial(Material):
    """Base of laws with mu and lam [Pa] and density whose state begins with H = F - I.

    H has nine numbers; the update leaves further state variables unchanged. A subclass defines Law,
    cost, stress, wave_speed2 and energy; `carries` and `advance` if its state has more than H, and
    `law` if Law has more numbers.
    """

    kind: str
    density: Annotated[float, Quantity("kg/m3", gt=0)] = 1100.0
    """at rest"""
    youngs_modulus: Annotated[float, Quantity("Pa", gt=0)]
    """stiffness in tension, for small strains"""
    poisson_ratio: Annotated[float, Quantity("", ge=0, lt=0.5)] = 0.3
    """0.5 would be incompressible; too stiff in bending above 0.45"""
    friction: Annotated[float, Quantity("", ge=0)] = 0.3
    """Coulomb friction coefficient against other solids without a contact coupling"""

    family: ClassVar[Family] = "solid"
    # H instead of F: in single precision an increment below 1e-8 added to 1 would be lost
    carries: ClassVar = {"H": (0.0,) * 9}
    presets: ClassVar[dict[str, dict]] = ELASTIC_PRESETS

    def law(self) -> NamedTuple:
        """Return the numbers of the law in SI units."""
        return self.Law(*lame(self.youngs_modulus, self.poisson_ratio), self.density)

    @staticmethod
    def advance(law, state, L, dt):
        """Return the state after a step dt [s] of L = grad v [1/s], nine components, row by row."""
        return (*update_deformation_gradient(state[:9], L, dt), *state[9:])

    @staticmethod
    def volume_ratio(law, state):
        """Return the volume ratio J."""
        return 1.0 + det_minus_one(state[:9])


class ElastoplasticMaterial(Material):
    """Base of laws with mu and lam [Pa] and density whose state begins with b_e - I.

    b_e - I has six numbers. A subclass defines `advance`, the return mapping
    (materials/tensor_math/hencky.py).
    """

    @staticmethod
    def stress(law, state, L):
        """Return the Kirchhoff stress (00, 11, 22, 01, 02, 12) [Pa]."""
        return hencky.stress(law.mu, law.lam, state[:6])

    @staticmethod
    def volume_ratio(law, state):
        """Return the elastic volume ratio."""
        return hencky.volume_ratio(state[:6])

    @staticmethod
    def wave_speed2(law, state):
        """Return a bound on the squared wave speed [m2/s2]."""
        return hencky.acoustic_modulus_bound(law.mu, law.lam, state[:6]) / law.density

    @staticmethod
    def energy(law, state):
        """Return the elastic energy per rest volume [J/m3]."""
        return hencky.energy(law.mu, law.lam, state[:6])
