"""Bodies with prescribed motion in a step."""

import numpy as np

from vgmpi.features.active_feature import ActiveFeature, StartContext
from vgmpi.features.particle_insertion import bounds_of_idle_group
from vgmpi.kernels.rigid.prescribed_motion import PrescribedBodies
from vgmpi.kernels.step_records import ParticleBounds, StepSpan


class PrescribedMotion(ActiveFeature):
    """Prescribed bodies of a run; all ranks hold the same."""

    def __init__(self, context: StartContext):
        """Take the bodies."""
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


def start(context: StartContext) -> PrescribedMotion | None:
    """Return the prescribed bodies of a run, or None if it has none."""
    return None if context.prescribed is None else PrescribedMotion(context)
