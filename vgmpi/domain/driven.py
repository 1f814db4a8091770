"""Bodies that are driven, as the grid sees them step by step: where every point of each goes."""

from typing import NamedTuple

import numpy as np

from ..planning.plan import Plan
from ..scene.motion import Courses
from .movers import shortened

TURNED = ("H", "F")  # channels that turn with what is driven: F - I, the law's or beside it
HEAVY = 2.0**60  # what is driven has so many times its mass in contact: nothing turns it aside


class Ways(NamedTuple):
    """How what was at x goes in a step, by phases: (turn (x - about) + shift) dt."""

    driven: np.ndarray  # (phases,) bool
    row: np.ndarray  # (phases,) of what they give, -1 of others: behind all colliders
    about: np.ndarray  # (phases, 3) [m]
    turn: np.ndarray  # (phases, 3, 3) [1/s]
    shift: np.ndarray  # (phases, 3) [m/s]


def _none(phases: int) -> Ways:
    """Ways of phases of which none is driven."""
    return Ways(
        np.zeros(phases, bool), np.full(phases, -1), np.zeros((phases, 3)),
        np.zeros((phases, 3, 3)), np.zeros((phases, 3)),
    )  # fmt: skip


NOTHING = _none(0)


class Driven:
    """What is driven. All ranks know the same."""

    def __init__(self, plan: Plan, colliders: int):
        self.dx, phases = plan.dx, len(plan.phases)
        at = [plan.groups[one.group].phase for one in plan.driven]
        self.ways = _none(phases)
        self.ways.driven[at] = True
        self.ways.row[at] = colliders + np.arange(len(at))
        for p, one in zip(at, plan.driven, strict=True):
            self.ways.about[p] = one.about
        plans = plan.driven
        moving = [(p, one) for p, one in zip(at, plans, strict=True) if one.course is not None]
        self.phases = [p for p, _ in moving]
        courses = [one.course for one in plans if one.course is not None]
        self.courses = Courses(courses) if courses else None
        self.far = np.array([one.far for _, one in moving])
        self.ends = np.array([one.ends for _, one in moving])  # it is driven no farther

    def go(self, time: float, end: float, dt: float) -> None:
        """How they go from a time to another [s], dt [s] apart."""
        if self.courses is None:
            return
        before, move = self.courses.poses(time)
        after, there = self.courses.poses(end)
        ways, p = self.ways, self.phases
        # products written out: all ranks must agree, and a matrix product's rounding may differ
        turned = (after[:, :, None, :] * before[:, None, :, :]).sum(axis=3)
        ways.turn[p] = (turned - np.eye(3)) / dt
        ways.about[p] = self.courses.about + move
        ways.shift[p] = (there - move) / dt

    def rate(self, time: float, rate: float) -> float:
        """1 / dt [1/s], `rate` or more, of a step in which none goes farther than it may."""
        return rate if self.courses is None else shortened(self.travels, time, rate)

    def travels(self, t0: float, t1: float) -> float:
        """How far a particle that is driven goes between two times [s], at the most [cells]."""
        if self.courses is None:
            return 0.0
        gone = self.courses.travels(t0, t1, self.far)
        return float(np.where(self.ends > t0, gone, 0.0).max()) / self.dx
