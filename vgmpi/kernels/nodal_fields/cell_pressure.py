"""Impulse of the mean stress [kg m/s] by the means of cells, a second contribution to momentum.

It is the adjoint of the dilatation by cells (kernels/transfer/cell_dilatation.py): a pressure does
work on that dilatation, so that a liquid locks less.
"""

from typing import NamedTuple

from vgmpi.kernels.cell_stencil_sums import scatter_cell_pressure
from vgmpi.kernels.particle_records import AFFINE, STATE, VOLUME, load_tensor
from vgmpi.kernels.simd.material_dispatch import load_state_vector, stress
from vgmpi.kernels.simd.row_ops import broadcast, store_records
from vgmpi.kernels.simd.vector16 import load

from .field_protocol import MIRROR_IMPULSE, accumulate, particle_contribution


class CellPressure(NamedTuple):
    """Contribution of the impulse of the mean stress, by the means of cells."""

    mirror: float  # code of nodal_fields/field_protocol.py
    dx: float  # [m] cell size


def kind(plan) -> CellPressure:
    """Return the contribution of a group's particles."""
    return CellPressure(*(plan.real.type(v) for v in (MIRROR_IMPULSE, plan.dx)))


@particle_contribution.of(CellPressure)
def _cell_pressure(kind, law, count, offset, cap, f, extra, peak, records, dt):
    zero = broadcast(f, 0.0)
    dx = kind.dx
    scale = broadcast(f, dt) * -1.0 / (3.0 * dx)
    for n in range(0, count, 16):
        p = offset + n
        L = load_tensor(f, p + AFFINE * cap, cap)
        t00, t11, t22, _, _, _ = stress(law, load_state_vector(law, f, p + STATE * cap, cap), L)
        impulse = scale * load(f, p + VOLUME * cap) * (t00 + t11 + t22)
        store_records(
            records,
            16 * n,
            (
                zero, zero, zero, zero, impulse, zero, zero, zero,
                zero, impulse, zero, zero, zero, zero, impulse, zero,
            ),
        )  # fmt: skip


@accumulate.of(CellPressure)
def _add_by_cells(kind, count, records, weights, base, patch):
    scatter_cell_pressure(count, records, weights, base, patch)
