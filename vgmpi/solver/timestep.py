"""The time step: the Courant bound of the last step's state, cut so that frame times are met
exactly.
"""

import math


def next_step(time: float, goal: float, bound: float) -> tuple[float, bool]:
    """(dt, whether it ends at `goal`): the rest of the way in equal steps of at most `bound` [s].

    Equal steps avoid a tiny last one. Only `time`, `goal` and `bound` enter, so every rank finds
    the same number.
    """
    left = goal - time
    steps = max(1, math.ceil(left / bound * (1.0 - 1e-12)))
    return (left, True) if steps == 1 else (left / steps, False)
