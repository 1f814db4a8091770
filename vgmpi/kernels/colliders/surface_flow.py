"""Flow at surfaces: which nodes touch a surface, and how much of what flows adheres to it.

A liquid with a slip length (Navier) takes the velocity of a surface as far as its viscosity
carries it in a step. Whatever couples nodes to surfaces shares these parts.
"""

import math
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.grid.contact_impulses import (
    GAP_RESOLVED,
    GAP_UNRESOLVED,
    distance,
    half_space_fraction,
    has_surface,
)
from vgmpi.kernels.kernel_arguments import CONTACT_MASS_FLOOR
from vgmpi.runtime.jit import always_inline, device_function

REACH_CELLS = 1.5  # [cells] distance from a surface, both ways, up to which nodes take impulses
# [cells] Depth from which the velocity inside is continued no further, beside an implicit pressure:
# drops that lie deeper have a gradient that says nothing about a flow, and would grow.
PUSHED_DEPTH_CELLS = 0.5
# [cells] distance outside up to which impulses act against approach
FULL_WEIGHT_CELLS = 0.5
SPRAY_FILL, FLOW_FILL = 0.25, 0.5  # [-] fill of a node in spray, and in a flow, at its distance


class AdhesionLaw(NamedTuple):
    """Adhesion of phases to surfaces."""

    length: np.ndarray  # (surfaces, phases) [m] slip length, infinite: free slip
    viscosity: np.ndarray  # (phases,) [Pa s]
    depth: float  # [cells] inside up to which velocities are continued to the surface


@device_function
def traction_share(outside):
    """Return the part of the traction on a plane that acts at a node, in faces of a cell.

    It is what the moments of quadratic B-splines give to a node some cells outside. All nodes along
    the normal have 1 together.
    """
    D = abs(outside)
    if D <= 0.5:
        return 0.8125 - D * D * (1.5 - D * D)
    a = max(REACH_CELLS - D, 0.0)
    return a * a * a * (1.0 - 0.5 * a)


@device_function
def adhering_mass(length, viscosity, mass, outside, dt, dx):
    """Return the part of a node's mass that takes the velocity of the surface [kg].

    Args:
        length: Slip length [m].
        viscosity: Viscosity [Pa s].
        mass: Nodal mass [kg].
        outside: Distance of the node outside the surface [cells].
        dt: Time step [s].
        dx: Cell size [m].
    """
    if length == 0.0:
        return mass if outside <= FULL_WEIGHT_CELLS else 0.0
    if not length < math.inf:
        return 0.0
    area = max(1.0 - abs(outside), 0.0) * dx * dx
    return min(mass, dt * viscosity * area / length)


@device_function
def shear_drag(length, viscosity, mass, outside, depth, dt, dx):
    """Return the impulse of viscous stress per change of velocity in a cell [kg].

    Without slip, nodes farther outside take their part of the stress on the surface.

    Args:
        length, viscosity, mass, outside: See `adhering_mass`.
        depth: Depth of the node in the liquid [cells], see `depth_in_flow`.
        dt, dx: Time step [s] and cell size [m].
    """
    acts = outside > FULL_WEIGHT_CELLS and length == 0.0 and viscosity < math.inf
    return min(dt * viscosity * traction_share(depth) * dx, mass) if acts else 0.0


@device_function
def depth_in_flow(nodes, o, n, dx):
    """Return the depth of a node in a phase that flows, from its surface next to a body [cells].

    Args:
        nodes: Table with `velocities` and `offsets`, such as NodesNearBodies.
        o: Offset of the phase's node in the flat nodal values.
        n: Outward normal of the body, shape (3,).
        dx: Cell size [m].
    """
    side = nodes.offsets[o // 256, o % 256 : o % 256 + 4]
    return -distance(n, -1.0, side, 0.0, False, dx)


@always_inline
def mean_gradient(gradients, o, n, out):
    """Store the change of a phase's velocity per cell along n at a node, 0 without particles.

    Args:
        gradients: The three fields of velocity gradients.
        o: Offset of the phase's node in the flat nodal values.
        n: Unit vector, shape (3,).
        out: Change per cell (out), shape (3,) [m/s].
    """
    for c in range(3):
        out[c] = 0.0
    for a in range(3):
        g = gradients[a].nodes
        mass = g[o // 256, o % 256 + 3]
        if mass > 0.0:
            for c in range(3):
                out[c] += n[a] * g[o // 256, o % 256 + c] / mass


@always_inline
def touches_surface(nodes, phases, p, nb, node, n, d, dx):
    """Return whether a phase at a node touches the surface near it.

    Args:
        nodes: Table with `velocities` and `offsets`, such as NodesNearBodies.
        phases: Constants of the phases.
        p, nb, node: Phase, its node block, number of the node in its block.
        n, d: Outward normal of the surface, and distance of the node [m].
        dx: Cell size [m].
    """
    mass, is_resolved = float(nodes.velocities[nb, 4 * node + 3]), phases.surface[p]
    side = nodes.offsets[nb, 4 * node : 4 * node + 4]
    if not (mass > CONTACT_MASS_FLOOR * phases.min_cell_mass[p] and has_surface(side, is_resolved)):
        return False
    gap = d / dx + distance(n, -1.0, side, mass, is_resolved, dx)
    return gap <= (GAP_RESOLVED if is_resolved else GAP_UNRESOLVED)


@always_inline
def flow_fraction(mass, full, outside):
    """Return 1 where a node is as full as in a flow that reaches the surface, 0 in spray.

    The gradient of a lone particle says nothing about a flow: left alone, it would grow.

    Args:
        mass: Nodal mass [kg].
        full: Mass of a full cell [kg].
        outside: Distance of the node outside the body [cells].
    """
    fill = mass / (full * max(half_space_fraction(-outside), 1e-6))
    return min(max((fill - SPRAY_FILL) / (FLOW_FILL - SPRAY_FILL), 0.0), 1.0)


@device_function
def tangential_part(u, n):
    """Remove the part along n from u, shape (3,)."""
    along = u[0] * n[0] + u[1] * n[1] + u[2] * n[2]
    for c in range(3):
        u[c] -= along * n[c]
