"""Numbers of steps between two corrections of motion, and between two shifts of particles."""

from vgmpi.scene.scene import Scene

from .step_costs import COSTS, StageCost, StepCosts

# Longer intervals cost less. If the shortest waves oscillate within an interval of the transfer
# correction, they regain more than they lost and grow (docs/benchmarks/extremes.md). The first is
# the longest interval [steps], the second the longest travel of a wave in it [cells].
MAX_CORRECTION_INTERVAL, MAX_WAVE_TRAVEL_CELLS = 3, 1.3
# The same of the shifts. They have a part of the transfer correction's sweep in common.
MAX_SHIFT_INTERVAL, MAX_SHIFT_TRAVEL_CELLS = 6, 2.41


def correction_interval(scene: Scene) -> int:
    """Return the number of steps between two transfer corrections, 0: never."""
    if not (scene.accuracy.corrects_transfers and scene.has_particles):
        return 0
    travel = int(MAX_WAVE_TRAVEL_CELLS / scene.courant_number)
    return max(1, min(MAX_CORRECTION_INTERVAL, travel))


def shift_interval(scene: Scene) -> int:
    """Return the number of steps between two shifts: whole intervals of the transfer correction."""
    interval = max(1, correction_interval(scene))
    travel = int(MAX_SHIFT_TRAVEL_CELLS / scene.courant_number)
    return interval * max(1, min(MAX_SHIFT_INTERVAL, travel) // interval)


def shift_cost(
    corrects_transfers: bool, interval: int, by_volume: bool, costs: StepCosts = COSTS
) -> StageCost:
    """Return the cost of particle shifting in steps of a fluid particle.

    Args:
        corrects_transfers: Whether the transfer correction makes the step of no time anyway.
        interval: Number of steps between two shifts.
        by_volume: Whether the liquids of the phase differ in density.
        costs: Costs of the parts of a step.
    """
    cost = costs.shift
    if by_volume:
        cost += costs.rest_volume
    if not corrects_transfers:
        cost += costs.correction
    return cost * (1.0 / interval)
