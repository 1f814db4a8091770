"""What a material is: a table of the scene, and a law as plain scalar Python.

A material class names its `kind` (a Literal), its `family`, the state its particles carry with the
value at rest, and turns its table into a `Law`, a NamedTuple of numbers. The law's functions take
the law, the particle's state (a tuple of scalars) and return scalars or tuples. They use operators
and numpy ufuncs only, so that the same text runs on numpy arrays (the tests' reference) and,
compiled, on the particles of the solver. No function of a law branches in Python on a particle's
value: it selects with minimum, maximum and device/select.py. device/tensor.py and device/eigen.py
have products, rotations and eigenvalues of 3x3 tensors.

    advance(law, state, L, dt) -> state     L = grad v [1/s], nine numbers, row by row; dt [s]
    stress(law, state, L) -> (t00, t11, t22, t01, t02, t12)     Kirchhoff stress [Pa]
    volume_ratio(law, state) -> J
    wave_speed2(law, state) -> c^2 [m2/s2], a bound on the fastest wave in the present state
    energy(law, state) -> psi [J per m3 of rest volume]
"""

from typing import Literal, get_args

registry: dict[str, type] = {}

FUNCTIONS = ("advance", "stress", "volume_ratio", "wave_speed2", "energy")

Family = Literal["fluid", "solid"]


def material(cls: type) -> type:
    """Register a material's table under its kind."""
    kind = get_args(cls.model_fields["kind"].annotation)[0]
    if kind in registry:
        raise TypeError(f"two materials call themselves {kind!r}")
    missing = [f for f in FUNCTIONS if not isinstance(cls.__dict__.get(f), staticmethod)]
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
