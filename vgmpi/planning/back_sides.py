"""Sides of thin walls: of every phase that flows, what lies on their back side is a phase apart."""

from typing import NamedTuple

from vgmpi.scene.scene import Scene

from .phases_and_groups import GroupPlan, PhasePlan

BACK_SIDE = "back side"  # in names of phases and groups


class WallSidesPlan(NamedTuple):
    """Phases and groups on the two sides of thin walls."""

    side: tuple[int, ...]  # (phases,) 1: front side, -1: back side, 0: of no side
    twin: tuple[int, ...]  # (phases,) the same phase on the other side, -1 for none
    twin_group: tuple[int, ...]  # (groups,) the same group on the other side, -1 for none


def with_back_sides(
    scene: Scene, groups: tuple[GroupPlan, ...], phases: tuple[PhasePlan, ...]
) -> tuple[tuple[GroupPlan, ...], tuple[PhasePlan, ...], WallSidesPlan | None]:
    """Return groups and phases with those on the back side of thin walls behind the others.

    Solids and bodies with prescribed motion have no sides.

    Args:
        scene: The scene.
        groups: All groups.
        phases: All phases.

    Returns:
        The groups, the phases and the sides, None without thin walls.

    Raises:
        SceneError: Colors travel with the steps.
    """
    thin = [k for k, obj in enumerate(scene.object) if obj.thin]
    if not thin:
        return groups, phases, None
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
    back_of = [back.get(p, -1) for p in range(len(phases))]
    back_group_of = [-1] * len(groups)
    for k, g in enumerate(sided):
        back_group_of[g] = len(groups) + k
    sides = WallSidesPlan(
        tuple(int(p in back) for p in range(len(phases))) + (-1,) * len(more),
        (*back_of, *flowing),
        (*back_group_of, *sided),
    )
    return (*groups, *back_groups), (*phases, *more), sides


def _flows(phase: PhasePlan) -> bool:
    """Return whether a phase flows, so that it has two sides."""
    return not (phase.driven or phase.surface or "solid" in phase.families)
