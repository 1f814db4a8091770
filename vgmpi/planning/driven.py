"""Bodies that are driven: moved as the scene says, or held, whatever meets them.

While it is driven a body has a group and a phase of its own, whose velocity is prescribed; when it
is let go its particles join the group in which they would have begun.
"""

import math
from typing import NamedTuple

import numpy as np

from ..scene.motion import Course
from ..scene.objects import Object
from ..scene.scene import Scene
from .groups import GroupPlan, PhasePlan

Extents = dict[int, tuple[tuple[float, ...], tuple[float, ...]]]


class Layer(NamedTuple):
    """What is let go at once."""

    time: float  # [s]
    low: float  # [m] range of heights; beyond both ends for all
    high: float


class DrivenPlan(NamedTuple):
    """Bodies that are driven alike."""

    things: tuple[int, ...]  # rows of the scene's objects
    group: int  # as long as they are driven
    joins: int  # the group afterwards
    course: Course | None  # how they move; None: they are held
    about: tuple[float, float, float]  # [m] what they turn about, or their middle
    far: float  # [m] of a particle from the axis they turn about, at the most
    layers: tuple[Layer, ...]  # in order of time; none where they are never let go

    @property
    def ends(self) -> float:
        """When the first of it is let go [s]."""
        return self.layers[0].time if self.layers else math.inf


def alike(scene: Scene) -> list[tuple[int, ...]]:
    """Rows of the bodies that are driven, those together that are held and let go alike."""
    found: dict[tuple, list[int]] = {}
    for k, thing in enumerate(scene.object):
        if thing.driven:
            key: tuple = (k,)
            if thing.motion is None:
                how = thing.frozen_until, thing.release, thing.released_by
                key = ("frozen", scene.phase_of(thing), thing.material, *how)
            found.setdefault(key, []).append(k)
    return [tuple(rows) for rows in found.values()]


def driven_phases(scene: Scene) -> dict[str, tuple[int, ...]]:
    """The bodies of every phase of what is driven, by its name."""
    found = {}
    for rows in alike(scene):
        thing = scene.object[rows[0]]
        found[f"{thing.name} ({'driven' if thing.motion else 'frozen'})"] = rows
    return found


def driven_plans(
    scene: Scene, groups: tuple[GroupPlan, ...], group_of: tuple[int, ...],
    phases: tuple[PhasePlan, ...], extents: Extents,
) -> tuple[tuple[DrivenPlan, ...], tuple[GroupPlan, ...], tuple[int, ...]]:  # fmt: skip
    """What is driven; the groups with those of it; and the group in which each thing begins.
    groups, group_of: as if nothing were driven; extents: lower and upper corner [m] of the
    particles of what is driven."""
    number = {phase.name: k for k, phase in enumerate(phases)}
    plans, more, begins = [], list(groups), list(group_of)
    for name, rows in driven_phases(scene).items():
        joins, first = group_of[rows[0]], scene.object[rows[0]]
        own = groups[joins]._replace(
            name=f"{name}/{first.material}", phase=number[name], apart=False, shares=False,
            driven=True,
        )  # fmt: skip
        for k in rows:
            begins[k] = len(more)
        boxes = [extents[k] for k in rows if k in extents]
        layers, course, far = _layers(first, boxes, scene.domain.cell), None, 0.0
        corners = boxes or [((0.0,) * 3, (0.0,) * 3)]
        low, high = np.min([a for a, _ in corners], axis=0), np.max([b for _, b in corners], axis=0)
        about = tuple(0.5 * (low + high))
        if first.motion is not None:
            course = course_of(first, low, high)
            about, far = course.about, course.far(low, high)
        plans.append(DrivenPlan(rows, len(more), joins, course, about, far, layers))
        more.append(own)
    return tuple(plans), tuple(more), tuple(begins)


def course_of(thing: Object, low, high) -> Course:
    """The motion of a body whose particles lie between two corners (3,) [m]: about their middle
    where it says nothing else."""
    assert thing.motion is not None
    x, y, z = (float(a + b) / 2 for a, b in zip(low, high, strict=True))
    return Course(thing.motion, thing.motion.about or (x, y, z))


def _layers(thing: Object, boxes: list, dx: float) -> tuple[Layer, ...]:
    """When what is let go."""
    if thing.motion is not None:
        ends = thing.motion.ends
        return (Layer(ends, -math.inf, math.inf),) if ends < math.inf else ()
    assert thing.frozen_until is not None
    if thing.release is None or thing.released_by is None:
        return (Layer(thing.frozen_until, -math.inf, math.inf),)
    first = min((math.floor(low[2] / dx) for low, _ in boxes), default=0)
    count = max((math.ceil(high[2] / dx) for _, high in boxes), default=1) - first
    edges = [-math.inf, *((first + k) * dx for k in range(1, count)), math.inf]
    heights = list(zip(edges, edges[1:]))
    if thing.release == "from above":
        heights.reverse()
    lasts = (thing.released_by - thing.frozen_until) / max(count - 1, 1)
    return tuple(Layer(thing.frozen_until + k * lasts, *height) for k, height in enumerate(heights))
