"""The conservation ledger: what each phase holds of mass, momentum and energy, the same on any
number of ranks.
"""

import numpy as np

from ..domain.state import Group
from ..kernels.measure import COLUMNS, ledger_rows, object_rows
from .step import Simulation
from .tally import Tally, united


def ledger(simulation: Simulation) -> list[dict]:
    """One entry per phase, on rank 0; empty on the others. Collective.

    Sums per segment travel to rank 0 in the order of the segments' keys and are added there in that
    order.
    """
    plan, found = simulation.plan, []
    for group in simulation.groups:
        rows = np.empty((len(group.start), COLUMNS))
        ledger_rows(
            group.plan.law, group.start, group.count, group.block, group.xi, group.f, group.bits,
            group.plan.density, plan.dx, plan.gravity_at(simulation.time), rows,
        )  # fmt: skip
        found.append(simulation.ranks.root_rows(rows))
    tally, flow = simulation.tally, []
    if tally is not None:
        gone = tally.totals(simulation.ranks)
        there = tally.there(simulation.groups, simulation.ranks)
        flow = [[*row, *now] for row, now in zip(gone, there, strict=True)]
    counts: list[list[int]] = []
    if plan.driven:  # what is let go changes its phase
        counts = united([[len(group)] for group in simulation.groups], simulation.ranks)
    if simulation.ranks.rank != 0:
        return []
    entries = [_entry(simulation, k, found) for k in range(len(plan.phases))]
    for k, entry in enumerate(entries if counts else ()):
        members = [g for g, group in enumerate(plan.groups) if group.phase == k]
        entry["count"] = sum(counts[g][0] for g in members)
    if tally is not None:
        for k, entry in enumerate(entries):
            entry |= _flow(tally, k, flow)
    return entries


def _flow(tally: Tally, phase: int, totals: list[list[int]]) -> dict:
    """What of a phase was there at the start or came since, what went, and what is there now,
    counted the same way. totals: particles and volume of each of them, by group."""
    members = [g for g, group in enumerate(tally.plan.groups) if group.phase == phase]
    came, went, count = (sum(totals[g][c] for g in members) for c in (0, 2, 4))
    brought, taken, mass = (sum(tally.mass(g, totals[g][c]) for g in members) for c in (1, 3, 5))
    return {
        "count": count,
        "mass": mass,
        "count_in": came,
        "mass_in": brought,
        "count_out": went,
        "mass_out": taken,
    }


def _entry(simulation: Simulation, phase: int, found: list) -> dict:
    plan = simulation.plan
    members = [g for g, group in enumerate(plan.groups) if group.phase == phase]
    rows = np.concatenate([found[g] for g in members])
    total = rows[:, :10].sum(0) if len(rows) else np.zeros(10)
    count = sum(plan.count[k] for k in plan.phases[phase].objects)
    entry = {
        "time": simulation.time,
        "step": simulation.step,
        "phase": plan.phases[phase].name,
        "count": count,
        "mass": total[0],
        "kinetic": total[7],
        "elastic": total[8],
        "potential": total[9],
        "J_min": rows[:, 10].min(initial=np.inf),
        "J_max": rows[:, 11].max(initial=-np.inf),
    }
    for a, axis in enumerate("xyz"):
        entry[f"momentum_{axis}"] = total[1 + a]
        entry[f"angular_{axis}"] = total[4 + a]
    return entry


def about(simulation: Simulation, group: Group, first: int, last: int) -> np.ndarray:
    """Mass, momentum and mass times position of the particles first .. last that are here, a row
    per segment that holds some: (n, 7).
    """
    rows = np.empty((len(group.start), 7))
    object_rows(
        group.start, group.count, group.block, group.xi, group.f, group.ids, group.bits,
        group.plan.density, simulation.plan.dx, first, last, rows,
    )  # fmt: skip
    return rows[rows[:, 0] > 0]


def drift(first: list[dict], last: list[dict]) -> str:
    """What changed between two ledgers, in one line: mass and energy of all phases together."""
    mass = [sum(e["mass"] for e in entries) for entries in (first, last)]
    flow = [
        sum(e.get("mass_in", 0.0) - e.get("mass_out", 0.0) for e in entries)
        for entries in (first, last)
    ]
    change = mass[1] - mass[0] - (flow[1] - flow[0])
    said = "change" if not any(flow) else "less what came and went: change"
    energy = [
        sum(e["kinetic"] + e["elastic"] + e["potential"] for e in entries)
        for entries in (first, last)
    ]
    low, high = min(e["J_min"] for e in last), max(e["J_max"] for e in last)
    return (
        f"mass {mass[1]:.6g} kg ({said} {change:+.1e}), "
        f"energy {energy[0]:.4g} -> {energy[1]:.4g} J"
        + (f", J {low:.3f} .. {high:.3f}" if low <= high else "; no particle is left")
    )
