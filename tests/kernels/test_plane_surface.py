"""What particle shifting takes for missing mass is nothing below a plane surface.

Rows of particles fill the half space below a plane, wherever it lies between two nodes. Theory:
they fill it, so no volume is to be corrected, whatever their fullness and its change per cell are.
Tolerances: mean error of all rows and offsets 0.5 %, root mean square 2 %, a row at most 7 %. A
margin of 0.4 of the change per cell, which the density correction has for fuller cells, misses the
last two.
"""

import numpy as np
import pytest

from vgmpi.features.shifting import kernels as shifting
from vgmpi.kernels.transfer import liquid_volume

OFFSETS = np.arange(40) / 40  # [cells] of the surface beyond a node


def spline(x):
    """Quadratic B-spline."""
    x = np.abs(x)
    return np.where(x < 0.5, 0.75 - x**2, 0.5 * np.maximum(1.5 - x, 0.0) ** 2)


def fullness_below(rows, offset):
    """Fullness and its change per cell at the particles of the topmost four cells.

    Args:
        rows: Rows of particles per cell.
        offset: Height of the surface over node 0 [cells].
    """
    nodes = np.arange(-12, 4)
    x = offset - (np.arange(8 * rows) + 0.5) / rows
    nodal = spline(nodes[:, None] - x).sum(1) / rows
    nodal[nodes < -6] = 1.0
    x = x[: 4 * rows]
    weights = spline(nodes[:, None] - x)
    return nodal @ weights, 4.0 * np.abs((nodal[:, None] * weights * (nodes[:, None] - x)).sum(0))


def balance(rows, margin, growth):
    """What particles at J = 1 miss, less what a plane surface explains; nothing in theory."""
    fill, slope = np.hstack([fullness_below(rows, offset) for offset in OFFSETS])
    counted = fill > shifting.MIN_FILL
    return (fill - 1.0 + (margin + growth * np.maximum(1.0 - fill, 0.0)) * slope)[counted]


@pytest.mark.parametrize("rows", [2, 3])
def test_nothing_is_missing_below_a_plane_surface(rows):
    missing = balance(rows, shifting.MARGIN, shifting.MARGIN_GROWTH)
    assert abs(missing.mean()) < 0.005
    assert np.sqrt((missing**2).mean()) < 0.02
    assert missing.min() > -0.07
    plain = balance(rows, liquid_volume.SURFACE_SLOPE, 0.0)
    assert np.sqrt((plain**2).mean()) > 0.02
    assert plain.min() < -0.07
