"""The summary of the validation: one line for each physical effect, chosen by hand.

Numbers are filled in from docs/benchmarks/data/validation.csv.
"""

from typing import NamedTuple


class Effect(NamedTuple):
    """A line of the summary.

    Each result is a pattern of case names (`fnmatch`) and a text in which `{error}` stands for the
    range of relative errors, `{value}` for that of the values and `{percent}` for that of 100
    times the values.
    """

    name: str
    topic: str
    test: str
    results: tuple[tuple[str, str], ...]
    reference: str


SUMMARY = (
    Effect(
        "Hydrostatic pressure", "Liquids", "water at rest",
        (("water at rest*: pressure", "error {percent} of rho g H"),),
        "p = rho g (H - z)",
    ),
    Effect(
        "Free-surface flow", "Liquids", "dam break, position of the front",
        (("dam break: front, against MPS", "{percent} of a column width (rms)"),),
        "Koshizuka and Oka 1996 (MPS simulation)",
    ),
    Effect(
        "Pressure of impacts", "Liquids beside published data",
        "dam break, gauges on the far wall, implicit pressure, 60 cells",
        (("dam break, gauge*: off the computed curve, 60*implicit pressure",
          "{value} rho g H (rms)"),),
        "De Courcy et al. 2024 (incompressible SPH)",
    ),
    Effect(
        "Drag", "Liquids beside published data",
        "flow past a cylinder, Re 20, 10 to 20 cells per diameter",
        (("flow past a cylinder, Re 20: drag coefficient*", "off by {error}"),
         ("flow past a cylinder, Re 20: length of the eddies*", "length of the eddies {error}")),
        "Schaefer and Turek 1996",
    ),
    Effect(
        "Gravity waves", "Liquids", "standing wave in a tank",
        (
            ("sloshing: period, ?0 cells", "period off by {error}"),
            ("sloshing: period, k = *", "with a bulk modulus too large for the depth {error}"),
        ),
        "Lamb, Hydrodynamics, art. 228",
    ),
    Effect(
        "Viscosity", "Liquids", "decay of Taylor-Green vortices",
        (("Taylor-Green vortices, UL*", "rate off by {error}"),),
        "Taylor and Green 1937",
    ),
    Effect(
        "Viscosity", "Liquids", "plane Poiseuille flow",
        (("plane Poiseuille flow*", "speed off by {error}"),),
        "Bird et al. 2002, sections 2.3 and 4.1",
    ),
    Effect(
        "Yield stress", "Liquids", "Bingham flow between plates",
        (("Bingham plug, speed", "plug speed off by {error}"),),
        "Bird et al. 2002, section 8.3",
    ),
    Effect(
        "Elasticity", "Elastic solids", "vibrating bar",
        (
            ("axial bar: frequency at 64 cells", "frequency off by {error}"),
            ("axial bar: order", "order of convergence {value}"),
        ),
        "f = c / (4 L), c = sqrt(E / rho)",
    ),
    Effect(
        "Large bending", "Elastic solids", "cantilever under an end load",
        (
            ("cantilever, *, 64 particles per cell", "64 particles per cell: {error}"),
            ("cantilever, alpha = 2, 8 particles*", "8 particles per cell: {error}"),
        ),
        "Bisshopp and Drucker 1945",
    ),
    Effect(
        "Torsion", "Elastic solids", "twisted bar",
        (("torsion of a bar: frequency", "frequency off by {error}"),),
        "Saint-Venant",
    ),
    Effect(
        "Granular flow", "Granular materials", "collapse of a plane column, aspect 0.5 to 5",
        (
            ("column of quartz sand, plane, *cells: run-out", "run-out, sand: {error}"),
            ("column of glass beads*: run-out", "glass beads: {error}"),
        ),
        "Lube et al. 2005; Lajeunesse et al. 2005",
    ),
    Effect(
        "Granular flow", "Granular materials", "collapse of a round column",
        (("column of quartz sand, round*", "run-out off by {error}"),),
        "Lube et al. 2004",
    ),
    Effect(
        "Seepage", "Seepage and drag", "settling at three permeabilities",
        (("settling at k*", "velocities off by {error}"),),
        "Darcy's law",
    ),
    Effect(
        "Consolidation", "Seepage and drag", "pore pressure at the base of a loaded layer",
        (("consolidation: rms*", "rms error {percent} of the load"),),
        "Terzaghi 1925",
    ),
    Effect(
        "Infiltration", "Seepage and drag", "ponded water sinks into sand",
        (("ponded infiltration*", "depth off by {percent} at most (tolerance 10 %)"),),
        "Green and Ampt 1911",
    ),
    Effect(
        "Diffusion", "Mixing", "two layers, 40 and 80 cells",
        (("diffusion, ?0 cells", "concentration off by {value}"),),
        "Crank 1975, erfc(x / sqrt(4 D t)) / 2",
    ),
    Effect(
        "Instability of a mixture", "Mixing", "Rayleigh-Taylor, 20 and 40 cells",
        (("Rayleigh-Taylor: rate*", "growth rate off by {error}"),),
        "Chandrasekhar 1961",
    ),
    Effect(
        "Buoyancy", "Bodies in a liquid", "floating slab and plate, density 600 kg/m3",
        (("Archimedes, s* of *[0-9] cells", "submerged fraction {value}"),),
        "Archimedes: 0.6",
    ),
    Effect(
        "Added mass", "Bodies in a liquid", "sphere released in water",
        (
            ("sphere released, density 3*", "heavy sphere: acceleration off by {error}"),
            ("sphere released, density 0.1*", "light sphere: {error}"),
        ),
        "Lamb, Hydrodynamics, art. 93",
    ),
    Effect(
        "Impact", "Contact", "bouncing elastic ball",
        (
            ("ball of *: restitution", "restitution {value}"),
            ("ball of *: contact time", "contact time off by {error}"),
        ),
        "Johnson, Contact Mechanics, section 11.4",
    ),
    Effect(
        "Non-penetration", "Contact", "14 pairs of materials, 0.2 s and 2 s",
        (("penetration, *", "overlap {value} cells"),),
        "0; tolerance 0.35 cells",
    ),
    Effect(
        "Coulomb friction", "Friction", "block on an incline",
        (
            ("block on an incline, *, friction*", "along the grid: {error}"),
            ("block on a * tilted by*", "tilted against the grid: {error}"),
        ),
        "a = g (sin a - mu cos a)",
    ),
    Effect(
        "Rolling and sliding", "Friction", "cylinder on an incline",
        (
            ("cylinder *: acceleration", "acceleration off by {error}"),
            ("cylinder *: spin", "spin off by {error}"),
        ),
        "Newton and Euler",
    ),
    Effect(
        "Momentum", "Conservation", "three bodies that collide",
        (("closed system of three phases: momentum", "{value} of sum m \\|v\\|"),),
        "exact conservation",
    ),
    Effect(
        "Angular momentum", "Conservation", "spinning body, default transfer and APIC",
        (
            ("spinning body, APIC*: angular momentum", "change {value}"),
        ),
        "Jiang et al. 2015, proposition 2",
    ),
)  # fmt: skip
