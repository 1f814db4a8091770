"""Volume fractions of phases that share space, as the particles see them.

Volumes are summed at the nodes as integers, so that they do not depend on the number of ranks. The
fractions at a node are those of docs/explanation/mixtures.md: with the volumes V_k of the fluids,
V_f of all of them, V_s of the grains and V_cell of the node's cell,

    1 - share = V_s / max(V_s + V_f, V_cell) of the grains,  share V_k / V_f of a fluid.
"""

from collections.abc import Iterator

import numpy as np

from vgmpi.features.mixtures.kernels import MIN_POROSITY
from vgmpi.features.mixtures.plan import MixturesPlan
from vgmpi.features.mixtures.rules import InteractionRules
from vgmpi.kernels.diagnostics import CELL_UNITS
from vgmpi.materials.material import law_function
from vgmpi.parallel.particle_group import ParticleGroup
from vgmpi.solver.simulation import Simulation

from .liquid_fill import add_remote_sums, cell_capacity


def volume_fractions(simulation: Simulation) -> list[np.ndarray]:
    """Return the volume fraction of its phase at each particle, shape (n_local,) by group.

    A phase that shares no space has the fraction 1. Collective.

    Args:
        simulation: The simulation, of a plan with rules of phases that share space.
    """
    plan, rules = simulation.plan, _rules_of(simulation)
    sums = np.zeros((len(simulation.exchange.tables.phase), 64), np.int64)
    for g, group in enumerate(simulation.groups):
        if rules.mixture_set[group.plan.phase] >= 0:
            units = _current_volumes(group, bool(rules.fluid[group.plan.phase])) / plan.dx**3
            for weight, place, inside in _stencil_nodes(simulation, g):
                part = np.rint(np.nan_to_num(weight * units) * CELL_UNITS).astype(np.int64)
                np.add.at(sums.reshape(-1), place[inside], part[inside])
    add_remote_sums(simulation, sums, to_all=True)
    fraction = _node_fractions(simulation, sums).reshape(-1)
    fractions = []
    for g, group in enumerate(simulation.groups):
        if rules.mixture_set[group.plan.phase] < 0:
            fractions.append(np.ones(len(group)))
            continue
        value = np.zeros(len(group))
        for weight, place, inside in _stencil_nodes(simulation, g):
            value += np.where(inside, weight * fraction[place], 0.0)
        fractions.append(value)
    return fractions


def _rules_of(simulation: Simulation) -> InteractionRules:
    """Return the rules of the phases that share space."""
    own = simulation.plan.feature(MixturesPlan)
    assert own is not None
    return own.rules


def _current_volumes(group: ParticleGroup, is_fluid: bool) -> np.ndarray:
    """Return the volume of the matter of each particle, without pores, shape (n,) [m3]."""
    indices = group.index()
    volume = group.get("vol0", indices)[:, 0].astype(np.float64)
    if not is_fluid:
        return volume * group.plan.share
    law = group.plan.law
    return volume * law_function(law, "volume_ratio")(law, group.law_state(indices))


def _stencil_nodes(
    simulation: Simulation, g: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the 27 nodes of all particles of a group, one of each particle at a time.

    What lies beyond a wall of the domain is reflected into it.

    Args:
        simulation: The simulation.
        g: Number of the group.

    Yields:
        Weights of the quadratic B-spline, places in the flat array of nodes (node blocks, 64), and
        whether the node is one of the segment's (all are, in a state that can be trusted); each of
        shape (n,).
    """
    group, tables = simulation.groups[g], simulation.exchange.tables
    segment = np.repeat(np.arange(len(group.start)), group.count)
    table = tables.table[tables.group == g][segment]
    x = group.positions() / simulation.plan.dx
    base = np.floor(np.nan_to_num(x) - 0.5).astype(np.int64)
    r = x - base
    weights = 0.5 * (1.5 - r) ** 2, 0.75 - (r - 1.0) ** 2, 0.5 * (r - 0.5) ** 2
    cells, first = np.array(simulation.plan.cells), 4 * group.block[segment] - 5
    axes = []
    for k in range(3):
        node = np.abs(base + k)
        axes.append(np.minimum(node, 2 * cells - node) - first)  # 0: of the block before
    rows = np.arange(len(x))
    for i, j, k in np.ndindex(3, 3, 3):
        u, v, w = axes[i][:, 0], axes[j][:, 1], axes[k][:, 2]
        inside = (np.minimum(np.minimum(u, v), w) >= 0) & (np.maximum(np.maximum(u, v), w) < 12)
        u, v, w = (np.clip(node, 0, 11) for node in (u, v, w))
        block = table[rows, (u // 4 * 3 + v // 4) * 3 + w // 4]
        place = 64 * block + (u % 4 * 4 + v % 4) * 4 + w % 4
        yield weights[i][:, 0] * weights[j][:, 1] * weights[k][:, 2], place, inside & (block >= 0)


def _node_fractions(simulation: Simulation, sums: np.ndarray) -> np.ndarray:
    """Return the fraction of each phase at its nodes.

    Args:
        simulation: The simulation.
        sums: Volumes of all ranks in units of 1 / CELL_UNITS of a cell, shape (node blocks, 64).
    """
    tables, rules = simulation.exchange.tables, _rules_of(simulation)
    block = np.repeat(np.arange(len(tables.coordinates)), np.diff(tables.first))
    capacity = cell_capacity(simulation.plan, tables.coordinates)
    result = np.zeros(sums.shape)
    for number in range(rules.sets):
        mixed = rules.mixture_set[tables.phase] == number
        wet = np.asarray(rules.fluid, bool)[tables.phase]
        fluid, grains = np.zeros((2, len(tables.coordinates), 64), np.int64)
        np.add.at(fluid, block[mixed & wet], sums[mixed & wet])
        np.add.at(grains, block[mixed & ~wet], sums[mixed & ~wet])
        dense = grains / np.maximum(np.maximum(fluid + grains, capacity), 1)
        share = np.where((fluid > 0) & (grains > 0), np.maximum(1.0 - dense, MIN_POROSITY), 1.0)
        for rows, total, part in ((mixed & wet, fluid, share), (mixed & ~wet, grains, dense)):
            of_row = block[rows]
            result[rows] = sums[rows] / np.maximum(total[of_row], 1) * part[of_row]
    return result
