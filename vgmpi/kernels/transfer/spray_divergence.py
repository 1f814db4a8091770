"""Divergence of sparse liquid: what its equation of state receives where it fills little of space.

A particle without neighbors is one mass with the nodes around it: with a pressure K theta its rate
of expansion changes by -(12 / dx^2) c^2 theta, 4 / dx^2 along each axis, where waves in a body of
liquid reach a third of that. So a lone drop would bound the steps of all liquids. Its volume has no
meaning: where the liquid fills little of the space around a particle, the volume ratio follows only
a part of the divergence. That divides the squared frequency, needs no further state and leaves
momentum as it is (docs/explanation/time-step.md).
"""

from vgmpi.runtime.jit import device_function

from .density_correction import clamp_to_unit

# [-] filled fraction of space below which the part falls, and at which it is least; on the flat
# surface of a liquid 0.61 to 0.66 is filled, at an edge 0.4 and around a lone drop 0.03
FULL_RESPONSE_FILL, LEAST_RESPONSE_FILL = 0.4, 0.1
LEAST_RESPONSE = 0.3  # [-] part of the divergence: a lone drop is stable up to sqrt(1 / 3 / 0.3)
INVERSE_RANGE = 1.0 / (FULL_RESPONSE_FILL - LEAST_RESPONSE_FILL)


@device_function
def reduce_spray_divergence(L, fill_fraction):
    """Return the velocity gradient that the equation of state of a liquid receives.

    Args:
        L: Velocity gradient, nine components, row by row [1/s].
        fill_fraction: Filled fraction of the space around the particle [-].
    """
    sparsity = clamp_to_unit((FULL_RESPONSE_FILL - fill_fraction) * INVERSE_RANGE)
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = L
    removed = ((1.0 - LEAST_RESPONSE) / 3.0) * sparsity * (c0 + c4 + c8)
    return (c0 - removed, c1, c2, c3, c4 - removed, c5, c6, c7, c8 - removed)
