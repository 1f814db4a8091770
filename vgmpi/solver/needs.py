"""What a scene asks of the tables."""

import numpy as np

from ..couplings.base import CONTACT, MIXING
from ..domain import topology
from ..planning.plan import Plan


def needs(plan: Plan) -> topology.Needs:
    """What the scene asks of the tables."""
    phase_of, hues = (np.array(rows, np.int64) for rows in zip(
        *((group.phase, group.coefficients) for group in plan.groups), strict=True
    ))  # fmt: skip
    surface = np.array([phase.surface for phase in plan.phases])
    return topology.Needs(
        phase_of, plan.contact, _apart(plan), hues, surface, plan.planes, plan.rubs
    )


def _apart(plan: Plan) -> bool | topology.Near:
    """Where the stress's impulses are kept apart: for FLIP, and where phases share space."""
    rules = plan.rules
    if rules is None:
        return plan.keeps is not None
    same = rules.together[:, None] == rules.together[None, :]
    shares = same & (rules.together >= 0)[:, None] & ~np.eye(len(same), dtype=bool)
    asks = (rules.pair == CONTACT) & ~np.eye(len(same), dtype=bool)
    asks |= (rules.pair == MIXING) & rules.drifting[:, None]
    return topology.Near(shares, asks, rules.fluid, plan.keeps is not None)
