"""Contact at the 64 nodes of a block: pairs of phases that touch, and the resulting impulses.

The rule for one pair and the impulses of all pairs of a node are in contact_impulses.py.
"""

from typing import NamedTuple

from vgmpi.kernels.colliders.static_colliders import SDF_BAND_CELLS
from vgmpi.kernels.kernel_arguments import CONTACT_MASS_FLOOR
from vgmpi.kernels.reaction_impulses import (
    add_contact_reaction,
    add_pair_reactions,
    add_prescribed_reaction,
    set_collider,
    set_node,
    set_wall,
)
from vgmpi.kernels.rigid.prescribed_motion import EFFECTIVE_MASS_FACTOR
from vgmpi.kernels.simd.cooperative import strided_range, sync_threads
from vgmpi.kernels.wall_boundary import project_tangential
from vgmpi.materials.couplings.interaction import CONTACT
from vgmpi.runtime.jit import always_inline, device_function

from .contact_impulses import (
    COLLIDER_ROW,
    WALL_ROW,
    ContactPair,
    apply_penalty_layer,
    contact_fraction,
    distance,
    face_fraction,
    faces_wall,
    has_surface,
    in_contact,
    normal_is_reliable,
    solve_contact_impulses,
    surface_normal,
)
from .divided_nodes import are_apart, face_of_phase


class ContactNode(NamedTuple):
    """One node at which contact is computed."""

    active: int  # number of phases
    node: int  # number in its block
    alone: bool  # whether only two parties meet at the node
    solid: int  # row of the block among those near colliders, or -1


@device_function
def apply_contact(block, tables, solid, velocities, offsets, shear, solids, walls, phases,
                  pair_rules, step, work):  # fmt: skip
    """Apply contact at the nodes of a block.

    Args:
        block, solid: Context of the block; its row in solids, or -1. Fields are in/out pointers.
    """
    motions, pushes = solids.motions, block.at_wall and _may_push(walls)
    sync_threads()
    for node in strided_range(64):
        active = _active(
            block, node, velocities, tables.phase, phases.min_cell_mass, work.node_block
        )
        ijk = block.low_x + node // 16, block.low_y + node // 4 % 4, block.low_z + node % 4
        planes = _planes(ijk, walls) if pushes else 0
        rigid = _is_near_collider(solids, solid, node, step.dx)
        if active == 0 or active + rigid + planes < 2:
            continue
        for q in range(active):
            nb = work.node_block[q]
            offset, ph = 256 * nb + 4 * node, tables.phase[nb]
            kinds = walls.kinds if phases.liquid[ph] else walls.kinds_for_solids
            project_tangential(offsets, offset, ijk[0], ijk[1], ijk[2], walls.cells, kinds)
            for c in range(3):
                work.v[q, c], work.change[q, c] = velocities[offset + c], 0.0
            work.mass[q] = work.effective_mass[q] = velocities[offset + 3]
            if _driven(motions, ph):
                work.effective_mass[q] *= EFFECTIVE_MASS_FACTOR
            if shear is not None:
                for c in range(3):
                    work.slope[q, c] = shear.nodes[offset + c] / work.mass[q]
            work.pair_count[q] = 0
        site = ContactNode(active, node, active + rigid + planes == 2, solid)
        set_node(work.reactions, node, ijk[0], ijk[1], ijk[2])
        pairs = _pairs(site, tables.phase, offsets, phases, pair_rules, motions, step, work)
        if rigid:
            surface = solids.nodes[solid, node]
            number = solids.collider_number[solid, node] if len(solids.collider_number) > 0 else 0
            set_collider(work.reactions, number, surface)
            rows = phases.friction[len(phases.contact_priority) :]
            row = rows[min(number, len(rows) - 1)]  # common to all colliders, or its own
            if len(solids.moves) > 0:
                for c in range(3):
                    work.v[COLLIDER_ROW, c] = solids.moves[solid, node, c]
            pairs = _add_rigid_pairs(pairs, site, tables.phase, offsets, surface, row,
                                     COLLIDER_ROW, phases, motions, step, work)  # fmt: skip
        if planes:
            pairs = _add_wall_pairs(
                pairs, site, tables.phase, offsets, ijk, walls, phases, motions, step, work
            )
        for q in range(active):
            for c in range(3):
                work.v[q, c] += work.change[q, c]
        if pairs > 0:
            solve_contact_impulses(work.v, work.effective_mass, active, work.normals,
                                   work.friction, work.fraction, work.master, work.other, pairs,
                                   _max_count(work.pair_count, active), work.impulse)  # fmt: skip
            add_pair_reactions(work.reactions, pairs, work)
        for q in range(active):
            for c in range(3):
                velocities[256 * work.node_block[q] + 4 * node + c] = work.v[q, c]
    sync_threads()


@always_inline
def _is_near_collider(solids, solid, node, dx):
    """Return whether a node is near a collider that is no free body."""
    if solid < 0 or not solids.nodes[solid, node, 3] < SDF_BAND_CELLS * dx:
        return False
    return len(solids.free) == 0 or not solids.free[solids.collider_number[solid, node]]


@device_function
def has_several_parties(block, solid, solids, dx):
    """Return whether more than one phase, or a phase and a boundary, may meet in a block.

    Free bodies do not count: they couple after all others.

    Args:
        block: Context of the block.
        solid, solids: Row of the block in the rigid boundaries, or -1, and the boundaries.
        dx: Cell size [m].
    """
    if block.n1 - block.n0 > 1 or block.at_wall or len(solids.free) == 0:
        return True
    if solid < 0:
        return False
    for node in range(64):
        if _is_near_collider(solids, solid, node, dx):
            return True
    return False


@always_inline
def _max_count(touches, active):
    """Return the number of pairs of the phase that touches most others."""
    count = touches[0]
    for q in range(1, active):
        count = max(count, touches[q])
    return count


@always_inline
def _side(offsets, nb, node):
    """Return the four numbers of the offset field for a phase at a node."""
    offset = 256 * nb + 4 * node
    return offsets[offset], offsets[offset + 1], offsets[offset + 2], offsets[offset + 3]


@always_inline
def _driven(motions, phase):
    """Return whether the motion of a phase is prescribed."""
    return len(motions.driven) > 0 and motions.driven[phase]


@always_inline
def _is_reserved(motions, nb, site):
    """Return whether something else than colliders attaches a node of a phase."""
    return len(motions.reserved) > 0 and motions.reserved[nb, site.node] != 0


@always_inline
def _active(block, node, velocities, phase, cell_mass, node_blocks):
    """Store the node blocks of the phases at a node; return their number.

    Lighter phases do not count: their sums have too few digits for the position of their particles.
    """
    active = 0
    for nb in range(block.n0, block.n1):
        if velocities[256 * nb + 4 * node + 3] > CONTACT_MASS_FLOOR * cell_mass[phase[nb]]:
            node_blocks[active] = nb
            active += 1
    return active


@always_inline
def _pairs(site, phase, offsets, phases, pair_rules, motions, step, work):
    """Find the pairs of phases that touch each other, in order; return their number.

    Pairs that meet by an elastic layer change work.change, the others are stored as pairs: masters,
    normals and friction.
    """
    pairs = 0
    for q in range(site.active):
        ph = phase[work.node_block[q]]
        for r in range(q + 1, site.active):
            other = phase[work.node_block[r]]
            if pair_rules is not None:
                if pair_rules[ph, other] != CONTACT:
                    continue
            both_driven = _driven(motions, ph) and _driven(motions, other)
            if both_driven or are_apart(phases, ph, other, site.solid, site.node, step.dx):
                continue
            a, b = (
                (q, r) if phases.contact_priority[ph] < phases.contact_priority[other] else (r, q)
            )
            pairs = _add_phase_pair(pairs, site, a, b, phase, offsets, phases, motions, step, work)
    return pairs


@always_inline
def _add_phase_pair(pairs, site, a, b, phase, offsets, phases, motions, step, work):
    """Apply the contact of two phases, or store it as a pair."""
    pa, pb = phase[work.node_block[a]], phase[work.node_block[b]]
    xa, xb = (
        _side(offsets, work.node_block[a], site.node),
        _side(offsets, work.node_block[b], site.node),
    )
    ka, kb = phases.surface[pa], phases.surface[pb]
    if not (has_surface(xa, ka) and has_surface(xb, kb)):
        return pairs
    ma, mb, n = work.mass[a], work.mass[b], work.normals[pairs]
    if not surface_normal(n, xa, xb, ma, mb, ka, kb, step.dx):
        return pairs
    both_resolved = ka and kb
    distance_a = distance(n, 1.0, xa, ma, ka, step.dx)
    distance_b = distance(n, -1.0, xb, mb, kb, step.dx)
    is_reliable, area_fraction, modulus = False, 0.0, 0.0
    if both_resolved:
        is_reliable = normal_is_reliable(xa, ma) and normal_is_reliable(xb, mb)
    elif ka:
        is_reliable = normal_is_reliable(xa, ma)
    elif kb:
        is_reliable = normal_is_reliable(xb, mb)
    if is_reliable:
        area_fraction = min(
            face_fraction(ma, phases.min_cell_mass[pa], distance_a),
            face_fraction(mb, phases.min_cell_mass[pb], distance_b),
        )
        modulus = phases.stiff[pa] * phases.stiff[pb] / (phases.stiff[pa] + phases.stiff[pb])
    friction = phases.friction[pa, pb]
    meeting = ContactPair(
        a, b, distance_a, distance_b, both_resolved, ka, is_reliable, area_fraction, modulus,
        friction, False,
    )  # fmt: skip
    source, target = (a, b) if _driven(motions, pa) else (b, a)
    change, first_pair = work.change[target], pairs
    before = change[0], change[1], change[2]
    pairs = _activate_pair(pairs, site, meeting, n, step, work)
    row = motions.row[phase[work.node_block[source]]] if len(motions.row) > 0 else -1
    add_prescribed_reaction(
        work.reactions, row, before, change, work.mass[target], work.v[source], first_pair, pairs
    )
    return pairs


@always_inline
def _add_rigid_pairs(
    pairs, site, phase, offsets, surface, friction, a, phases, motions, step, work
):
    """Apply the contact of something rigid with the phases of a node, or store pairs.

    surface: (4,) its normal and distance [m]; friction: (phases,); a: COLLIDER_ROW, or WALL_ROW
    for a wall, which meets only phases whose surfaces it pushes.
    """
    for q in range(site.active):
        ph, mine = phase[work.node_block[q]], _side(offsets, work.node_block[q], site.node)
        is_resolved, mass, n = phases.surface[ph], work.mass[q], work.normals[pairs]
        if not ((a == COLLIDER_ROW or phases.at_walls[ph]) and has_surface(mine, is_resolved)):
            continue
        if _driven(motions, ph) or (
            a == COLLIDER_ROW and _is_reserved(motions, work.node_block[q], site)
        ):
            continue
        for c in range(3):
            n[c] = surface[c]
        depth = surface[3]
        if a == COLLIDER_ROW:
            depth = face_of_phase(phases, ph, site.solid, site.node, step.dx, n, depth)
        distance_b = distance(n, -1.0, mine, mass, is_resolved, step.dx)
        is_reliable = is_resolved and normal_is_reliable(mine, mass)
        area_fraction = (
            face_fraction(mass, phases.min_cell_mass[ph], distance_b) if is_reliable else 0.0
        )
        distance_a = depth / step.dx
        meeting = ContactPair(
            a, q, distance_a, distance_b, is_resolved, True, is_reliable, area_fraction,
            phases.stiff[ph], friction[ph], a == WALL_ROW and faces_wall(n, mine),
        )  # fmt: skip
        change, first_pair = work.change[q], pairs
        before = change[0], change[1], change[2]
        pairs = _activate_pair(pairs, site, meeting, n, step, work)
        add_contact_reaction(work.reactions, before, change, mass, work.v[a], first_pair, pairs)
    return pairs


@always_inline
def _activate_pair(pairs, site, meeting, n, step, work):
    """Apply the penalty layer of a contact pair; store it if its phases may not approach.

    n: normal (3,). The layer changes work.change. A pair that is alone at its node and separating
    is left out: nothing acts on it.
    """
    if meeting.normals_reliable:
        apply_penalty_layer(
            work.change, work.v, work.slope, work.effective_mass, meeting, n, step.dt, step.dx
        )
    fraction = contact_fraction(meeting)
    if (
        fraction <= 0.0
        or not in_contact(meeting)
        or (site.alone and _is_separating(work.v, meeting, n))
    ):
        return pairs
    work.master[pairs], work.other[pairs] = meeting.a, meeting.b
    work.friction[pairs], work.fraction[pairs] = meeting.friction, fraction
    work.pair_count[meeting.b] += 1
    if meeting.a >= 0:
        work.pair_count[meeting.a] += 1
    return pairs + 1


@always_inline
def _is_separating(v, meeting, n):
    """Return whether two phases separate along n."""
    nearing = 0.0
    for c in range(3):
        nearing -= v[meeting.b, c] * n[c]
        nearing += v[meeting.a, c] * n[c]
    return nearing <= 0.0


@device_function
def _may_push(walls):
    """Return whether any wall pushes resolved surfaces."""
    for a in range(3):
        for side in range(2):
            if walls.kinds_for_surfaces[a, side] == 0:
                return True
    return False


@always_inline
def _pushes_at(ijk, walls, a, side):
    """Return whether a wall pushes resolved surfaces at a node: on its plane and a cell beyond."""
    beyond = (2 * side - 1) * (ijk[a] - side * walls.cells[a])
    return walls.kinds_for_surfaces[a, side] == 0 and 0 <= beyond <= 1


@always_inline
def _planes(ijk, walls):
    """Return the number of walls at a node that push resolved surfaces."""
    count = 0
    for a in range(3):
        for side in range(2):
            count += _pushes_at(ijk, walls, a, side)
    return count


@always_inline
def _add_wall_pairs(pairs, site, phase, offsets, ijk, walls, phases, motions, step, work):
    """Apply the contact of walls that push resolved surfaces, or store pairs."""
    surface, row = work.plane, work.row
    for a in range(3):
        for side in range(2):
            if not _pushes_at(ijk, walls, a, side):
                continue
            inward = 1.0 - 2.0 * side
            surface[0] = surface[1] = surface[2] = 0.0
            surface[a] = inward
            surface[3] = inward * (ijk[a] - side * walls.cells[a]) * step.dx
            set_wall(work.reactions, a, side, surface)
            for k in range(len(row)):
                row[k] = walls.friction[a, side]
            pairs = _add_rigid_pairs(
                pairs, site, phase, offsets, surface, row, WALL_ROW, phases, motions, step, work
            )
    return pairs
