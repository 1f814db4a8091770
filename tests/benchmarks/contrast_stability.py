"""The largest stable step over the default one where two bodies or materials meet that differ.

Two bodies of 4 x 4 x 4 cells, one on the other, or two materials that share a box of 4 x 4 x 8
cells, below a free surface; a ratio is the first one's, of contact the lower one's, over the
other's. Stiffness is the modulus of waves, rho c^2. Both begin with random velocities of the same
energy per volume, under a faint weight. Stable: in STEPS steps kinetic and elastic energy stay
below GROWTH times the most that they come to with steps of SURE times the default, and nothing
blows up.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tests.benchmarks.limit_scenes import DX, box, coupling, toml
from tests.benchmarks.stability_limits import GROWTH, STEPS, Box, largest_stable
from vgmpi.materials import registry
from vgmpi.materials.material import law_function
from vgmpi.runtime.config.schema import SceneError
from vgmpi.solver.run_outcome import BlowUp

WIDE, HIGH, AIR = 4, 8, 2  # [cells]: both ways, of both bodies together, and above them
DENSITY, MODULUS = 1000.0, 1e5  # [kg/m3], [Pa] about which both lie
SPEED = 1e-2  # of the random velocity, as a share of the wave speed of the softer one
ENERGY_LIMIT = 100.0  # times what was put in: energy that no stable run comes to
REFERENCE_FACTOR = 0.5  # factor that is taken for the truth
STEP_LADDER = (REFERENCE_FACTOR, 0.5**0.5, *(2.0 ** (k / 4) for k in range(7)))  # factors looked at
RATIOS = tuple(10.0**k for k in range(-4, 5))
PER_CELL = ((64, 1), (64, 8), (27, 8), (8, 8), (8, 27), (8, 64), (1, 64), (8, 8000))
CONDUCTIVITIES = tuple(10.0**-k for k in range(2, 13, 2))
DIFFUSIONS = (0.0, 1e-4, 1e-2, 0.5)
SLIP = 1.0  # [s] in which fluids that mix come to move alike, where it is not at once
MARGIN = 1.3  # that the default step should have
WIDTH = 44  # of the names in the table


@dataclass(frozen=True)
class Pair:
    """Two materials, `kinds` of laws; density, stiffness: ratios; coupled: a table of the scene, by
    which they share space."""

    kinds: tuple[str, str]
    density: float = 1.0
    stiffness: float = 1.0
    per_cell: tuple[int, int] = (8, 8)
    coupled: str = ""
    transfer: str = "apic-corrected"

    @property
    def text(self) -> str:
        """The scene, with the default step."""
        d, s = self.density**0.5, self.stiffness**0.5
        first = made_of(self.kinds[0], DENSITY * d, MODULUS * s)
        second = made_of(self.kinds[1], DENSITY / d, MODULUS / s)
        wide, middle, high = (n * DX for n in (WIDE, HIGH // 2, HIGH))
        spaced = [{"particles_per_cell": n} for n in self.per_cell]
        if self.coupled:
            shares = (0.4, 1.0) if "sand" in self.kinds else (0.5, 0.5)  # of water in the pores
            bodies = "".join(
                box(name, name, [0, 0, 0], [wide, wide, high], volume_fraction=share, **keys)
                for name, share, keys in zip(("one", "two"), shares, spaced, strict=True)
            )
        else:
            bodies = box("one", "one", [0, 0, 0], [wide, wide, middle], **spaced[0])
            bodies += box("two", "two", [0, 0, middle], [wide, wide, high], **spaced[1])
        return (
            f"[domain]\nsize = {[wide, wide, (HIGH + AIR) * DX]}\ncell = {DX}\n"
            "gravity = [0, 0, -1]\n[time]\nend = 1\n"
            f'[accuracy]\nprecision = "double"\ntransfer = "{self.transfer}"\n'
            f"[material.one]\n{toml(first)}\n[material.two]\n{toml(second)}\n{bodies}{self.coupled}"
        )


def made_of(kind: str, density: float, modulus: float) -> dict:
    """The keys of a material of this bulk density [kg/m3] and modulus of waves [Pa]."""
    stiff = "tait_coefficient" if kind == "fluid" else "youngs_modulus"
    keys = {"kind": kind, "density": density, stiff: modulus}
    keys["density"] = density**2 / registry[kind].model_validate(keys).bulk_density
    material = registry[kind].model_validate(keys)
    state_at_rest = tuple(v for values in material.carries.values() for v in values)
    wave2 = law_function(material.law(), "wave_speed2")(material.law(), state_at_rest)
    return {**keys, stiff: modulus**2 / (density * float(wave2))}


class TwoBodyBox(Box):
    """Box with the two bodies or materials of a pair."""

    def __init__(self, pair: Pair):
        super().__init__(pair.text)

    def run(self, factor: float, steps: int, limit: float) -> float:
        """Return the largest energy [J] in some steps of `factor` times the default.

        It is infinite above the limit and after a blow-up.

        Args:
            factor: Step relative to the default.
            steps: Number of steps.
            limit: Energy [J] at which the run stops.
        """
        simulation, max_energy = self.begin(self._velocity), 0.0
        simulation.gravity[:] = (0.0, 0.0, -self._pressure / self._column)
        try:
            for step in range(steps):
                simulation.advance(factor * simulation.bound())
                if step % 20 == 19:
                    energy = self.energy(simulation)
                    if not energy <= limit:
                        return np.inf
                    max_energy = max(max_energy, energy)
        except BlowUp:
            return np.inf
        return max_energy

    def stable(self, factor: float) -> bool:
        """Return if the run is stable with steps of `factor` times the default."""
        return np.isfinite(self.run(factor, STEPS, GROWTH * self.reference_energy))

    @cached_property
    def reference_energy(self) -> float:
        """The most energy [J] with short steps, at least what was put in; infinite where even these
        are not stable."""
        initial_energy = float((0.5 * self.mass * (self._velocity**2).sum(1)).sum())
        volume = np.bincount(self.built.object, self.built.vol0)
        initial_energy += float((self._pressure**2 * volume / self._stiff).sum())
        return max(
            initial_energy,
            self.run(
                REFERENCE_FACTOR, round(STEPS / REFERENCE_FACTOR), ENERGY_LIMIT * initial_energy
            ),
        )

    @property
    def _stiff(self) -> np.ndarray:
        """Modulus of waves [Pa] of each body."""
        plan = self.plan
        return np.array([plan.contact.stiffness[plan.groups[g].phase] for g in plan.group_of])

    @property
    def _velocity(self) -> np.ndarray:
        """At the start (n, 3) [m/s]."""
        speed = SPEED * np.sqrt(self._stiff.min() / self.density)[self.built.object]
        return speed[:, None] * np.random.default_rng(3).uniform(-1, 1, self.built.x.shape)

    @property
    def _pressure(self) -> float:
        """[Pa] of the weight at the floor."""
        return float(SPEED * self._stiff.min())

    @property
    def _column(self) -> float:
        """Mass over a square metre of the floor [kg/m2]."""
        return float(self.mass.sum()) / (WIDE * self.plan.dx) ** 2


def max_stable_step(pair: Pair) -> float:
    """The largest stable step over the default one; the last of RUNGS where these end first, 0
    where SURE times the default is not stable. Raises SceneError where the scene refuses it."""
    bodies = TwoBodyBox(pair)
    return (
        largest_stable(bodies.stable, STEP_LADDER) if np.isfinite(bodies.reference_energy) else 0.0
    )


@dataclass(frozen=True)
class Table:
    """Rows of pairs, one for each column."""

    name: str
    columns: tuple[str, ...]
    rows: dict[str, tuple[Pair, ...]]


def tables(transfer: str = "apic-corrected") -> list[Table]:
    """All that is measured."""
    ratios = _ratios(transfer)
    plain = tuple(format(r, ".0e").replace("e-0", "e-").replace("e+0", "e") for r in ratios)
    return [
        Table("contact, by ratio", plain, _contacts(transfer)),
        Table("contact, by particles per cell", tuple(f"{a}:{b}" for a, b in PER_CELL), {
            f"{a} on {b}": tuple(Pair((b, a), per_cell=n, transfer=transfer) for n in PER_CELL)
            for b, a in LEANING
        }),
        Table("drag, by hydraulic conductivity [m/s]",
              tuple(format(k, ".0e") for k in CONDUCTIVITIES), {
            f"water / sand density {d:g}": tuple(
                Pair(WET, density=d, coupled=_drag(k), transfer=transfer) for k in CONDUCTIVITIES
            )
            for d in (1e-4, 1e-2, 1.0, 1e2, 1e4)
        }),
        Table("drag, by ratio of stiffness", plain, {
            f"hydraulic conductivity {k:g} m/s": tuple(
                Pair(WET, stiffness=r, coupled=_drag(k), transfer=transfer) for r in ratios
            )
            for k in (1e-2, 1e-4, 1e-8, 1e-12)
        }),
        Table("mixing, by ratio", plain[len(ratios) // 2 :], _mixtures(transfer)),
    ]  # fmt: skip


LEANING = (("elastic", "fluid"), ("elastic", "elastic"), ("elastic", "sand"))  # lower, upper
WET, MIXED = ("fluid", "sand"), ("fluid", "fluid")
# of density and stiffness, the powers of a ratio
CONTRAST_EXPONENTS = {
    "density": (1, 0),
    "stiffness": (0, 1),
    "density and stiffness": (1, 1),
    "density, 1 / stiffness": (1, -1),
}


def _ratios(transfer: str) -> tuple[float, ...]:
    """All with the transfer that is the default, with others every second one."""
    return RATIOS if transfer == "apic-corrected" else RATIOS[::2]


def _contacts(transfer: str) -> dict[str, tuple[Pair, ...]]:
    return {
        f"{over} on {under}: {contrast}": tuple(
            Pair((under, over), r**d, r**s, transfer=transfer) for r in _ratios(transfer)
        )
        for under, over in LEANING
        for contrast, (d, s) in CONTRAST_EXPONENTS.items()
    }


def _mixtures(transfer: str) -> dict[str, tuple[Pair, ...]]:
    rows = {}
    for slip in (0.0, SLIP):
        for D in DIFFUSIONS:
            coupled = _mixing(D, slip)
            for contrast, (d, s) in CONTRAST_EXPONENTS.items():
                if contrast == "density" or D == 0.0:
                    name = f"slip {slip:g} s, D {D:g} m2/s: {contrast}"
                    rows[name] = tuple(
                        Pair(MIXED, r**d, r**s, coupled=coupled, transfer=transfer)
                        for r in _ratios(transfer)
                        if r >= 1.0  # the other way round it is the same
                    )
    return rows


def _drag(conductivity: float) -> str:
    return coupling("drag", "one", "two", hydraulic_conductivity=conductivity)


def _mixing(diffusivity: float, slip: float) -> str:
    return coupling("mixing", "one", "two", diffusivity=diffusivity, slip_relaxation_time=slip)


def lines(words: list[str], transfers: list[str]) -> Iterator[str]:
    """All tables as text, row by row as they are found. words: of the rows, all by default."""
    for transfer in transfers:
        for table in tables(transfer):
            rows = {
                name: pairs
                for name, pairs in table.rows.items()
                if not words or any(word in f"{table.name} {name}" for word in words)
            }
            if not rows:
                continue
            yield f"{table.name}, {transfer}".ljust(WIDTH) + "".join(map(_cell, table.columns))
            for name, pairs in rows.items():
                yield name.ljust(WIDTH) + "".join(_cell(_found(pair)) for pair in pairs)
            yield ""


def _cell(text: str) -> str:
    return text.rjust(9)


def _found(pair: Pair) -> str:
    try:
        factor = max_stable_step(pair)
    except SceneError:
        return "refused"
    if not REFERENCE_FACTOR <= factor < STEP_LADDER[-1]:
        return f">= {STEP_LADDER[-1]:.1f}" if factor else f"< {REFERENCE_FACTOR:g}"
    return format(factor, ".2f") + (" !" if factor < MARGIN else "")
