"""Overhead of a step: what it takes besides its particles, of which small runs take most."""

from vgmpi.planning.plan import Plan
from vgmpi.scene.scene import Scene

# [s] of processor time, from pilot runs (`python -m tests.benchmarks predictions`)
STEP_SECONDS = 1e-4  # a step of one phase (`python -m tests.benchmarks overhead`)
PHASE_SECONDS = 1.5e-4  # each further phase
COLLIDER_SECONDS = 1.5e-4  # a collider at rest
MOVING_COLLIDER_SECONDS = 1.5e-3  # one that moves


def step_overhead(scene: Scene, plan: Plan) -> float:
    """Return the processor time [s] of a step besides its particles.

    Args:
        scene: The scene.
        plan: Its plan.
    """
    colliders = [obj for obj in scene.object if obj.collider]
    moving = sum(obj.motion is not None for obj in colliders)
    moving += sum(feature.moved_colliders for feature in plan.features)
    return (
        STEP_SECONDS
        + PHASE_SECONDS * max(len(plan.phases) - 1, 0)
        + COLLIDER_SECONDS * (len(colliders) - moving)
        + MOVING_COLLIDER_SECONDS * moving
        + sum(feature.step_seconds for feature in plan.features)
    )
