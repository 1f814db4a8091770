"""Phase and group of a scene of rigid bodies alone: tables of the solver need at least one row."""

import numpy as np

from vgmpi.scene.scene import Scene

from .phases_and_groups import GroupPlan, PhasePlan, make_group


def idle_phase(scene: Scene, real: np.dtype) -> tuple[tuple[PhasePlan, ...], tuple[GroupPlan, ...]]:
    """Return a phase, and a group of a solid of the scene in it, both without particles."""
    name, solid = next((n, m) for n, m in scene.material.items() if m.family == "solid")
    mass = solid.bulk_density * scene.domain.cell**3
    phase = PhasePlan("rigid bodies", ("solid",), (), 0, mass, mass)
    return (phase,), (make_group(0, phase.name, name, solid, real),)
