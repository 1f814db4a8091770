"""Tables of a plan that kernels and the exchange of nodal sums read: walls, phases, fields."""

import numpy as np

from vgmpi.kernels.grid.divided_nodes import Phases
from vgmpi.kernels.kernel_arguments import Walls
from vgmpi.kernels.wall_boundary import KINDS, SEPARATE, YIELDING
from vgmpi.materials.couplings.interaction import CONTACT, MIXING
from vgmpi.parallel.exchange_topology import MixtureProximity, TopologyRequirements
from vgmpi.planning.phases_and_groups import PhasePlan
from vgmpi.planning.plan import Plan

from .nodal_field_storage import field_requests
from .surface_fields import is_summed_at_surfaces


def wall_table(plan: Plan) -> Walls:
    """Return the kinds and friction of the six walls, for liquids and for everything else."""
    kinds, for_solids = (
        np.array([KINDS[kind] for kind, _ in walls], np.int64).reshape(3, 2)
        for walls in (plan.walls, plan.walls_of_solids)
    )
    friction = np.array([mu for _, mu in plan.walls]).reshape(3, 2)
    if plan.flip is None:
        for_solids[for_solids == SEPARATE] = YIELDING
    for_surfaces = for_solids.copy()
    for plane in plan.planes:
        for_surfaces[plane.axis, plane.side] = 0
    return Walls(np.array(plan.cells), kinds, for_solids, for_surfaces, friction)


def wall_kinds_of(walls: Walls, phase: PhasePlan) -> np.ndarray:
    """Return the wall kinds of a phase, shape (3, 2)."""
    if phase.meets_walls_by_contact:
        return walls.kinds_for_surfaces
    return walls.kinds if phase.is_liquid else walls.kinds_for_solids


def phase_table(plan: Plan) -> Phases:
    """Return the numbers of all phases."""
    return Phases(
        np.array([phase.min_cell_mass for phase in plan.phases]),
        np.array([phase.contact_priority for phase in plan.phases]),
        np.array(plan.friction),
        np.array(plan.stiff),
        np.array([phase.surface for phase in plan.phases]),
        np.array([phase.meets_walls_by_contact for phase in plan.phases]),
        np.array([phase.is_liquid for phase in plan.phases]),
    )


def phase_sets(plan: Plan) -> np.ndarray:
    """Return the number of the set with one velocity that each phase is in, -1 for none."""
    return np.full(len(plan.phases), -1) if plan.rules is None else plan.rules.phase_sets


def topology_requirements(plan: Plan) -> TopologyRequirements:
    """Return the requirements of the plan for the exchange tables."""
    return TopologyRequirements(
        np.array([group.phase for group in plan.groups], np.int64),
        plan.contact,
        _separate_stress(plan),
        tuple(request.place(plan) for request in field_requests(plan)),
        np.array([phase.surface for phase in plan.phases]),
        plan.planes,
        is_summed_at_surfaces(plan),
        _phases_in_contact(plan),
    )


def _phases_in_contact(plan: Plan) -> np.ndarray:
    """Return the phases whose fields near surfaces are summed near other phases, too, or no rows.

    Returns:
        Shape (phases,) bool, or (0,) if there are none.
    """
    rows = sorted(frozenset().union(*(each.phases_in_contact for each in plan.features)))
    return np.isin(np.arange(len(plan.phases)), rows) if rows else np.zeros(0, bool)


def _separate_stress(plan: Plan) -> bool | MixtureProximity:
    """Return where stress impulses are summed separately: with FLIP and in mixtures."""
    rules = plan.rules
    if rules is None:
        return plan.flip is not None
    same_mixture = rules.mixture_set[:, None] == rules.mixture_set[None, :]
    shares_space = (
        same_mixture & (rules.mixture_set >= 0)[:, None] & ~np.eye(len(same_mixture), dtype=bool)
    )
    needs_contact = (rules.pair == CONTACT) & ~np.eye(len(same_mixture), dtype=bool)
    needs_contact |= (rules.pair == MIXING) & rules.drifting[:, None]
    return MixtureProximity(shares_space, needs_contact, rules.fluid, plan.flip is not None)
