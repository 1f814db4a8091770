"""Bodies with prescribed motion in a step."""

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.features.particle_insertion import bounds_of_idle_group
from vgmpi.kernels.colliders.moving_colliders import limit_rate_by_motion
from vgmpi.kernels.rigid.prescribed_motion import no_motions, turn_rates
from vgmpi.kernels.step_records import ParticleBounds, StepSpan
from vgmpi.planning.plan import Plan
from vgmpi.scene.rigid_motion import Trajectories

from .plan import PrescribedBodyPlan, PrescribedMotionPlan


class PrescribedBodies:
    """Bodies with prescribed motion; all ranks hold the same."""

    def __init__(self, bodies: tuple[PrescribedBodyPlan, ...], plan: Plan, first_row: int):
        """Take the bodies and the row of the reactions of the first one."""
        self.dx, self.motions = plan.dx, no_motions(len(plan.phases))
        phase_of = [body.phase for body in bodies]
        self.motions.driven[phase_of] = True
        self.motions.row[phase_of] = first_row + np.arange(len(phase_of))
        for body in bodies:
            self.motions.about[body.phase] = body.about
        moving = [body for body in bodies if body.particles.course is not None]
        self.phases = [body.phase for body in moving]
        courses = [body.particles.course for body in moving if body.particles.course is not None]
        self.courses = Trajectories(courses) if courses else None
        self.max_radius = np.array([body.max_radius for body in moving])
        self.ends = np.array([body.ends for body in moving])  # [s] end of the prescribed motion

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


class PrescribedMotion(ActiveFeature):
    """Prescribed bodies of a run; all ranks hold the same."""

    def __init__(self, plan: PrescribedMotionPlan, context: StartContext):
        """Take the bodies."""
        self.rows = [body.phase for body in plan.bodies]
        self.plan, self.ranks, self.groups = context.plan, context.ranks, context.groups
        self.bodies: PrescribedBodies = context.prescribed

    def limit_rate(self, time: float, rate: float) -> float:
        """Return 1 / dt [1/s], at least `rate`, of a step in which no body moves too far."""
        # nothing else bounds a step while all bodies are prescribed
        return self.bodies.limit_rate(time, max(rate, 1.0 / float(self.plan.times[-1])))

    def begin_step(self, span: StepSpan) -> None:
        """Set the displacements of a step."""
        self.bodies.begin_step(span)

    def push_particles(self, span: StepSpan) -> float:
        """Return the largest speed [m/s] of a prescribed particle."""
        return self.plan.dx * self.bodies.travels(span.start, span.end) / span.dt

    def adjust_bounds(self, span: StepSpan, bounds: ParticleBounds) -> ParticleBounds:
        """Return the bounds of the next step; if all is prescribed, none of its length."""
        return bounds if bounds.rate else bounds_of_idle_group(self.plan)._replace(rate=0.0)

    def phase_entries(self) -> list[dict[str, float]]:
        """Return the present particles of each phase: released bodies change theirs. Collective."""
        counts = self.ranks.sum(np.array([len(group) for group in self.groups], np.int64))
        phases, groups = range(len(self.plan.phases)), self.plan.groups
        return [
            {"particles": sum(int(counts[g]) for g, group in enumerate(groups) if group.phase == p)}
            for p in phases
        ]

    def reaction_points(self) -> np.ndarray:
        """Return the present centers of rotation of the bodies, shape (bodies, 3) [m]."""
        return self.bodies.motions.about[self.rows]
