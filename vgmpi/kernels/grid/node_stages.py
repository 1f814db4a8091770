"""Separate stress impulses at the nodes of a block, and stages in which features act on it.

A kind of a feature acts where stress impulses are summed separately from momentum: before they act,
after those have acted that no feature distributes, and after contact and walls. Kinds of several
features are joined by `Both`, in the order of their list.
"""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.kernel_arguments import NODE_MASS_FLOOR, Sums
from vgmpi.kernels.simd.row_ops import broadcast, fourth_of, with_fourth
from vgmpi.kernels.simd.static_dispatch import Both, static_dispatch
from vgmpi.kernels.simd.vector16 import load, store
from vgmpi.materials.tensor_math.select import select
from vgmpi.runtime.jit import device_function


class SeparatedStress(NamedTuple):
    """Stress impulses that are kept separate from momentum, and what features do with them."""

    impulses: Sums  # [kg m/s], and volumes [m3]
    shared: np.ndarray  # (phases,) 1: a feature distributes them; (0,) if none does
    adds_own: int  # whether other phases have some, which act on these alone
    kind: tuple  # kind of these stages
    scratch: tuple  # scratch of the calling thread for that kind
    is_converted: int  # whether the nodes have velocities, and these impulses, before the update


class NoStage(NamedTuple):
    """Kind of runs in which no feature acts at these stages."""

    unused: int = 0


@static_dispatch
def before_stress(kind, block, fields, push):
    """Act before separate stress impulses do, in a block that has some.

    Args:
        kind: Kind of the feature.
        block: Context of the block.
        fields: Nodal arrays (in/out).
        push: Change of velocity by gravity, which the velocities have, as a vector [m/s].
    """


@static_dispatch
def after_stress(kind, block, fields, scratch, walls, phases, step):
    """Act after the separate stress impulses that no feature distributes, in a block with some.

    Args:
        kind: Kind of the feature.
        block: Context of the block.
        fields: Nodal arrays (in/out).
        scratch: Scratch of the calling thread, see `FeaturePlan.stage_scratch`.
        walls, phases, step: See kernels/kernel_arguments.py.
    """


@static_dispatch
def after_walls(kind, block, has_impulses, fields, scratch, dx):
    """Act after contact and walls, in every block.

    Args:
        kind: Kind of the feature.
        block: Context of the block.
        has_impulses: Whether stress impulses, and with them volumes, are summed in the block.
        fields: Nodal arrays (in/out).
        scratch: Scratch of the calling thread.
        dx: Cell size [m].
    """


@before_stress.register(NoStage)
def _(kind, block, fields, push):
    pass


@after_stress.register(NoStage)
def _(kind, block, fields, scratch, walls, phases, step):
    pass


@after_walls.register(NoStage)
def _(kind, block, has_impulses, fields, scratch, dx):
    pass


@before_stress.register(Both)
def _(kind, block, fields, push):
    before_stress(kind.first, block, fields, push)
    before_stress(kind.second, block, fields, push)


@after_stress.register(Both)
def _(kind, block, fields, scratch, walls, phases, step):
    after_stress(kind.first, block, fields, scratch, walls, phases, step)
    after_stress(kind.second, block, fields, scratch, walls, phases, step)


@after_walls.register(Both)
def _(kind, block, has_impulses, fields, scratch, dx):
    after_walls(kind.first, block, has_impulses, fields, scratch, dx)
    after_walls(kind.second, block, has_impulses, fields, scratch, dx)


@device_function
def add_own_impulses(block, fields, shared):
    """Add the separate stress impulses to the velocities of a block.

    Impulses that a feature distributes are left to it, and it sees none of the others.

    Args:
        block: Context of the block.
        fields: Nodal arrays (in/out).
        shared: 1 for phases whose impulses it distributes, shape (phases,); (0,) without one.
    """
    for nb in range(block.n0, block.n1):
        if len(shared) == 0:
            _add_impulse_of_node_block(nb, fields)
        elif shared[fields.phase[nb]] == 0:
            _add_impulse_of_node_block(nb, fields)
            for c in range(256 * nb, 256 * (nb + 1), 16):  # the impulse has acted
                row = load(fields.forces, c)
                store(fields.forces, c, with_fourth(0.0 * row, row))


@device_function
def _add_impulse_of_node_block(nb, fields):
    """Add the separate stress impulses to the velocities of one node block."""
    tiny = broadcast(fields.grid, NODE_MASS_FLOOR * fields.min_cell_mass[fields.phase[nb]])
    for c in range(256 * nb, 256 * (nb + 1), 16):
        row = load(fields.grid, c)
        m = fourth_of(row)
        change = select(m > tiny, load(fields.forces, c) / m, 0.0)
        store(fields.grid, c, with_fourth(row + change, row))
