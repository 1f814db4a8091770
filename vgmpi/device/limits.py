"""What a step may do at the most, and what counts as nothing; docs/theory.md says why.

Plain numbers, in one place for kernels, engines and the solver. They lie in this folder because the
cache of compiled code is named by it (jit.py): an edit here is seen.
"""

FARTHEST = 0.3  # cells that a particle may move in a step
STRETCH = 0.1  # share of its volume that a particle may win or lose in a step: |tr C| dt
LEAST_J, MOST_J = 0.1, 5.0  # volume ratios a particle may have; beyond them the run ends

# shares of the mass of one full cell of the phase's lightest material
ROUNDING = 1e-20  # a node lighter than this holds rounding alone, and stays at rest
# a node lighter than this takes no part in contact: of lighter ones the sums (kernels/sums.py) hold
# fewer digits than a number in single precision, and directions would suffer
TOUCHING = 2.0**-21
