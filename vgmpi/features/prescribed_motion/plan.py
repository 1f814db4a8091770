"""Bodies with prescribed motion: moved along a given course, or frozen, whatever they meet.

While its motion is prescribed, a body has a group and a phase of its own with a prescribed
velocity. When it is released, its particles join the group in which they would have begun.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from vgmpi.planning.feature_plan import FeaturePlan, PlanDraft, ReleasedParticles, ReleaseLayer
from vgmpi.planning.plan import Plan
from vgmpi.scene.rigid_motion import Trajectory, course_of

Extents = dict[int, tuple[tuple[float, ...], tuple[float, ...]]]  # object -> corners [m]


class PrescribedBodyPlan(NamedTuple):
    """Bodies with identically prescribed motion."""

    objects: tuple[int, ...]  # rows of the scene's objects
    phase: int  # phase while the motion is prescribed
    particles: ReleasedParticles
    about: tuple[float, float, float]  # [m] center of rotation, or their center
    max_radius: float  # [m] largest distance of a particle from the axis of rotation

    @property
    def ends(self) -> float:
        """Time of the first release [s], infinity if there is none."""
        return self.particles.layers[0].time if self.particles.layers else math.inf


class PrescribedMotionPlan(FeaturePlan):
    """Bodies with prescribed motion of a run."""

    name = "prescribed_motion"

    def __init__(self, bodies: tuple[PrescribedBodyPlan, ...]):
        """Take the bodies."""
        self.bodies = bodies

    def released_particles(self) -> list[ReleasedParticles]:
        """Return the particles of the bodies, which are released as a whole or in layers."""
        return [body.particles for body in self.bodies]

    def groups_after_release(self) -> dict[int, int]:
        """Return the group that each body joins, by its row."""
        return {k: body.particles.group_after_release for body in self.bodies for k in body.objects}

    def reserved_bytes(self, plan: Plan) -> int:
        """Return the memory [bytes] of the particles in the groups that they join."""
        return sum(
            int(
                sum(plan.count[k] for k in body.objects)
                * 1.4
                * plan.bytes_per_particle(body.particles.group_after_release)
            )
            for body in self.bodies
        )

    def courses(self) -> list[tuple[Trajectory, float]]:
        """Return the motion of each body that moves and its largest radius about the axis [m]."""
        pairs = ((body.particles.course, body.max_radius) for body in self.bodies)
        return [(course, radius) for course, radius in pairs if course is not None]

    def reaction_bodies(self) -> list[tuple[tuple[int, ...], tuple[float, ...]]]:
        """Return the bodies with their centers of rotation."""
        return [(body.objects, body.about) for body in self.bodies]

    def phase_motions(self, plan: Plan, first_row: int) -> Any:
        """Return the motions of the bodies' phases.

        Args:
            plan, first_row: See `FeaturePlan.phase_motions`.
        """
        from .coupling import PrescribedBodies  # it compiles

        return PrescribedBodies(self.bodies, plan, first_row)

    def start(self, context: Any) -> Any:
        """Return the bodies as they act in a run.

        Args:
            context: See `FeaturePlan.start`.
        """
        from .coupling import PrescribedMotion  # it compiles

        return PrescribedMotion(self, context)


def plan_prescribed_motion(
    draft: PlanDraft, extents: Extents, phases: dict[str, tuple[int, ...]]
) -> tuple[PrescribedMotionPlan, PlanDraft]:
    """Plan the bodies with prescribed motion and the groups that they have meanwhile.

    Args:
        draft: Phases and groups as if no motion were prescribed.
        extents: Lower and upper corner of the particles of each such body [m].
        phases: Rows of the bodies of each phase with prescribed motion, by its name.

    Returns:
        The plan, and the draft with the additional groups last, in which the bodies begin.
    """
    number = {phase.name: k for k, phase in enumerate(draft.phases)}
    bodies, groups, group_of = [], list(draft.groups), list(draft.group_of)
    for name, rows in phases.items():
        released, first = draft.group_of[rows[0]], draft.scene.object[rows[0]]
        own = draft.groups[released]._replace(
            name=f"{name}/{first.material}", phase=number[name], separates_stress=False,
            shares_space=False, driven=True,
        )  # fmt: skip
        boxes = [extents[k] for k in rows if k in extents]
        layers, course, radius = _layers(first, boxes, draft.scene.domain.cell), None, 0.0
        corners = boxes or [((0.0,) * 3, (0.0,) * 3)]
        low, high = np.min([a for a, _ in corners], axis=0), np.max([b for _, b in corners], axis=0)
        about = tuple(0.5 * (low + high))
        if first.motion is not None:
            course = course_of(first.motion, low, high)
            about, radius = course.about, course.max_radius(low, high)
        particles = ReleasedParticles(len(groups), released, course, layers)
        bodies.append(PrescribedBodyPlan(rows, own.phase, particles, about, radius))
        for k in rows:
            group_of[k] = len(groups)
        groups.append(own)
    draft = draft._replace(groups=tuple(groups), group_of=tuple(group_of))
    return PrescribedMotionPlan(tuple(bodies)), draft


def _layers(obj: Any, boxes: list, dx: float) -> tuple[ReleaseLayer, ...]:
    """Return the layers of a body in order of release; `boxes` are the extents of its particles."""
    if obj.motion is not None:
        ends = obj.motion.ends
        return (ReleaseLayer(ends),) if ends < math.inf else ()
    assert obj.release_time is not None
    if obj.release_order is None or obj.release_end_time is None:
        return (ReleaseLayer(obj.release_time),)
    first = min((math.floor(low[2] / dx) for low, _ in boxes), default=0)
    count = max((math.ceil(high[2] / dx) for _, high in boxes), default=1) - first
    edges = [-math.inf, *((first + k) * dx for k in range(1, count)), math.inf]
    heights = list(zip(edges, edges[1:]))
    if obj.release_order == "top-down":
        heights.reverse()
    lasts = (obj.release_end_time - obj.release_time) / max(count - 1, 1)
    return tuple(
        ReleaseLayer(obj.release_time + k * lasts, *height) for k, height in enumerate(heights)
    )
