"""What a material is: a table of the scene, and a law as plain scalar Python.

A material class names its `kind` (a Literal), its `family`, the state its particles carry with the
value at rest, and turns its table into a `Law`, a NamedTuple of numbers. The law's functions take
the law, the particle's state (a tuple of scalars) and return scalars or tuples. They use operators
and numpy ufuncs only, so that the same text runs on numpy arrays (the tests' reference) and,
compiled, on the particles of the solver. No function of a law branches in Python on a particle's
value: it selects with minimum, maximum and device/select.py. device/tensor.py and device/eigen.py
have products, rotations and eigenvalues of 3x3 tensors; device/hencky.py, flow.py and tait.py what
laws have in common; yielding.py is the base of laws that yield.

    advance(law, state, L, dt) -> state     L = grad v [1/s], nine numbers, row by row; dt [s]
    stress(law, state, L) -> (t00, t11, t22, t01, t02, t12)     Kirchhoff stress [Pa]
    volume_ratio(law, state) -> J; of a law that yields the elastic part of it
    wave_speed2(law, state) -> c^2 [m2/s2], a bound on the fastest wave in the present state
    energy(law, state) -> psi [J per m3 of rest volume]
"""

import inspect
from typing import Any, ClassVar, Literal, get_args

from pydantic import BaseModel, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from ..misspelt import nearest
from ..tables import Table

registry: dict[str, type] = {}

FUNCTIONS = ("advance", "stress", "volume_ratio", "wave_speed2", "energy")

# who shares a velocity field: all fluids one, all sand one, all snow one, a solid body its own
Family = Literal["fluid", "sand", "snow", "solid"]


class Material(Table):
    """What every material can say; a law overrides what is different for it."""

    kind: str
    preset: str = ""
    """name of a known stuff: gives the keys that are not given here their values"""

    presets: ClassVar[dict[str, dict]] = {}  # values of keys, SI, by the stuff's name
    kinematic_viscosity: ClassVar[float] = 0.0  # [m2/s]: bounds the time step by diffusion

    @model_validator(mode="before")
    @classmethod
    def _fill(cls, raw: Any) -> Any:
        """The keys of the preset beneath those that are given."""
        name = raw.get("preset", "") if isinstance(raw, dict) else ""
        if name == "":
            return raw
        if not isinstance(name, str) or name not in cls.presets:
            known = ", ".join(cls.presets) or "none"
            said = f"there is no such preset{nearest(name, cls.presets)}; known here: {known}"
            raise complain(cls, "preset", said, name)
        return {**cls.presets[name], **raw}

    @property
    def bulk_density(self) -> float:
        """Mass per volume at rest, pores included [kg/m3]: what a particle weighs."""
        return self.density  # type: ignore[attr-defined]

    @property
    def solid_share(self) -> float:
        """Volume of the matter itself per volume at rest; less than 1 where there are pores."""
        return 1.0

    @property
    def stiffening(self) -> float:
        """How many times its moduli at rest a law's may become in a run: what --plan reckons with.
        Elastic strains are not in it."""
        return 1.0


def complain(table: Any, key: str, said: str, value: Any = None) -> ValidationError:
    """The error that a table's own check raises about one of its keys. value: what was given,
    by default what the table holds."""
    value = getattr(table, key) if isinstance(table, BaseModel) else value
    kind = PydanticCustomError("table", "{said}", {"said": said})
    details = InitErrorDetails(type=kind, loc=(key,), input=value)
    return ValidationError.from_exception_data("table", [details])


def lame(youngs_modulus: float, poisson_ratio: float) -> tuple[float, float]:
    """Shear modulus mu and Lame's first parameter [Pa]."""
    E, nu = youngs_modulus, poisson_ratio
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def material(cls: type) -> type:
    """Register a material's table under its kind."""
    kind = get_args(cls.model_fields["kind"].annotation)[0]
    if kind in registry:
        raise TypeError(f"two materials call themselves {kind!r}")
    own = [inspect.getattr_static(cls, name, None) for name in FUNCTIONS]
    missing = [f for f, found in zip(FUNCTIONS, own) if not isinstance(found, staticmethod)]
    if missing:
        raise TypeError(f"material {kind!r} lacks the static functions {', '.join(missing)}")
    registry[kind] = cls
    return cls


def function(law: tuple, name: str):
    """The plain Python function `name` of the material that made `law`."""
    return getattr(law_owner(type(law)), name)


def law_owner(law_type: type) -> type:
    """The material whose Law is `law_type`; KeyError if there is none."""
    for cls in registry.values():
        if cls.Law is law_type:
            return cls
    raise KeyError(law_type)


def state_channels(law_type: type) -> int:
    """Numbers a particle of this law carries."""
    return sum(len(rest) for rest in law_owner(law_type).carries.values())
