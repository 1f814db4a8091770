"""Friction and slip of phases on each other and on colliders."""

import math
from typing import NamedTuple

import numpy as np

from vgmpi.materials.couplings.contact_rule import Contact
from vgmpi.scene.scene import Scene
from vgmpi.scene.slip_lengths import dynamic_viscosity

from .phases_and_groups import GroupPlan

# a boundary layer over this length [cells], of a flow that fell as far, is compared with the cells
FLOW_LENGTH_CELLS = 10.0
RESOLVED_LAYER_CELLS = 3.0  # [cells] thickness of a boundary layer above which a liquid sticks


class SurfaceSlipPlan(NamedTuple):
    """Slip of viscous liquids on colliders, or on solids."""

    # (colliders, phases) or (phases, phases) [m] slip lengths, inf: free slip
    lengths: tuple[tuple[float, ...], ...]
    viscosities: tuple[float, ...]  # (phases,) [Pa s] dynamic viscosity

    @property
    def phases(self) -> tuple[bool, ...]:
        """Return whether each phase has a finite slip length on something, by phase."""
        return tuple(min(column) < math.inf for column in zip(*self.lengths, strict=True))


def friction_table(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: int
) -> tuple[tuple[float, ...], ...]:
    """Return the friction of every pair of phases, and of phases on colliders.

    If several materials meet in one pair of phases, the largest coefficient counts.
    """
    own = [obj.friction for obj in scene.object if obj.collider]
    own = own if any(mu is not None for mu in own) else [None]
    named = {frozenset(c.between): c.friction for c in scene.coupling if isinstance(c, Contact)}
    out = np.zeros((phases + len(own), phases))
    for a in groups:
        material = scene.material[a.material]
        out[phases:, a.phase] = np.maximum(
            out[phases:, a.phase], Contact.default_friction(material, material)
        )
        for b in groups:
            default = Contact.default_friction(material, scene.material[b.material])
            mu = named.get(frozenset((a.material, b.material)), default)
            out[a.phase, b.phase] = max(out[a.phase, b.phase], mu)
    for c, value in enumerate(own):
        if value is not None:
            out[phases + c] = value
    return tuple(tuple(float(v) for v in row) for row in out)


def surface_slip_plan(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: int
) -> SurfaceSlipPlan | None:
    """Return the slip of viscous liquids on colliders, or None if they slip freely on all.

    If several liquids share a phase, the largest viscosity counts.
    """
    own = [math.inf if o.slip_length is None else o.slip_length for o in scene.object if o.collider]
    if not any(length < math.inf for length in own):
        return None
    viscosities = _viscosities(scene, groups, phases)
    lengths = tuple(
        tuple(length if eta > 0.0 else math.inf for eta in viscosities) for length in own
    )
    return SurfaceSlipPlan(lengths, viscosities)


def _viscosities(scene: Scene, groups: tuple[GroupPlan, ...], phases: int) -> tuple[float, ...]:
    """Return the largest dynamic viscosity in each phase [Pa s], 0 for all but viscous liquids."""
    viscosities = [0.0] * phases
    for group in groups:
        value = dynamic_viscosity(scene.material[group.material])
        viscosities[group.phase] = max(viscosities[group.phase], value)
    return tuple(viscosities)


def slip_of_solids(
    scene: Scene, groups: tuple[GroupPlan, ...], group_of: tuple[int, ...], phases: int
) -> SurfaceSlipPlan | None:
    """Return the slip of viscous liquids on solids, or None if they slip freely on all.

    Where several solids share a phase, the smallest slip length counts.

    Args:
        scene: The scene.
        groups: All groups.
        group_of: Group of each object.
        phases: Number of phases.

    Returns:
        Its slip lengths are symmetric: (phases, phases).
    """
    rows = {k: o.slip_length for k, o in enumerate(scene.object) if o.material and not o.rigid}
    own = {k: length for k, length in rows.items() if length is not None}
    if not own:
        return None
    viscosities = _viscosities(scene, groups, phases)
    lengths = np.full((phases, phases), np.inf)
    for k, length in own.items():
        solid = groups[group_of[k]].phase
        for p in np.flatnonzero(viscosities):
            lengths[solid, p] = lengths[p, solid] = min(length, lengths[solid, p])
    return SurfaceSlipPlan(tuple(tuple(map(float, row)) for row in lengths), viscosities)


def liquids_expected_to_stick(scene: Scene) -> dict[str, float]:
    """Return viscous liquids whose boundary layers the cells resolve, with the thickness [cells].

    The layer is that of Blasius, 5 sqrt(nu L / U), over a length L of ten cells at the speed U of a
    fall over ten cells. The thickness is infinite for liquids with a yield stress.

    References:
        Schlichting (1979): Boundary-layer theory, section 7.
    """
    length = FLOW_LENGTH_CELLS * scene.domain.cell
    speed = math.sqrt(2.0 * math.hypot(*scene.domain.gravity) * length)
    if speed == 0.0:
        return {}
    thick = {}
    for name, material in scene.material.items():
        eta = dynamic_viscosity(material)
        layer = 5.0 * math.sqrt(eta / material.bulk_density * length / speed)
        if layer >= RESOLVED_LAYER_CELLS * scene.domain.cell:
            thick[name] = layer / scene.domain.cell
    return thick
