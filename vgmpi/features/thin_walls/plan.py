"""Plan of thin walls: of every phase that flows, what lies on their back side is a phase apart."""

from typing import Any

import numpy as np

from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft
from vgmpi.planning.phases_and_groups import PhasePlan
from vgmpi.planning.plan import Plan
from vgmpi.runtime.config.toml_source import escape_control_characters

BACK_SIDE = "back side"  # in names of phases and groups


class ThinWallsPlan(FeaturePlan):
    """Phases and groups on the two sides of thin walls.

    Attributes:
        walls: Names of the walls.
        side: 1: front side, -1: back side, 0: of no side, (phases,).
        twin: The same phase on the other side, -1 for none, (phases,).
        twin_group: The same group on the other side, -1 for none, (groups,).
    """

    name = "thin_walls"
    reads_all_nodes = True
    step_seconds = 3e-3  # in one step in which sides are found

    def __init__(
        self, walls: tuple[str, ...], side: tuple[int, ...], twin: tuple[int, ...],
        twin_group: tuple[int, ...],
    ):  # fmt: skip
        """Take the walls and the sides of phases and groups."""
        self.walls, self.side, self.twin, self.twin_group = walls, side, twin, twin_group
        self.added_phases = side.count(-1)

    def may_hold(self, group: int, usual: np.ndarray) -> np.ndarray:
        """Return which particles may be in a group, since they are on the back side of a wall.

        Args:
            group, usual: See `FeaturePlan.may_hold`.
        """
        return np.array(self.twin_group)[usual] == group

    def report_lines(self, plan: Plan) -> list[str]:
        """Return the line that names the walls."""
        names = ", ".join(map(escape_control_characters, self.walls))
        return [f"  thin walls  {names}: what flows on one side does not feel the other"]

    def start(self, context: Any) -> Any:
        """Return the walls as they act in a run, or None if no collider is evaluated in its steps.

        Args:
            context: See `FeaturePlan.start`.
        """
        if context.movers is None:
            return None
        from .coupling import ThinWalls  # it compiles

        return ThinWalls(self, context)


def plan_thin_walls(draft: PlanDraft) -> tuple[ThinWallsPlan, PlanDraft]:
    """Plan the sides of thin walls. Solids and bodies with prescribed motion have none.

    Args:
        draft: Phases and groups of a scene with thin walls.

    Returns:
        The plan, and the draft with phases and groups on back sides behind the others.

    Raises:
        SceneError: Colors travel with the steps.
    """
    scene, phases, groups = draft.scene, draft.phases, draft.groups
    thin = [k for k, obj in enumerate(scene.object) if obj.thin]
    if scene.appearance.color_transfer == "step":
        message = 'is not for appearance.color_transfer = "step"'
        raise scene.error([(("object", thin[0], "thin"), message)])
    flowing = [p for p, phase in enumerate(phases) if _flows(phase)]
    back = {p: len(phases) + k for k, p in enumerate(flowing)}
    # either side of a material comes before both sides of the next one
    more = tuple(
        phases[p]._replace(
            name=f"{phases[p].name} ({BACK_SIDE})",
            contact_priority=2 * phases[p].contact_priority + 1,
        )
        for p in flowing
    )
    phases = tuple(p._replace(contact_priority=2 * p.contact_priority) for p in phases)
    sided = [g for g, group in enumerate(groups) if group.phase in back]
    back_groups = tuple(
        groups[g]._replace(
            name=f"{groups[g].name} ({BACK_SIDE})", phase=back[groups[g].phase]
        )
        for g in sided
    )  # fmt: skip
    back_group_of = [-1] * len(groups)
    for k, g in enumerate(sided):
        back_group_of[g] = len(groups) + k
    plan = ThinWallsPlan(
        tuple(scene.object[k].name for k in thin),
        tuple(int(p in back) for p in range(len(phases))) + (-1,) * len(more),
        (*(back.get(p, -1) for p in range(len(phases))), *flowing),
        (*back_group_of, *sided),
    )
    return plan, draft._replace(phases=(*phases, *more), groups=(*groups, *back_groups))


def _flows(phase: PhasePlan) -> bool:
    """Return whether a phase flows, so that it has two sides."""
    return not (phase.driven or phase.surface or "solid" in phase.families)
