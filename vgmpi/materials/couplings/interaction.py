"""Base of all couplings: tables of a scene that say how two materials or objects interact.

A coupling names its `kind` (a Literal) and the two it is `between`. Its `rule` says how the phases
of the two interact, `refuses` why it cannot couple two materials.
"""

from typing import TypeVar, get_args

from vgmpi.runtime.config.schema import StrictModel

# interaction of two phases; PRESSURE: the pressure of the grid keeps both apart
CONTACT, MIXING, DRAG, PRESSURE = 0, 1, 2, 3
RULES = ("contact", "mixing", "drag", "pressure")

registry: dict[str, type[StrictModel]] = {}
CouplingClass = TypeVar("CouplingClass", bound=StrictModel)


def coupling(cls: type[CouplingClass]) -> type[CouplingClass]:
    """Register a coupling's table under its kind."""
    kind = get_args(cls.model_fields["kind"].annotation)[0]
    if kind in registry:
        raise TypeError(f"two couplings call themselves {kind!r}")
    registry[kind] = cls
    return cls
