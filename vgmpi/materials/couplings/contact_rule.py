"""Contact: phases that touch do not pass through each other; friction may act between them.

Every pair of phases is in contact unless another coupling says otherwise. A fluid slips along
everything; between two others (sand, snow, solids) the larger of their materials' friction
coefficients acts.
"""

from typing import Annotated, ClassVar, Literal

from vgmpi.materials.material import Material
from vgmpi.runtime.config.schema import Quantity, StrictModel

from .interaction import CONTACT, coupling


@coupling
class Contact(StrictModel):
    """Friction of a pair of materials in contact."""

    between: tuple[str, str]
    """two materials, or the same material twice"""
    kind: Literal["contact"]
    friction: Annotated[float, Quantity("", ge=0)]
    """Coulomb coefficient"""

    rule: ClassVar = CONTACT

    @staticmethod
    def refuses(a: Material, b: Material) -> str:
        """Return why materials a and b cannot be coupled, or an empty string."""
        return ""

    @staticmethod
    def default_friction(a: Material, b: Material) -> float:
        """Return the friction of two material tables that no coupling names."""
        if "fluid" in (a.family, b.family):
            return 0.0
        # a key of some laws, a constant of others
        return max(a.friction, b.friction)  # type: ignore[attr-defined]
