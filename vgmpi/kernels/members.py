"""Who shares space in a block of nodes, by what rules, and the scratch of a row of four nodes."""

from typing import NamedTuple

import numpy as np

from ..couplings.base import Rules
from ..device.jit import inline
from ..lanes.lanes import place

ROW = 16  # numbers of a row of four nodes


class Room(NamedTuple):
    """Scratch of one thread for up to n phases of one set: who they are, and rows of four nodes."""

    block: np.ndarray  # (n,) node block of each member
    wet: np.ndarray  # (n,) whether it is a fluid
    group: np.ndarray  # (n,) its mixing group, or -1
    grains: np.ndarray  # (n,) [m3/kg] volume of a sand's grains
    pores: np.ndarray  # (n,) porosity of a sand
    drag: np.ndarray  # (n n,) coefficients [kg/(m3 s)]
    printed: np.ndarray  # (n n,) whether as the paper prints it
    M: np.ndarray  # (16 n,) [kg], a row of four nodes per member
    V: np.ndarray  # (16 n + 16,) [m3], and the space of each node
    U: np.ndarray  # (16 n,) drift [m/s]
    K: np.ndarray  # (16 n n,) exchange [kg]
    S: np.ndarray  # (16 n,) of the elimination
    R: np.ndarray  # (16 n,) of the elimination


def room(n: int, real: np.dtype, aligned) -> Room:
    """Scratch for n phases. aligned: makes an array of a shape and type."""
    M, U, S, R = (aligned((ROW * n,), real) for _ in range(4))
    V, K = aligned((ROW * n + ROW,), real), aligned((ROW * n * n,), real)
    block, wet, group = (np.zeros(n, np.int64) for _ in range(3))
    grains, pores, drag, printed = (np.zeros(k) for k in (n, n, n * n, n * n))
    return Room(block, wet, group, grains, pores, drag, printed, M, V, U, K, S, R)


class Tables(NamedTuple):
    """couplings.base.Rules in numbers, tables of pairs one row after the other."""

    phases: int
    sets: int
    mixes: int
    drags: int
    drifts: int  # whether drifts are kept out of the particles' momentum
    together: np.ndarray
    fluid: np.ndarray
    mix: np.ndarray
    diffusion: np.ndarray
    slip_time: np.ndarray
    printed_mix: np.ndarray
    volume: np.ndarray
    porosity: np.ndarray
    drag: np.ndarray
    printed_drag: np.ndarray


def tables(rules: Rules) -> Tables:
    """The rules as rows are told of them."""
    return Tables(
        len(rules.fluid), rules.sets, rules.mixes, int(rules.drags),
        int(rules.drifting_apart.any()),
        *(np.array(table, np.int64) for table in (rules.together, rules.fluid, rules.mix)),
        *(
            np.array(table, float).ravel()
            for table in (
                rules.diffusion, rules.slip_time, rules.printed_mix, rules.volume, rules.porosity,
                rules.drag, rules.printed_drag,
            )
        ),
    )  # fmt: skip


@inline
def places(room, tables):
    """Both by the places of their arrays (lanes.place), which is what rows are handed on with."""
    r, t = room, tables
    return Room(
        place(r.block), place(r.wet), place(r.group), place(r.grains), place(r.pores),
        place(r.drag), place(r.printed), place(r.M), place(r.V), place(r.U), place(r.K),
        place(r.S), place(r.R),
    ), Tables(
        t.phases, t.sets, t.mixes, t.drags, t.drifts,
        place(t.together), place(t.fluid), place(t.mix),
        place(t.diffusion), place(t.slip_time), place(t.printed_mix), place(t.volume),
        place(t.porosity), place(t.drag), place(t.printed_drag),
    )  # fmt: skip


@inline
def members(one, n0, n1, phase, rules, of):
    """The node blocks n0 .. n1 that belong to set `one`, and what to know of them, into `of`;
    returns how many."""
    count = 0
    for nb in range(n0, n1):
        p = phase[nb]
        if rules.together[p] == one:
            of.block[count], of.wet[count], of.group[count] = nb, rules.fluid[p], rules.mix[p]
            of.grains[count], of.pores[count] = rules.volume[p], rules.porosity[p]
            count += 1
    for a in range(count if count > 1 else 0):
        for b in range(count):
            pair = phase[of.block[a]] * rules.phases + phase[of.block[b]]
            of.drag[a * count + b] = rules.drag[pair]
            of.printed[a * count + b] = rules.printed_drag[pair]
    return count
