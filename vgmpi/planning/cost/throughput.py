"""Throughput of a processor, by which --plan turns particles and steps into seconds."""

from typing import Any, NamedTuple

from vgmpi.materials.neo_hookean import Elastic
from vgmpi.materials.newtonian_fluid import Fluid


class Throughput(NamedTuple):
    """Time of a step [ns per particle] on one core, with APIC, in cubes of full blocks."""

    fluid: float
    elastic: float
    origin: str  # name of the processor, for display

    def law(self, material: Any) -> float:
        """Return the time of a material's law [ns per particle and step].

        Laws that carry more than a fluid are scaled from an elastic law by their relative cost.
        """
        if isinstance(material, Fluid):
            return self.fluid
        return self.elastic * material.cost / Elastic.cost


_PAGE = "of a processor as in docs/benchmarks/performance.md"
# Used without a measurement: one core of an AVX-512 machine, in scenes whose blocks are not full.
ASSUMED_THROUGHPUT = {
    "single": Throughput(45.0, 63.0, _PAGE),
    "double": Throughput(90.0, 126.0, _PAGE),
}
