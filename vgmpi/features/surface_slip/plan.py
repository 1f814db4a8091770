"""Plan of the slip of viscous liquids on colliders, rigid bodies and solids."""

import math
from typing import Any, NamedTuple

import numpy as np

from vgmpi.parallel.exchange_topology import GRADIENTS
from vgmpi.planning.feature_plan import Adhesion, FeaturePlan, PlanDraft
from vgmpi.planning.plan import Plan
from vgmpi.runtime.config.toml_source import escape_control_characters


class SlipLengths(NamedTuple):
    """Objects with a slip length, for the report."""

    name: str
    length: float  # [m]


class SurfaceSlipPlan(FeaturePlan):
    """Slip of viscous liquids of a run.

    Attributes:
        on_colliders: Slip on each collider, or None if liquids slip freely on all.
        on_solids: Slip of each phase on each, symmetric, or None if liquids slip freely on solids.
    """

    name = "surface_slip"
    nodal_fields = frozenset(GRADIENTS)

    def __init__(
        self, objects: tuple[SlipLengths, ...], on_colliders: Adhesion | None,
        on_solids: Adhesion | None,
    ):  # fmt: skip
        """Take the slip on colliders and on solids."""
        self.objects, self.on_colliders, self.on_solids = objects, on_colliders, on_solids
        laws = [law for law in (on_colliders, on_solids) if law is not None]
        self.phases = frozenset().union(*(_finite(law) for law in laws))
        self.adhesion = on_colliders
        self.numbers_colliders = on_colliders is not None
        self.phases_in_contact = frozenset() if on_solids is None else _finite(on_solids)
        self.reads_all_nodes = on_solids is not None

    def report_lines(self, plan: Plan) -> list[str]:
        """Return a line on each object on which the slip of viscous liquids is limited."""
        return [
            f"  slip        {escape_control_characters(obj.name)}: viscous liquids"
            + (f" slip with a length of {obj.length:g} m" if obj.length else " stick to it")
            for obj in self.objects
        ]

    def start(self, context: Any) -> Any:
        """Return the slip as it acts in a run, or None if liquids slip freely on what it has.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import start  # it compiles

        return start(self, context)


def _finite(law: Adhesion) -> frozenset[int]:
    """Return the phases with a finite slip length on something."""
    columns = enumerate(zip(*law.lengths, strict=True))
    return frozenset(p for p, column in columns if min(column) < math.inf)


def plan_surface_slip(draft: PlanDraft) -> SurfaceSlipPlan:
    """Plan the slip of viscous liquids; if several share a phase, the largest viscosity counts.

    It is infinite where the stress of particles does not tell it.

    Args:
        draft: Phases and groups of a scene with slip lengths.
    """
    viscosities = [0.0] * len(draft.phases)
    for group in draft.groups:
        value = draft.scene.material[group.material].dynamic_viscosity
        if value and group.separate_viscosity:
            value = math.inf  # no stress of particles is to be shared among the nodes
        viscosities[group.phase] = max(viscosities[group.phase], value)
    objects = tuple(
        SlipLengths(obj.name, obj.slip_length)
        for obj in draft.scene.object
        if obj.slip_length is not None
    )
    eta = tuple(viscosities)
    return SurfaceSlipPlan(objects, _slip_on_colliders(draft, eta), _slip_on_solids(draft, eta))


def _slip_on_colliders(draft: PlanDraft, viscosities: tuple[float, ...]) -> Adhesion | None:
    """Return the slip on each collider, or None if liquids slip freely on all.

    Args:
        draft: Phases and groups of the scene.
        viscosities: Viscosity of each phase [Pa s].
    """
    colliders = [obj for obj in draft.scene.object if obj.collider]
    own = [math.inf if obj.slip_length is None else obj.slip_length for obj in colliders]
    if not any(length < math.inf for length in own):
        return None
    lengths = tuple(
        tuple(length if eta > 0.0 else math.inf for eta in viscosities) for length in own
    )
    return Adhesion(lengths, viscosities)


def _slip_on_solids(draft: PlanDraft, viscosities: tuple[float, ...]) -> Adhesion | None:
    """Return the slip of phases on each other, or None if liquids slip freely on solids.

    Where several solids share a phase, the smallest slip length counts.

    Args:
        draft: Phases and groups of the scene.
        viscosities: Viscosity of each phase [Pa s].
    """
    objects = enumerate(draft.scene.object)
    rows = {k: obj.slip_length for k, obj in objects if obj.material and not obj.rigid}
    own = {k: length for k, length in rows.items() if length is not None}
    if not own:
        return None
    lengths = np.full((len(draft.phases), len(draft.phases)), np.inf)
    for k, length in own.items():
        solid = draft.groups[draft.group_of[k]].phase
        for p in np.flatnonzero(viscosities):
            lengths[solid, p] = lengths[p, solid] = min(length, lengths[solid, p])
    return Adhesion(tuple(tuple(map(float, row)) for row in lengths), viscosities)
