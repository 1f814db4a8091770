"""Requirements of a scene for the exchange tables."""

import numpy as np

from vgmpi.materials.couplings.interaction import CONTACT, MIXING
from vgmpi.parallel import exchange_topology
from vgmpi.planning.plan import Plan

from .engines.nodal_field_storage import fields_near_colliders
from .engines.surface_fields import is_summed_at_surfaces


def needs(plan: Plan) -> exchange_topology.TopologyRequirements:
    """Return the requirements of the plan for the exchange tables."""
    phase_of, color_counts = (np.array(rows, np.int64) for rows in zip(
        *((group.phase, group.coefficients) for group in plan.groups), strict=True
    ))  # fmt: skip
    surface = np.array([phase.surface for phase in plan.phases])
    return exchange_topology.TopologyRequirements(
        phase_of,
        plan.contact,
        _separate_stress(plan),
        color_counts,
        surface,
        plan.planes,
        plan.has_surface_friction,
        np.array([phase.fills_by_volume for phase in plan.phases]),
        fields_near_colliders(plan),
        is_summed_at_surfaces(plan),
        plan.implicit_pressure,
        np.array(() if plan.slip_of_solids is None else plan.slip_of_solids.phases, bool),
    )


def _separate_stress(plan: Plan) -> bool | exchange_topology.MixtureProximity:
    """Return where stress impulses are summed separately: with FLIP and in mixtures."""
    rules = plan.rules
    if rules is None:
        return plan.keeps is not None
    same_mixture = rules.mixture_set[:, None] == rules.mixture_set[None, :]
    shares_space = (
        same_mixture & (rules.mixture_set >= 0)[:, None] & ~np.eye(len(same_mixture), dtype=bool)
    )
    needs_contact = (rules.pair == CONTACT) & ~np.eye(len(same_mixture), dtype=bool)
    needs_contact |= (rules.pair == MIXING) & rules.drifting[:, None]
    return exchange_topology.MixtureProximity(
        shares_space, needs_contact, rules.fluid, plan.keeps is not None
    )
