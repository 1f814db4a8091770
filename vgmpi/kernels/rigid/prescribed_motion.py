"""Prescribed motion of bodies as the grid sees it, step by step."""

from typing import NamedTuple

import numpy as np

from vgmpi.kernels.colliders.moving_colliders import limit_rate_by_motion
from vgmpi.kernels.step_records import StepSpan
from vgmpi.planning.plan import Plan
from vgmpi.scene.rigid_motion import Trajectories

ROTATED_CHANNELS = (
    "H",
    "F",
)  # channels that rotate with the body: F - I of the law, or stored in addition
EFFECTIVE_MASS_FACTOR = (
    2.0**60
)  # [-] factor on the mass of such bodies in contact: nothing deflects them


class PrescribedSteps(NamedTuple):
    """Prescribed displacement of a point x in a step: (turn (x - about) + shift) dt, by phase.

    Nodes that something else attaches are marked: colliders do not touch these bodies there.
    """

    driven: np.ndarray  # (phases,) bool, True if the motion is prescribed
    row: np.ndarray  # (phases,) row of the reactions, after all colliders; -1 for other phases
    about: np.ndarray  # (phases, 3) [m] center of rotation
    turn: np.ndarray  # (phases, 3, 3) [1/s] rotation minus identity, per time
    shift: np.ndarray  # (phases, 3) [m/s] translation per time
    reserved: np.ndarray = np.zeros((0, 64), np.uint8)  # (node blocks, 64), or without rows


def _none(phases: int) -> PrescribedSteps:
    """Return the steps of phases without prescribed motion."""
    return PrescribedSteps(
        np.zeros(phases, bool), np.full(phases, -1), np.zeros((phases, 3)),
        np.zeros((phases, 3, 3)), np.zeros((phases, 3)),
    )  # fmt: skip


NO_PRESCRIBED_BODIES = _none(0)


def turn_rates(before: np.ndarray, after: np.ndarray, dt: float) -> np.ndarray:
    """Return rotation minus identity, per time, between two rotations, shape (m, 3, 3) [1/s].

    The products are written out: all ranks must agree, and the rounding of a matrix product may
    differ.

    Args:
        before, after: Rotations at the beginning and the end of a step, shape (m, 3, 3).
        dt: Length of the step [s].
    """
    turned = (after[:, :, None, :] * before[:, None, :, :]).sum(axis=3)
    return (turned - np.eye(3)) / dt


class PrescribedBodies:
    """Bodies with prescribed motion; all ranks hold the same."""

    def __init__(self, plan: Plan, colliders: int):
        self.dx, phases = plan.dx, len(plan.phases)
        phase_of = [plan.groups[body.group].phase for body in plan.driven]
        self.motions = _none(phases)
        self.motions.driven[phase_of] = True
        self.motions.row[phase_of] = colliders + np.arange(len(phase_of))
        for p, body in zip(phase_of, plan.driven, strict=True):
            self.motions.about[p] = body.about
        plans = plan.driven
        moving = [
            (p, body) for p, body in zip(phase_of, plans, strict=True) if body.course is not None
        ]
        self.phases = [p for p, _ in moving]
        courses = [body.course for body in plans if body.course is not None]
        self.courses = Trajectories(courses) if courses else None
        self.max_radius = np.array([body.max_radius for _, body in moving])
        self.ends = np.array([body.ends for _, body in moving])  # [s] end of the prescribed motion

    def row_of_group(self, group: int, phase: int) -> int:
        """Return the row of a group's motion in `motions`, -1 if it is at rest.

        Args:
            group: Number of the group, unused.
            phase: Its phase.
        """
        return phase if phase in self.phases else -1

    def begin_step(self, span: StepSpan) -> None:
        """Set the displacements of a step."""
        if self.courses is None:
            return
        before, move = self.courses.poses(span.start)
        after, move_end = self.courses.poses(span.end)
        steps, p = self.motions, self.phases
        steps.turn[p] = turn_rates(before, after, span.dt)
        steps.about[p] = self.courses.about + move
        steps.shift[p] = (move_end - move) / span.dt

    def limit_rate(self, time: float, rate: float) -> float:
        """Return 1 / dt [1/s], at least `rate`, of a step in which no body moves too far."""
        return rate if self.courses is None else limit_rate_by_motion(self.travels, time, rate)

    def travels(self, t0: float, t1: float) -> float:
        """Return the largest travel [cells] of a prescribed particle between two times [s]."""
        if self.courses is None:
            return 0.0
        travel = self.courses.travels(t0, t1, self.max_radius)
        return float(np.where(self.ends > t0, travel, 0.0).max()) / self.dx
