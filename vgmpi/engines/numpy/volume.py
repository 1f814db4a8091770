"""Volume of liquids that is held to the space that they take: docs/theory.md."""

import numpy as np

from ...kernels.volume import DENSE, RETURN, SPRAY, SURFACE
from .dense import Dense, Stencil


def held(
    dense: Dense, mass: np.ndarray, stencil: Stencil, space: float, J: np.ndarray, L: np.ndarray
) -> np.ndarray:
    """The velocity gradients L (n, 3, 3) [1/s] with which what is crowded shrinks, and what has
    room inside the fluid swells, by what a cell's mass and the particle's J (n,) differ.

    mass: at the nodes [kg]; space: 1 / mass of a full cell at rest [1/kg].
    """
    mass = dense.whole(mass)
    crowd = space * dense.gather(mass, stencil)[:, 0]
    slope = dense.gather_slopes(mass, stencil)[:, 0]
    near = SURFACE * space * dense.dx * np.linalg.norm(slope, axis=1)
    more = crowd * J - 1.0
    inner = np.clip((crowd - SPRAY) / (DENSE - SPRAY), 0.0, 1.0)
    off = np.maximum(more, 0.0) + inner * np.minimum(more + near, 0.0)
    return L - (RETURN / 3.0 * off)[:, None, None] * np.eye(3)
