"""Time steps that meet frame times exactly.

The stable step itself comes from the particles (`record_step_bounds` in kernels/transfer/g2p.py)
and from `Simulation.bound`.
"""

import math


def next_step(time: float, goal: float, bound: float) -> tuple[float, bool]:
    """Divide the time to `goal` into equal steps of at most `bound` [s].

    Equal steps avoid a tiny last one. The result depends on the arguments alone, so every rank
    finds the same number.

    Args:
        time: Current time [s].
        goal: Time that a step must meet exactly [s].
        bound: Largest stable time step [s].

    Returns:
        (dt, whether the step ends at `goal`).
    """
    remaining = goal - time
    steps = max(1, math.ceil(remaining / bound * (1.0 - 1e-12)))
    return (remaining, True) if steps == 1 else (remaining / steps, False)
