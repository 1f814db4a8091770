"""How large a time step each law bears: the Courant factor up to which all are stable.

A box filled by one material, or by two that share it, under a faint weight and with a random
velocity. The step is a factor times dx / (c + |v|), of couplings times the step the solver would
choose. Stable: in all steps kinetic and elastic energy stay below GROWTH times what the random
motion and the weight can give, and nothing blows up. contrast_stability.py has two bodies that
differ.
"""

import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from tests.benchmarks.limit_scenes import DX, WATER, box, coupling, of_law, toml
from vgmpi.materials import registry
from vgmpi.parallel.communicator import SerialCommunicator
from vgmpi.preprocess.scene_builder import build_scene
from vgmpi.scene.loader import load
from vgmpi.scene.scene import DEFAULT_CFL
from vgmpi.scene.sections import Transfer
from vgmpi.solver.diagnostics.conservation import conservation_rows
from vgmpi.solver.initial_particles import known_of, plan_for
from vgmpi.solver.run_outcome import BlowUp
from vgmpi.solver.simulation import Simulation

TRANSFERS, PRECISIONS = get_args(Transfer), ("single", "double")
CELLS = (6, 6, 10)
STEPS = 300
GROWTH = 4.0
JITTER = 0.1  # of the particles about their lattice, in cells
SPEED = 1e-3  # of the random velocity, as a share of the wave speed
# factors looked at one after the other: where motion is restored longer steps than the largest may
# be stable again, which one bisection of the range would take for it
RUNGS = tuple(0.2 * 2.0 ** (k / 4) for k in range(25))
ROUNDS = 2  # halvings between two of them: to 4 %
COUPLED = {
    "drag 1e-3": coupling("drag", "water", "grains", hydraulic_conductivity=1e-3),
    "drag 1e-12": coupling("drag", "water", "grains", hydraulic_conductivity=1e-12),
    "mixing": coupling("mixing", "water", "milk", diffusivity=1e-4),
    "mixing at limit": coupling("mixing", "water", "milk", diffusivity=0.5),
}


@dataclass(frozen=True)
class Case:
    """Filling of the box: a law, or the name of one of COUPLED."""

    name: str
    transfer: str = "apic-corrected"
    precision: str = "double"

    @property
    def cfl(self) -> float:
        """Return the CFL number of the scene: motion is restored as often as by default."""
        is_default = self.name in COUPLED or self.transfer == "apic-corrected"
        return DEFAULT_CFL if is_default else 1.0

    @property
    def text(self) -> str:
        """The scene."""
        size = [n * DX for n in CELLS]
        corners = ([0, 0, 0], size)
        half = {"volume_fraction": 0.5}
        if self.name not in COUPLED:
            materials = {"stuff": of_law(self.name)}
            bodies = box("column", "stuff", *corners)
        elif self.name.startswith("drag"):
            materials = {"water": WATER, "grains": {"kind": "sand"}}
            bodies = box("pores", "water", *corners, volume_fraction=0.4)
            bodies += box("bed", "grains", *corners) + COUPLED[self.name]
        else:
            materials = {"water": WATER, "milk": {**WATER, "density": 1030}}
            bodies = box("one", "water", *corners, **half) + box("two", "milk", *corners, **half)
            bodies += COUPLED[self.name]
        named = "".join(f"[material.{k}]\n{toml(v)}\n" for k, v in materials.items())
        return (
            f"[domain]\nsize = {size}\ncell = {DX}\ngravity = [0, 0, -1]\n"
            f"[time]\nend = 1\ncfl = {self.cfl}\n"
            f'[accuracy]\npressure = "explicit"\ntransfer = "{self.transfer}"\n'
            f'precision = "{self.precision}"\n'
            f"{named}{bodies}"
        )


class Box:
    """The particles of a scene, ready to be run again and again."""

    def __init__(self, text: str):
        scene = load("scene.toml", text=text)
        self.built = build_scene(scene)
        self.plan = plan_for(scene, known_of(scene, self.built))
        self.density = np.array([self.plan.groups[g].density for g in self.plan.group_of])
        self.mass = self.density[self.built.object] * self.built.vol0

    def begin(self, v: np.ndarray) -> Simulation:
        """At the start, jittered, with velocities v (n, 3) [m/s]."""
        bodies = self.built
        simulation = Simulation(self.plan, SerialCommunicator())
        x = bodies.x + self.plan.dx * np.random.default_rng(4).uniform(-JITTER, JITTER, v.shape)
        simulation.put(x, v, bodies.vol0, np.arange(len(v)), bodies.object, surface=bodies.surface0)
        return simulation

    @staticmethod
    def energy(simulation: Simulation) -> float:
        """Kinetic and elastic [J]."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # of a state that has blown up
            return sum(
                row["kinetic_energy"] + row["elastic_energy"]
                for row in conservation_rows(simulation)
            )


class Column(Box):
    """The box of a case."""

    def __init__(self, case: Case):
        self.case = case
        super().__init__(case.text)

    def stable(self, factor: float) -> bool:
        """Return if STEPS steps of `factor` are stable.

        The unit is dx / (c + |v|) for a law, and the bound of the solver for couplings.
        """
        unit = 1.0 if self.case.name in COUPLED else self.case.cfl
        bodies, still = self.built, np.zeros_like(self.built.x)
        simulation = self.begin(still)
        wave = self.plan.time_step.cfl * self.plan.dx * simulation.rate  # c: nothing moves yet
        speed, height = SPEED * wave, CELLS[2] * self.plan.dx
        # a weight whose sudden onset lets the column fall at `speed`
        pull = speed * wave / height
        v = speed * np.random.default_rng(3).uniform(-1, 1, bodies.x.shape)
        simulation = self.begin(v)
        simulation.gravity[:] = (0.0, 0.0, -pull)
        limit = GROWTH * float((self.mass * (0.5 * (v**2).sum(1) + speed**2)).sum())
        try:
            for step in range(STEPS):
                simulation.advance(factor * simulation.bound() / unit)
                if step % 20 == 19 and not self.energy(simulation) <= limit:
                    return False
        except BlowUp:
            return False
        return True


def largest_stable_factor(case: Case) -> float:
    """The largest stable factor; the last of RUNGS where these end first, 0 below them."""
    column = Column(case)
    return largest_stable(column.stable, RUNGS) if column.stable(RUNGS[0]) else 0.0


def largest_stable(stable: Callable[[float], bool], rungs: Sequence[float]) -> float:
    """The largest factor up to which all are stable: the last of the rungs before one that is not,
    and of ROUNDS halvings of what lies between. The first rung is known to be stable."""
    low = rungs[0]
    for high in rungs[1:]:
        if not stable(high):
            break
        low = high
    else:
        return low
    for _ in range(ROUNDS):
        middle = (low * high) ** 0.5
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def cases(names: list[str], transfers: list[str] | None, precisions: list[str]) -> list[Case]:
    """Every combination there is; FLIP is not for couplings."""
    return [
        Case(name, transfer, precision)
        for name in names or [*registry, *COUPLED]
        for transfer in transfers or TRANSFERS
        for precision in precisions
        if not (name in COUPLED and transfer == "flip")
    ]


HEAD = f"{'filling':20s} {'transfer':9s} {'precision':10s} {'largest factor':15s} over default"


def lines(names: list[str], transfers: list[str] | None, precisions: list[str]) -> Iterator[str]:
    """The table as text, row by row as they are found. Arguments as of `cases`."""
    yield HEAD
    for case in cases(names, transfers, precisions):
        yield _line(case, largest_stable_factor(case))


def _line(case: Case, limit: float) -> str:
    default = 1.0 if case.name in COUPLED else DEFAULT_CFL
    more = ">= " if limit >= RUNGS[-1] else ""
    return (
        f"{case.name:20s} {case.transfer:9s} {case.precision:10s} {more + format(limit, '.2f'):15s}"
        f" {limit / default:.1f}"
    )
