"""Slip of viscous liquids on solids: what flows at a surface takes the solid's velocity there.

The rule is that of surface_slip.py, for the velocity fields of a liquid and of a solid at a node.
The solid's surface is the resolved one, which contact uses, too. Both velocities are continued to
it by the gradients of their particles. The impulse acts on both fields at the same node, so that
momentum and angular momentum are exact: reduced masses take the place of the liquid's.
"""

import math
from typing import NamedTuple

import numpy as np

from vgmpi.kernels.grid.contact_impulses import distance, normalize
from vgmpi.kernels.kernel_arguments import CONTACT_MASS_FLOOR, Sums
from vgmpi.kernels.reaction_impulses import add_prescribed_reaction, set_block, set_node
from vgmpi.runtime.jit import device_function, kernel

from .body_nodes import (
    REACH_CELLS,
    SlipLaw,
    adhering_mass,
    depth_in_flow,
    flow_fraction,
    mean_gradient,
    shear_drag,
    tangential_part,
    touches_surface,
)
from .sdf_sampling import set_node_indices
from .surface_slip import stopped_axes


class SolidSlipLaw(NamedTuple):
    """Slip of phases on each other, and which of them move as prescribed."""

    slip: SlipLaw  # its lengths: (phases, phases) [m], infinite: free slip
    driven: np.ndarray  # (phases,) bool: its velocity is prescribed
    rows: np.ndarray  # (phases,) rows of prescribed bodies in the reactions, or -1


class NodesOfPhases(NamedTuple):
    """Nodes of a rank at which phases may meet, and what slip needs of them."""

    velocities: np.ndarray  # (node blocks, 256) velocities and masses (in/out)
    offsets: np.ndarray  # (node blocks, 256) values of the field of offsets
    fields: tuple[Sums, ...]  # the three fields of velocity gradients


class SlipScratch(NamedTuple):
    """Vectors of one node, shape (3,) each."""

    normal: np.ndarray  # outward normal of the solid
    slope: np.ndarray  # change of the liquid's velocity per cell along it
    slope_of_solid: np.ndarray
    impulse: np.ndarray  # [kg m/s]
    before: np.ndarray  # velocity of the liquid before [m/s]
    speed: np.ndarray  # velocity of the solid [m/s]


@device_function
def _find_surface(nodes, phases, p, nb, node, normal, dx):
    """Store the normal of a solid's surface at a node; return its distance [cells], or infinity."""
    mass = float(nodes.velocities[nb, 4 * node + 3])
    if not mass > CONTACT_MASS_FLOOR * phases.least[p]:
        return math.inf
    side = nodes.offsets[nb, 4 * node : 4 * node + 4]
    for c in range(3):
        normal[c] = side[c]
    return distance(normal, 1.0, side, mass, True, dx) if normalize(normal, 0.0) else math.inf


@device_function
def _store_impulse(nodes, law, phases, pair, flat, outside, dt, dx, scratch):
    """Store the tangential impulse of a solid on a liquid at a node.

    Args:
        nodes: NodesOfPhases.
        law: SolidSlipLaw.
        phases: Constants of the phases.
        pair: Phases of the liquid and of the solid.
        flat: Offsets of both in the flat nodal values.
        outside: Distance of the node outside the solid [cells].
        dt, dx: Time step [s] and cell size [m].
        scratch: SlipScratch (in/out).
    """
    liquid, solid = nodes.velocities[flat[0] // 256], nodes.velocities[flat[1] // 256]
    k, q = flat[0] % 256, flat[1] % 256
    mass, other = float(liquid[k + 3]), float(solid[q + 3])
    reduced = mass * other / (mass + other)
    length, eta = law.slip.length[pair[1], pair[0]], law.slip.viscosity[pair[0]]
    if law.driven[pair[1]]:
        reduced = mass
    flow = flow_fraction(mass, phases.least[pair[0]], outside)
    depth = depth_in_flow(nodes, flat[0], scratch.normal, dx)
    adhering = adhering_mass(length, eta, reduced, outside, dt, dx)
    drag = flow * shear_drag(length, eta, reduced, outside, depth, dt, dx)
    mean_gradient(nodes.fields, flat[0], scratch.normal, scratch.slope)
    mean_gradient(nodes.fields, flat[1], scratch.normal, scratch.slope_of_solid)
    for c in range(3):
        scratch.speed[c] = solid[q + c]
        approach = solid[q + c] - outside * scratch.slope_of_solid[c]
        approach -= liquid[k + c] - flow * outside * scratch.slope[c]
        scratch.impulse[c] = adhering * approach - drag * scratch.slope[c]
    tangential_part(scratch.impulse, scratch.normal)


@device_function
def _apply_impulse(nodes, is_driven, flat, axes, scratch):
    """Add an impulse to the velocity of a liquid, and its reaction to that of a solid.

    Args:
        nodes: NodesOfPhases (in/out).
        is_driven: Whether the motion of the solid is prescribed.
        flat: Offsets of liquid and solid in the flat nodal values.
        axes: Bits of the axes along which a wall stops the node.
        scratch: SlipScratch (in/out).
    """
    liquid, solid = nodes.velocities[flat[0] // 256], nodes.velocities[flat[1] // 256]
    k, q = flat[0] % 256, flat[1] % 256
    for c in range(3):
        scratch.before[c] = liquid[k + c]
        if not axes >> c & 1:
            liquid[k + c] += scratch.impulse[c] / liquid[k + 3]
            if not is_driven:
                solid[q + c] -= scratch.impulse[c] / solid[q + 3]


@kernel
def apply_solid_slip(rows, nodes, tables, law, phases, walls, dt, dx, reaction):
    """Apply the slip of viscous liquids on solids at the nodes of some blocks.

    Args:
        rows: Blocks in which several phases meet, shape (n,).
        nodes: NodesOfPhases; its velocities are changed (in/out).
        tables: Node blocks of the rank.
        law: SolidSlipLaw.
        phases: Constants of the phases.
        walls: Walls of the domain.
        dt: Time step [s].
        dx: Cell size [m].
        reaction: Reaction sums of the thread (in/out), or None.
    """
    ijk = np.zeros(3, np.int64)
    scratch = SlipScratch(
        np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    )
    for b in rows:
        set_block(reaction, b)
        for node in range(64):
            set_node_indices(ijk, tables.at[b], node)
            axes = stopped_axes(ijk, walls)
            if axes < 0:
                continue
            for sb in range(tables.first[b], tables.first[b + 1]):
                solid = tables.phase[sb]
                if not phases.surface[solid]:
                    continue
                outside = _find_surface(nodes, phases, solid, sb, node, scratch.normal, dx)
                if not abs(outside) < REACH_CELLS:
                    continue
                for nb in range(tables.first[b], tables.first[b + 1]):
                    p = tables.phase[nb]
                    if not (
                        law.slip.length[solid, p] < math.inf
                        and not phases.surface[p]
                        and touches_surface(
                            nodes, phases, p, nb, node, scratch.normal, outside * dx, dx
                        )
                    ):
                        continue
                    pair, flat = (p, solid), (256 * nb + 4 * node, 256 * sb + 4 * node)
                    _store_impulse(nodes, law, phases, pair, flat, outside, dt, dx, scratch)
                    _apply_impulse(nodes, law.driven[solid], flat, axes, scratch)
                    if reaction is not None:
                        set_node(reaction, node, ijk[0], ijk[1], ijk[2])
                        liquid = nodes.velocities[nb, 4 * node : 4 * node + 4]
                        add_prescribed_reaction(
                            reaction, law.rows[solid], scratch.before, liquid, float(liquid[3]),
                            scratch.speed, 0, 0,
                        )  # fmt: skip
