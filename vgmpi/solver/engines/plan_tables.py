"""Tables of a plan that kernels and the exchange of nodal sums read: walls, phases, fields."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.grid.divided_nodes import Phases
from vgmpi.kernels.grid.update import RigidBoundaries
from vgmpi.kernels.kernel_arguments import Walls
from vgmpi.kernels.rigid.prescribed_motion import NO_PRESCRIBED_BODIES, PhaseMotions
from vgmpi.kernels.wall_boundary import KINDS, RELEASING, SEPARATE, YIELDING
from vgmpi.parallel.exchange_topology import StressProximity, TopologyRequirements
from vgmpi.planning.phases_and_groups import PhasePlan
from vgmpi.planning.plan import Plan

from .engine_protocol import CollidersAtNodes
from .nodal_field_storage import field_requests
from .surface_fields import is_summed_at_surfaces


class PlanTables(NamedTuple):
    """Tables of a plan that kernels read at nodes."""

    walls: Walls
    phases: Phases
    phase_sets: np.ndarray  # set with one velocity that each phase is in, -1 for none
    shared_stress: np.ndarray  # (phases,) 1: a feature distributes their impulses; (0,) for none
    adds_own_stress: int  # 1 if stress impulses are separate that act on their phase alone
    boundaries: RigidBoundaries  # prescribed bodies, without colliders


def plan_tables(
    plan: Plan, prescribed: PhaseMotions | None, colliders: CollidersAtNodes | None
) -> PlanTables:
    """Return the tables of a plan.

    Args:
        plan: Plan of the run.
        prescribed: Prescribed bodies.
        colliders: Colliders at the nodes.
    """
    boundaries = RigidBoundaries(
        np.zeros((0, 64, 4), plan.real), np.zeros((0, 64, 3), plan.real), np.zeros((0, 64), int),
        NO_PRESCRIBED_BODIES if prescribed is None else prescribed.motions,
        getattr(colliders, "is_free", np.zeros(0, bool)),
    )  # fmt: skip
    groups = plan.groups
    adds_own_stress = any(each.separates_stress and not each.shares_space for each in groups)
    return PlanTables(
        wall_table(plan), phase_table(plan), phase_sets(plan), shared_stress(plan),
        int(adds_own_stress), boundaries,
    )  # fmt: skip


def wall_table(plan: Plan) -> Walls:
    """Return the kinds and friction of the six walls, for liquids and for everything else."""
    kinds, for_solids = (
        np.array([KINDS[kind] for kind, _ in walls], np.int64).reshape(3, 2)
        for walls in (plan.walls.liquids, plan.walls.solids)
    )
    friction = np.array([mu for _, mu in plan.walls.liquids]).reshape(3, 2)
    if any(group.volume.separate_pressure for group in plan.groups):
        kinds[kinds == SEPARATE] = RELEASING
    if not plan.separates_stress:
        for_solids[for_solids == SEPARATE] = YIELDING
    for_surfaces = for_solids.copy()
    for plane in plan.planes:
        for_surfaces[plane.axis, plane.side] = 0
    return Walls(np.array(plan.cells), kinds, for_solids, for_surfaces, friction)


def open_wall(walls: Walls, wall: int) -> None:
    """Remove a wall that has vanished.

    Args:
        walls: Kinds and friction (in/out).
        wall: Number of the wall.
    """
    for kinds in walls[1:4]:
        kinds[divmod(wall, 2)] = KINDS["open"]


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
        np.array(plan.contact.friction),
        np.array(plan.contact.stiffness),
        np.array([phase.surface for phase in plan.phases]),
        np.array([phase.meets_walls_by_contact for phase in plan.phases]),
        np.array([phase.is_liquid for phase in plan.phases]),
    )


def phase_sets(plan: Plan) -> np.ndarray:
    """Return the number of the set with one velocity that each phase is in, -1 for none."""
    sets = (feature.phase_sets for feature in plan.features)
    return next((each for each in sets if each is not None), np.full(len(plan.phases), -1))


def shared_stress(plan: Plan) -> np.ndarray:
    """Return 1 for phases whose stress impulses a feature distributes, (phases,); (0,) for none."""
    shared = (feature.shared_stress for feature in plan.features)
    mask = next((each for each in shared if each is not None), np.zeros(0, bool))
    return mask.astype(np.uint8)


def topology_requirements(plan: Plan) -> TopologyRequirements:
    """Return the requirements of the plan for the exchange tables."""
    return TopologyRequirements(
        np.array([group.phase for group in plan.groups], np.int64),
        plan.contact.has_pairs,
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


def _separate_stress(plan: Plan) -> bool | StressProximity:
    """Return where stress impulses are summed separately from momentum."""
    places = (feature.stress_proximity() for feature in plan.features)
    place = next((each for each in places if each is not None), None)
    if place is None:
        return plan.separates_stress
    proximity: StressProximity = place._replace(everywhere=place.everywhere | plan.separates_stress)
    return proximity
