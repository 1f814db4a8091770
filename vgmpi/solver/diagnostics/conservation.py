"""Conservation monitor: mass, momentum and energy of each phase, for any number of ranks."""

import math

import numpy as np

from vgmpi.kernels.diagnostics import COLUMNS, body_momentum_rows, segment_conservation_rows
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.solver.simulation import Simulation

from .liquid_fill import LiquidFill, liquid_fill


def conservation_rows(simulation: Simulation) -> list[dict]:
    """Return one entry per phase, on rank 0; an empty list on the others. Collective.

    Sums per segment travel to rank 0 in the order of the segments' keys and are added in that
    order.
    """
    plan, sums = simulation.plan, list[np.ndarray | None]()
    for group in simulation.groups:
        rows = np.empty((len(group.start), COLUMNS))
        segment_conservation_rows(
            group.plan.law, group.start, group.count, group.block, group.xi, group.f, group.bits,
            group.plan.density, plan.dx, plan.gravity.vector_at(simulation.time), rows,
        )  # fmt: skip
        if any(len(sums) in feature.uncounted_groups for feature in plan.features):
            rows[:, 1:8] = rows[:, 9] = 0.0  # part of the columns of rigid bodies
        sums.append(simulation.ranks.gather_rows(rows))
    own = [feature.phase_entries() for feature in simulation.features.values()]
    fill = liquid_fill(simulation)
    if simulation.ranks.rank != 0:
        return []
    entries = [_entry(simulation, k, sums) for k in range(len(plan.phases))]
    if fill:
        unknown = LiquidFill(*(4 * (math.nan,)))
        for k, entry in enumerate(entries):
            entry |= fill.get(k, unknown)._asdict()
    for columns in own:
        for entry, values in zip(entries, columns):
            entry |= values
    for feature in simulation.features.values():
        more = feature.conserved(simulation.time)
        for k, entry in enumerate(entries):
            entry |= {name: value if k == 0 else 0.0 for name, value in more.items()}
    return entries


def _entry(simulation: Simulation, phase: int, sums: list) -> dict:
    """Return the entry of one phase from the segments' sums of all groups."""
    plan = simulation.plan
    members = [g for g, group in enumerate(plan.groups) if group.phase == phase]
    rows = np.concatenate([sums[g] for g in members])
    total = rows[:, :10].sum(0) if len(rows) else np.zeros(10)
    count = sum(plan.count[k] for k in plan.phases[phase].objects)
    entry = {
        "time": simulation.time,
        "step": simulation.step,
        "phase": plan.phases[phase].name,
        "particles": count,
        "mass": total[0],
        "kinetic_energy": total[7],
        "elastic_energy": total[8],
        "potential_energy": total[9],
        "J_min": rows[:, 10].min(initial=np.inf),
        "J_max": rows[:, 11].max(initial=-np.inf),
    }
    for a, axis in enumerate("xyz"):
        entry[f"momentum_{axis}"] = total[1 + a]
        entry[f"angular_momentum_{axis}"] = total[4 + a]
    return entry


def body_momentum(
    simulation: Simulation, group: ParticleGroup, first: int, last: int
) -> np.ndarray:
    """Return sums over the local particles with ids `first` to `last` (inclusive), shape (n, 7).

    The columns are mass [kg], momentum [kg m/s] and mass times position [kg m]; there is a row for
    every segment that holds some of the particles.

    Args:
        simulation: The simulation.
        group: Particle group.
        first: Lowest id.
        last: Highest id.
    """
    rows = np.empty((len(group.start), 7))
    body_momentum_rows(
        group.start, group.count, group.block, group.xi, group.f, group.ids, group.bits,
        group.plan.density, simulation.plan.dx, first, last, rows,
    )  # fmt: skip
    return rows[rows[:, 0] > 0]


def format_drift(first: list[dict], last: list[dict]) -> str:
    """Return one line with the change of mass and energy of all phases between two ledgers."""
    mass = [sum(e["mass"] for e in entries) for entries in (first, last)]
    flow = [
        sum(e.get("mass_in", 0.0) - e.get("mass_out", 0.0) for e in entries)
        for entries in (first, last)
    ]
    change = mass[1] - mass[0] - (flow[1] - flow[0])
    label = "change" if not any(flow) else "less what came and went: change"
    energy = [
        sum(e[f"{kind}_energy"] for e in entries for kind in ("kinetic", "elastic", "potential"))
        for entries in (first, last)
    ]
    for k, entries in enumerate((first, last)):
        energy[k] += sum(
            e.get(f"rigid_{kind}_energy", 0.0) for e in entries for kind in ("kinetic", "potential")
        )
    low, high = min(e["J_min"] for e in last), max(e["J_max"] for e in last)
    energies = f"energy {energy[0]:.4g} -> {energy[1]:.4g} J"
    if not any(mass) and any("rigid_kinetic_energy" in e for e in last):
        return f"{energies} of rigid bodies"
    return f"mass {mass[1]:.6g} kg ({label} {change:+.1e}), {energies}" + (
        f", J {low:.3f} .. {high:.3f}" if low <= high else "; no particle is left"
    )
