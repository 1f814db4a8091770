"""Plan of color transfer: whose colors mix, and the scaling of the coefficients."""

from typing import Any, NamedTuple

import numpy as np

from vgmpi.gaussians.spherical_harmonics import COEFFICIENTS
from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft
from vgmpi.planning.phases_and_groups import GroupPlan, color_sets
from vgmpi.planning.plan import Plan
from vgmpi.planning.step_costs import StageCost, StepCosts
from vgmpi.scene.scene import Scene

CHANNEL = "color"  # of the particles


class ColorExchange(NamedTuple):
    """Colors that are transferred in every step, as spherical harmonics.

    Particles carry the difference from `minimum`, so that equal colors stay exactly equal.
    """

    set_of: np.ndarray  # (phases,) exchange set; phases of one set exchange; -1: none
    coefficients: np.ndarray  # (phases,) coefficients per particle; 0: none travel
    minimum: np.ndarray  # (phases, K, 3) minimum over the set, which is subtracted
    span: np.ndarray  # (phases, K) largest remaining value


class ColorTransferPlan(FeaturePlan):
    """Colors of a run that travel with the steps.

    Attributes:
        exchange: Who exchanges them.
    """

    name, title = "color_transfer", "colors that travel"
    particle_channels = (CHANNEL,)

    def __init__(self, exchange: ColorExchange):
        """Take the exchange."""
        self.exchange = exchange
        self.summed_fields = int(exchange.coefficients.max())
        self.frame_bytes = 4 * 3 * self.summed_fields

    def particle_cost(self, group: GroupPlan, costs: StepCosts) -> StageCost | None:
        """Return the price of the colors of a particle.

        Args:
            group, costs: See `FeaturePlan.particle_cost`.
        """
        count = count_of(group)
        return count * costs.carried_values if count else None

    def field_requests(self, plan: Plan) -> tuple:
        """Return the request for a nodal field of each coefficient."""
        from .coupling import request_color  # it compiles

        return tuple(request_color(plan, self.exchange, k) for k in range(self.summed_fields))

    def start(self, context: Any) -> Any:
        """Return the colors as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import ColorTransfer  # it compiles

        return ColorTransfer(self.exchange)


def count_of(group: GroupPlan) -> int:
    """Return the number of color coefficients that a particle of a group carries."""
    return group.channels[CHANNEL].width // 3 if CHANNEL in group.channels else 0


def plan_colors(
    draft: PlanDraft, ranges: np.ndarray | None
) -> tuple[ColorTransferPlan | None, PlanDraft]:
    """Plan the colors that travel.

    Args:
        draft: Phases and groups.
        ranges: Result of `coefficient_ranges`, None if unknown.

    Returns:
        The plan, None if all colors are equal, and the draft with channels of their groups.
    """
    exchange = color_exchange(draft.scene, draft.phases, ranges)
    if exchange is None:
        return None, draft
    groups = tuple(
        group._replace(
            extra_channels=(*group.extra_channels, (CHANNEL, "1", 3 * count)),
        )
        if (count := int(exchange.coefficients[group.phase]))
        else group
        for group in draft.groups
    )
    return ColorTransferPlan(exchange), draft._replace(groups=groups)


def color_exchange(scene: Scene, phases, shades: np.ndarray | None) -> ColorExchange | None:
    """Return the color exchange of a scene, or None if no color travels with the steps.

    A set of a single color takes no part.

    Args:
        scene: The scene.
        phases: `PhasePlan` of each phase.
        shades: Minimum and maximum of each color coefficient by object, shape (objects, 2, K, 3),
            NaN for objects without particles; None if unknown.
    """
    if scene.appearance.color_transfer != "step":
        return None
    travelling = _travelling_objects(scene)
    width = COEFFICIENTS[scene.appearance.color_sh_degree]
    if shades is None:
        shades = np.zeros((len(scene.entities), 2, width, 3)) + np.array([0.0, 1.0])[:, None, None]
    shades = shades[:, :, :width]
    set_of = np.full(len(phases), -1)
    count = np.zeros(len(phases), np.int64)
    minimum = np.zeros((len(phases), *shades.shape[2:]))
    span = np.zeros(minimum.shape[:2])
    sets: dict[int | None, list[int]] = {}
    meets = color_sets(scene)
    for k, phase in enumerate(phases):
        if travelling & set(phase.objects):
            sets.setdefault(meets[phase.objects[0]], []).append(k)
    for number, members in enumerate(sets.values()):
        # The higher degrees of a rotating body are expressed in axes that rotate with it.
        turns = any("solid" in phases[k].families for k in members)
        every = [shades[m] for k in members for m in phases[k].objects]
        ranges = np.array([values for values in every if not np.isnan(values).any()])
        ranges = ranges[:, :, : 1 if turns else width]
        if not len(ranges) or (ranges == ranges[0, 0]).all():
            continue
        for k in members:
            set_of[k], count[k] = number, ranges.shape[2]
            minimum[k, : ranges.shape[2]] = ranges.min(axis=(0, 1))
            span[k, : ranges.shape[2]] = np.ptp(ranges, axis=(0, 1)).max(-1)
    return ColorExchange(set_of, count, minimum, span) if count.any() else None


def _travelling_objects(scene: Scene) -> set[int]:
    """Return the rows of the objects whose colors travel."""
    names = scene.appearance.color_objects
    rows = set()
    for k, entity in enumerate(scene.entities):
        if entity.material:
            fluid = scene.material[entity.material].family == "fluid"
            if fluid if names is None else entity.name in names:
                rows.add(k)
    return rows


def coefficient_ranges(count: int, object_of, sh) -> np.ndarray:
    """Return the minimum and maximum of each color coefficient, by object.

    Args:
        count: Number of objects.
        object_of: Object of each particle, shape (n,).
        sh: Spherical-harmonic coefficients, shape (n, K, 3).

    Returns:
        Shape (count, 2, K, 3), NaN for objects without particles.
    """
    object_of, sh = np.asarray(object_of), np.asarray(sh, np.float64)
    out = np.full((count, 2, *sh.shape[1:]), np.nan)
    for k in range(count):
        mine = sh[object_of == k]
        if len(mine):
            out[k] = mine.min(axis=0), mine.max(axis=0)
    return out
