"""Bodies with prescribed motion: moved along a given course, or frozen, whatever they meet.

While its motion is prescribed, a body has a group and a phase of its own with a prescribed
velocity. When it is released, its particles join the group in which they would have begun.
"""

import math
from typing import NamedTuple

import numpy as np

from vgmpi.scene.objects import Object
from vgmpi.scene.rigid_motion import Trajectory
from vgmpi.scene.scene import Scene

from .phases_and_groups import GroupPlan, PhasePlan

TIME_TOLERANCE = 1.0 + 1e-12  # [-] ratio below which two times count as equal

Extents = dict[int, tuple[tuple[float, ...], tuple[float, ...]]]  # object -> corners [m]


class ReleaseLayer(NamedTuple):
    """Horizontal layer of a frozen body, released as a whole."""

    time: float  # [s] of the release
    low: float  # [m] lower end of the range of heights; -inf for the whole body
    high: float  # [m] upper end; inf for the whole body


class PrescribedBodyPlan(NamedTuple):
    """Bodies with identically prescribed motion."""

    objects: tuple[int, ...]  # rows of the scene's objects
    group: int  # group while the motion is prescribed
    group_after_release: int  # group after the release
    course: Trajectory | None  # prescribed motion; None: the bodies are frozen
    about: tuple[float, float, float]  # [m] center of rotation, or their center
    max_radius: float  # [m] largest distance of a particle from the axis of rotation
    layers: tuple[ReleaseLayer, ...]  # in order of time; empty if never released

    @property
    def ends(self) -> float:
        """Time of the first release [s], infinity if there is none."""
        return self.layers[0].time if self.layers else math.inf


def group_identically_driven(scene: Scene) -> list[tuple[int, ...]]:
    """Group the rows of bodies with prescribed motion that are frozen and released identically."""
    rows_by_key: dict[tuple, list[int]] = {}
    for k, entity in enumerate(scene.object):
        if entity.driven:
            key: tuple = (k,)
            if entity.motion is None:
                how = entity.release_time, entity.release_order, entity.release_end_time
                key = ("frozen", scene.phase_of(entity), entity.material, *how)
            rows_by_key.setdefault(key, []).append(k)
    return [tuple(rows) for rows in rows_by_key.values()]


def prescribed_phases(scene: Scene) -> dict[str, tuple[int, ...]]:
    """Return the rows of the bodies of every phase with prescribed motion, by the phase's name."""
    rows_by_name = {}
    for rows in group_identically_driven(scene):
        entity = scene.object[rows[0]]
        rows_by_name[f"{entity.name} ({'driven' if entity.motion else 'frozen'})"] = rows
    return rows_by_name


def prescribed_body_plans(
    scene: Scene, groups: tuple[GroupPlan, ...], group_of: tuple[int, ...],
    phases: tuple[PhasePlan, ...], extents: Extents,
) -> tuple[tuple[PrescribedBodyPlan, ...], tuple[GroupPlan, ...], tuple[int, ...]]:  # fmt: skip
    """Plan the bodies with prescribed motion and the groups that they have meanwhile.

    Args:
        scene: The scene.
        groups: Groups as if no motion were prescribed.
        group_of: Group of each object and particle source, likewise.
        phases: All phases.
        extents: Lower and upper corner of the particles of each such body [m].

    Returns:
        The plans, all groups with the additional ones last, and the initial group of each object
        and particle source.
    """
    number = {phase.name: k for k, phase in enumerate(phases)}
    plans, more, begins = [], list(groups), list(group_of)
    for name, rows in prescribed_phases(scene).items():
        released, first = group_of[rows[0]], scene.object[rows[0]]
        own = groups[released]._replace(
            name=f"{name}/{first.material}", phase=number[name], separates_stress=False,
            shares=False,
            driven=True,
        )  # fmt: skip
        for k in rows:
            begins[k] = len(more)
        boxes = [extents[k] for k in rows if k in extents]
        layers, course, radius = _layers(first, boxes, scene.domain.cell), None, 0.0
        corners = boxes or [((0.0,) * 3, (0.0,) * 3)]
        low, high = np.min([a for a, _ in corners], axis=0), np.max([b for _, b in corners], axis=0)
        about = tuple(0.5 * (low + high))
        if first.motion is not None:
            course = course_of(first, low, high)
            about, radius = course.about, course.max_radius(low, high)
        plans.append(PrescribedBodyPlan(rows, len(more), released, course, about, radius, layers))
        more.append(own)
    return tuple(plans), tuple(more), tuple(begins)


def course_of(obj: Object, low, high) -> Trajectory:
    """Return the motion of a body whose particles lie between two corners, shape (3,) [m].

    The body rotates about the center of that box unless its motion says otherwise.
    """
    assert obj.motion is not None
    x, y, z = (float(a + b) / 2 for a, b in zip(low, high, strict=True))
    return Trajectory(obj.motion, obj.motion.pivot or (x, y, z))


def _layers(obj: Object, boxes: list, dx: float) -> tuple[ReleaseLayer, ...]:
    """Return the layers of a body in order of release; `boxes` are the extents of its particles."""
    if obj.motion is not None:
        ends = obj.motion.ends
        return (ReleaseLayer(ends, -math.inf, math.inf),) if ends < math.inf else ()
    assert obj.release_time is not None
    if obj.release_order is None or obj.release_end_time is None:
        return (ReleaseLayer(obj.release_time, -math.inf, math.inf),)
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
