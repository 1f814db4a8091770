"""Limits of one time step, and negligible masses; docs/explanation/time-step.md explains them.

The plain numbers stand in one place for kernels, engines and the solver. They are in this folder
because the cache of compiled code is named by its contents (runtime/jit.py): an edit here is seen.
"""

MAX_CELLS_PER_STEP = 0.3  # [cells] largest displacement of a particle in a step
MAX_VOLUME_STRAIN_PER_STEP = (
    0.1  # [-] largest relative volume change of a particle in a step: |tr C| dt
)
J_MIN, J_MAX = 0.1, 5.0  # [-] bounds of a particle's volume ratio; beyond them the run ends

# fractions of the mass of one full cell of the phase's lightest material
NODE_MASS_FLOOR = 1e-20  # [-] a lighter node holds rounding errors only, and stays at rest
# [-] A lighter node takes no part in contact: its sums (kernels/reproducible_sums.py) have fewer
# digits than a number in single precision, and directions would suffer.
CONTACT_MASS_FLOOR = 2.0**-21
