"""Dilatation of liquids by the means of cells, against locking.

The volume of a particle follows the mean divergence of the cells around it, interpolated, in place
of the trace of its own velocity gradient. It is a kind of auxiliary_gather.py; its adjoint is
kernels/nodal_fields/cell_pressure.py. See docs/explanation/transfer-schemes.md.
"""

from typing import NamedTuple

from vgmpi.kernels.cell_stencil_sums import gather_cell_slopes
from vgmpi.kernels.particle_records import velocity_patch_of
from vgmpi.kernels.simd.vector16 import load

from .auxiliary_gather import (
    VelocityOnly,
    advection_velocity,
    displacement,
    gather_batch,
    load_patches,
    max_velocity,
    mixture_wave_speed_squared,
    particle_velocity,
    velocity_gradient,
)


class CellDilatation(NamedTuple):
    """Kind of liquids whose dilatation is that of cells; otherwise as `VelocityOnly`."""

    unused: float


for _dispatch in (
    load_patches, particle_velocity, max_velocity, advection_velocity, displacement,
    mixture_wave_speed_squared,
):  # fmt: skip
    _dispatch.of(CellDilatation)(_dispatch.table[VelocityOnly])


@gather_batch.of(CellDilatation)
def _(kind, count, weights, records, base, real, extra):
    """Gather the mean divergence of the cells [cells/s]."""
    gather_cell_slopes(count, records, weights, base, velocity_patch_of(real))
    for n in range(count):
        m = 16 * n
        extra[n] = records[m] + records[m + 5] + records[m + 10]


@velocity_gradient.of(CellDilatation)
def _(kind, split, f, p, cap, extra, n, L, fill, slope, numbers):
    """Replace the trace of the velocity gradient."""
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    added = (load(extra, n) / numbers.dx - (c0 + c4 + c8)) * (1.0 / 3.0)
    return (c0 + added, c1, c2, c3, c4 + added, c5, c6, c7, c8 + added)
