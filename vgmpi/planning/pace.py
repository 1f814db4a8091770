"""How fast a processor is: what --plan turns particles and steps into seconds with."""

from typing import Any, NamedTuple

from ..materials.elastic import Elastic
from ..materials.fluid import Fluid


class Pace(NamedTuple):
    """Time of a step [ns per particle] on one core, APIC, in cubes of full blocks."""

    fluid: float
    elastic: float
    of: str  # the processor, for people

    def law(self, material: Any) -> float:
        """Of a material's law [ns per particle and step]: laws that carry more than a fluid go by
        their cost beside an elastic one's."""
        if isinstance(material, Fluid):
            return self.fluid
        return self.elastic * material.cost / Elastic.cost


_PAGE = "of a processor as in docs/performance.md"
# where nothing was measured: one core of an AVX-512 machine, in scenes that are not full blocks
ASSUMED = {
    "single": Pace(45.0, 63.0, _PAGE),
    "double": Pace(90.0, 126.0, _PAGE),
}
