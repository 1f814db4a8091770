"""Phases that share space in a block of nodes, their rules, and scratch for a row of four nodes."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.simd.vector16 import pointer
from vgmpi.runtime.aligned_arrays import aligned_zeros
from vgmpi.runtime.jit import device_function

from .rules import InteractionRules

ROW = 16  # numbers in a row of four nodes


class MixtureWorkspace(NamedTuple):
    """Scratch of one thread for up to n phases of one mixture set.

    It holds the members of the set and rows of four nodes.
    """

    block: np.ndarray  # (n,) node block of each member
    wet: np.ndarray  # (n,) 1 if it is a fluid
    group: np.ndarray  # (n,) its mixing group, or -1
    grains: np.ndarray  # (n,) [m3/kg] specific volume of a sand's grains
    porosity: np.ndarray  # (n,) porosity of a sand
    drag: np.ndarray  # (n n,) [kg/(m3 s)] drag coefficients
    printed: np.ndarray  # (n n,) 1 if the drag is as published
    M: np.ndarray  # (16 n,) [kg] masses, a row of four nodes per member
    V: np.ndarray  # (16 n + 16,) [m3] volumes, then the space of each node
    U: np.ndarray  # (16 n,) drift [m/s]
    K: np.ndarray  # (16 n n,) exchange [kg]
    S: np.ndarray  # (16 n,) [kg] masses in the elimination
    R: np.ndarray  # (16 n,) [kg m/s] momenta in the elimination, then velocities


def mixture_workspace(n: int, real: np.dtype) -> MixtureWorkspace:
    """Allocate scratch for n phases."""
    M, U, S, R = (aligned_zeros((ROW * n,), real) for _ in range(4))
    V, K = aligned_zeros((ROW * n + ROW,), real), aligned_zeros((ROW * n * n,), real)
    block, wet, group = (np.zeros(n, np.int64) for _ in range(3))
    grains, pores, drag, printed = (np.zeros(k) for k in (n, n, n * n, n * n))
    return MixtureWorkspace(block, wet, group, grains, pores, drag, printed, M, V, U, K, S, R)


class MixtureTables(NamedTuple):
    """Interaction rules as numbers; tables of pairs are flat, one row after the other."""

    phases: int
    sets: int
    mixing_group_count: int
    has_drag: int
    drifts: int  # 1 if drifts are kept out of the particles' momentum
    mixture_set: np.ndarray
    fluid: np.ndarray
    mix: np.ndarray
    diffusion: np.ndarray
    slip_relaxation_time: np.ndarray
    printed_mix: np.ndarray
    volume: np.ndarray
    porosity: np.ndarray
    drag: np.ndarray
    printed_drag: np.ndarray


def mixture_tables(rules: InteractionRules) -> MixtureTables:
    """Convert the interaction rules to tables for the kernels."""
    return MixtureTables(
        len(rules.fluid), rules.sets, rules.mixing_group_count, int(rules.has_drag),
        int(rules.conservative_drift.any()),
        *(np.array(table, np.int64) for table in (rules.mixture_set, rules.fluid, rules.mix)),
        *(
            np.array(table, float).ravel()
            for table in (
                rules.diffusion, rules.slip_relaxation_time, rules.printed_mix, rules.volume,
                rules.porosity, rules.drag, rules.printed_drag,
            )
        ),
    )  # fmt: skip


@device_function
def to_pointers(workspace, tables):
    """Return workspace and tables with pointers in place of arrays (vector16.pointer)."""
    r, t = workspace, tables
    return MixtureWorkspace(
        pointer(r.block), pointer(r.wet), pointer(r.group), pointer(r.grains), pointer(r.porosity),
        pointer(r.drag), pointer(r.printed), pointer(r.M), pointer(r.V), pointer(r.U), pointer(r.K),
        pointer(r.S), pointer(r.R),
    ), MixtureTables(
        t.phases, t.sets, t.mixing_group_count, t.has_drag, t.drifts,
        pointer(t.mixture_set), pointer(t.fluid), pointer(t.mix),
        pointer(t.diffusion), pointer(t.slip_relaxation_time), pointer(t.printed_mix),
        pointer(t.volume), pointer(t.porosity), pointer(t.drag), pointer(t.printed_drag),
    )  # fmt: skip


@device_function
def collect_members(set_index, n0, n1, phase, rules, work):
    """Collect the node blocks n0 .. n1 that belong to a mixture set; return their number.

    Args:
        set_index: Number of the mixture set.
        n0: First node block.
        n1: Node block behind the last one.
        phase: Phase of each node block.
        rules: Interaction rules as tables.
        work: Members and their constants (out).
    """
    count = 0
    for nb in range(n0, n1):
        p = phase[nb]
        if rules.mixture_set[p] == set_index:
            work.block[count], work.wet[count], work.group[count] = nb, rules.fluid[p], rules.mix[p]
            work.grains[count], work.porosity[count] = rules.volume[p], rules.porosity[p]
            count += 1
    for a in range(count if count > 1 else 0):
        for b in range(count):
            pair = phase[work.block[a]] * rules.phases + phase[work.block[b]]
            work.drag[a * count + b] = rules.drag[pair]
            work.printed[a * count + b] = rules.printed_drag[pair]
    return count
